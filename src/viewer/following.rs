//! Light by its path, in the background: a trace that sums it up, maps by a second trace, and rays of some paths.

use crate::error::{Error, Result};
use crate::gpu::Gpu;
use crate::model::shapes::Outline;
use crate::model::surface_optics::splits;
use crate::model::{DetectorKind, PathFilter, RayDatabase, SceneIr, Sequence, ray_id};
use crate::paths::rows::{self, PathMap, TableOptions, flux_unit, table_with_maps};
use crate::result::{
    DetectorTally, FluxSum, FluxUnit, Grouping, PathColumns, PathEvent, PathTable, RayPaths, RowWriter,
    Sorting, Tally,
};
use crate::run::{Collect, Next, Outcome, RecordPaths, StandardError, Strict, TraceOptions, Tracer};
use crate::viewer::tracing::{self, Background, Device, LoadedScene, Notify, RunOptions};
use glam::DVec3;
use std::collections::HashMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

/// Rows of a table that have maps.
const MOST_MAPS: usize = 50;
/// Most cells of all maps of a table: half a gigabyte.
const MOST_CELLS: usize = 1 << 25;
/// Rays of paths that are drawn.
const MOST_DRAWN: usize = 100;
/// Rays among which rays of paths are looked for.
const MOST_SEARCHED: u64 = 1 << 21;
/// Rays whose events are in memory at a time.
const SEARCHED_AT_ONCE: u64 = 1 << 14;

/// How far work has come, and whether it shall end.
#[derive(Default)]
pub struct Watch {
    is_stopped: AtomicBool,
    done: AtomicU64,
}

impl Watch {
    pub(super) fn is_stopped(&self) -> bool {
        self.is_stopped.load(Ordering::Relaxed)
    }
}

/// Work in the background, which ends soon after this value is dropped.
pub struct Work<T> {
    watch: Arc<Watch>,
    background: Option<Background<Result<T>>>,
}

impl<T: Send + 'static> Work<T> {
    /// Begins the work.
    pub fn start(work: impl FnOnce(&Watch) -> Result<T> + Send + 'static, notify: Notify) -> Self {
        let watch = Arc::new(Watch::default());
        let of_work = watch.clone();
        Work { watch, background: Some(Background::start(move || work(&of_work), notify)) }
    }

    /// The outcome, once.
    pub fn take(&self) -> Option<Result<T>> {
        self.background.as_ref()?.take()
    }

    /// Rays done.
    pub fn done(&self) -> u64 {
        self.watch.done.load(Ordering::Relaxed)
    }

    /// Waits until the work has ended, which is soon.
    pub fn finish(mut self) {
        self.stop();
        if let Some(background) = self.background.take() {
            background.finish();
        }
    }
}

impl<T> Work<T> {
    /// Ends the work soon, with what there is.
    pub fn stop(&self) {
        self.watch.is_stopped.store(true, Ordering::Relaxed);
    }
}

impl<T> Drop for Work<T> {
    fn drop(&mut self) {
        self.stop();
    }
}

/// A trace that summed up light by its path.
pub struct Followed {
    /// The scene.
    pub scene: Arc<LoadedScene>,
    /// The options of the trace.
    pub options: TraceOptions,
    /// The sums.
    pub tally: Tally,
    /// Where some ray of each sequence arrived.
    found: HashMap<Sequence, DVec3>,
}

impl Followed {
    /// The unit of flux.
    pub fn unit(&self) -> FluxUnit {
        flux_unit(&self.scene.ir, &self.tally, self.options.num_rays)
    }
}

/// Traces a scene, and sums up light by its path. It launches the rays of the trace whose maps the window shows.
pub(crate) fn follow(
    device: &Device,
    scene: &Arc<LoadedScene>,
    run: &RunOptions,
    watch: &Watch,
    notify: &Notify,
) -> Result<Followed> {
    let gpu = device.open()?;
    let run = tracing::run(scene, run, &gpu)?.change_options(|options| options.collect = Collect::paths());
    let outcome = run.go_with(|pass| {
        watch.done.store(pass.status.rays, Ordering::Relaxed);
        notify();
        Ok(Next::stop_if(watch.is_stopped()))
    })?;
    let Outcome { options, tally, found_paths: found, .. } = outcome;
    Ok(Followed { scene: scene.clone(), options, tally, found })
}

/// Light of a table that has no map of its own.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RestOfLight {
    /// Rows of the table.
    pub num_rows: usize,
    /// Flux \[W\].
    pub flux: f64,
    /// The fraction of all light on the detector.
    pub share: f64,
    /// Rays that brought the light.
    pub num_rays: u64,
    /// True unless it is known that all of it was reflected or scattered.
    pub may_be_direct: bool,
}

/// The table of a detector's light, with maps of the first rows.
pub struct Listing {
    /// The trace.
    pub followed: Arc<Followed>,
    /// The detector's number.
    pub detector: usize,
    /// The table.
    pub table: PathTable,
    maps: Vec<Option<PathMap>>,
}

/// Lists a detector's light by its path, without maps: nothing is traced.
pub(crate) fn list(followed: &Arc<Followed>, detector: usize, group: Grouping) -> Listing {
    let options =
        TableOptions { group, sort: Sorting::Flux, detector: Some(detector), ..TableOptions::default() };
    let Followed { scene, options: traced, tally, .. } = followed.as_ref();
    let table = rows::table(&scene.ir, tally, followed.unit(), traced.sampler, &options);
    Listing { followed: followed.clone(), detector, table, maps: Vec::new() }
}

/// The same table with maps of its first rows, by a second trace.
pub(crate) fn list_with_maps(
    device: &Device,
    followed: &Arc<Followed>,
    detector: usize,
    group: Grouping,
    watch: &Watch,
) -> Result<Listing> {
    let (gpu, ir) = (device.open()?, &followed.scene.ir);
    let num_cells = ir.detectors.get(detector).map_or(0, |detector| detector.num_cells());
    let num_maps = MOST_CELLS.checked_div(num_cells).map_or(0, |maps| maps.clamp(1, MOST_MAPS));
    let options = TableOptions {
        group,
        sort: Sorting::Flux,
        detector: Some(detector),
        num_maps,
        ..TableOptions::default()
    };
    let found = followed.found.iter().map(|(sequence, at)| (sequence, *at)).collect();
    let traced = table_with_maps(&gpu, ir, &followed.options, &followed.tally, &found, &options, || {
        !watch.is_stopped()
    })?;
    let has_maps = num_maps > 0 && traced.is_whole;
    let maps = if has_maps { traced.maps } else { Vec::new() };
    Ok(Listing { followed: followed.clone(), detector, table: traced.table, maps })
}

impl Listing {
    /// True if the row of this index has a map.
    pub fn has_map(&self, row: usize) -> bool {
        self.maps.get(row).is_some_and(Option::is_some)
    }

    /// True if rows have maps.
    pub fn has_maps(&self) -> bool {
        self.has_map(0)
    }

    /// All light on the detector that no row with a map has; none if there is no such light.
    pub fn rest(&self) -> Option<RestOfLight> {
        let name = &self.followed.scene.ir.detectors.get(self.detector)?.name;
        let mut rest = RestOfLight { num_rows: 0, flux: 0.0, share: 0.0, num_rays: 0, may_be_direct: false };
        let mut add = |flux, share, num_rays| {
            rest.flux += flux;
            rest.share += share;
            rest.num_rays += num_rays;
        };
        let rows = self.table.paths.iter().enumerate().filter(|(index, _)| !self.has_map(*index));
        let (mut num_rows, mut may_be_direct) = (0, false);
        for (_, row) in rows {
            add(row.flux, row.share, row.num_rays);
            num_rows += 1;
            may_be_direct |= row.reflections + row.scatterings == 0;
        }
        for other in self.table.other.iter().filter(|other| other.detector.as_ref() == Some(name)) {
            add(other.flux, other.share, other.num_rays);
            may_be_direct = true;
        }
        (rest.num_rays > 0).then_some(RestOfLight { num_rows, may_be_direct, ..rest })
    }

    /// The detector's sums of the light of some rows, and of the rest if it is taken. They are exact: the rest is what
    /// the detector has in all, less the rows with maps.
    pub fn sums(&self, is_taken: impl Fn(usize) -> bool, takes_rest: bool) -> DetectorTally {
        let whole = self.followed.tally.detectors.get(self.detector).map_or(&[][..], |sums| &sums.quanta);
        let mut quanta = if takes_rest { whole.to_vec() } else { vec![0; whole.len()] };
        let mut count = if takes_rest { self.rest().map_or(0, |rest| rest.num_rays) } else { 0 };
        let rows = self.maps.iter().zip(&self.table.paths).enumerate();
        for (index, (map, row)) in rows.filter_map(|(index, (map, row))| Some((index, (map.as_ref()?, row))))
        {
            let is_taken = is_taken(index);
            count += if is_taken { row.num_rays } else { 0 };
            if is_taken == takes_rest {
                continue;
            }
            for (sum, part) in quanta.iter_mut().zip(&map.sums.quanta).filter(|(_, part)| **part > 0) {
                *sum = if takes_rest { sum.saturating_sub(*part) } else { *sum + part };
            }
        }
        let recorded = FluxSum { count, quanta: 0 };
        DetectorTally { hits: vec![0; quanta.len()], quanta, recorded, ..DetectorTally::default() }
    }
}

/// Rays that came to a detector by some paths, up to there.
pub struct LightRays {
    /// Their events.
    pub columns: Arc<PathColumns>,
    /// The number of arrivals.
    pub num_arrivals: usize,
    /// The rays among which they were found: the first ones of the trace.
    pub num_searched: u64,
}

/// Finds rays whose light on a detector one of the expressions keeps. A ray database in the detector's place records
/// which rays these are.
pub(crate) fn find_rays(
    device: &Device,
    followed: &Followed,
    detector: usize,
    filters: &[String],
    watch: &Watch,
) -> Result<LightRays> {
    let (gpu, scene) = (device.open()?, &followed.scene);
    let ir = with_ray_database(&scene.ir, detector)?;
    let options = TraceOptions {
        collect: Collect::Light,
        paths: RecordPaths::All,
        standard_error: StandardError::Off,
        strict: if followed.options.is_strict(&gpu.info) { Strict::On } else { Strict::Auto },
        may_end_early: true,
        batch_size: Some(SEARCHED_AT_ONCE as u32),
        ..followed.options.clone()
    };
    let mut found = Found::default();
    for filter in filters {
        let path_filter = Some(Arc::new(PathFilter::parse(filter, &ir)?));
        let options = TraceOptions { path_filter, ..options.clone() };
        let part = search(&gpu, &ir, &options, detector, MOST_DRAWN.div_ceil(filters.len().max(1)), watch)?;
        found.events.extend(part.events);
        found.num_arrivals += part.num_arrivals;
        found.num_searched = part.num_searched.max(found.num_searched);
    }
    // A ray may have come by several paths.
    let splits = splits(&ir);
    found.events.sort_by_key(|event| (event.ray.order(splits), event.kind.rank()));
    found.events.dedup();
    let mut writer = RowWriter::in_memory(None);
    found.events.iter().try_for_each(|event| writer.push(event))?;
    let (num_arrivals, num_searched) = (found.num_arrivals, found.num_searched);
    let none = || Error::Usage(format!("none of the first {num_searched} rays took the path"));
    let columns = RayPaths::new(&ir, followed.unit(), writer.finish()).ok_or_else(none)?.columns()?;
    Ok(LightRays { columns: Arc::new(columns), num_arrivals, num_searched })
}

/// What a search found.
#[derive(Default)]
struct Found {
    events: Vec<PathEvent>,
    num_arrivals: usize,
    num_searched: u64,
}

fn with_ray_database(ir: &SceneIr, detector: usize) -> Result<SceneIr> {
    let mut ir = ir.clone();
    let changed = ir.detectors.get_mut(detector);
    let changed = changed.ok_or_else(|| Error::Internal("the detector is not one of the scene".into()))?;
    let (width, height) = match changed.outline() {
        Outline::Rectangle { width, height } => (width, height),
        // The disk of a far-field detector, which is as good as endless.
        Outline::Disk { radius } => (2.0 * radius, 2.0 * radius),
        _ => return Err(Error::Usage("rays of paths can be drawn for detectors with an edge alone".into())),
    };
    changed.kind = DetectorKind::RayDatabase(RayDatabase { width, height, max_rays: None });
    Ok(ir)
}

fn search(
    gpu: &Gpu,
    ir: &SceneIr,
    options: &TraceOptions,
    detector: usize,
    most: usize,
    watch: &Watch,
) -> Result<Found> {
    let mut tracer = Tracer::new(gpu, ir, options)?;
    let splits = splits(ir);
    let last = tracer.num_rays().min(MOST_SEARCHED);
    let mut tally = tracer.empty_tally();
    let (mut at, mut found) = (0, Found::default());
    while at < last && found.num_arrivals < most && !watch.is_stopped() {
        let end = (at + SEARCHED_AT_ONCE).min(last);
        tracer.pause_at(end);
        tally = tracer.go_on(tally, |progress| {
            at = progress.position();
            Ok(at < end && !watch.is_stopped())
        })?;
        let mut arrivals = std::mem::take(&mut tally.detectors[detector].rows);
        arrivals.sort_by_key(|row| row.order(splits));
        arrivals.truncate(most - found.num_arrivals);
        found.num_arrivals += arrivals.len();
        let arrivals = arrivals.iter().map(|row| (row.ray_id, row.bounce));
        found.events.extend(of_lineages(std::mem::take(&mut tally.paths), &lineages(arrivals, splits)));
    }
    Ok(Found { num_searched: tally.launched.count, ..found })
}

/// Which rays brought light, and up to which number of events. A ray that was split off has the events of the ray that it
/// comes from, up to the split.
fn lineages(arrivals: impl Iterator<Item = (u64, u32)>, splits: bool) -> HashMap<u64, u32> {
    let mut lineages: HashMap<u64, u32> = HashMap::new();
    for (id, bounce) in arrivals {
        let (launched, number) = ray_id::order(id, splits);
        let (mut number, mut last) = (number as u32, bounce);
        loop {
            let id = if splits { ray_id::of(launched, number) } else { launched };
            let known = lineages.entry(id).or_insert(last);
            *known = last.max(*known);
            let Some(split) = number.checked_ilog2() else { break };
            number &= !(1 << split);
            last = split;
        }
    }
    lineages
}

fn of_lineages(events: Vec<PathEvent>, lineages: &HashMap<u64, u32>) -> impl Iterator<Item = PathEvent> {
    events
        .into_iter()
        .filter(|event| lineages.get(&event.ray.ray_id).is_some_and(|last| event.ray.bounce <= *last))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_ray_has_the_events_of_those_that_it_was_split_from() {
        // Split off at event 1, and again at event 4; arrived as event 6.
        let (root, child, grandchild) = (ray_id::of(9, 0), ray_id::of(9, 0b10), ray_id::of(9, 0b1_0010));
        let found = lineages([(grandchild, 6)].into_iter(), true);
        assert_eq!(found, HashMap::from([(root, 1), (child, 4), (grandchild, 6)]));
        // What the root itself brought is drawn up to its own arrival.
        let found = lineages([(child, 3), (root, 5)].into_iter(), true);
        assert_eq!(found, HashMap::from([(root, 5), (child, 3)]));
        // Without splitting an id is a launched ray alone.
        let large = 1 << 41;
        assert_eq!(lineages([(large, 2)].into_iter(), false), HashMap::from([(large, 2)]));
    }
}
