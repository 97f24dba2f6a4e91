//! Which path light took: from the sums of a trace to a table, with maps of the strongest paths by a second trace.

use crate::engine::options::TraceOptions;
use crate::error::Result;
use crate::gpu::Gpu;
use crate::model::{SceneIr, Sequence};
use crate::paths::maps::{PathMaps, WantedMaps, Watched, trace_maps};
use crate::program::Sampler;
use crate::result::detectors::bins::pixel_area;
use crate::result::light_paths::{Group, PlaceMoments, groups};
use crate::result::{
    Detector, DetectorTally, FluxSum, FluxUnit, Grouping, LightPath, PathSum, PathTable, PathTally,
    Recoating, Sorting, Tally,
};
use glam::DVec3;
use std::collections::HashMap;

/// Most cells of all maps in one trace.
const MOST_CELLS: usize = 1 << 25;

/// Most cells of all maps that are kept when their peaks are known.
const MOST_KEPT_CELLS: usize = 1 << 27;

/// How a table is made.
#[derive(Debug, Clone, Default)]
pub struct TableOptions {
    /// Which sequences make a row.
    pub group: Grouping,
    /// By what rows are sorted.
    pub sort: Sorting,
    /// The detector whose light is listed, by its number; all if none.
    pub detector: Option<usize>,
    /// So many rows, from the first on, have a map, and with it a peak.
    pub num_maps: usize,
    /// Rays were guided: rows have what that was worth.
    pub is_guided: bool,
    /// Coatings of faces that the rows have in the place of the trace's.
    pub recoating: Recoating,
}

/// The map of a row's light on its detector.
#[derive(Debug, Clone, PartialEq)]
pub struct PathMap {
    /// The detector's number.
    pub detector: usize,
    /// The detector's sums of the row's light.
    pub sums: DetectorTally,
}

/// A table, and the maps of its first rows.
#[derive(Debug)]
pub struct Traced {
    /// The table.
    pub table: PathTable,
    /// The maps, by the rows' ranks less 1; none for light that ended on no detector, or on one without a map.
    pub maps: Vec<Option<PathMap>>,
    /// Per row, a sequence of the row.
    pub sequences: Vec<Sequence>,
    /// False if the second trace was ended before its last ray.
    pub is_whole: bool,
}

/// The unit of flux of a trace.
pub fn flux_unit(ir: &SceneIr, tally: &Tally, num_rays: u64) -> FluxUnit {
    FluxUnit::of_scene(ir, tally.launched.count.min(num_rays))
}

/// The table of a tally, without maps.
pub fn table(
    ir: &SceneIr,
    tally: &Tally,
    unit: FluxUnit,
    sampler: Sampler,
    options: &TableOptions,
) -> PathTable {
    let Some(sums) = &tally.path_sums else { return PathTable::default() };
    let groups = listed(ir, tally, sums, unit, sampler, options);
    let rows = groups.into_iter().map(|group| group.row);
    PathTable::new(ir, sums, unit, options.group, options.detector, rows, &options.recoating)
}

/// The map of a row as the result of a detector of this name.
///
/// # Errors
/// [`crate::Error::Internal`] if the map is not one of this scene.
pub fn detector_of(
    ir: &SceneIr,
    tally: &Tally,
    unit: FluxUnit,
    map: &PathMap,
    row: &LightPath,
    name: String,
) -> Result<Detector> {
    let detector = crate::model::Detector { name, ..ir.detectors[map.detector].clone() };
    let recorded = FluxSum { count: row.num_rays, quanta: 0 };
    let cells = DetectorTally { recorded, hits: vec![0; map.sums.quanta.len()], ..map.sums.clone() };
    let found = Detector::of_part(ir, tally, unit, &detector, &cells)?;
    Ok(Detector { few_rays: row.few_rays, title: Some(row.title()), ..found })
}

/// The rows that are listed: the rows of one detector, or all.
pub(crate) fn listed<'a>(
    ir: &SceneIr,
    tally: &Tally,
    sums: &'a PathTally,
    unit: FluxUnit,
    sampler: Sampler,
    options: &TableOptions,
) -> Vec<Group<'a>> {
    let has_errors = sampler == Sampler::Pcg;
    let all = groups(ir, tally, sums, unit, options.group, has_errors, &options.recoating);
    let is_listed = |group: &Group| {
        options.detector.is_none_or(|detector| group.sequences[0].end.detector() == Some(detector))
    };
    let launched = unit.watts(tally.launched.quanta);
    let row = |rank, row: LightPath| {
        let row = LightPath { rank, ..row };
        if options.is_guided && options.recoating.is_empty() { row.with_worth(launched) } else { row }
    };
    (1..)
        .zip(all.into_iter().filter(is_listed))
        .map(|(rank, group)| Group { row: row(rank, group.row), ..group })
        .collect()
}

/// The table of a tally, with maps of its first rows from a second trace of the same rays. `found` has a point where a ray
/// of each sequence arrived ([`crate::Tracer::found_paths`]). `keep_going` is asked after each dispatch.
///
/// # Errors
/// [`crate::Error::Device`] if the device fails.
pub fn table_with_maps(
    gpu: &Gpu,
    ir: &SceneIr,
    trace: &TraceOptions,
    tally: &Tally,
    found: &HashMap<&Sequence, DVec3>,
    options: &TableOptions,
    mut keep_going: impl FnMut() -> bool,
) -> Result<Traced> {
    let empty = PathTally::default();
    let sums = tally.path_sums.as_ref().unwrap_or(&empty);
    let unit = flux_unit(ir, tally, trace.num_rays);
    let groups = listed(ir, tally, sums, unit, trace.sampler, options);
    let num_cells: usize = ir.detectors.iter().map(|detector| detector.num_cells().max(1)).sum();
    let per_trace = (MOST_CELLS / num_cells).clamp(1, options.num_maps.max(1));
    let num_maps = options.num_maps.min(groups.len());
    let mut maps: Vec<Option<PathMap>> = Vec::new();
    let mut peaks: Vec<Option<f64>> = Vec::new();
    let mut places: HashMap<&Sequence, PlaceMoments> = HashMap::new();
    let mut is_whole = true;
    // At least one trace, which finds where the light of all rows lies.
    for first in (0..num_maps.max(1)).step_by(per_trace) {
        if !keep_going() {
            is_whole = false;
            break;
        }
        let last = (first + per_trace).min(num_maps);
        let mut watched = Vec::new();
        for (rank, group) in groups.iter().enumerate() {
            let map = (first..last).contains(&rank).then(|| (rank - first) as u32);
            let is_watched =
                |sequence: &&&Sequence| sequence.end.detector().is_some() && (map.is_some() || first == 0);
            watched.extend(group.sequences.iter().filter(is_watched).map(|sequence| Watched {
                sequence,
                about: about(ir, sequence, found),
                map,
            }));
        }
        if watched.is_empty() {
            break;
        }
        let num = (last - first).max(1) as u32;
        let wanted = WantedMaps { rays: &tally.rays, watched: &watched, num_maps: num };
        let PathMaps { tally: second, places: of_watched, is_whole: is_done } =
            trace_maps(gpu, ir, trace, &wanted, None, &mut keep_going)?;
        if !is_done {
            // Maps of some of the rays would pass for maps of all.
            is_whole = false;
            break;
        }
        if first == 0 {
            places.extend(watched.iter().map(|path| path.sequence).zip(of_watched));
        }
        for (map, group) in groups[first..last].iter().enumerate() {
            let detector = group.sequences[0].end.detector();
            let detector = detector.filter(|number| ir.detectors[*number].num_cells() > 0);
            let map = detector.map(|number| map_of(ir, &second, number, map));
            let peak = map.as_ref().and_then(|map| peak_irradiance(ir, map, unit));
            peaks.push(peak.zip(group.factor).map(|(peak, factor)| peak * factor));
            // Many large maps would take all memory.
            maps.push(map.filter(|_| maps.len() < MOST_KEPT_CELLS / num_cells));
        }
    }
    let mut rows: Vec<LightPath> = Vec::new();
    for (rank, group) in groups.iter().enumerate() {
        let mut row = group.row.clone();
        let has_places = |sequence: &&&Sequence| {
            is_whole && sequence.end.detector().is_some_and(|number| ir.detectors[number].kind.is_placed())
        };
        let parts: Vec<(PathSum, PlaceMoments)> = group
            .sequences
            .iter()
            .filter(has_places)
            .filter_map(|sequence| Some((sums.rows[*sequence], *places.get(sequence)?, *sequence)))
            .map(|(sum, places, sequence)| scaled(sum, places, options.recoating.factor(sequence)))
            .collect();
        if let Some((centroid, rms_radius)) = PlaceMoments::spot(&parts) {
            (row.centroid, row.rms_radius) = (Some(centroid), Some(rms_radius));
        }
        row.peak_irradiance = peaks.get(rank).copied().flatten().filter(|_| is_whole);
        rows.push(row);
    }
    let mut order: Vec<usize> = (0..rows.len()).collect();
    if options.sort == Sorting::Peak {
        let peak = |row: usize| rows[row].peak_irradiance.unwrap_or(-1.0);
        order.sort_by(|&a, &b| peak(b).total_cmp(&peak(a)));
    }
    let sorted: Vec<LightPath> =
        (1..).zip(&order).map(|(rank, &row)| LightPath { rank, ..rows[row].clone() }).collect();
    let maps = order.iter().map(|&row| maps.get_mut(row).and_then(Option::take)).collect();
    let sequences = order.iter().map(|&row| groups[row].sequences[0].clone()).collect();
    let table = PathTable::new(ir, sums, unit, options.group, options.detector, sorted, &options.recoating);
    Ok(Traced { table, maps, sequences, is_whole })
}

/// The sum of a sequence and its places, times a factor.
fn scaled(sum: PathSum, places: PlaceMoments, factor: f64) -> (PathSum, PlaceMoments) {
    if factor == 1.0 {
        return (sum, places);
    }
    (PathSum { quanta: (sum.quanta as f64 * factor).round() as u128, ..sum }, places.scaled(factor))
}

/// A point where light of a sequence arrived, in the detector's frame \[mm\]; the origin where none is known.
fn about(ir: &SceneIr, sequence: &Sequence, found: &HashMap<&Sequence, DVec3>) -> [f64; 2] {
    let (Some(number), Some(position)) = (sequence.end.detector(), found.get(sequence)) else {
        return [0.0; 2];
    };
    let frame = ir.detectors[number].frame;
    let local = frame.rotation.transpose() * (*position - frame.origin);
    [local.x, local.y]
}

fn map_of(ir: &SceneIr, second: &Tally, number: usize, map: usize) -> PathMap {
    let num_cells = ir.detectors[number].num_cells();
    let (size, sums) = (num_cells.max(1), &second.detectors[number].replicates);
    let quanta = sums.get(map * size..(map + 1) * size).unwrap_or_default().to_vec();
    let sums = DetectorTally { quanta, ..DetectorTally::default() };
    PathMap { detector: number, sums }
}

/// The irradiance of the brightest pixel \[W/mm^2\]. `None` if the detector has no pixels.
fn peak_irradiance(ir: &SceneIr, map: &PathMap, unit: FluxUnit) -> Option<f64> {
    let kind = &ir.detectors[map.detector].kind;
    let grid = kind.grid()?;
    let pixels = map.sums.quanta.chunks(kind.num_bins().max(1) as usize);
    let pixels = pixels.map(|bins| bins.iter().sum::<u128>());
    Some(unit.watts(pixels.max()?) / pixel_area(grid))
}
