//! The checks that mutants must fail, found by name: `<kind> <scene>[, setting]...`, or a closed form's own name.

use crate::bench::{Bench, Setting, precision, scene};
use crate::closed_forms;
use crate::oracle::Oracle;
use nsq_gpu::ir::{Sensor, Splat};
use nsq_gpu::program::Precision;
use nsq_gpu::result::{PathEventKind, Tally};
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
    /// A scene whose result is known in closed form.
    ClosedForm(fn(&Bench) -> Outcome),
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
        let (kind, scene) = name.split_once(' ').unwrap_or_else(|| panic!("no check is named {name}"));
        let scene = Scene::parse(scene);
        match kind {
            "parity" => Check::Parity(scene),
            "ledger" => Check::Ledger(scene),
            "same_bits" => Check::SameBits(scene),
            "paths" => Check::Paths(scene),
            "hits" => Check::Hits(scene),
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
            Check::ClosedForm(check) => check(bench),
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
                ("baked", _) => setting.options.baked = Some(true),
                ("table", _) => {
                    setting.options.baked = Some(false);
                    setting.options.tree = Some(false);
                }
                ("tree", _) => setting.options.baked = Some(false),
                ("queued", _) => setting.options.events_per_dispatch = 3,
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
        Precision::F64 => oracle.compare(&result),
        Precision::F32 => oracle.compare_roughly(&result),
    }
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
    let mut other = first.clone();
    other.native = false;
    other.options.batch_size = Some(7_777);
    other.options.events_per_dispatch = 3;
    if bench.tally(&ir, &first) == bench.tally(&ir, &other) { Ok(()) } else { Err("the sums differ".into()) }
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
    for (i, sensor) in tally.sensors.iter().enumerate() {
        expected.insert(label(PathEventKind::Sensor(i)), sensor.total().count);
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
    let sharp = |sensor: &Sensor| sensor.kind.grid().is_some_and(|grid| grid.splat == Splat::Hard);
    let sensors: Vec<_> = ir.sensors.iter().zip(&tally.sensors).filter(|(sensor, _)| sharp(sensor)).collect();
    if sensors.is_empty() {
        return Err("no detector of the scene keeps a ray in one pixel".into());
    }
    for (sensor, sums) in sensors {
        let lit = |cell: &usize| (sums.quanta[*cell] > 0) != (sums.hits[*cell] > 0);
        if let Some(cell) = (0..sums.quanta.len()).find(lit) {
            return Err(format!("{}: cell {cell} has hits without flux, or flux without hits", sensor.name));
        }
    }
    Ok(())
}
