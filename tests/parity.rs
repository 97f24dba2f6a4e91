//! The whole scene collection against the reference's committed results, ray for ray.
//!
//! f64 decides as the reference does at every event: counts are equal, maps and totals agree to rounding. Scenes in
//! which rounding decides paths are compared as samples of one distribution. f32 may decide otherwise for a ray that
//! passes an edge or a draw within its precision: such rays are counted.
#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "clippy's exemption of tests does not reach their helpers"
)]

#[path = "parity/agreement.rs"]
mod agreement;
#[path = "parity/chance.rs"]
mod chance;
#[path = "parity/kinds.rs"]
mod kinds;
#[path = "parity/oracle.rs"]
mod oracle;
mod zoo;

use std::collections::{BTreeMap, BTreeSet};

use agreement::Agreement;
use nsq_gpu::model::{DetectorKind, RayDatabase, SceneIr};
use nsq_gpu::program::Precision;
use nsq_gpu::result::{PathEvent, PathEventKind};
use nsq_gpu::run::RecordPaths;
use nsq_gpu::{TraceOptions, TraceResult};
use oracle::{Body, Oracle};

/// The seeds of our runs of chaotic scenes; the reference's runs have seeds of their own.
const CHAOTIC_SEEDS: std::ops::Range<u64> = 1000..1016;

/// A scene of the collection that keeps every row of its ray databases: which rows a cap keeps depends on the order
/// in which rays are traced, so the reference was traced without.
fn load_uncapped(name: &str) -> SceneIr {
    let mut ir = zoo::load(name);
    for detector in &mut ir.detectors {
        if let DetectorKind::RayDatabase(RayDatabase { max_rays, .. }) = &mut detector.kind {
            *max_rays = None;
        }
    }
    ir
}

fn oracle_options(oracle: &Oracle, precision: Precision) -> TraceOptions {
    zoo::options(oracle.num_rays, oracle.seed, precision)
}

fn trace_as(oracle: &Oracle, name: &str) -> TraceResult {
    zoo::result(&load_uncapped(name), &oracle_options(oracle, Precision::F64))
}

fn table_line(name: &str, agreement: &Agreement) -> String {
    let worst: Vec<String> =
        agreement.worst.iter().map(|(kind, value)| format!("{kind} {value:.1e}")).collect();
    format!("{name:28} {}", worst.join("  "))
}

// The reference.

#[test]
fn every_scene_has_a_committed_oracle_and_every_oracle_a_scene() {
    assert_eq!(zoo::scenes(), zoo::json_files("tests/oracle"));
}

#[test]
fn the_turns_have_every_scene_once() {
    for scene in 0..zoo::scenes().len() {
        let turns = (7..7 + zoo::NUM_TURNS).filter(|turn| zoo::is_of_turn(scene, *turn, zoo::NUM_TURNS));
        assert_eq!(turns.count(), 1, "{scene}");
    }
    // Each remainder of five tiers and of three is in each turn.
    for (turn, tiers) in (0..zoo::NUM_TURNS).flat_map(|turn| [(turn, 3), (turn, 5)]) {
        let of_turn = (0..zoo::scenes().len()).filter(|scene| zoo::is_of_turn(*scene, turn, zoo::NUM_TURNS));
        assert_eq!(of_turn.map(|scene| scene % tiers).collect::<BTreeSet<usize>>().len(), tiers, "{turn}");
    }
}

#[test]
fn f64_agrees_with_the_reference_ray_for_ray() {
    let mut violations = Vec::new();
    for name in zoo::scenes() {
        let oracle = oracle::load(&name);
        if oracle.chaotic {
            continue;
        }
        let result = trace_as(&oracle, &name);
        let agreement = Agreement::of(&result, &oracle);
        eprintln!("{}", table_line(&name, &agreement));
        if !result.ledger.closes() {
            violations
                .push(format!("{name}: the ledger is off by {} quanta", result.ledger.imbalance_quanta));
        }
        violations.extend(agreement.violations.iter().map(|violation| format!("{name}: {violation}")));
    }
    assert!(violations.is_empty(), "{} violations:\n{}", violations.len(), violations.join("\n"));
}

/// Mirrors, absorption, Gaussian beams, spectra, scattering, far fields and ray databases.
const IN_DF64: [&str; 8] = [
    "bench_lens",
    "cooke_triplet",
    "filter_stack",
    "hubble_nasmyth",
    "newtonian_telescope",
    "prism_spectrometer",
    "scattering_telescope",
    "tessar_gaussian_beams",
];

#[test]
fn df64_agrees_with_the_reference_ray_for_ray() {
    for name in zoo::in_turn(IN_DF64) {
        let oracle = oracle::load(name);
        let ir = load_uncapped(name);
        let options = oracle_options(&oracle, Precision::Df64);
        let result = zoo::result(&ir, &options);
        let agreement = Agreement::of(&result, &oracle);
        eprintln!("{}", table_line(name, &agreement));
        assert_eq!(agreement.violations, Vec::<String>::new(), "{name}");
        assert!(result.ledger.closes(), "{name}: off by {} quanta", result.ledger.imbalance_quanta);
        let few = zoo::options(10_000, 0, Precision::Df64);
        let wide = TraceOptions { precision: Precision::F64, ..few.clone() };
        assert_eq!(flips(&fates(&ir, &few), &fates(&ir, &wide)), 0, "{name}: fates");
    }
}

#[test]
fn chaotic_scenes_agree_with_the_reference_as_samples_of_one_distribution() {
    let mut num_chaotic = 0;
    for name in zoo::scenes() {
        let Some(statistics) = oracle::load(&name).statistics else {
            continue;
        };
        num_chaotic += 1;
        let ir = load_uncapped(&name);
        for precision in [Precision::F64, Precision::F32] {
            let runs = chaotic_runs(&ir, statistics.num_rays_per_run, precision);
            let (differences, figures) = chance::differences(&runs, &statistics);
            eprintln!("{name:28} {precision:?}: {figures} figures compared");
            assert!(differences.is_empty(), "{name} in {precision:?}: {differences:#?}");
            assert!(figures > 200, "{name}: only {figures} figures are compared");
        }
    }
    assert!(num_chaotic > 0, "no scene is chaotic, and this comparison proves nothing");
}

fn chaotic_runs(ir: &SceneIr, num_rays: u64, precision: Precision) -> Vec<TraceResult> {
    CHAOTIC_SEEDS.map(|seed| zoo::result(ir, &zoo::options(num_rays, seed, precision))).collect()
}

#[test]
fn a_chaotic_scene_with_a_dimmer_mirror_is_told_from_the_reference() {
    let name = zoo::scenes().into_iter().find(|name| oracle::load(name).chaotic).unwrap();
    let statistics = oracle::load(&name).statistics.unwrap();
    let mut ir = load_uncapped(&name);
    for surface in &mut ir.surfaces {
        if let nsq_gpu::model::Interaction::Reflective { reflectance } = &mut surface.interaction {
            reflectance.iter_mut().for_each(|reflectance| *reflectance *= 0.98);
        }
    }
    let runs = chaotic_runs(&ir, statistics.num_rays_per_run, Precision::F64);
    assert_ne!(chance::differences(&runs, &statistics).0, Vec::<String>::new());
}

#[test]
fn a_cap_keeps_the_last_rows_of_a_ray_database() {
    let ir = zoo::load("telephoto_spectral");
    let options = zoo::options(5000, 0, Precision::F64);
    let capped = zoo::result(&ir, &options);
    let whole = zoo::result(&load_uncapped("telephoto_spectral"), &options);
    let rows = |result: &TraceResult| {
        result
            .detectors
            .iter()
            .find_map(|detector| match &detector.data {
                nsq_gpu::result::DetectorData::RayDatabase(rays) => {
                    Some((detector.num_rays_hit, rays.truncated, rays.columns().unwrap()))
                }
                _ => None,
            })
            .unwrap()
    };
    let ((hits, truncated, kept), (all_hits, all_truncated, all)) = (rows(&capped), rows(&whole));
    assert_eq!(hits, all_hits);
    assert_eq!(kept.flux.len(), 100);
    let last = all.flux.len() - 100;
    assert_eq!(kept.ray_id.to_vec(), all.ray_id.to_vec()[last..]);
    assert_eq!(kept.flux.to_vec(), all.flux.to_vec()[last..]);
    assert!(truncated && !all_truncated);
}

// The events.

/// The events of each ray, in order: what happened where, and how it ended.
type Fates = BTreeMap<u64, Vec<PathEventKind>>;

fn fates(ir: &SceneIr, options: &TraceOptions) -> Fates {
    let options = TraceOptions { paths: RecordPaths::All, ..options.clone() };
    let mut fates = Fates::new();
    for PathEvent { ray, kind } in zoo::trace(ir, &options).paths {
        fates.entry(ray.ray_id).or_default().push(kind);
    }
    fates
}

fn is_interaction(kind: &PathEventKind) -> bool {
    matches!(kind, PathEventKind::Surface(_) | PathEventKind::Detector(_))
}

fn interactions(fates: &Fates) -> usize {
    fates.values().flatten().filter(|kind| is_interaction(kind)).count()
}

fn surface_hits(ir: &SceneIr, fates: &Fates) -> BTreeMap<String, u64> {
    let mut hits: BTreeMap<String, u64> =
        ir.surfaces.iter().map(|surface| (surface.name.clone(), 0)).collect();
    for kind in fates.values().flatten() {
        if let PathEventKind::Surface(surface) = kind {
            *hits.get_mut(&ir.surfaces[*surface].name).unwrap() += 1;
        }
    }
    hits
}

/// Rays whose fates differ.
fn flips(ours: &Fates, theirs: &Fates) -> usize {
    assert_eq!(ours.len(), theirs.len(), "both sides recorded every ray");
    ours.iter().filter(|(ray, fate)| theirs.get(ray) != Some(fate)).count()
}

#[test]
fn every_surface_is_hit_as_often_as_in_the_reference() {
    let mut differ = Vec::new();
    for (_, name) in zoo::scenes_in_turn() {
        let oracle = oracle::load(&name);
        if oracle.chaotic {
            continue;
        }
        let ir = zoo::load(&name);
        let fates = fates(&ir, &oracle_options(&oracle, Precision::F64));
        if surface_hits(&ir, &fates) != oracle.surface_hits {
            differ.push(format!("{name}: {:?}, not {:?}", surface_hits(&ir, &fates), oracle.surface_hits));
        }
        let per_ray = interactions(&fates) as f64 / oracle.num_rays as f64;
        if (per_ray - oracle.interactions_per_ray).abs() > 1e-9 {
            differ.push(format!("{name}: {per_ray} interactions a ray, not {}", oracle.interactions_per_ray));
        }
    }
    assert!(differ.is_empty(), "{}", differ.join("\n"));
}

#[test]
fn f32_changes_the_fate_of_less_than_one_ray_in_1e5_interactions() {
    const LIMIT: f64 = 1e-5;
    const NUM_RAYS: u64 = 20_000;
    let (mut all_flips, mut all_interactions) = (0, 0);
    for name in zoo::scenes().into_iter().filter(|name| !oracle::load(name).chaotic) {
        let ir = zoo::load(&name);
        let [wide, narrow] = [Precision::F64, Precision::F32]
            .map(|precision| fates(&ir, &zoo::options(NUM_RAYS, 0, precision)));
        let (flips, interactions) = (flips(&narrow, &wide), interactions(&wide));
        eprintln!(
            "{name:28} {flips:3} flips in {interactions:7}: {:.1e}",
            flips as f64 / interactions as f64
        );
        all_flips += flips;
        all_interactions += interactions;
    }
    let rate = all_flips as f64 / all_interactions as f64;
    eprintln!("{:28} {all_flips:3} flips in {all_interactions:7}: {rate:.1e}", "all");
    assert!(rate < LIMIT, "{all_flips} fates differ in {all_interactions} interactions: {rate:.2e}");
}

#[test]
fn a_changed_event_is_a_flip() {
    let ir = zoo::load("bench_lens");
    let options = zoo::options(100, 0, Precision::F64);
    let ours = fates(&ir, &options);
    let mut other = ours.clone();
    assert_eq!(flips(&ours, &other), 0);
    other.get_mut(&17).unwrap().pop();
    assert_eq!(flips(&ours, &other), 1);
}

// Recorded paths.

/// `tests/data/paths.json`, written by `python/tools/make_paths_oracle.py`.
#[derive(serde::Deserialize)]
struct PathsOracle {
    num_rays: u64,
    num_recorded: u64,
    seed: u64,
    scenes: BTreeMap<String, Vec<OracleEvent>>,
}

/// One event; `numbers` are x, y, z, L, M, N, flux, wavelength.
#[derive(Debug, Clone, PartialEq, serde::Deserialize)]
struct OracleEvent {
    ray_id: i64,
    event_type: String,
    bounce: i32,
    component_name: String,
    numbers: [f64; 8],
}

fn paths_oracle() -> PathsOracle {
    serde_json::from_str(&std::fs::read_to_string(zoo::repository("tests/data/paths.json")).unwrap()).unwrap()
}

fn recorded_paths(name: &str, oracle: &PathsOracle) -> Vec<OracleEvent> {
    let paths = RecordPaths::About(oracle.num_recorded);
    let options = TraceOptions { paths, ..zoo::options(oracle.num_rays, oracle.seed, Precision::F64) };
    let recorded = zoo::result(&zoo::load(name), &options).ray_paths.unwrap().columns().unwrap();
    let event = |i: usize| {
        let ([x, y, z], [l, m, n]) = (&recorded.position, &recorded.direction);
        let (flux, wavelength) = (recorded.flux[i], recorded.wavelength[i]);
        OracleEvent {
            ray_id: recorded.ray_id[i],
            event_type: recorded.event_type[i].to_string(),
            bounce: recorded.bounce[i],
            component_name: recorded.component_name[i].clone(),
            numbers: [x[i], y[i], z[i], l[i], m[i], n[i], flux, wavelength],
        }
    };
    (0..recorded.flux.len()).map(event).collect()
}

/// The first difference of two lists of events: positions to 1e-9 of the largest coordinate, flux to 1e-9 of itself.
fn path_difference(ours: &[OracleEvent], theirs: &[OracleEvent]) -> Option<String> {
    const LIMIT: f64 = 1e-9;
    if ours.len() != theirs.len() {
        return Some(format!("{} events, not {}", ours.len(), theirs.len()));
    }
    let coordinates = theirs.iter().flat_map(|event| &event.numbers[..3]);
    let extent = coordinates.fold(1e-300_f64, |largest, x| largest.max(x.abs()));
    ours.iter().zip(theirs).find_map(|(mine, other)| {
        let scales = [extent, extent, extent, 1.0, 1.0, 1.0, other.numbers[6].abs().max(1e-300), 1.0];
        let near = |i: usize| (mine.numbers[i] - other.numbers[i]).abs() <= LIMIT * scales[i];
        let same = (mine.ray_id, &mine.event_type, mine.bounce, &mine.component_name)
            == (other.ray_id, &other.event_type, other.bounce, &other.component_name);
        (!same || !(0..8).all(near)).then(|| format!("{mine:?}, not {other:?}"))
    })
}

#[test]
fn recorded_paths_are_those_of_the_reference() {
    let oracle = paths_oracle();
    assert!(oracle.scenes.len() >= 3);
    for (name, events) in &oracle.scenes {
        assert_eq!(path_difference(&recorded_paths(name, &oracle), events), None, "{name}");
    }
}

#[test]
fn a_recorded_path_that_differs_in_anything_is_reported() {
    let events = &paths_oracle().scenes["double_gauss"];
    let changes: [fn(&mut OracleEvent); 5] = [
        |event| event.ray_id += 1,
        |event| event.bounce += 1,
        |event| event.component_name.push('x'),
        |event| event.numbers[0] += 1e-6,
        |event| event.numbers[6] *= 1.0 + 1e-8,
    ];
    assert_eq!(path_difference(events, events), None);
    for change in changes {
        let mut other = events.clone();
        change(&mut other[20]);
        assert!(path_difference(&other, events).is_some());
    }
    assert!(path_difference(&events[1..], events).is_some());
}

// What the collection covers.

#[test]
fn the_collection_is_large_and_deep_and_real() {
    let oracles: Vec<Oracle> = zoo::scenes().iter().map(|name| oracle::load(name)).collect();
    assert!(oracles.len() >= 14, "{} scenes", oracles.len());
    let mean = oracles.iter().map(|oracle| oracle.interactions_per_ray).sum::<f64>() / oracles.len() as f64;
    assert!(mean >= 6.0, "{mean} interactions a ray on average");
    assert!(oracles.iter().all(|oracle| oracle.num_rays == 100_000));
    let readme = std::fs::read_to_string(zoo::repository("scenes/README.md")).unwrap();
    let converted = |name: &&String| {
        let start = format!("| `{name}` | ");
        let line = readme.lines().find_map(|line| line.strip_prefix(&start));
        line.is_some_and(|line| line.starts_with("Converted sample:") || line.starts_with("Sample:"))
    };
    assert!(zoo::scenes().iter().filter(converted).count() >= 6);
}

#[test]
fn every_kind_of_source_shape_and_detector_is_in_two_scenes() {
    let mut scenes_with: BTreeMap<&str, BTreeSet<String>> = BTreeMap::new();
    for name in zoo::scenes() {
        let ir = zoo::load(&name);
        let sources = ir.sources.iter().map(kinds::of_source);
        let shapes = ir.surfaces.iter().map(|surface| kinds::of_shape(&surface.shape));
        let detectors = ir.detectors.iter().map(kinds::of_detector);
        for kind in sources.chain(shapes).chain(detectors) {
            scenes_with.entry(kind).or_default().insert(name.clone());
        }
    }
    let kinds = kinds::SOURCES.iter().chain(&kinds::SHAPES).chain(&kinds::DETECTORS);
    let rare: Vec<_> =
        kinds.filter(|kind| scenes_with.get(**kind).is_none_or(|names| names.len() < 2)).collect();
    assert!(rare.is_empty(), "in fewer than two scenes: {rare:?}");
}

#[test]
fn every_kind_of_finish_is_in_a_scene() {
    let irs: Vec<SceneIr> = zoo::scenes().iter().map(|name| zoo::load(name)).collect();
    let found: BTreeSet<&str> = irs.iter().flat_map(|ir| &ir.surfaces).flat_map(kinds::of_finish).collect();
    assert_eq!(found, BTreeSet::from(kinds::FINISHES));
    let transmits = |fraction: f64| (0.01..0.99).contains(&fraction);
    let scatters = irs.iter().flat_map(|ir| &ir.surfaces).filter_map(|surface| surface.scatter.as_ref());
    assert!(scatters.filter(|scatter| transmits(scatter.bsdf.transmissive_fraction())).count() >= 3);
}

// The comparison can fail.

#[test]
fn every_planted_difference_is_reported() {
    let oracle = oracle::load("filter_stack");
    let result = trace_as(&oracle, "filter_stack");
    assert_eq!(Agreement::of(&result, &oracle).violations, Vec::<String>::new());
    for (what, plant) in PLANTED {
        let mut other = oracle.clone();
        plant(&mut other);
        assert!(!Agreement::of(&result, &other).violations.is_empty(), "a planted difference passed: {what}");
    }
}

type Plant = (&'static str, fn(&mut Oracle));

/// One difference for each thing compared, just above its limit.
const PLANTED: [Plant; 18] = [
    ("one ray more escaped", |oracle| oracle.totals.num_rays_escaped += 1),
    ("one ray more absorbed", |oracle| oracle.totals.num_rays_absorbed += 1),
    ("a total", |oracle| oracle.totals.total_flux_detected *= 1.0 + 3e-11),
    ("a small total", |oracle| oracle.totals.total_flux_lost += 1e-10 * oracle.totals.total_flux_in),
    ("the conservation error", |oracle| oracle.flux_conservation_error += 1e-10),
    ("an unreached surface", |oracle| oracle.diagnostics.unreached_geometry.push("face".into())),
    ("an underflow", |oracle| oracle.diagnostics.medium_stack_underflows += 1),
    ("a roulette fraction", |oracle| oracle.diagnostics.rr_killed_flux_fraction += 1e-10),
    ("a diagnosed detector", |oracle| oracle.diagnostics.detectors[1].num_rays_hit += 1),
    ("a missing detector", |oracle| drop(oracle.detectors.pop_first())),
    ("a hit", |oracle| oracle.detectors.get_mut("rest").unwrap().num_rays_hit += 1),
    ("a detector's flux", |oracle| oracle.detectors.get_mut("rest").unwrap().total_flux *= 1.0 + 3e-11),
    ("a bin of a whole map", |oracle| bin_of(oracle, "returned", |map| map.values.as_mut().unwrap())),
    ("a bin of a large map", |oracle| bin_of(oracle, "behind", |map| map.bin_values.as_mut().unwrap())),
    ("a sum of a large map", |oracle| {
        bin_of(oracle, "behind", |map| &mut map.axis_sums.as_mut().unwrap()[1])
    }),
    ("an axis", |oracle| map_of(oracle, "rest").axis_ends.get_mut("theta").unwrap()[1] += 1e-9),
    ("a row's sum", |oracle| rows_of(oracle).column_sums[3] += 1e-5),
    ("a row", |oracle| rows_of(oracle).first_rows[7][2] += 1e-5),
];

fn map_of<'a>(oracle: &'a mut Oracle, detector: &str) -> &'a mut oracle::MapDigest {
    match &mut oracle.detectors.get_mut(detector).unwrap().body {
        Body::Map(map) => map,
        Body::Rows(_) => panic!("{detector} is a ray database"),
    }
}

fn rows_of(oracle: &mut Oracle) -> &mut oracle::RowsDigest {
    match &mut oracle.detectors.get_mut("between").unwrap().body {
        Body::Rows(rows) => rows,
        Body::Map(_) => panic!("it is a map"),
    }
}

fn bin_of(oracle: &mut Oracle, detector: &str, values: fn(&mut oracle::MapDigest) -> &mut Vec<f64>) {
    let map = map_of(oracle, detector);
    let peak = map.peak;
    *values(map).last_mut().unwrap() += 2e-9 * peak;
}
