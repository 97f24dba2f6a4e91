//! Measures error and time of a method as its rays grow.

use crate::bench::accuracy::estimate::{Errors, Estimate};
use crate::bench::accuracy::methods::{Method, best, methods};
use crate::bench::accuracy::scenes::AccuracyScene;
use crate::bench::peers::optiland::{MapRequest, Optiland};
use crate::bench::statistics::Summary;
use crate::error::{Error, Result};
use crate::gpu::Gpu;
use crate::model::SceneIr;
use crate::program::Precision;
use crate::run::{StandardError, TraceOptions, Tracer};

/// The effort of a measurement.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Effort {
    /// Independent traces of each point.
    pub num_seeds: u64,
    /// The time after which a curve ends \[s\]: a trace that takes longer is its last.
    pub trace_sec: f64,
    /// The same for the answer \[s\].
    pub answer_sec: f64,
    /// Rays at which a curve ends in any case.
    pub most_rays: u64,
}

/// Rays of a curve's first point; each further point has four times as many.
pub const FIRST_RAYS: u64 = 1 << 12;
const STEP: u64 = 4;
/// Rays of a peer's first point; peers are slower.
const FIRST_PEER_RAYS: u64 = 1 << 10;
/// Number of traces of the answer.
const ANSWER_SEEDS: u64 = 2;
/// The first seed of the answer, which shares no draw with the compared traces.
const FIRST_ANSWER_SEED: u64 = 1 << 32;

/// The curves of a scene.
#[derive(Debug, Clone, PartialEq)]
pub struct SceneCurves {
    /// The scene.
    pub scene: AccuracyScene,
    /// Rays of the answer.
    pub answer_rays: u64,
    /// The answer's own error, from the spread of its traces.
    pub answer_errors: Errors,
    /// The curves, by method.
    pub curves: Vec<Curve>,
}

/// A method in one scene.
#[derive(Debug, Clone, PartialEq)]
pub struct Curve {
    /// This program, or a peer.
    pub engine: String,
    /// The method.
    pub method: String,
    /// The points, from few rays to many.
    pub points: Vec<Point>,
}

/// The result of a method with this number of rays.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Point {
    /// Rays launched.
    pub num_rays: u64,
    /// Time from the first ray to the sums \[s\].
    pub seconds: Summary,
    /// Root mean squares over the traces, compared with the converged answer.
    pub errors: Errors,
}

/// One trace at several numbers of rays: (rays, time \[s\], estimate).
type Snapshots = Vec<(u64, f64, Estimate)>;

/// Measures a scene by every method, and by the peers.
///
/// # Errors
/// The errors of a trace, and of a peer.
pub fn measure(
    gpu: &Gpu,
    scene: &AccuracyScene,
    precisions: &[Precision],
    peers: &mut [Optiland],
    effort: &Effort,
) -> Result<SceneCurves> {
    let plain = scene.plain()?;
    let detector = scene.detector(&plain)?;
    let precision = *precisions.last().ok_or_else(|| Error::Usage("no precision is measured".into()))?;
    let way = best(&plain, precision);
    let (answer_rays, answers) = answers(gpu, scene, &way.setting.apply(&plain), &way, detector, effort)?;
    let answer = Estimate::mean(&answers);
    let mut curves = Vec::new();
    for method in methods(&plain, precisions) {
        let ir = method.setting.apply(&plain);
        let traces = traces(gpu, &ir, &options(scene, &method, effort.most_rays), detector, effort)?;
        curves.push(Curve {
            engine: env!("CARGO_PKG_NAME").into(),
            method: method.name,
            points: points(&traces, &answer),
        });
    }
    for peer in peers {
        curves.push(peer_curve(peer, scene, &answer, effort)?);
    }
    let answer_errors = half_of(answers[0].errors(&answers[1]));
    Ok(SceneCurves { scene: *scene, answer_rays, answer_errors, curves })
}

/// The error of the mean of two independent answers, which is half of their difference.
fn half_of(errors: Errors) -> Errors {
    Errors { cells: 0.5 * errors.cells, total: 0.5 * errors.total }
}

fn options(scene: &AccuracyScene, method: &Method, num_rays: u64) -> TraceOptions {
    TraceOptions {
        num_rays,
        max_depth: scene.max_depth,
        precision: method.precision,
        sampler: method.sampler,
        standard_error: StandardError::Off,
        ..TraceOptions::default()
    }
}

/// The numbers of rays of a curve's points.
fn ray_counts(first: u64, most: u64) -> Vec<u64> {
    std::iter::successors(Some(first), |count| Some(count * STEP))
        .take_while(|count| *count <= most)
        .collect()
}

fn answers(
    gpu: &Gpu,
    scene: &AccuracyScene,
    ir: &SceneIr,
    method: &Method,
    detector: usize,
    effort: &Effort,
) -> Result<(u64, Vec<Estimate>)> {
    let effort = Effort {
        num_seeds: ANSWER_SEEDS,
        trace_sec: effort.answer_sec,
        most_rays: 16 * effort.most_rays,
        ..*effort
    };
    let mut tracer = Tracer::new(gpu, ir, &options(scene, method, effort.most_rays))?;
    let traces = traces_of(&mut tracer, FIRST_ANSWER_SEED, detector, &effort)?;
    let ends = traces.into_iter().filter_map(|mut snapshots| snapshots.pop());
    let (rays, answers): (Vec<u64>, Vec<Estimate>) = ends.map(|(rays, _, end)| (rays, end)).unzip();
    let rays = rays.first().copied().ok_or_else(|| Error::Internal("an answer without rays".into()))?;
    Ok((rays * ANSWER_SEEDS, answers))
}

fn traces(
    gpu: &Gpu,
    ir: &SceneIr,
    options: &TraceOptions,
    detector: usize,
    effort: &Effort,
) -> Result<Vec<Snapshots>> {
    traces_of(&mut Tracer::new(gpu, ir, options)?, 0, detector, effort)
}

/// The traces of a curve. The first decides how far all go, so that each point has as many traces.
fn traces_of(
    tracer: &mut Tracer,
    first_seed: u64,
    detector: usize,
    effort: &Effort,
) -> Result<Vec<Snapshots>> {
    let mut counts = ray_counts(FIRST_RAYS, effort.most_rays);
    // Drivers compile at the first dispatch.
    trace_through(tracer, &counts[..1], detector, f64::INFINITY)?;
    let mut traces: Vec<Snapshots> = Vec::new();
    for seed in first_seed..first_seed + effort.num_seeds {
        tracer.set_seed(seed);
        let limit = if traces.is_empty() { effort.trace_sec } else { f64::INFINITY };
        traces.push(trace_through(tracer, &counts, detector, limit)?);
        counts.truncate(traces[0].len());
    }
    Ok(traces)
}

/// Traces, and takes the sums at each of these numbers of rays, up to the first one reached after `limit` \[s\].
fn trace_through(tracer: &mut Tracer, counts: &[u64], detector: usize, limit: f64) -> Result<Snapshots> {
    let mut snapshots = Snapshots::new();
    tracer.pause_at(counts[0]);
    let begun = tracer.empty_tally();
    tracer.go_on(begun, |progress| {
        if progress.position() < counts[snapshots.len()] {
            return Ok(true);
        }
        let estimate = Estimate::of(progress.tally()?, detector);
        let seconds = progress.elapsed.as_secs_f64();
        snapshots.push((counts[snapshots.len()], seconds, estimate));
        match counts.get(snapshots.len()) {
            Some(next) if seconds * STEP as f64 <= limit => progress.pause_at(*next),
            _ => return Ok(false),
        }
        Ok(true)
    })?;
    Ok(snapshots)
}

fn points(traces: &[Snapshots], answer: &Estimate) -> Vec<Point> {
    let point = |i: usize| {
        let seconds: Vec<f64> = traces.iter().map(|trace| trace[i].1).collect();
        let errors: Vec<Errors> = traces.iter().map(|trace| trace[i].2.errors(answer)).collect();
        Some(Point {
            num_rays: traces[0][i].0,
            seconds: Summary::of(&seconds)?,
            errors: Errors::root_mean_square(&errors),
        })
    };
    let num_points = traces.iter().map(Vec::len).min().unwrap_or(0);
    (0..num_points).filter_map(point).collect()
}

/// The curve of a peer, which traces the same plain scene, anew for each number of rays.
fn peer_curve(
    peer: &mut Optiland,
    scene: &AccuracyScene,
    answer: &Estimate,
    effort: &Effort,
) -> Result<Curve> {
    let request = |num_rays, seed| MapRequest {
        scene: scene.text,
        detector: scene.detector,
        num_rays,
        max_depth: scene.max_depth,
        seed,
    };
    // The first trace loads what is loaded at first use.
    let (first_sec, _) = peer.map(&request(FIRST_PEER_RAYS, 0))?;
    let num_seeds = if first_sec > effort.trace_sec { 1 } else { effort.num_seeds };
    let mut traces: Vec<Snapshots> = vec![Snapshots::new(); num_seeds as usize];
    for count in ray_counts(FIRST_PEER_RAYS, effort.most_rays) {
        for (seed, trace) in (0..).zip(&mut traces) {
            let (seconds, estimate) = peer.map(&request(count, seed))?;
            let (num_cells, ours) = (estimate.cells.len(), answer.cells.len());
            if num_cells != ours {
                let engine = peer.engine();
                return Err(Error::Internal(format!("{engine} gave {num_cells} pixels of {ours}")));
            }
            trace.push((count, seconds, estimate));
        }
        if traces.iter().filter_map(|trace| trace.last()).any(|last| 2.0 * last.1 > effort.trace_sec) {
            break;
        }
    }
    Ok(Curve { engine: peer.engine().into(), method: "f64".into(), points: points(&traces, answer) })
}
