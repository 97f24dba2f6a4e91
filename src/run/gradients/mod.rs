//! Maps of derivatives: what each parameter does to each pixel, by forward derivatives of the trace
//! ([`crate::program::rewrite::jvp`]).
//!
//! The derivative covers the interior: light that goes on through the surfaces that it meets. What a change moves
//! across an edge, such as the rim of a lens, is missing. `nsq-gpu diff` sees both.

mod chain;
mod edges;
mod scaled;
mod with_edges;

pub use crate::run::gradients::edges::LossWithEdges;

use crate::derivatives::jacobian::ProgramNumbers;
use crate::derivatives::walk::Walker;
use crate::engine::options::{Collect, RecordPaths, StandardError, TraceOptions};
use crate::engine::pipeline_cache::Shaders;
use crate::error::{Error, Result};
use crate::format::shown;
use crate::gpu::Gpu;
use crate::model::key_path::quoted;
use crate::model::{Bsdf, Precision, SceneIr};
use crate::program::layout::bindings;
use crate::program::rewrite::jvp::{Parameter, Tangents};
use crate::result::difference::Spread;
use crate::result::{Gradient, Tally};
use crate::run::additions::ForAdapter;
use crate::run::blocks::{Blocks, notes_of_few_rays, num_blocks};
use crate::run::gradients::chain::{Chain, sizes};
use crate::run::gradients::edges::{MOST_EDGE_RAYS, rounding};
use crate::run::gradients::scaled::{Scaled, allowance, unquoted};
use crate::run::{PipelineCache, Tracer};
use crate::scene::Scene;
use ndarray::ArrayD;
use std::path::Path;
use std::sync::Arc;

/// Parameters of one trace: more take several.
pub const MOST_PARAMETERS: usize = 4;

/// Blocks of rays, at least, where derivatives have standard errors.
const NUM_BLOCKS: u64 = 64;
/// Changes of numbers below this are of rounding.
const NOISE: f64 = 1e-9;
/// A trace of more rays than these is preceded by a short one, so that a parameter is refused at once.
const MOST_UNCHECKED_RAYS: u64 = 10_000_000;

/// A scene and the parameters by which it is differentiated.
#[derive(Debug, Clone)]
pub struct Differentiated {
    /// The scene, with what its shaders must allow for.
    pub ir: SceneIr,
    /// What was read.
    pub scene: Scene,
    parameters: Vec<Scaled>,
}

/// The gradient of a loss.
#[derive(Debug, Clone, PartialEq)]
pub struct LossGradient {
    /// What the loss gains by a unit of each parameter, in their order \[units of the loss per unit of the parameter\].
    pub values: Vec<f64>,
    /// Rays, or deposits, whose derivatives are no numbers, or too large: they are missing.
    pub num_lost: u64,
    /// Parameters that were differentiated forward, because there is no reverse pass to them.
    pub num_forward: usize,
    /// Why some were.
    pub why_forward: Option<String>,
}

/// How derivatives are traced.
#[derive(Clone, Copy, Default)]
pub struct How<'a> {
    /// Compiled shaders of earlier traces.
    pub cache: Option<&'a PipelineCache>,
    /// No standard errors, which short traces spend most of their time on.
    pub without_errors: bool,
    /// A parameter may act at edges alone, such as where [`Differentiated::add_edges`] follows.
    pub with_edges: bool,
    /// A loss is differentiated forward where it could be differentiated back: for tests and measurements.
    #[doc(hidden)]
    pub forward: bool,
    /// Changes the composed text: for tests that plant an error in a shader.
    #[doc(hidden)]
    pub edit: Option<&'a dyn Fn(String) -> String>,
}

/// Refuses a wavelength where a medium is a table, which has only straight lines between two samples.
fn refuse_by_wavelength(scene: &Scene, name: &str) -> Result<()> {
    let is_wavelength = name.split('.').any(|part| part == "wavelengths");
    match scene.tabulated_medium().filter(|_| is_wavelength) {
        None => Ok(()),
        Some(medium) => Err(Error::Usage(format!(
            "`{}` is a wavelength, and the medium {} is a table, which has no derivative by it; compare two scenes by \
             `nsq-gpu diff`, or give the medium by its name in the catalog",
            shown(name),
            quoted(&medium)
        ))),
    }
}

impl Differentiated {
    /// A scene's text, read from a folder, with some numbers set, and names of numbers by which it is differentiated.
    /// `change` is made to each scene, such as another sampling.
    ///
    /// # Errors
    /// [`Error::Scene`] if the text is no scene. [`Error::Usage`] for a name of nothing, and for a number by which nothing
    /// can be differentiated.
    pub fn new(
        text: &str,
        folder: &Path,
        set: &[(String, f64)],
        names: &[String],
        change: impl Fn(&mut SceneIr) -> Result<()> + Sync,
    ) -> Result<Self> {
        let read = |numbers: &[(String, f64)]| -> Result<(SceneIr, Scene)> {
            let is_changed =
                |name: &String| numbers.iter().any(|(changed, _)| unquoted(changed) == unquoted(name));
            let kept = set.iter().filter(|(name, _)| !is_changed(name)).chain(numbers).cloned();
            let scene = Scene::with_numbers(text, folder, &kept.collect::<Vec<_>>())?;
            let mut ir = scene.lower()?;
            change(&mut ir)?;
            Ok((ir, scene))
        };
        let (mut ir, scene) = read(&[])?;
        let mut parameters: Vec<Scaled> = Vec::new();
        for (name, written) in names.iter().zip(Scene::numbers(text, names)?) {
            let is_this = |other: &str| unquoted(other) == unquoted(name);
            if parameters.iter().any(|scaled| is_this(&scaled.parameter.name)) {
                return Err(Error::Usage(format!("`{}` is named twice; name it once", shown(name))));
            }
            refuse_by_wavelength(&scene, name)?;
            let value =
                set.iter().rev().find(|(known, _)| is_this(known)).map_or(written, |(_, value)| *value);
            parameters.push(Scaled::new(&ir, name, value, |value| Ok(read(&[(name.clone(), value)])?.0))?);
        }
        let allowed = allowance(&ir, &parameters);
        ir.allowed = allowed;
        let scenes = parameters.iter_mut().flat_map(|scaled| &mut scaled.parameter.stencil);
        scenes.for_each(|(_, scene)| scene.allowed = allowed);
        let found = Differentiated { ir, scene, parameters };
        found.check()?;
        Ok(found)
    }

    /// Refuses what has no derivative.
    fn check(&self) -> Result<()> {
        let refused = |what: &str| {
            Err(Error::Usage(format!(
                "{what} have no derivatives; compare two scenes by `nsq-gpu diff` instead"
            )))
        };
        if !self.ir.meshes.is_empty() {
            return refused("meshes");
        }
        if crate::model::surface_optics::splits(&self.ir) {
            return refused("split rays (split_depth)");
        }
        if !self.ir.scatter_sampling.is_empty() {
            return refused("rays that scatter on purpose (scatter_prob, scatter_to)");
        }
        // Which row a ray is drawn from depends on its angle of incidence.
        let is_measured =
            |bsdf: &Bsdf| matches!(bsdf, Bsdf::Measured(measured) if measured.table.rows.len() > 1);
        let bsdfs = self.ir.surfaces.iter().filter_map(|surface| surface.scatter.as_ref());
        if bsdfs.map(|scatter| &scatter.bsdf).any(is_measured) {
            return refused("measured BSDFs of several angles of incidence");
        }
        Ok(())
    }

    /// What to say of standard errors that are too large.
    ///
    /// # Errors
    /// [`Error::Usage`] for options that make no sense.
    pub fn notes(&self, options: &TraceOptions) -> Result<Vec<String>> {
        notes_of_few_rays(&self.ir, &self.traced_options(options), num_blocks(options.num_rays, NUM_BLOCKS))
    }

    /// The number of parameters.
    pub fn num_parameters(&self) -> u64 {
        self.parameters.len() as u64
    }

    /// How often all rays are traced.
    pub fn num_passes(&self) -> u64 {
        self.parameters.len().div_ceil(MOST_PARAMETERS) as u64
    }

    /// The derivatives of every detector by every parameter, and the sums of the trace. `keep_going` gets the rays done
    /// of all passes, and ends the trace by returning false. The result then covers all passes done, or the rays that
    /// the first pass has done. Where the very first call ends the trace, there is no result.
    ///
    /// # Errors
    /// [`Error::Usage`] for options that make no sense, for a parameter that changes what the scene is made of, or one
    /// that acts at edges alone. [`Error::Interrupted`] if the first call ended it. [`Error::Device`] if the device
    /// fails.
    pub fn gradients(
        &self,
        gpu: &Gpu,
        options: &TraceOptions,
        how: How,
        mut keep_going: impl FnMut(u64) -> bool,
    ) -> Result<(Vec<Gradient>, Tally)> {
        let options = self.traced_options(options);
        let own = PipelineCache::new();
        let cache = how.cache.or_else(|| how.edit.is_none().then_some(&own));
        let how = How { cache, ..how };
        let (mut found, mut sums, mut done_before) = (Vec::new(), None, 0);
        for parameters in self.parameters.chunks(MOST_PARAMETERS) {
            let (is_checked, is_long) = (!how.with_edges, options.num_rays > MOST_UNCHECKED_RAYS);
            if is_checked && is_long {
                // What is refused is refused before a long trace.
                let few = TraceOptions { num_rays: MOST_EDGE_RAYS, ..options.clone() };
                let how = How { without_errors: true, ..how };
                let sums = self.pass(gpu, &few, how, parameters, |_| true)?.1;
                edges::check_maps(&self.ir, gpu, &few, how.cache, parameters, &sums)?;
            }
            let of_pass = self.pass(gpu, &options, how, parameters, |done| keep_going(done_before + done));
            let of_pass = match of_pass {
                Err(Error::Interrupted) if sums.is_some() => break,
                of_pass => of_pass?,
            };
            let is_whole = of_pass.1.launched.count == options.num_rays;
            if !is_whole && sums.is_some() {
                break;
            }
            done_before += options.num_rays;
            if is_checked && !is_long {
                edges::check_maps(&self.ir, gpu, &options, how.cache, parameters, &of_pass.1)?;
            }
            found.extend(of_pass.0);
            sums = sums.or(Some(of_pass.1));
            if !is_whole {
                break;
            }
        }
        let sums = sums.ok_or_else(|| Error::Usage("name a parameter, such as L1.r1".into()))?;
        Ok((found, sums))
    }

    /// What a loss gains at most by rounding, where a parameter changes by its natural size.
    fn least(&self, precision: Precision, adjoints: &[Vec<f64>]) -> f64 {
        rounding(precision) * largest(adjoints) * self.ir.emitted_flux()
    }

    /// The gradient of a loss by all parameters: what the loss gains by a unit of each. `adjoints` says for each
    /// detector what the loss gains by a watt in each cell \[1/W\], in the order of its array. A detector without cells
    /// has one number.
    ///
    /// Rays are walked back once, however many parameters there are. Parameters of what has no reverse pass are
    /// differentiated forward.
    ///
    /// # Errors
    /// As [`Differentiated::gradients`].
    pub fn loss_gradient(
        &self,
        gpu: &Gpu,
        options: &TraceOptions,
        how: How,
        adjoints: &[Vec<f64>],
        mut keep_going: impl FnMut(u64) -> bool,
    ) -> Result<LossGradient> {
        self.check_adjoints(adjoints)?;
        let options = TraceOptions {
            paths: RecordPaths::None,
            collect: Collect::Light,
            ..self.traced_options(options)
        };
        let all = 0..self.parameters.len();
        let mut found =
            LossGradient { values: vec![0.0; all.len()], num_lost: 0, num_forward: 0, why_forward: None };
        let mut done_before = 0;
        let forward: Vec<usize> = match how.forward {
            true => all.collect(),
            false => match self.walk_back(gpu, &options, how, adjoints, &mut found, &mut keep_going) {
                Err(error @ Error::NoWayBack(_)) => {
                    found.why_forward = Some(error.to_string());
                    all.collect()
                }
                left => {
                    done_before = options.num_rays;
                    left?
                }
            },
        };
        found.num_forward = forward.len();
        for numbers in forward.chunks(MOST_PARAMETERS) {
            let parameters: Vec<Scaled> =
                numbers.iter().map(|number| self.parameters[*number].clone()).collect();
            let how = How { without_errors: true, ..how };
            let sums = self.pass(gpu, &options, how, &parameters, |done| keep_going(done_before + done))?.1;
            if sums.launched.count < options.num_rays {
                return Err(Error::Interrupted);
            }
            done_before += options.num_rays;
            for (at, (number, scaled)) in numbers.iter().zip(&parameters).enumerate() {
                let chain = Chain::of(&self.ir, scaled, sums.launched.count)?;
                found.values[*number] = chain.of_loss(&sums, at, adjoints);
            }
            found.num_lost += sums.detectors.iter().map(|detector| detector.lost_tangents).sum::<u64>();
        }
        let largest = largest(adjoints);
        let least = self.least(options.precision, adjoints);
        for (scaled, value) in self.parameters.iter().zip(&found.values) {
            if !how.with_edges && largest > 0.0 && (value * scaled.size).abs() <= least {
                edges::check(gpu, &options, how.cache, scaled, |changes| {
                    changes.map(|(detector, cell, change)| adjoints[detector][cell] / largest * change).sum()
                })?;
            }
        }
        Ok(found)
    }

    /// Options as derivatives are traced with.
    fn traced_options(&self, options: &TraceOptions) -> TraceOptions {
        let fluxes = || self.ir.sources.iter().map(|source| source.total_flux).collect();
        TraceOptions {
            live: true,
            // Each source launches as many rays in all scenes about this one.
            shares: options.shares.clone().or_else(|| Some(fluxes())),
            standard_error: StandardError::Off,
            ..options.clone()
        }
    }

    /// The number of each detector's cells, as [`Differentiated::loss_gradient`] takes their adjoints.
    pub fn adjoint_lengths(&self) -> impl Iterator<Item = usize> {
        self.ir.detectors.iter().map(|detector| detector.num_cells().max(1))
    }

    /// Walks rays back, and gives the numbers of the parameters that have no reverse pass.
    fn walk_back(
        &self,
        gpu: &Gpu,
        options: &TraceOptions,
        how: How,
        adjoints: &[Vec<f64>],
        found: &mut LossGradient,
        keep_going: &mut dyn FnMut(u64) -> bool,
    ) -> Result<Vec<usize>> {
        let walker = Walker::new(gpu, &self.ir, options, Shaders { cache: how.cache, edit: how.edit })?;
        let plan = &walker.again.plan;
        let program = &plan.program;
        let cells = &program.cells;
        let first = cells.detectors.first().copied().unwrap_or(cells.num_cells);
        let largest = largest(adjoints);
        // A power of two, so that no digit is lost; reals of 32 bits hold the quotients.
        let scale = if largest > 0.0 { largest.log2().floor().exp2() } else { 1.0 };
        let mut of_cells = vec![0.0; (cells.num_cells - first) as usize];
        for (begin, adjoints) in cells.detectors.iter().zip(adjoints) {
            let begin = (begin - first) as usize;
            for (cell, adjoint) in of_cells[begin..].iter_mut().zip(adjoints) {
                *cell = adjoint / scale;
            }
        }
        let parameters: Vec<Parameter> =
            self.parameters.iter().map(|scaled| scaled.parameter.clone()).collect();
        let slopes = walker.jacobian(options, &parameters)?;
        let has_no_way = |slopes: &ProgramNumbers| {
            let is_known = |binding: u32| walker.layout.buffers.iter().any(|(known, _)| *known == binding);
            slopes
                .buffers
                .iter()
                .any(|(binding, reals)| !is_known(*binding) && reals.iter().any(|real| real.abs() > NOISE))
        };
        let walked = walker.walk(&of_cells, keep_going)?;
        let mut forward = Vec::new();
        for (number, (scaled, slopes)) in self.parameters.iter().zip(&slopes).enumerate() {
            if has_no_way(slopes) {
                let name = &scaled.parameter.name;
                found.why_forward = Some(format!("`{}` changes a table of unknown length", shown(name)));
                forward.push(number);
                continue;
            }
            let [unit, slope] = Chain::of(&self.ir, scaled, plan.num_rays)?.unit;
            let mut value = 0.0;
            for (source, walked) in walked.iter().enumerate() {
                let mut at = 0;
                for (binding, num) in &walker.layout.buffers {
                    let of_buffer = slopes.buffers.iter().find(|(known, _)| known == binding);
                    let reals = match *binding {
                        bindings::SOURCE => slopes.sources.get(source),
                        _ => of_buffer.map(|(_, reals)| reals),
                    };
                    let given = &walked.numbers[at..at + num];
                    let num_slopes = reals.map_or(0, Vec::len);
                    if num_slopes != 0 && num_slopes != *num {
                        let what = format!("{num} adjoints for {num_slopes} numbers of binding {binding}");
                        return Err(Error::Internal(what));
                    }
                    let products =
                        reals.into_iter().flatten().zip(given).map(|(slope, adjoint)| slope * adjoint);
                    value += unit / scaled.size * products.sum::<f64>();
                    at += num;
                }
                value += slope * walked.noted;
            }
            found.values[number] = scale * value;
        }
        found.num_lost += walked.iter().map(|walked| walked.num_lost).sum::<u64>();
        Ok(forward)
    }

    /// Adjoints of one detector's cells, in the order of its array.
    ///
    /// # Errors
    /// [`Error::Usage`] if they have another shape than the detector's map, and another number than its cells.
    pub fn adjoints_of(&self, number: usize, given: &ArrayD<f64>) -> Result<Vec<f64>> {
        let detector = &self.ir.detectors[number];
        let shape = sizes(&self.ir, number)?.map_or_else(|| ndarray::IxDyn(&[]), |(_, shape)| shape);
        let is_flat = given.ndim() <= 1 && given.len() == detector.num_cells().max(1);
        if given.raw_dim() != shape && !is_flat {
            return Err(Error::Usage(format!(
                "adjoints of `{}` have the shape {:?}; its map has {:?}",
                shown(&detector.name),
                given.shape(),
                ndarray::Dimension::slice(&shape),
            )));
        }
        Ok(given.iter().copied().collect())
    }

    fn check_adjoints(&self, adjoints: &[Vec<f64>]) -> Result<()> {
        let wanted: Vec<usize> = self.adjoint_lengths().collect();
        let given: Vec<usize> = adjoints.iter().map(Vec::len).collect();
        if wanted != given {
            return Err(Error::Usage(format!(
                "the adjoints of a loss have {given:?} numbers by detector; give {wanted:?}"
            )));
        }
        let mut all = self.ir.detectors.iter().zip(adjoints);
        let wrong = all.find_map(|(detector, adjoints)| {
            adjoints.iter().find(|value| !value.is_finite()).map(|value| (detector, value))
        });
        match wrong {
            Some((detector, value)) => Err(Error::Usage(format!(
                "an adjoint of `{}` is {value}; give finite numbers",
                shown(&detector.name)
            ))),
            None => Ok(()),
        }
    }

    fn pass(
        &self,
        gpu: &Gpu,
        options: &TraceOptions,
        how: How,
        parameters: &[Scaled],
        mut keep_going: impl FnMut(u64) -> bool,
    ) -> Result<(Vec<Gradient>, Tally)> {
        let ir = &self.ir;
        let tangents =
            Tangents { parameters: parameters.iter().map(|scaled| scaled.parameter.clone()).collect() };
        let options = &TraceOptions { collect: Collect::Tangents(Arc::new(tangents)), ..options.clone() };
        let shaders = Shaders { cache: how.cache, edit: how.edit };
        let mut tracer = Tracer::with(gpu, ir, options, ForAdapter::WhatPays, shaders)?;
        let num_rays = tracer.num_rays();
        let least = if how.without_errors { 1 } else { NUM_BLOCKS };
        let num_blocks = num_blocks(num_rays, least);
        let mut blocks = Blocks::new(&tracer, num_blocks);
        let chains: Vec<Chain> =
            parameters.iter().map(|scaled| Chain::of(ir, scaled, num_rays)).collect::<Result<_>>()?;
        let mut spreads = vec![Spread::default(); parameters.len()];
        let mut has_gone_on = false;
        for _ in 0..num_blocks {
            let end = blocks.next_end(&tracer);
            let traced = blocks.trace_to(&mut tracer, end, |rays| {
                let goes_on = keep_going(rays);
                has_gone_on |= goes_on;
                goes_on
            })?;
            if !has_gone_on && traced.tally.launched.count < num_rays {
                return Err(Error::Interrupted);
            }
            // Of a block that was stopped, the rays that were traced are a smaller block.
            let block = blocks.add(traced.tally);
            for (number, (chain, spread)) in chains.iter().zip(&mut spreads).enumerate() {
                spread.add(block.launched.count, &chain.derivatives(&block, number));
            }
            if traced.is_stopped {
                break;
            }
            blocks.end_block();
        }
        let done = blocks.sums.launched.count;
        if done == 0 {
            return Err(Error::Interrupted);
        }
        // After a stop, the rays so far share all flux that the sources emit.
        let scale = num_rays as f64 / done as f64;
        let scaled = |values: Vec<f64>| values.into_iter().map(|value| scale * value).collect::<Vec<_>>();
        let mut found = Vec::new();
        for (number, (chain, spread)) in chains.iter().zip(&spreads).enumerate() {
            let values = scaled(chain.derivatives(&blocks.sums, number));
            let errors = spread.errors().map(scaled);
            let mut at = ir.detectors.len();
            for (index, detector) in ir.detectors.iter().enumerate() {
                let num_cells = detector.num_cells();
                let shape = chain.shapes[index].clone();
                let cut = |all: &[f64]| -> Result<Option<ArrayD<f64>>> {
                    let Some(shape) = &shape else { return Ok(None) };
                    let cells = all[at..at + num_cells].to_vec();
                    let array = ArrayD::from_shape_vec(shape.clone(), cells);
                    array.map(Some).map_err(|error| Error::Internal(error.to_string()))
                };
                found.push(Gradient {
                    parameter: parameters[number].parameter.name.clone(),
                    detector: detector.name.clone(),
                    flux: values[index],
                    standard_error: errors.as_ref().map(|errors| errors[index]),
                    map: cut(&values)?,
                    map_errors: errors.as_ref().map(|errors| cut(errors)).transpose()?.flatten(),
                    num_lost: blocks.sums.detectors[index].lost_tangents,
                    with_edges: None,
                });
                at += num_cells;
            }
        }
        Ok((found, blocks.sums))
    }
}

/// The largest of all adjoints, without its sign.
fn largest(adjoints: &[Vec<f64>]) -> f64 {
    adjoints.iter().flatten().fold(0.0, |largest, adjoint| largest.max(adjoint.abs()))
}
