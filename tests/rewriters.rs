//! The compilers over naga's modules, rule by rule: pairs of f32 in place of f64, tangents, and adjoints. Small functions are
//! rewritten and run. What they find is compared with the textbook's derivatives, which are compared with differences.

#![allow(clippy::unwrap_used, clippy::panic, clippy::print_stdout, reason = "a test fails by panicking")]

mod common;
#[path = "rewriters/generated.rs"]
mod generated;
#[path = "rewriters/harness.rs"]
mod harness;
#[path = "rewriters/number.rs"]
mod number;
#[path = "rewriters/planted.rs"]
mod planted;
#[path = "rewriters/rules.rs"]
mod rules;

use common::Gpu;
use generated::{May, Program};
use harness::{Function, Inputs};
use nsq_gpu::program::layout::rng::splitmix64;
use nsq_gpu::program::wgsl::library::{Integers, Real};
use number::{Dual, NUM_INPUTS, with_largest};
use rules::{RULES, Rule};
use std::path::Path;

/// Numbers from -2 to 2.
fn points(seed: u64, num: usize) -> Vec<Inputs> {
    let number = |i: u64| splitmix64(seed.wrapping_mul(1 << 32) + i) as f64 / 2_f64.powi(62) - 2.0;
    (0..num as u64).map(|p| std::array::from_fn(|i| number(p * NUM_INPUTS as u64 + i as u64))).collect()
}

/// The points of all rules: random ones, then the edges of each.
fn points_of(rules: &[&Rule]) -> Vec<Inputs> {
    let mut all = points(1, 64);
    all.extend(rules.iter().flat_map(|rule| rule.edges));
    all
}

/// What is wrong with numbers that were found, if anything is.
fn fault(found: &[f64], wanted: &[f64], tolerance: f64) -> Option<String> {
    let is_close = |(found, wanted): (&f64, &f64)| (found - wanted).abs() <= tolerance;
    (!found.iter().zip(wanted).all(is_close)).then(|| format!("{found:?}, not {wanted:?}"))
}

/// What is wrong at a point with a value and tangents, which are to be those of a reference, and with adjoints.
fn faults_at(
    (value, tangents): (f64, Inputs),
    wanted: &Dual,
    [adjoints, wanted_adjoints]: [&Inputs; 2],
    tolerance: f64,
) -> Vec<String> {
    let all = [
        ("value", fault(&[value], &[wanted.value], tolerance)),
        ("tangents", fault(&tangents, &wanted.slopes, tolerance)),
        ("adjoints", fault(adjoints, wanted_adjoints, tolerance)),
    ];
    all.into_iter().filter_map(|(what, fault)| Some(format!("{what}: {}", fault?))).collect()
}

/// The rules that a tier has.
fn of_tier(real: Real) -> Vec<&'static Rule> {
    RULES.iter().filter(|rule| rule.df64 || real == Real::F64).collect()
}

/// Faults of values and derivatives, by tangents and by adjoints. Rules without the library stand in a module of their own,
/// because the library's `dot` takes three reals.
fn faults_of_rules(gpu: &Gpu, real: Real, tolerance: f64) -> Vec<String> {
    let needs_library = |rule: &&Rule| harness::needs_library(&rule.function().text);
    let (with_library, without): (Vec<_>, Vec<_>) = of_tier(real).into_iter().partition(needs_library);
    [with_library, without].iter().flat_map(|rules| faults_of(gpu, real, rules, tolerance)).collect()
}

fn faults_of(gpu: &Gpu, real: Real, rules: &[&Rule], tolerance: f64) -> Vec<String> {
    let functions: Vec<Function> = rules.iter().map(|rule| rule.function()).collect();
    let points = points_of(rules);
    let forward = harness::by_tangents(gpu, real, &functions, &points);
    let back = harness::by_adjoints(gpu, real, &functions, &points);
    let mut faults = Vec::new();
    for (i, rule) in rules.iter().enumerate() {
        for (p, point) in points.iter().enumerate() {
            let (wanted, largest) = with_largest(|| (rule.value)(Dual::inputs(point), p as u32));
            let found = faults_at(forward[i][p], &wanted, [&back[i][p], &wanted.slopes], tolerance * largest);
            faults.extend(found.into_iter().map(|fault| format!("{} at {point:?}, {fault}", rule.name)));
        }
    }
    faults
}

fn gpu(test: &str, real: Real) -> Option<Gpu> {
    Gpu::open(test, real, Integers::Portable)
}

#[test]
fn each_rule_has_the_textbooks_derivative() {
    let Some(gpu) = gpu("each_rule_has_the_textbooks_derivative", Real::F64) else { return };
    let faults = faults_of_rules(&gpu, Real::F64, 2e-14);
    assert!(faults.is_empty(), "{}", faults.join("\n"));
}

#[test]
fn each_rule_holds_in_pairs_of_f32() {
    let Some(gpu) = gpu("each_rule_holds_in_pairs_of_f32", Real::Df64) else { return };
    let faults = faults_of_rules(&gpu, Real::Df64, 1e-12);
    assert!(faults.is_empty(), "{}", faults.join("\n"));
}

/// The textbook itself, by differences.
#[test]
fn the_textbook_agrees_with_differences() {
    const STEP: f64 = 1e-5;
    let mut num_agreeing = 0;
    let mut faults = Vec::new();
    for rule in RULES.iter().filter(|rule| {
        ![
            "said_to_vary_otherwise",
            "said_to_be_constant",
            "a_note",
            "a_loop_that_notes",
            "a_loop_that_notes_an_argument",
        ]
        .contains(&rule.name)
    }) {
        for (p, point) in points(2, 64).iter().enumerate() {
            let value = |point: &Inputs| (rule.value)(Dual::inputs(point), p as u32).value;
            let slopes = (rule.value)(Dual::inputs(point), p as u32).slopes;
            for (i, slope) in slopes.iter().enumerate() {
                let moved =
                    |by: f64| value(&std::array::from_fn(|j| if i == j { point[j] + by } else { point[j] }));
                let [one_way, other_way] = [moved(STEP) - value(point), value(point) - moved(-STEP)];
                // Between two points that lie on either side of a kink there is no derivative.
                if (one_way - other_way).abs() > 1e-3 * STEP {
                    continue;
                }
                num_agreeing += 1;
                let difference = (one_way + other_way) / (2.0 * STEP);
                if (difference - slope).abs() > 1e-7 * (1.0 + slope.abs()) {
                    faults.push(format!("{} at {point:?} by {i}: {difference}, not {slope}", rule.name));
                }
            }
        }
    }
    assert!(faults.is_empty(), "{}", faults.join("\n"));
    assert!(num_agreeing > RULES.len() * 64 * NUM_INPUTS * 8 / 10, "{num_agreeing}");
}

/// Checks programs made by chance: values and tangents beside the reference, and adjoints beside tangents.
fn check_programs(gpu: &Gpu, real: Real, programs: impl Iterator<Item = Program>, tolerance: f64) {
    const NUM_POINTS: usize = 24;
    let (mut num_programs, mut num_varying) = (0, 0);
    for program in programs {
        num_programs += 1;
        let function = [program.function()];
        let points = points(num_programs, NUM_POINTS);
        let forward = &harness::by_tangents(gpu, real, &function, &points)[0];
        let back = &harness::by_adjoints(gpu, real, &function, &points)[0];
        for (p, point) in points.iter().enumerate() {
            let (wanted, largest) = with_largest(|| program.value(point, p as u32));
            num_varying += usize::from(wanted.slopes.iter().any(|slope| slope.abs() > 1e-6));
            let tangents = forward[p].1;
            let faults = faults_at(forward[p], &wanted, [&back[p], &tangents], tolerance * largest);
            let text = &function[0].text;
            assert!(faults.is_empty(), "at {point:?}, n = {p}: {}\n{text}", faults.join("\n"));
        }
    }
    assert!(num_varying > num_programs as usize * NUM_POINTS * 8 / 10, "{num_varying} of {num_programs}");
}

fn programs(seeds: std::ops::Range<u64>, may: May) -> impl Iterator<Item = Program> {
    seeds.map(move |seed| Program::by_chance(seed, may))
}

#[test]
fn functions_made_by_chance_have_equal_derivatives_both_ways() {
    let test = "functions_made_by_chance_have_equal_derivatives_both_ways";
    let Some(gpu) = gpu(test, Real::F64) else { return };
    check_programs(&gpu, Real::F64, programs(0..96, May { library: false, fused: true, seen: true }), 1e-12);
    check_programs(&gpu, Real::F64, programs(96..112, May { library: true, fused: true, seen: true }), 1e-12);
}

#[test]
fn functions_made_by_chance_hold_in_pairs_of_f32() {
    let Some(gpu) = gpu("functions_made_by_chance_hold_in_pairs_of_f32", Real::Df64) else { return };
    let all = programs(200..260, May { library: true, fused: false, seen: true });
    // A longer one takes lavapipe a minute to compile.
    let short = all.filter(|program| program.function().text.len() < 2500);
    check_programs(&gpu, Real::Df64, short.take(12), 1e-11);
}

#[test]
fn references_of_functions_made_by_chance_agree_with_differences() {
    const STEP: f64 = 1e-5;
    let (mut num_agreeing, mut num_all) = (0, 0);
    for seed in 0..400 {
        let program = Program::by_chance(seed, May { library: true, fused: true, seen: false });
        for (p, point) in points(seed, 8).iter().enumerate() {
            let n = p as u32;
            let (wanted, largest) = with_largest(|| program.value(point, n));
            let here = program.loss(point, n);
            for i in 0..NUM_INPUTS {
                num_all += 1;
                let moved = |by: f64| {
                    program.loss(&std::array::from_fn(|j| point[j] + if i == j { by } else { 0.0 }), n)
                };
                let [one_way, other_way] = [moved(STEP) - here, here - moved(-STEP)];
                // Kinks and large curvature.
                if (one_way - other_way).abs() > 1e-4 * STEP * largest {
                    continue;
                }
                num_agreeing += 1;
                let difference = (one_way + other_way) / (2.0 * STEP);
                let off = (difference - wanted.slopes[i]).abs();
                assert!(
                    off < 1e-6 * largest,
                    "{difference}, not {wanted:?} by {i} at {point:?}: {}",
                    program.function().text
                );
            }
        }
    }
    assert!(num_agreeing > num_all * 8 / 10, "{num_agreeing} of {num_all}");
}

/// Every operation of every rewritten function is spoilt in turn, and the comparison must notice.
#[test]
#[ignore = "long"]
fn an_operation_planted_wrong_is_found() {
    let Some(gpu) = gpu("an_operation_planted_wrong_is_found", Real::F64) else { return };
    let rules: Vec<&Rule> =
        RULES.iter().filter(|rule| !harness::needs_library(&rule.function().text)).collect();
    let functions: Vec<Function> = rules.iter().map(|rule| rule.function()).collect();
    let points = points_of(&rules);
    let wanted: Vec<Vec<(Dual, f64)>> = rules
        .iter()
        .map(|rule| {
            let of = |(p, point)| with_largest(|| (rule.value)(Dual::inputs(point), p as u32));
            (0..).zip(&points).map(|(p, point)| of((p, point))).collect()
        })
        .collect();
    let (_, forward) = harness::forward(Real::F64, &functions, points.len() * NUM_INPUTS);
    let (_, back) = harness::back(Real::F64, &functions, points.len());
    let (mut num_planted, mut unseen) = (0, Vec::new());
    for (suffix, text) in [("_with_tangents", &forward), ("_backward", &back)] {
        for turn in 0.. {
            let mut spoilt = text.clone();
            let mut which = Vec::new();
            for (i, function) in functions.iter().enumerate() {
                if let Some(what) = planted::spoil(&mut spoilt, &format!("{}{suffix}", function.name), turn) {
                    which.push((i, what));
                }
            }
            if which.is_empty() {
                break;
            }
            let found: Vec<Vec<(Option<f64>, Inputs)>> = match suffix {
                "_backward" => harness::run_back(&gpu, Real::F64, &spoilt, functions.len(), &points)
                    .into_iter()
                    .map(|rows| rows.into_iter().map(|slopes| (None, slopes)).collect())
                    .collect(),
                _ => harness::run_forward(&gpu, Real::F64, &spoilt, functions.len(), &points)
                    .into_iter()
                    .map(|rows| rows.into_iter().map(|(value, slopes)| (Some(value), slopes)).collect())
                    .collect(),
            };
            for (i, what) in which {
                num_planted += 1;
                let is_seen = found[i].iter().zip(&wanted[i]).any(|((value, slopes), (wanted, largest))| {
                    let tolerance = 2e-14 * largest;
                    let is_off = |value: &f64| fault(&[*value], &[wanted.value], tolerance).is_some();
                    value.as_ref().is_some_and(is_off) || fault(slopes, &wanted.slopes, tolerance).is_some()
                });
                if !is_seen {
                    unseen.push(format!("{}{suffix}: {what}", functions[i].name));
                }
            }
        }
    }
    println!("{num_planted} planted, {} unseen:\n{}", unseen.len(), unseen.join("\n"));
    assert!(num_planted > 300, "{num_planted}");
    assert!(
        unseen.len() * 50 < num_planted,
        "{} of {num_planted} unseen:\n{}",
        unseen.len(),
        unseen.join("\n")
    );
}

/// What the compilers write for three functions, to be read where it changes: `NSQ_GPU_UPDATE_SNAPSHOTS=1` takes it anew.
#[test]
fn rewritten_functions_are_as_reviewed() {
    const NAMES: [&str; 3] = ["branches", "a_struct", "behind_a_pointer"];
    let functions: Vec<Function> =
        RULES.iter().filter(|rule| NAMES.contains(&rule.name)).map(Rule::function).collect();
    let plain = harness::parsed(&harness::plain_text(Real::Df64, &functions, 8));
    let texts = [
        ("tangents", harness::forward(Real::F64, &functions, 8).1),
        ("adjoints", harness::back(Real::F64, &functions, 1).1),
        ("df64", nsq_gpu::program::rewrite::df64::rewrite(&plain).unwrap().1),
    ];
    for (compiler, text) in texts {
        let found =
            planted::functions_of(&text, &["branches", "a_struct", "behind_a_pointer", "moved", "scaled_by"]);
        let path =
            Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("tests/snapshots/rewritten_{compiler}.wgsl"));
        if std::env::var_os("NSQ_GPU_UPDATE_SNAPSHOTS").is_some() {
            std::fs::write(&path, &found).unwrap();
        }
        let reviewed = std::fs::read_to_string(&path).unwrap_or_default();
        assert!(
            found == reviewed,
            "{} differs; NSQ_GPU_UPDATE_SNAPSHOTS=1 takes this:\n{found}",
            path.display()
        );
    }
}
