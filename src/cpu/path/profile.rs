//! Profiling: finds the path that most rays of a scene take, and the paths of most others. These paths then get stages
//! of their own (shaders/cpu/path/hot_path.wgsl).

use crate::cpu::Override;
use crate::cpu::path::hot_path::{MAX_EVENTS, ProfiledPath, SampledPath, is_possible};
use crate::cpu::path::pays::{LEAST_SHARE, is_long_enough};
use crate::engine::addition::Additions;
use crate::engine::options::{RecordPaths, StandardError, TraceOptions};
use crate::engine::pass_loop;
use crate::engine::pipeline_cache::Shaders;
use crate::engine::prepare::prepare;
use crate::engine::undrained::empty_tally;
use crate::error::{Error, Result};
use crate::gpu::Gpu;
use crate::model::SceneIr;
use crate::program::ProgramOptions;
use crate::result::{PathEvent, PathEventKind, Tally};
use glam::DVec3;

/// Rays whose paths are looked at.
const PROFILED_RAYS: u64 = 512;

/// At least this share of the profiled rays takes a side trace: a stage does not pay for fewer.
const LEAST_SIDE_SHARE: f64 = 0.01;

/// What profiling has found.
#[derive(Debug, Clone, PartialEq)]
pub struct FrequentPaths {
    /// The hot path, which most rays take.
    pub hot: ProfiledPath,
    /// The paths that most of the others take, the most frequent first.
    pub sides: Vec<ProfiledPath>,
}

/// The path that most rays take. `None` if there is no such path, if a trace has too few rays for profiling to pay, or
/// if no stage could follow it. Where the hot path is always followed, a path of any share of the rays will do.
///
/// # Errors
/// [`crate::Error::Device`] if the device fails.
pub(crate) fn find(
    gpu: &Gpu,
    ir: &SceneIr,
    options: &TraceOptions,
    program_options: &ProgramOptions,
    hot_path: Override,
) -> Result<Option<FrequentPaths>> {
    let pays = hot_path.holds(|| is_long_enough(options.num_rays));
    // Two forms of one scene must give the same bits.
    let is_alike = options.strict.holds(&gpu.info);
    if !(pays && is_alike && is_possible(ir, program_options)) {
        return Ok(None);
    }
    let profile = TraceOptions {
        num_rays: options.num_rays.min(PROFILED_RAYS),
        of_rays: None,
        max_depth: options.max_depth.min(MAX_EVENTS),
        paths: RecordPaths::All,
        standard_error: StandardError::Off,
        ..options.clone()
    };
    let tally = match trace_profiled(gpu, &ir.with_single_cells(), &profile) {
        // So few rays may be too few for the weakest source.
        Err(Error::Usage(_)) => return Ok(None),
        tally => tally?,
    };
    let least = if hot_path == Override::Always { 0.0 } else { LEAST_SHARE };
    let shares = [least, LEAST_SIDE_SHARE];
    let is_cut = profile.max_depth < options.max_depth;
    Ok(most_frequent(ir, &tally.paths, is_cut, tally.launched.count, shares))
}

/// Traces the profiled rays, in the plain way.
fn trace_profiled(gpu: &Gpu, ir: &SceneIr, options: &TraceOptions) -> Result<Tally> {
    let mut plain = Additions::default();
    let mut engine = prepare(gpu, ir, options, &mut plain, Shaders::default())?;
    pass_loop::trace(&mut engine, &mut plain, empty_tally(ir), |_| Ok(true))
}

/// How a profiled ray came to its end.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum End {
    /// It was detected or absorbed, or has as many events as a ray may have.
    Reached,
    Escaped,
    /// It was killed, where another one may go on.
    Lost,
}

/// The most frequent complete path of the profiled rays, if `least` of them take it; then every other path that
/// `least_of_side` take. A path is complete when it ends on a detector or absorber, or at the depth limit; side traces may
/// also escape. `is_cut`: rays could have had more events.
fn most_frequent(
    ir: &SceneIr,
    paths: &[PathEvent],
    is_cut: bool,
    num_rays: u64,
    [least, least_of_side]: [f64; 2],
) -> Option<FrequentPaths> {
    let mut sorted: Vec<&PathEvent> = paths.iter().collect();
    sorted.sort_by_key(|event| (event.ray.ray_id, event.ray.bounce, !is_birth(event.kind)));
    let rays = sorted.chunk_by(|a, b| a.ray.ray_id == b.ray.ray_id);
    let mut by_path: Vec<_> = rays.map(|ray| ((end_of(ray, is_cut), met(ir, ray)), ray)).collect();
    by_path.sort_by(|(a, _), (b, _)| a.cmp(b));
    let mut alike: Vec<_> = by_path.chunk_by(|(a, _), (b, _)| a == b).collect();
    alike.sort_by_key(|rays| std::cmp::Reverse(rays.len()));
    let most = alike.iter().position(|rays| rays[0].0.0 == End::Reached)?;
    let most = alike.remove(most);
    type Ray<'a> = ((End, Vec<usize>), &'a [&'a PathEvent]);
    let share = |rays: &[Ray]| rays.len() as f64 / num_rays as f64;
    let path = |rays: &[Ray]| ProfiledPath {
        primitives: rays[0].0.1.clone(),
        samples: rays.iter().map(|(_, ray)| sample(ray)).collect(),
        escapes: rays[0].0.0 == End::Escaped,
        share: share(rays),
    };
    let is_side = |rays: &&&[Ray]| {
        let (end, primitives) = &rays[0].0;
        *end != End::Lost && !primitives.is_empty() && share(rays) >= least_of_side
    };
    let sides = || alike.iter().filter(is_side).map(|rays| path(rays)).collect();
    let hot = path(most);
    (hot.share >= least).then(|| FrequentPaths { hot, sides: sides() })
}

fn end_of(ray: &[&PathEvent], is_cut: bool) -> End {
    let has = |kind: PathEventKind| ray.iter().any(|event| event.kind == kind);
    if has(PathEventKind::FluxKilled) || is_cut && has(PathEventKind::DepthKilled) {
        End::Lost
    } else if has(PathEventKind::Escaped) {
        End::Escaped
    } else {
        End::Reached
    }
}

/// The primitives that a ray has met.
fn met(ir: &SceneIr, ray: &[&PathEvent]) -> Vec<usize> {
    let primitive = |event: &&PathEvent| match event.kind {
        PathEventKind::Surface(index) => Some(index),
        PathEventKind::Detector(index) => Some(ir.surfaces.len() + index),
        PathEventKind::Birth(_)
        | PathEventKind::Escaped
        | PathEventKind::DepthKilled
        | PathEventKind::FluxKilled => None,
    };
    ray.iter().filter_map(primitive).collect()
}

fn sample(ray: &[&PathEvent]) -> SampledPath {
    // An escape is recorded where the ray was last. Its path goes on from there.
    let position = |event: &&PathEvent| {
        let [at, direction] = [event.ray.position, event.ray.direction].map(DVec3::from_array);
        if event.kind == PathEventKind::Escaped { at + direction } else { at }
    };
    SampledPath {
        positions: ray.iter().map(position).collect(),
        weights: ray.iter().map(|event| event.ray.weight).collect(),
    }
}

fn is_birth(kind: PathEventKind) -> bool {
    matches!(kind, PathEventKind::Birth(_))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::result::RayRow;

    fn event(ray_id: u64, bounce: u32, kind: PathEventKind) -> PathEvent {
        let row = RayRow {
            ray_id,
            bounce,
            wavelength: 0,
            position: [0.0, 0.0, f64::from(bounce) + if is_birth(kind) { 0.0 } else { 1.0 }],
            direction: [0.0, 0.0, 1.0],
            weight: 1.0,
        };
        PathEvent { ray: row, kind }
    }

    fn scene() -> SceneIr {
        let text = include_str!("../../../scenes/cooke_triplet.json");
        crate::Scene::from_json(text).unwrap().lower().unwrap()
    }

    #[test]
    fn the_path_of_most_rays_is_found_in_any_order_of_events() {
        let ir = scene();
        let surfaces = ir.surfaces.len();
        let mut paths = Vec::new();
        for ray_id in 0..10 {
            let second = if ray_id < 6 { 1 } else { 3 };
            paths.push(event(ray_id, 2, PathEventKind::Detector(0)));
            paths.push(event(ray_id, 0, PathEventKind::Surface(0)));
            paths.push(event(ray_id, 1, PathEventKind::Surface(second)));
            paths.push(event(ray_id, 0, PathEventKind::Birth(0)));
        }
        let path = most_frequent(&ir, &paths, true, 10, [0.6, 0.0]).unwrap().hot;
        assert_eq!(path.primitives, [0, 1, surfaces]);
        let positions = [0.0, 1.0, 2.0, 3.0].map(|z| DVec3::new(0.0, 0.0, z)).to_vec();
        assert_eq!(path.samples, vec![SampledPath { positions, weights: vec![1.0; 4] }; 6]);
        assert_eq!(most_frequent(&ir, &paths, true, 10, [0.7, 0.0]), None, "too few of the launched rays");
        for ray_id in 0..3 {
            paths.push(event(ray_id, 3, PathEventKind::Escaped));
        }
        let path = most_frequent(&ir, &paths, true, 10, [0.0; 2]).unwrap().hot;
        assert_eq!(path.primitives, [0, 3, surfaces], "an escape is no end");
        let sides = |least| most_frequent(&ir, &paths, true, 10, [0.0, least]).unwrap().sides;
        let escape = DVec3::new(0.0, 0.0, 5.0);
        let taken: Vec<_> = sides(0.3).into_iter().map(|side| (side.primitives, side.escapes)).collect();
        assert_eq!(taken, [(vec![0, 1, surfaces], false), (vec![0, 1, surfaces], true)]);
        assert!(
            sides(0.3)[1].samples.iter().all(|sample| sample.positions.last() == Some(&escape)),
            "a way goes on"
        );
        assert!(sides(0.4).is_empty());
    }
}
