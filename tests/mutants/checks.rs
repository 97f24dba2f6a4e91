//! The checks that mutants must fail, found by name: `<kind> <scene>[, setting]...`, or a closed form's own name.

use crate::bench::{Bench, Setting, precision, scene};
use crate::closed_forms;
use crate::oracle::Oracle;
use crate::stability::{StabilityCase, cases};
use nsq_gpu::StandardError;
use nsq_gpu::cpu::Override;
use nsq_gpu::engine::options::DEFAULT_PATH_ROWS;
use nsq_gpu::model::surface_optics::splits;
use nsq_gpu::model::{Detector, DetectorKind, End, Interaction, PathFilter, SceneIr, Sequence, Splat};
use nsq_gpu::paths::maps::{PathMaps, Watched};
use nsq_gpu::program::Precision;
use nsq_gpu::result::light_paths::PlaceMoments;
use nsq_gpu::result::{DetectorTally, PathEventKind, Tally};
use nsq_gpu::result::{FluxSum, PathSum};
use nsq_gpu::run::{Collect, RecordPaths};
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
    /// The rows of the table of paths are those of all light, with the sequences that rays took.
    PathSums(Scene),
    /// A filter of paths keeps the light of the rows that match.
    PathFilter(Scene),
    /// Maps of paths add up to the detectors', and their light lies where the maps have it.
    PathMaps(Scene),
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
            "path_sums" => Check::PathSums(scene),
            "path_filter" => Check::PathFilter(scene),
            "path_maps" => Check::PathMaps(scene),
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
            Check::PathSums(scene) => path_sums(bench, scene),
            Check::PathFilter(scene) => path_filter(bench, scene),
            Check::PathMaps(scene) => path_maps(bench, scene),
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
                    setting.overrides.deferred_splats = Override::Always;
                    setting.overrides.rays_per_invocation = Some(8);
                }
                ("hot_path", _) => {
                    setting.overrides.deferred_splats = Override::Always;
                    setting.overrides.hot_path = Override::Always;
                    setting.options.standard_error = StandardError::Off;
                }
                ("sides", _) => setting.overrides.side_traces = Override::Always,
                ("baked", _) => setting.options.baked = Some(true),
                ("table", _) => {
                    setting.options.baked = Some(false);
                    setting.options.tree = Some(false);
                }
                ("tree", _) => setting.options.baked = Some(false),
                ("many", _) => setting.options.num_rays = 200_000,
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

/// Counts and quanta of every end are those of the ledger. Where each ray ends in one cell, so are the squares.
fn path_sums(bench: &Bench, scene_of: &Scene) -> Outcome {
    let ir = scene(&scene_of.name);
    let mut setting = scene_of.setting.clone();
    setting.options.collect = Collect::Paths { rows: DEFAULT_PATH_ROWS, ends: true };
    if setting.options.num_rays == Setting::default().options.num_rays {
        setting.options.num_rays = 20_000;
    }
    setting.options.standard_error = StandardError::On;
    if setting.options.events_per_dispatch == 3 {
        setting.options.standard_error = StandardError::Off;
    }
    let tally = bench.path_tally(&ir, &setting)?;
    let sums = tally.path_sums.as_ref().ok_or("no table")?;
    let mut ends: Vec<(End, FluxSum)> = vec![
        (End::Missed, tally.escaped),
        (End::DepthLimit, tally.depth_killed),
        (End::Roulette, tally.roulette_loss),
    ];
    ends.extend((0..).zip(&tally.detectors).map(|(number, sums)| (End::Detector(number), sums.total())));
    let absorbing = (0..).zip(&ir.surfaces).filter(|(_, s)| s.interaction == Interaction::Absorbing);
    ends.extend(
        absorbing.map(|(number, _)| (End::Absorbed(number), tally.surfaces[number as usize].absorbed)),
    );
    for (end, expected) in ends {
        let found = sums.total(end);
        if (found.count, found.quanta) != (expected.count, expected.quanta) {
            return Err(format!("{end:?} has {found:?}, not {expected:?}"));
        }
    }
    if !sums.other.is_empty() {
        return Err("light has no row".into());
    }
    for (number, (detector, sums_of)) in (0..).zip(ir.detectors.iter().zip(&tally.detectors)) {
        let squares: u128 = sums_of.totals.iter().map(|moments| moments.squares).sum();
        let found = sums.total(End::Detector(number)).squares;
        if detector.absorb && !splits(&ir) && !sums_of.totals.is_empty() && squares != found {
            return Err(format!("squares of detector {number} add up to {found}, not to {squares}"));
        }
    }
    Ok(())
}

/// Rows, counts and quanta of a filtered trace are those rows of the whole that match on the host.
fn path_filter(bench: &Bench, scene_of: &Scene) -> Outcome {
    let ir = scene(&scene_of.name);
    let mut setting = scene_of.setting.clone();
    setting.options.collect = Collect::paths();
    setting.options.num_rays = 20_000;
    let whole = Bench::of_originals().path_tally(&ir, &setting)?;
    let filter = PathFilter::parse("reflections >= 2 or scatterings > 0", &ir).map_err(|e| e.to_string())?;
    setting.options.path_filter = Some(filter.clone().into());
    let tally = bench.path_tally(&ir, &setting)?;
    let rows = |tally: &Tally| tally.path_sums.clone().unwrap_or_default().rows;
    let kept = rows(&whole).into_iter().filter(|(sequence, _)| filter.keeps(sequence));
    if !kept.eq(rows(&tally)) {
        return Err("the rows are not those that match".into());
    }
    let total = |tally: &Tally, absorb: bool| {
        let detectors =
            ir.detectors.iter().zip(&tally.detectors).filter(|(detector, _)| detector.absorb == absorb);
        detectors.fold(FluxSum::default(), |mut sum, (_, sums)| {
            sum += sums.total();
            sum
        })
    };
    let mut ended = total(&tally, true);
    ended += tally.filtered_out;
    if ended != total(&whole, true) {
        return Err(format!("{ended:?} ended on detectors, not {:?}", total(&whole, true)));
    }
    Ok(())
}

/// Each row of the first detector has a map. The maps have the rows' quanta, and together the detector's; where light
/// lies, by the sums of places, is where the pixels of the map are.
fn path_maps(bench: &Bench, scene_of: &Scene) -> Outcome {
    let ir = scene(&scene_of.name);
    let mut setting = scene_of.setting.clone();
    setting.options.collect = Collect::paths();
    setting.options.num_rays = 20_000;
    setting.options.standard_error = StandardError::Off;
    let tally = Bench::of_originals().path_tally(&ir, &setting)?;
    let sums = tally.path_sums.clone().unwrap_or_default();
    let is_on_first = |(sequence, _): &(&Sequence, &PathSum)| sequence.end == End::Detector(0);
    let rows: Vec<(&Sequence, &PathSum)> = sums.rows.iter().filter(is_on_first).collect();
    let about = [1.25, -0.5];
    let watched: Vec<Watched> =
        (0..).zip(&rows).map(|(map, (sequence, _))| Watched { sequence, about, map: Some(map) }).collect();
    let PathMaps { tally: second, places, .. } = bench.path_maps(&ir, &setting, &tally, &watched);
    let grid = ir.detectors[0].kind.grid().copied().ok_or("no pixels")?;
    let num_cells = ir.detectors[0].num_cells();
    let mut whole = vec![0; num_cells];
    for (map, (_, sum)) in rows.iter().enumerate() {
        let cells = &second.detectors[0].replicates[map * num_cells..(map + 1) * num_cells];
        if cells.iter().sum::<u128>() != sum.quanta {
            return Err(format!("map {map} has not the light of its path"));
        }
        whole.iter_mut().zip(cells).for_each(|(sum, cell)| *sum += cell);
        let parts = [(**sum, places[map])];
        let (centroid, radius) = PlaceMoments::spot(&parts).ok_or("no place")?;
        let (mut first, mut second) = ([0.0; 2], 0.0);
        let pitch = [grid.width / f64::from(grid.num_pixels_x), grid.height / f64::from(grid.num_pixels_y)];
        for (cell, quanta) in cells.iter().enumerate().filter(|(_, quanta)| **quanta > 0) {
            let place = [cell % grid.num_pixels_x as usize, cell / grid.num_pixels_x as usize];
            let half = [0.5 * grid.width, 0.5 * grid.height];
            let at = [0, 1].map(|axis| (place[axis] as f64 + 0.5) * pitch[axis] - half[axis]);
            let share = *quanta as f64 / sum.quanta as f64;
            [0, 1].into_iter().for_each(|axis| first[axis] += share * at[axis]);
            second += share * (at[0].powi(2) + at[1].powi(2));
        }
        let radius_of_map = (second - first[0].powi(2) - first[1].powi(2)).max(0.0).sqrt();
        let slack = pitch[0].max(pitch[1]);
        let is_off = |axis: usize| (centroid[axis] - first[axis]).abs() > slack;
        if is_off(0) || is_off(1) || (radius - radius_of_map).abs() > slack {
            return Err(format!(
                "path {map} lies at {centroid:?} +- {radius}, its map at {first:?} +- {radius_of_map}"
            ));
        }
    }
    if whole != tally.detectors[0].quanta {
        return Err("the maps do not add up to the detector's".into());
    }
    Ok(())
}

/// Batches of another size, with and without queue, native and portable integers.
fn same_bits(bench: &Bench, scene_of: &Scene) -> Outcome {
    let ir = scene(&scene_of.name);
    let mut first = scene_of.setting.clone();
    first.options.num_rays = 20_000;
    first.options.standard_error = StandardError::Off;
    let mut other = first.clone();
    other.native = false;
    other.overrides.deferred_splats = Override::Never;
    other.overrides.rays_per_invocation = Some(1);
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
