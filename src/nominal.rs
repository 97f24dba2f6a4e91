//! Which path most rays of a scene take, so that it can have a stage of its own (shaders/nominal.wgsl).

use crate::error::{Error, Result};
use crate::gpu::Gpu;
use crate::ir::SceneIr;
use crate::program::ProgramOptions;
use crate::program::nominal::{MAX_EVENTS, PilotPath, Way, is_possible};
use crate::result::{PathEvent, PathEventKind};
use crate::trace::{RecordPaths, StandardError, TraceOptions, Tracer};
use glam::DVec3;

/// Rays whose paths are looked at.
const PILOT_RAYS: u64 = 512;
/// The stage pays where this share of the rays keeps to the path: it takes 0.3 (f64) to 0.45 (f32) of the time of the others,
/// and rays that stray are traced again, in nearly the time that they took without it.
const LEAST_SHARE: f64 = 0.45;
/// So many rays tell whether the pilot was right.
const TELLING_RAYS: u64 = 1 << 16;
/// Shorter traces are over before the pilot has paid.
const LEAST_RAYS: u64 = 1 << 22;

/// Whether a trace of so many rays looks for such a path.
pub fn is_long_enough(num_rays: u64) -> bool {
    num_rays >= LEAST_RAYS
}

/// Whether it still pays to follow the path, as far as these rays tell: a pilot may be wrong.
pub fn pays([num_followed, num_strayed]: [u64; 2]) -> bool {
    num_followed < TELLING_RAYS || num_strayed as f64 <= (1.0 - LEAST_SHARE) * num_followed as f64
}

/// The path that most rays take, or none: where there is no such path, where a trace has too few rays for the
/// search to pay, and where no stage could follow it. On demand, a path of any share of the rays will do.
///
/// # Errors
/// [`crate::Error::Device`] if the device fails.
pub fn find(
    gpu: &Gpu,
    ir: &SceneIr,
    options: &TraceOptions,
    program_options: &ProgramOptions,
) -> Result<Option<PilotPath>> {
    let pays = options.nominal_path.unwrap_or(is_long_enough(options.num_rays));
    // Two forms of one scene must give the same bits.
    let is_alike = options.strict.holds(&gpu.info);
    if !(pays && is_alike && is_possible(ir, program_options)) {
        return Ok(None);
    }
    let pilot = TraceOptions {
        num_rays: options.num_rays.min(PILOT_RAYS),
        of_rays: None,
        max_depth: options.max_depth.min(MAX_EVENTS),
        paths: RecordPaths::All,
        standard_error: StandardError::Off,
        nominal_path: Some(false),
        ..options.clone()
    };
    let tally = match Tracer::new(gpu, &ir.with_single_cells(), &pilot)
        .and_then(|mut tracer| tracer.trace(|_| true))
    {
        // So few rays may be too few for the weakest source.
        Err(Error::Usage(_)) => return Ok(None),
        tally => tally?,
    };
    let least = if options.nominal_path == Some(true) { 0.0 } else { LEAST_SHARE };
    let is_cut = pilot.max_depth < options.max_depth;
    Ok(most_frequent(ir, &tally.paths, is_cut, least * tally.launched.count as f64))
}

/// The path that most rays take to where they are detected or absorbed, or have as many events as a ray may have, if at
/// least so many do. `is_cut`: they could have had more.
fn most_frequent(ir: &SceneIr, paths: &[PathEvent], is_cut: bool, least: f64) -> Option<PilotPath> {
    let mut sorted: Vec<&PathEvent> = paths.iter().collect();
    sorted.sort_by_key(|event| (event.ray.ray_id, event.ray.bounce, !is_birth(event.kind)));
    let primitive = |event: &&PathEvent| match event.kind {
        PathEventKind::Surface(index) => Some(index),
        PathEventKind::Sensor(index) => Some(ir.surfaces.len() + index),
        PathEventKind::Birth(_)
        | PathEventKind::Escaped
        | PathEventKind::DepthKilled
        | PathEventKind::FluxKilled => None,
    };
    let is_lost = |event: &&PathEvent| match event.kind {
        PathEventKind::Escaped | PathEventKind::FluxKilled => true,
        PathEventKind::DepthKilled => is_cut,
        PathEventKind::Birth(_) | PathEventKind::Surface(_) | PathEventKind::Sensor(_) => false,
    };
    let met = |ray: &[&PathEvent]| -> Vec<usize> { ray.iter().filter_map(primitive).collect() };
    let rays = sorted.chunk_by(|a, b| a.ray.ray_id == b.ray.ray_id);
    let ended = rays.filter(|ray| !ray.iter().any(is_lost));
    let mut by_path: Vec<_> = ended.map(|ray| (met(ray), ray)).collect();
    by_path.sort_by(|(a, _), (b, _)| a.cmp(b));
    let most = by_path.chunk_by(|(a, _), (b, _)| a == b).max_by_key(|same| same.len())?;
    let way = |ray: &[&PathEvent]| Way {
        positions: ray.iter().map(|event| DVec3::from_array(event.ray.position)).collect(),
        weights: ray.iter().map(|event| event.ray.weight).collect(),
    };
    let path =
        || PilotPath { primitives: most[0].0.clone(), ways: most.iter().map(|(_, ray)| way(ray)).collect() };
    (most.len() as f64 >= least).then(path)
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
        let text = include_str!("../scenes/cooke_triplet.json");
        crate::Scene::from_json(text).unwrap().lower().unwrap()
    }

    #[test]
    fn a_path_that_most_rays_stray_from_does_not_pay() {
        let num = TELLING_RAYS;
        assert!(pays([0, 0]) && pays([num - 1, num - 1]), "too few to tell");
        assert!(pays([num, 0]) && pays([num, num / 2]));
        assert!(!pays([num, num / 8 * 5]) && !pays([num, num]));
    }

    #[test]
    fn the_path_of_most_rays_is_found_in_any_order_of_events() {
        let ir = scene();
        let surfaces = ir.surfaces.len();
        let mut paths = Vec::new();
        for ray_id in 0..10 {
            let second = if ray_id < 6 { 1 } else { 3 };
            paths.push(event(ray_id, 2, PathEventKind::Sensor(0)));
            paths.push(event(ray_id, 0, PathEventKind::Surface(0)));
            paths.push(event(ray_id, 1, PathEventKind::Surface(second)));
            paths.push(event(ray_id, 0, PathEventKind::Birth(0)));
        }
        let path = most_frequent(&ir, &paths, true, 6.0).unwrap();
        assert_eq!(path.primitives, [0, 1, surfaces]);
        let positions = [0.0, 1.0, 2.0, 3.0].map(|z| DVec3::new(0.0, 0.0, z)).to_vec();
        assert_eq!(path.ways, vec![Way { positions, weights: vec![1.0; 4] }; 6]);
        assert_eq!(most_frequent(&ir, &paths, true, 7.0), None, "too few of the launched rays");
        for ray_id in 0..3 {
            paths.push(event(ray_id, 3, PathEventKind::Escaped));
        }
        let path = most_frequent(&ir, &paths, true, 0.0).unwrap();
        assert_eq!(path.primitives, [0, 3, surfaces], "an escape is no end");
    }
}
