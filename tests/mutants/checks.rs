//! The checks that mutants must fail, found by name: `<kind> <scene>[, setting]...`, or a closed form's own name.

use crate::bench::{Bench, Setting, precision, scene};
use crate::closed_forms;
use crate::oracle::Oracle;
use nsq_gpu::StandardError;
use nsq_gpu::bench::stability::{StabilityCase, cases};
use nsq_gpu::model::{Detector, DetectorKind, SceneIr, Splat};
use nsq_gpu::program::Precision;
use nsq_gpu::result::{DetectorTally, PathEventKind, Tally};
use nsq_gpu::software::When;
use nsq_gpu::trace::RecordPaths;
use std::collections::BTreeMap;

/// A check; its error says what was wrong.
pub type Outcome = Result<(), String>;

/// A named check.
pub enum Check {
    /// Agreement with what Optiland computed.
    Parity(Scene),
    /// Every quantum is accounted for.
    Ledger(Scene),
    /// The sums are the same integers whatever the setting.
    SameBits(Scene),
    /// Recorded paths tell what the sums tell.
    Paths(Scene),
    /// Where no flux is spread over pixels, the lit pixels are those that were hit.
    Hits(Scene),
    /// Second moments are those of whole rays, each seen alone.
    Squares(Scene),
    /// A scene whose result is known in closed form.
    ClosedForm(fn(&Bench) -> Outcome),
    /// A case of benches/stability/cases.json.
    Stability(Box<StabilityCase>, Precision),
}

/// A scene and how it is traced.
pub struct Scene {
    name: String,
    setting: Setting,
}

impl Check {
    /// Finds a check.
    pub fn named(name: &str) -> Self {
        if let Some(check) = closed_forms::named(name) {
            return Check::ClosedForm(check);
        }
        if let Some((case, tier)) = name.strip_prefix("stability ").and_then(|rest| rest.rsplit_once(", in "))
        {
            let found = cases().unwrap().into_iter().find(|known| known.name == case);
            let case = found.unwrap_or_else(|| panic!("no case is named {case}"));
            return Check::Stability(Box::new(case), precision(tier).unwrap());
        }
        let (kind, scene) = name.split_once(' ').unwrap_or_else(|| panic!("no check is named {name}"));
        let scene = Scene::parse(scene);
        match kind {
            "parity" => Check::Parity(scene),
            "ledger" => Check::Ledger(scene),
            "same_bits" => Check::SameBits(scene),
            "paths" => Check::Paths(scene),
            "hits" => Check::Hits(scene),
            "squares" => Check::Squares(scene),
            _ => panic!("no check is named {name}"),
        }
    }

    /// Runs it.
    pub fn run(&self, bench: &Bench) -> Outcome {
        match self {
            Check::Parity(scene) => parity(bench, scene),
            Check::Ledger(scene) => ledger(bench, scene),
            Check::SameBits(scene) => same_bits(bench, scene),
            Check::Paths(scene) => paths(bench, scene),
            Check::Hits(scene) => hits(bench, scene),
            Check::Squares(scene) => squares(bench, scene),
            Check::ClosedForm(check) => check(bench),
            Check::Stability(case, precision) => stability(bench, case, *precision),
        }
    }
}

impl Scene {
    fn parse(text: &str) -> Self {
        let mut words = text.split(", ");
        let name = words.next().unwrap_or_default().to_string();
        let mut setting = Setting::default();
        for word in words {
            match (word, precision(word)) {
                (_, Some(precision)) => setting.options.precision = precision,
                ("portable", _) => setting.native = false,
                ("logged", _) => {
                    setting.choices.host_sums = When::Always;
                    setting.choices.rays_per_invocation = Some(8);
                }
                ("main_path", _) => {
                    setting.choices.host_sums = When::Always;
                    setting.choices.main_path = When::Always;
                    setting.choices.stores_together = When::Never;
                    setting.options.standard_error = StandardError::Off;
                }
                ("together", _) => setting.choices.stores_together = When::Always,
                ("sides", _) => setting.choices.side_paths = When::Always,
                ("baked", _) => setting.options.baked = Some(true),
                ("table", _) => {
                    setting.options.baked = Some(false);
                    setting.options.tree = Some(false);
                }
                ("tree", _) => setting.options.baked = Some(false),
                ("queued", _) => {
                    setting.options.events_per_dispatch = 3;
                    // With second moments, no ray outlives a dispatch where detectors let rays pass.
                    setting.options.standard_error = StandardError::Off;
                }
                _ => panic!("no setting is named {word}"),
            }
        }
        Scene { name, setting }
    }
}

fn parity(bench: &Bench, scene_of: &Scene) -> Outcome {
    let mut setting = scene_of.setting.clone();
    let oracle = Oracle::load(&scene_of.name);
    setting.options.num_rays = oracle.num_rays();
    let result = bench.result(&scene(&scene_of.name), &setting);
    match setting.options.precision {
        Precision::F64 | Precision::Df64 => oracle.compare(&result),
        Precision::F32 => oracle.compare_roughly(&result),
    }
}

fn stability(bench: &Bench, case: &StabilityCase, precision: Precision) -> Outcome {
    let setting = Setting { options: case.options(precision), ..Setting::default() };
    let read = case.read(&bench.result(&case.scene().unwrap(), &setting));
    let faults = case.faults(precision, &read.map_err(|error| error.to_string())?);
    if faults.is_empty() { Ok(()) } else { Err(faults.join("; ")) }
}

fn ledger(bench: &Bench, scene_of: &Scene) -> Outcome {
    let mut setting = scene_of.setting.clone();
    setting.options.num_rays = 20_000;
    let ledger = bench.result(&scene(&scene_of.name), &setting).ledger;
    if ledger.closes() { Ok(()) } else { Err(format!("{} quanta are missing", ledger.imbalance_quanta)) }
}

/// Batches of another size, with and without queue, native and portable integers.
fn same_bits(bench: &Bench, scene_of: &Scene) -> Outcome {
    let ir = scene(&scene_of.name);
    let mut first = scene_of.setting.clone();
    first.options.num_rays = 20_000;
    first.options.standard_error = StandardError::Off;
    let mut other = first.clone();
    other.native = false;
    other.choices.host_sums = When::Never;
    other.choices.stores_together = When::ItPays;
    other.choices.rays_per_invocation = Some(1);
    other.options.batch_size = Some(7_777);
    other.options.events_per_dispatch = 3;
    if bench.tally(&ir, &first) == bench.tally(&ir, &other) { Ok(()) } else { Err("the sums differ".into()) }
}

/// The scene with few pixels, so that rays come by the same again and taps fall beyond the map; then with all its sources.
fn squares(bench: &Bench, scene_of: &Scene) -> Outcome {
    let ir = scene(&scene_of.name);
    for num_pixels in [3, 1] {
        let mut lone = ir.clone();
        // Of several sources, one step would launch several rays.
        lone.sources.truncate(1);
        for detector in &mut lone.detectors {
            if let DetectorKind::Irradiance(grid) = &mut detector.kind {
                (grid.num_pixels_x, grid.num_pixels_y) = (num_pixels, num_pixels);
            }
        }
        squares_of_rays(bench, &lone, &scene_of.setting)?;
    }
    totals_of_sources(bench, &ir, &scene_of.setting)
}

/// The sources' sums on each detector add up to what it took.
fn totals_of_sources(bench: &Bench, ir: &SceneIr, setting: &Setting) -> Outcome {
    let mut setting = setting.clone();
    setting.options.standard_error = StandardError::On;
    for detector in &bench.tally(ir, &setting).detectors {
        let quanta: u128 = detector.totals.iter().map(|total| total.quanta).sum();
        if quanta != detector.total().quanta {
            return Err(format!("the sources' sums add up to {quanta}, not {}", detector.total().quanta));
        }
    }
    Ok(())
}

/// The squares of what each ray adds to every cell and detector, ray by ray, against the device's sums of squares.
fn squares_of_rays(bench: &Bench, ir: &SceneIr, setting: &Setting) -> Outcome {
    let mut setting = setting.clone();
    setting.options.num_rays = 100;
    setting.options.batch_size = Some(1);
    setting.options.standard_error = StandardError::On;
    let snapshots = bench.ray_by_ray(ir, &setting);
    let weight = |quanta: u128| quanta as f64 / 2_f64.powi(52);
    let last = snapshots.last().ok_or("no ray was traced")?;
    for (index, detector) in last.detectors.iter().enumerate() {
        let expected = |value: &dyn Fn(&DetectorTally) -> u128| -> f64 {
            let of_ray = |pair: &[Tally]| value(&pair[1].detectors[index]) - value(&pair[0].detectors[index]);
            snapshots.windows(2).map(|pair| weight(of_ray(pair)).powi(2)).sum()
        };
        let agrees = |what: String, found: u128, expected: f64| {
            let found = weight(found);
            let agree = (found - expected).abs() <= 1e-9 * expected + 1e-12;
            if agree { Ok(()) } else { Err(format!("{what}: {found} for {expected}")) }
        };
        for cell in 0..detector.quanta.len() {
            agrees(
                format!("cell {cell}"),
                detector.squares[cell],
                expected(&|detector| detector.quanta[cell]),
            )?;
        }
        let total = detector.totals.iter().map(|total| total.squares).sum();
        agrees("the total".into(), total, expected(&|detector| detector.total().quanta))?;
    }
    Ok(())
}

/// Counts of each kind of event against the counts of the trace.
fn paths(bench: &Bench, scene_of: &Scene) -> Outcome {
    let mut setting = scene_of.setting.clone();
    setting.options.paths = RecordPaths::All;
    let ir = scene(&scene_of.name);
    let oracle = Oracle::load(&scene_of.name);
    setting.options.num_rays = oracle.num_rays();
    let tally = bench.tally(&ir, &setting);
    let mut events: BTreeMap<String, u64> = BTreeMap::new();
    for event in &tally.paths {
        *events.entry(label(event.kind)).or_default() += 1;
    }
    let mut expected = fates(&tally);
    for (i, surface) in ir.surfaces.iter().enumerate() {
        expected.insert(label(PathEventKind::Surface(i)), oracle.surface_hits(&surface.name));
    }
    for (i, detector) in tally.detectors.iter().enumerate() {
        expected.insert(label(PathEventKind::Detector(i)), detector.total().count);
    }
    expected.retain(|_, count| *count > 0);
    if events == expected { Ok(()) } else { Err(format!("{events:?} instead of {expected:?}")) }
}

fn fates(tally: &Tally) -> BTreeMap<String, u64> {
    [
        (PathEventKind::Birth(0), tally.launched.count),
        (PathEventKind::Escaped, tally.escaped.count),
        (PathEventKind::DepthKilled, tally.depth_killed.count),
        (PathEventKind::FluxKilled, tally.roulette_loss.count),
    ]
    .map(|(kind, count)| (label(kind), count))
    .into()
}

fn label(kind: PathEventKind) -> String {
    format!("{kind:?}")
}

fn hits(bench: &Bench, scene_of: &Scene) -> Outcome {
    let ir = scene(&scene_of.name);
    let tally = bench.tally(&ir, &scene_of.setting);
    let sharp = |detector: &Detector| detector.kind.grid().is_some_and(|grid| grid.splat == Splat::Hard);
    let detectors: Vec<_> =
        ir.detectors.iter().zip(&tally.detectors).filter(|(detector, _)| sharp(detector)).collect();
    if detectors.is_empty() {
        return Err("no detector of the scene keeps a ray in one pixel".into());
    }
    for (detector, sums) in detectors {
        let lit = |cell: &usize| (sums.quanta[*cell] > 0) != (sums.hits[*cell] > 0);
        if let Some(cell) = (0..sums.quanta.len()).find(lit) {
            return Err(format!(
                "{}: cell {cell} has hits without flux, or flux without hits",
                detector.name
            ));
        }
    }
    Ok(())
}
