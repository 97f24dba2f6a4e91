//! The ledger closes to the last bit: every scene with every sampling policy, in precisions and kinds of integers by turns.
#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "clippy's exemption of tests does not reach their helpers"
)]

mod zoo;

use nsq_gpu::model::{DetectorKind, Interaction, ReflectProb, Sampling, SceneIr, Splat};
use nsq_gpu::program::Precision;
use nsq_gpu::result::Tally;
use nsq_gpu::{Error, TraceOptions};
use zoo::forced::Asked;

const POLICIES: [ReflectProb; 4] =
    [ReflectProb::Fresnel, ReflectProb::Auto, ReflectProb::Constant(0.3), ReflectProb::Constant(0.02)];
/// Roulette almost never, and from four tenths of a new ray's weight on.
const ROULETTE_STARTS: [f64; 2] = [1e-3, 0.4];

/// Every scene with every policy and start of roulette, and of the precisions and kinds of integers each combination in
/// turn: over the scenes, all meet all.
fn assert_ledgers_close(precision: Precision, native: bool) {
    let gpu = if native { zoo::gpu() } else { zoo::portable_gpu() };
    for (k, name) in zoo::scenes_in_turn() {
        let mut ir = zoo::load(&name);
        let refracts = ir.surfaces.iter().any(|surface| surface.interaction == Interaction::Refractive);
        // Without refraction every policy makes the same program.
        let num_policies = if refracts { POLICIES.len() } else { 1 };
        for (i, policy) in POLICIES.into_iter().enumerate().take(num_policies) {
            for (j, start) in ROULETTE_STARTS.into_iter().enumerate() {
                let turn = (i + 2 * j + k) % 4;
                if turn != 2 * usize::from(native) + usize::from(precision == Precision::F64) {
                    continue;
                }
                ir.sampling.reflect_prob = policy;
                ir.sampling.rr_start_flux = start;
                let options = zoo::options(1500, 6, precision);
                let tally = zoo::trace_on(gpu, &ir, &options);
                let ledger = zoo::result_of(&ir, &options, &tally).ledger;
                let what = format!("{name}, {precision:?}, {policy:?}, roulette from {start}");
                assert_eq!(ledger.imbalance_quanta, 0, "{what}");
                assert_eq!(ledger.invalid_deposits, 0, "{what}");
            }
        }
    }
}

#[test]
#[ignore = "long"]
fn ledgers_close_in_f32_with_native_integers() {
    assert_ledgers_close(Precision::F32, true);
}

#[test]
fn ledgers_close_in_f32_with_pairs_of_integers() {
    assert_ledgers_close(Precision::F32, false);
}

#[test]
fn ledgers_close_in_f64_with_native_integers() {
    assert_ledgers_close(Precision::F64, true);
}

#[test]
#[ignore = "long"]
fn ledgers_close_in_f64_with_pairs_of_integers() {
    assert_ledgers_close(Precision::F64, false);
}

/// Branches of all sizes: gains of up to 50 before a split, roulette between splits, budgets that are used up. Of every so
/// many scenes one is traced.
fn check_split_rays(every: usize) {
    let refracts = |ir: &SceneIr| ir.surfaces.iter().any(|s| s.interaction == Interaction::Refractive);
    let scenes =
        zoo::scenes().into_iter().map(|name| (zoo::load(&name), name)).filter(|(ir, _)| refracts(ir));
    for (i, (mut ir, name)) in scenes.enumerate().step_by(every) {
        let reflect_prob = POLICIES[i % POLICIES.len()];
        ir.sampling = Sampling { reflect_prob, rr_start_flux: 0.1, split_depth: 4, split_budget: 3.5 };
        let precision = [Precision::F64, Precision::F32, Precision::Df64][i % 3];
        let options = zoo::options(500, 6, precision);
        let tally = zoo::trace(&ir, &options);
        let ledger = zoo::result_of(&ir, &options, &tally).ledger;
        assert_eq!((ledger.imbalance_quanta, ledger.invalid_deposits), (0, 0), "{name}, {precision:?}");
    }
}

#[test]
fn some_ledgers_close_where_rays_are_split() {
    check_split_rays(4);
}

#[test]
#[ignore = "long"]
fn every_ledger_closes_where_rays_are_split() {
    check_split_rays(1);
}

/// Traces what makes more iterations of loops than lavapipe allows: where they are cut, the trace is refused with this advice.
/// Unnoticed, `is_wrong` tells.
fn assert_cut_loops_are_refused(
    ir: &SceneIr,
    options: &TraceOptions,
    advice: &str,
    is_wrong: impl Fn(&Tally) -> bool,
) {
    let trace =
        |edit: fn(String) -> String| options.tracer_with(zoo::gpu(), ir, edit).unwrap().trace(|_| true);
    match trace(|wgsl| wgsl) {
        Ok(tally) => assert!(!is_wrong(&tally), "a driver that cuts nothing"),
        Err(Error::Device(message)) => {
            assert!(message.contains(advice), "{message}");
            let unnoticed =
                trace(|wgsl| zoo::replaced(&wgsl, "iterations < wanted", "iterations > wanted")).unwrap();
            assert!(is_wrong(&unnoticed), "the loops were cut");
        }
        Err(other) => panic!("{other}"),
    }
}

#[test]
fn a_family_beyond_the_drivers_loops_is_refused() {
    let mut ir = zoo::load("stacked_plates_ghosts");
    ir.sampling = Sampling {
        reflect_prob: ReflectProb::Fresnel,
        rr_start_flux: 0.0,
        split_depth: 14,
        split_budget: 15.0,
    };
    let options =
        TraceOptions { max_depth: 60, min_flux_fraction: 0.0, ..zoo::options(8, 0, Precision::F64) };
    let is_open = |tally: &Tally| !zoo::result_of(&ir, &options, tally).ledger.closes();
    assert_cut_loops_are_refused(&ir, &options, "a split_depth below 14 or a split_budget below 15", is_open);
}

/// The rows that are never reached leave their share to the pixel in the middle, and the ledger closes.
#[test]
fn a_splat_beyond_the_drivers_loops_is_refused() {
    let mut ir = zoo::load("bench_lens");
    let DetectorKind::Irradiance(grid) = &mut ir.detectors[0].kind else { panic!("the scene has changed") };
    grid.splat = Splat::Gaussian { sigma: 50.0 };
    let options = zoo::options(8, 0, Precision::F64);
    let most = |tally: &Tally| *tally.detectors[0].quanta.iter().max().unwrap();
    let all = |tally: &Tally| tally.detectors[0].quanta.iter().sum::<u128>();
    let has_peak = |tally: &Tally| 100 * most(tally) > all(tally);
    assert_cut_loops_are_refused(&ir, &options, "a smaller splat_sigma", has_peak);
}

#[test]
fn a_single_quantum_astray_opens_the_ledger() {
    let ir = zoo::load("kaleidoscope");
    let options = zoo::options(1500, 6, Precision::F64);
    let tally = zoo::trace(&ir, &options);
    assert!(zoo::result_of(&ir, &options, &tally).ledger.closes());
    let mut other = tally.clone();
    other.roulette_gain.quanta += 1;
    assert_eq!(zoo::result_of(&ir, &options, &other).ledger.imbalance_quanta, 1);
}
