//! What a derivative does not see: light that a change moves across an edge.

use crate::engine::options::{Collect, TraceOptions};
use crate::engine::pipeline_cache::Shaders;
use crate::error::{Error, Result};
use crate::format::shown;
use crate::gpu::Gpu;
use crate::model::{Precision, ReflectProb, SceneIr};
use crate::result::difference::DetectorDifference;
use crate::result::{Gradient, Tally, WithEdges};
use crate::run::additions::ForAdapter;
use crate::run::difference::Pair;
use crate::run::gradients::chain::{Chain, QUANTUM};
use crate::run::gradients::scaled::Scaled;
use crate::run::{PipelineCache, Tracer};

/// Rays of a trace that looks for what crosses edges, at most.
pub(super) const MOST_EDGE_RAYS: u64 = 10_000;
/// Derivatives that differ by less than this share are alike, whatever their errors.
const ALIKE: f64 = 0.01;
/// Standard errors by which chance hardly ever parts two derivatives.
const SIGMAS: f64 = 3.0;
/// Rays of a check whether light crosses edges, at most.
pub(super) const MOST_CHECK_RAYS: u64 = 1 << 15;
/// How often a face reflects while two traces are compared: seldom, as glass does, and as often in both.
const HELD_REFLECT_PROB: f64 = 0.1;

/// The derivative of a loss by a difference of two traces, which sees what moves across edges, too.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LossWithEdges {
    /// What the loss gains by a unit of the parameter.
    pub value: f64,
    /// Its standard error; none from too few rays.
    pub standard_error: Option<f64>,
}

impl LossWithEdges {
    /// True if this and the derivative of the interior differ by more than chance, and by more than [`ALIKE`].
    pub(super) fn differs_from(&self, interior: f64) -> bool {
        let apart = (self.value - interior).abs();
        let largest = self.value.abs().max(interior.abs());
        self.standard_error.is_some_and(|error| apart > SIGMAS * error) && apart > ALIKE * largest
    }
}

/// Two scenes with more and less of a parameter, and how much more \[units of the parameter\].
struct Ends {
    more: SceneIr,
    less: SceneIr,
    distance: f64,
}

impl Ends {
    fn of(scaled: &Scaled) -> Self {
        let ([more, less], distance) = scaled.ends;
        let [more, less] = [more, less].map(|end| without_chance(&scaled.parameter.stencil[end].1));
        Ends { more, less, distance }
    }

    /// Three times as far apart where there is more and less, so that more light crosses edges.
    fn wide(scaled: &Scaled) -> Self {
        match scaled.is_central() {
            true => {
                let [less, more] = scaled.farthest().map(without_chance);
                Ends { more, less, distance: 3.0 * scaled.ends.1 }
            }
            false => Ends::of(scaled),
        }
    }

    /// The two scenes side by side.
    fn pair<'a>(&'a self, cache: Option<&'a PipelineCache>) -> Result<Pair<'a>> {
        Ok(Pair::new(&self.more, self.less.clone())?.with_cache(cache))
    }
}

/// Adds to derivatives what a difference of two traces gives in their place, which sees what moves across edges, too.
/// `keep_going` gets the rays done of both traces for all parameters.
///
/// # Errors
/// [`Error::Interrupted`] if a trace was ended. [`Error::Device`] if the device fails.
pub(super) fn add(
    parameters: &[Scaled],
    gpu: &Gpu,
    options: &TraceOptions,
    cache: Option<&PipelineCache>,
    gradients: &mut [Gradient],
    mut keep_going: impl FnMut(u64) -> bool,
) -> Result<()> {
    for (number, scaled) in (0..).zip(parameters) {
        let ends = Ends::of(scaled);
        let distance = ends.distance;
        let done_before = 2 * number * options.num_rays;
        let keep_going = |done: [u64; 2]| keep_going(done_before + done.iter().sum::<u64>());
        let found = ends.pair(cache)?.difference(gpu, options, keep_going)?;
        if found.run.partial {
            return Err(Error::Interrupted);
        }
        for row in gradients.iter_mut().filter(|row| row.parameter == scaled.parameter.name) {
            let of_detector = found.detectors.iter().find(|detector| detector.flux.name == row.detector);
            row.with_edges = of_detector.map(|DetectorDifference { flux, map, .. }| WithEdges {
                flux: flux.difference / distance,
                standard_error: flux.standard_error.map(|error| error / distance.abs()),
                map: map.as_ref().map(|map| &map.values / distance),
                map_errors: map.as_ref().and_then(|map| Some(map.errors.as_ref()? / distance.abs())),
                few_rays: flux.few_rays.map(|few| few.scaled(1.0 / distance.abs())),
            });
        }
    }
    Ok(())
}

/// The derivatives of a loss by differences of two traces; where they are a check, of scenes farther apart. `keep_going` as in
/// [`add`].
///
/// # Errors
/// As [`add`].
pub(super) fn of_loss(
    parameters: &[Scaled],
    gpu: &Gpu,
    options: &TraceOptions,
    cache: Option<&PipelineCache>,
    adjoints: &[Vec<f64>],
    is_check: bool,
    mut keep_going: impl FnMut(u64) -> bool,
) -> Result<Vec<LossWithEdges>> {
    let of_parameter = |(number, scaled): (u64, &Scaled)| {
        let ends = if is_check { Ends::wide(scaled) } else { Ends::of(scaled) };
        let done_before = 2 * number * options.num_rays;
        let keep_going = |done: [u64; 2]| keep_going(done_before + done.iter().sum::<u64>());
        let found = ends.pair(cache)?.loss_difference(gpu, options, adjoints, keep_going)?;
        Ok(LossWithEdges {
            value: found.difference / ends.distance,
            standard_error: found.standard_error.map(|error| error / ends.distance.abs()),
        })
    };
    (0..).zip(parameters).map(of_parameter).collect()
}

/// Refuses a parameter that acts at edges alone: whose derivatives are 0, while a change of it changes what detectors
/// record. `change` sums up the changes of the cells of all detectors, in units of the weight with which a ray is born.
pub(super) fn check(
    gpu: &Gpu,
    options: &TraceOptions,
    cache: Option<&PipelineCache>,
    scaled: &Scaled,
    change: impl Fn(&mut dyn Iterator<Item = (usize, usize, f64)>) -> f64,
) -> Result<()> {
    let options = TraceOptions {
        num_rays: options.num_rays.min(MOST_EDGE_RAYS),
        collect: Collect::Light,
        ..options.clone()
    };
    let traced = |ir: &SceneIr| -> Result<Tally> {
        let shaders = Shaders { cache, edit: None };
        Tracer::with(gpu, ir, &options, ForAdapter::WhatPays, shaders)?.trace(|_| true)
    };
    let [less, more] = scaled.farthest();
    // A quantum is a share of all flux, which the parameter may change.
    let worth = more.emitted_flux() / less.emitted_flux();
    let [more, less] = [traced(more)?, traced(less)?];
    let detectors = more.detectors.iter().zip(&less.detectors).enumerate();
    let mut changes = detectors.flat_map(|(number, (more, less))| {
        let (more, less) = (more.quanta_of_cells(), less.quanta_of_cells());
        let num_cells = more.len().min(less.len());
        let change = move |cell: usize| {
            let same = more[cell] as i128 - less[cell] as i128;
            same as f64 + (worth - 1.0) * more[cell] as f64
        };
        (0..num_cells).map(move |cell| (number, cell, change(cell) * QUANTUM))
    });
    if change(&mut changes).abs() <= seen_by(options.precision) * more.launched.quanta as f64 * QUANTUM {
        return Ok(());
    }
    Err(Error::Usage(format!(
        "`{}` acts at edges alone, such as rims, stops, draws, and the borders of pixels that take rays whole; derivatives \
         do not see these: compare two scenes by `nsq-gpu diff`",
        shown(&scaled.parameter.name)
    )))
}

/// [`check`] for each of some parameters whose derivatives are all 0.
pub(super) fn check_maps(
    ir: &SceneIr,
    gpu: &Gpu,
    options: &TraceOptions,
    cache: Option<&PipelineCache>,
    parameters: &[Scaled],
    sums: &Tally,
) -> Result<()> {
    for (number, scaled) in parameters.iter().enumerate() {
        let is_dark = light_moved(sums, number) <= rounding(options.precision);
        if is_dark && Chain::of(ir, scaled, options.num_rays)?.is_constant() {
            check(gpu, options, cache, scaled, |changes| changes.map(|(.., change)| change.abs()).sum())?;
        }
    }
    Ok(())
}

/// Light that rounding moves, as a share of all, where a derivative is 0.
pub(super) fn rounding(precision: Precision) -> f64 {
    if precision == Precision::F32 { 1e-6 } else { 1e-12 }
}

/// A change by more than this share of all light is none of rounding: in f32, half a ray of [`MOST_EDGE_RAYS`].
fn seen_by(precision: Precision) -> f64 {
    if precision == Precision::F32 { 0.5 / MOST_EDGE_RAYS as f64 } else { 1e-9 }
}

/// The light that the parameter of this number moves among cells, or adds to them, as a share of all light. The
/// parameter changes by its natural size.
fn light_moved(sums: &Tally, number: usize) -> f64 {
    let tangents = sums.detectors.iter().flat_map(|detector| detector.tangents_by(number));
    tangents.map(|tangent| tangent.unsigned_abs()).sum::<u128>() as f64 / sums.launched.quanta as f64
}

/// A scene whose rays draw the same branches at faces, whatever these reflect: the weights take what a small change does to a
/// reflectance. Else almost no ray would draw otherwise, and a difference would be mostly 0 and sometimes large.
fn without_chance(ir: &SceneIr) -> SceneIr {
    let mut ir = ir.clone();
    if ir.sampling.reflect_prob == ReflectProb::Fresnel {
        ir.sampling.reflect_prob = ReflectProb::Constant(HELD_REFLECT_PROB);
    }
    ir
}
