//! Maps of derivatives: what each parameter does to each pixel, by forward derivatives of the trace
//! ([`crate::program::tangents`]).
//!
//! The derivative is that of the interior: of light that goes on through the surfaces that it meets. What a change moves
//! across an edge, such as the rim of a lens, is not in it; `nsq-gpu diff` sees both.

use crate::engine::options::{RecordPaths, StandardError, TraceOptions};
use crate::engine::tangents::{Numbers, slopes};
use crate::engine::walk::Walker;
use crate::error::{Error, Result};
use crate::format::shown;
use crate::gpu::Gpu;
use crate::model::{
    Allowance, Coating, Frame, Interaction, Medium, Precision, ReflectProb, SceneIr, SimpleCoating,
};
use crate::program::features::has_unit_gradients;
use crate::program::layout::bindings;
use crate::program::tangents::{Parameter, Tangents};
use crate::result::difference::Spread;
use crate::result::{Detector, DetectorTally, FluxUnit, Gradient, Tally, WithEdges};
use crate::scene::Scene;
use crate::trace::blocks::{Blocks, notes_of_few_rays};
use crate::trace::difference::Pair;
use crate::trace::{Shelf, Tracer};
use glam::DMat3;
use ndarray::ArrayD;
use rayon::prelude::*;
use std::path::Path;
use std::sync::Arc;

/// Parameters of one trace: more take several.
pub const MOST_PARAMETERS: usize = 4;

/// Blocks of rays, at least, where derivatives have standard errors.
const NUM_BLOCKS: u64 = 64;
/// Rays of a block, at most: sums of derivatives are read before they can overflow.
const MOST_BLOCK_RAYS: u64 = 1 << 20;

/// Differences of sixth order: how many steps from the scene, and the factor.
const CENTRAL: [(f64, f64); 6] =
    [(1.0, 0.75), (-1.0, -0.75), (2.0, -0.15), (-2.0, 0.15), (3.0, 1.0 / 60.0), (-3.0, -1.0 / 60.0)];
/// The same from one side, where a number cannot go below, or above, what it is.
const ONE_SIDED: [(f64, f64); 7] =
    [(0.0, -2.45), (1.0, 6.0), (2.0, -7.5), (3.0, 20.0 / 3.0), (4.0, -3.75), (5.0, 1.2), (6.0, -1.0 / 6.0)];
/// A step, relative to the size of the number.
const STEP: f64 = 2e-3;
/// A step of a position \[mm\] or an angle \[rad\].
const FRAME_STEP: f64 = 1e-3;
/// Differences of scenes on one side leave so much of what does not change.
const NOISE: f64 = 1e-9;
/// The weight of a quantum.
const QUANTUM: f64 = 1.0 / (1_u64 << 52) as f64;
/// A change of a coefficient that counts moves a shape by so much of its size.
const MOVED: f64 = 1e-2;
/// The size of a k that is 0: glass of 10 mm with this k takes a quarter of green light.
const ABSORPTION: f64 = 1e-6;
/// Rays of a trace that looks for what crosses edges, at most.
const MOST_EDGE_RAYS: u64 = 10_000;
/// A trace of more rays than these is preceded by a short one, so that a parameter is refused at once.
const MOST_UNCHECKED_RAYS: u64 = 1_000_000;
/// How often a face reflects while two traces are compared: seldom, as glass does, and as often in both.
const HELD_REFLECT_PROB: f64 = 0.1;
/// Keys of positions and angles.
const FRAME_KEYS: [&str; 6] = ["x", "y", "z", "rx", "ry", "rz"];

/// A scene and the parameters by which it is differentiated.
#[derive(Debug, Clone)]
pub struct Differentiated {
    /// The scene, with what its shaders must allow for.
    pub ir: SceneIr,
    /// Warnings of reading it.
    pub warnings: Vec<String>,
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
    pub shelf: Option<&'a Shelf>,
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

/// A parameter in units of its natural size, so that sums of derivatives neither overflow nor lose digits.
#[derive(Debug, Clone)]
struct Scaled {
    parameter: Parameter,
    size: f64,
    /// Two scenes of the stencil, and how much larger the number is in the first.
    ends: ([usize; 2], f64),
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
        let read = |numbers: &[(String, f64)]| -> Result<(SceneIr, Vec<String>)> {
            let scene = Scene::with_numbers(text, folder, &[set, numbers].concat())?;
            let mut ir = scene.lower()?;
            change(&mut ir)?;
            Ok((ir, scene.warnings))
        };
        let (mut ir, warnings) = read(&[])?;
        let mut parameters: Vec<Scaled> = Vec::new();
        for (name, written) in names.iter().zip(Scene::numbers(text, names)?) {
            let is_this = |other: &str| unquoted(other) == unquoted(name);
            if parameters.iter().any(|scaled| is_this(&scaled.parameter.name)) {
                return Err(Error::Usage(format!("`{}` is named twice; name it once", shown(name))));
            }
            let value =
                set.iter().rev().find(|(known, _)| is_this(known)).map_or(written, |(_, value)| *value);
            let key = name.rsplit('.').next().unwrap_or_default();
            if !value.is_finite() || value == 0.0 && is_radius(key) {
                return Err(Error::Usage(format!(
                    "`{}` is {value}: a flat face has no derivative by its radius; give it a large radius, such as 1e6",
                    shown(name)
                )));
            }
            let is_frame = FRAME_KEYS.contains(&key);
            let is_of_list = key.parse::<usize>().is_ok();
            let of_list = || name.rsplit('.').find(|part| part.parse::<usize>().is_err());
            let is_absorption = key == "k" || is_of_list && of_list() == Some("k");
            let by_shape = || size_by_shape(&ir, |change| Ok(read(&[(name.clone(), value + change)])?.0));
            let size = match is_of_list.then(by_shape).flatten() {
                Some(size) => size.max(value.abs()),
                None if is_absorption => value.abs().max(ABSORPTION),
                None if is_frame || value == 0.0 => 1.0,
                None if key.starts_with("conic") => value.abs().max(1.0),
                None => value.abs(),
            };
            let step = if is_frame { FRAME_STEP } else { STEP * size };
            let stencil = |points: &[(f64, f64)], sign: f64| -> Result<Vec<(f64, SceneIr)>> {
                let points = points.par_iter().map(|(steps, factor)| {
                    let (there, _) = read(&[(name.clone(), value + sign * steps * step)])?;
                    Ok((sign * factor * size / step, there))
                });
                points.collect()
            };
            let central = stencil(&CENTRAL, 1.0).map(|found| (found, ([0, 1], 2.0 * step)));
            let (stencil, ends) = central.or_else(|error| {
                let of_sign = |sign: f64| Ok((stencil(&ONE_SIDED, sign)?, ([1, 0], sign * step)));
                of_sign(1.0).or_else(|_: Error| of_sign(-1.0)).map_err(|_| changed_a_little(name, error))
            })?;
            if stencil.iter().any(|(_, there)| takes_undrawn(&ir, there)) {
                return Err(Error::Usage(format!(
                    "`{}` is {value}: no ray takes the branch whose share it changes, so a trace sees no derivative; \
                     give it a value such as 0.001 or 0.999, or compare two scenes by `nsq-gpu diff`",
                    shown(name)
                )));
            }
            parameters.push(Scaled { parameter: Parameter { name: name.clone(), stencil }, size, ends });
        }
        let allowed = allowance(&ir, &parameters);
        ir.allowed = allowed;
        let scenes = parameters.iter_mut().flat_map(|scaled| &mut scaled.parameter.stencil);
        scenes.for_each(|(_, scene)| scene.allowed = allowed);
        let found = Differentiated { ir, warnings, parameters };
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
        Ok(())
    }

    /// What to say of standard errors that are too large.
    ///
    /// # Errors
    /// [`Error::Usage`] for options that make no sense.
    pub fn notes(&self, options: &TraceOptions) -> Result<Vec<String>> {
        notes_of_few_rays(&self.ir, &self.traced_options(options), num_blocks(options.num_rays, NUM_BLOCKS))
    }

    /// How often all rays are traced.
    pub fn num_passes(&self) -> u64 {
        self.parameters.len().div_ceil(MOST_PARAMETERS) as u64
    }

    /// The derivatives of every detector by every parameter, and the sums of the trace. `keep_going` gets the rays done of
    /// all passes, and ends the trace by returning false: what is found then is that of all passes done, or of the blocks of rays
    /// that the first pass has done.
    ///
    /// # Errors
    /// [`Error::Usage`] for options that make no sense, and for a parameter whose change changes what the scene is made of.
    /// [`Error::Interrupted`] if no block of rays was done. [`Error::Device`] if the device fails.
    pub fn gradients(
        &self,
        gpu: &Gpu,
        options: &TraceOptions,
        how: How,
        mut keep_going: impl FnMut(u64) -> bool,
    ) -> Result<(Vec<Gradient>, Tally)> {
        let options = self.traced_options(options);
        let (mut found, mut sums, mut done_before) = (Vec::new(), None, 0);
        for parameters in self.parameters.chunks(MOST_PARAMETERS) {
            if options.num_rays > MOST_UNCHECKED_RAYS {
                // What is refused is refused before a long trace.
                let few = TraceOptions { num_rays: MOST_EDGE_RAYS, ..options.clone() };
                let how = How { without_errors: true, ..how };
                let sums = self.pass(gpu, &few, how, parameters, |_| keep_going(done_before))?.1;
                self.check_maps(gpu, &few, how, parameters, &sums)?;
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
            self.check_maps(gpu, &options, how, parameters, &of_pass.1)?;
            found.extend(of_pass.0);
            sums = sums.or(Some(of_pass.1));
            if !is_whole {
                break;
            }
        }
        let sums = sums.ok_or_else(|| Error::Usage("name a parameter, such as L1.r1".into()))?;
        Ok((found, sums))
    }

    /// Adds to derivatives what a difference of two traces gives in their place, which sees what moves across edges, too.
    /// `keep_going` gets the rays done of both traces for all parameters.
    ///
    /// # Errors
    /// As [`Differentiated::gradients`].
    pub fn add_edges(
        &self,
        gpu: &Gpu,
        options: &TraceOptions,
        gradients: &mut [Gradient],
        mut keep_going: impl FnMut(u64) -> bool,
    ) -> Result<()> {
        for (number, Scaled { parameter, ends: ([more, less], distance), .. }) in (0..).zip(&self.parameters)
        {
            let [more, less] = [*more, *less].map(|end| without_chance(&parameter.stencil[end].1));
            let pair = Pair::new(&more, less)?;
            let done_before = 2 * number * options.num_rays;
            let found = pair
                .difference(gpu, options, None, |done| keep_going(done_before + done.iter().sum::<u64>()))?;
            if found.run.partial {
                return Err(Error::Interrupted);
            }
            for row in gradients.iter_mut().filter(|row| row.parameter == parameter.name) {
                let of_detector = found.detectors.iter().find(|detector| detector.flux.name == row.detector);
                row.with_edges = of_detector.map(|detector| WithEdges {
                    flux: detector.flux.difference / distance,
                    standard_error: detector.flux.standard_error.map(|error| error / distance.abs()),
                });
            }
        }
        Ok(())
    }

    /// The gradient of a loss by all parameters: what the loss gains by a unit of each. `adjoints` says for each detector what
    /// the loss gains by a watt in each cell \[1/W\]: in the order of its array, and one number of a detector without cells.
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
        let options =
            TraceOptions { paths: RecordPaths::None, path_table: false, ..self.traced_options(options) };
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
        let largest = adjoints.iter().flatten().fold(0.0, |largest: f64, adjoint| largest.max(adjoint.abs()));
        let flux: f64 = self.ir.sources.iter().map(|source| source.total_flux).sum();
        let least = rounding(options.precision) * largest * flux;
        for (scaled, value) in self.parameters.iter().zip(&found.values) {
            if !how.with_edges && largest > 0.0 && (value * scaled.size).abs() <= least {
                self.check_edges(gpu, &options, how, scaled, |changes| {
                    changes.map(|(detector, cell, change)| adjoints[detector][cell] / largest * change).sum()
                })?;
            }
        }
        Ok(found)
    }

    /// Refuses a parameter that acts at edges alone: whose derivatives are 0, while a change of it changes what detectors
    /// record. `change` sums up the changes of the cells of all detectors, in units of the weight with which a ray is born.
    fn check_edges(
        &self,
        gpu: &Gpu,
        options: &TraceOptions,
        how: How,
        scaled: &Scaled,
        change: impl Fn(&mut dyn Iterator<Item = (usize, usize, f64)>) -> f64,
    ) -> Result<()> {
        let options = TraceOptions {
            num_rays: options.num_rays.min(MOST_EDGE_RAYS),
            tangents: None,
            ..options.clone()
        };
        // The two that lie farthest apart.
        let stencil = &scaled.parameter.stencil;
        let ends = [stencil.len() - 1, if stencil.len() == CENTRAL.len() { CENTRAL.len() - 2 } else { 0 }];
        let traced = |end: usize| -> Result<Tally> {
            let ir = &stencil[end].1;
            match how.shelf {
                Some(shelf) => Tracer::on_shelf(gpu, ir, &options, shelf)?.trace(|_| true),
                None => Tracer::new(gpu, ir, &options)?.trace(|_| true),
            }
        };
        let [more, less] = [traced(ends[0])?, traced(ends[1])?];
        let detectors = more.detectors.iter().zip(&less.detectors).enumerate();
        let mut changes = detectors.flat_map(|(number, (more, less))| {
            let cells = more.quanta_of_cells().into_iter().zip(less.quanta_of_cells()).enumerate();
            cells.map(move |(cell, (more, less))| {
                (number, cell, (more as i128 - less as i128) as f64 * QUANTUM)
            })
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

    /// [`Differentiated::check_edges`] for each of some parameters whose derivatives are all 0.
    fn check_maps(
        &self,
        gpu: &Gpu,
        options: &TraceOptions,
        how: How,
        parameters: &[Scaled],
        sums: &Tally,
    ) -> Result<()> {
        for (number, scaled) in parameters.iter().enumerate().filter(|_| !how.with_edges) {
            let chain = Chain::of(&self.ir, scaled, options.num_rays)?;
            if chain.is_constant() && light_moved(sums, number) <= rounding(options.precision) {
                self.check_edges(gpu, options, how, scaled, |changes| {
                    changes.map(|(.., change)| change.abs()).sum()
                })?;
            }
        }
        Ok(())
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
        let walker = Walker::new(gpu, &self.ir, options, how.shelf, how.edit)?;
        let program = &walker.plan.program;
        let cells = &program.cells;
        let first = cells.detectors.first().copied().unwrap_or(cells.num_cells);
        let largest = adjoints.iter().flatten().fold(0.0, |largest: f64, value| largest.max(value.abs()));
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
        let slopes = slopes(&self.ir, options, program, &walker.first, &parameters)?;
        let has_no_way = |slopes: &Numbers| {
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
            let [unit, slope] = Chain::of(&self.ir, scaled, walker.plan.num_rays)?.unit;
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
        let options = &TraceOptions { tangents: Some(Arc::new(tangents)), ..options.clone() };
        let mut tracer = match (how.shelf, how.edit) {
            (Some(shelf), _) => Tracer::on_shelf(gpu, ir, options, shelf)?,
            (None, Some(edit)) => Tracer::plain_edited(gpu, ir, options, edit)?,
            (None, None) => Tracer::new(gpu, ir, options)?,
        };
        let num_rays = tracer.num_rays();
        let least = if how.without_errors { 1 } else { NUM_BLOCKS };
        let num_blocks = num_blocks(num_rays, least);
        let mut blocks = Blocks::new(&tracer, num_blocks);
        let chains: Vec<Chain> =
            parameters.iter().map(|scaled| Chain::of(ir, scaled, num_rays)).collect::<Result<_>>()?;
        let mut spreads = vec![Spread::default(); parameters.len()];
        for _ in 0..num_blocks {
            let Some(traced) = blocks.trace_next(&mut tracer, &mut keep_going)? else { break };
            let block = blocks.add(traced);
            for (number, (chain, spread)) in chains.iter().zip(&mut spreads).enumerate() {
                spread.add(block.launched.count, &chain.derivatives(&block, number));
            }
        }
        let done = blocks.sums.launched.count;
        if done == 0 {
            return Err(Error::Interrupted);
        }
        // Of a part of the rays, fluxes are those of all that the sources emit, shared among that part.
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

/// The number of blocks of a trace, where there are so many at least.
fn num_blocks(num_rays: u64, least: u64) -> u64 {
    least.max(num_rays.div_ceil(MOST_BLOCK_RAYS)).min(num_rays)
}

/// Light that rounding moves, as a share of all, where a derivative is 0.
fn rounding(precision: Precision) -> f64 {
    if precision == Precision::F32 { 1e-6 } else { 1e-12 }
}

/// A change by more than this share of all light is none of rounding: in f32, half a ray of [`MOST_EDGE_RAYS`].
fn seen_by(precision: Precision) -> f64 {
    if precision == Precision::F32 { 0.5 / MOST_EDGE_RAYS as f64 } else { NOISE }
}

/// The light that the parameter of this number moves among cells, or adds to them, by a change of its natural size; as a share
/// of all light.
fn light_moved(sums: &Tally, number: usize) -> f64 {
    let of_detector = |detector: &DetectorTally| -> u128 {
        let num_cells = detector.quanta.len().max(1);
        let tangents =
            detector.tangents.get(number * num_cells..(number + 1) * num_cells).unwrap_or_default();
        tangents.iter().map(|tangent| tangent.unsigned_abs()).sum()
    };
    sums.detectors.iter().map(of_detector).sum::<u128>() as f64 / sums.launched.quanta as f64
}

/// A name as it is without quotes.
fn unquoted(name: &str) -> String {
    name.replace('"', "")
}

/// True of `radius`, `r1`, `r2`, and so on: 0 stands for a flat face.
fn is_radius(key: &str) -> bool {
    let digits = key.strip_prefix('r').unwrap_or_default();
    key == "radius" || !digits.is_empty() && digits.chars().all(|digit| digit.is_ascii_digit())
}

/// How large a change of a coefficient is one that counts: it moves points of a shape by [`MOVED`] of the shape's size. None if
/// the number changes no shape. `with` gives the scene in which the number is so much larger.
fn size_by_shape(ir: &SceneIr, with: impl Fn(f64) -> Result<SceneIr>) -> Option<f64> {
    let moved = |there: &SceneIr| {
        let surfaces = ir.surfaces.iter().zip(&there.surfaces);
        let moved = surfaces.map(|(here, there)| {
            let [here, there] = [here, there].map(|surface| surface.shape.samples());
            let size = here.iter().map(|p| p.truncate().length()).fold(0.0, f64::max);
            let most = here.iter().zip(&there).map(|(here, there)| here.distance(*there)).fold(0.0, f64::max);
            most / size
        });
        moved.filter(|moved| moved.is_finite()).fold(0.0, f64::max)
    };
    let mut change = 1e-9;
    // Powers as high as 20 of a size of 1000 mm are within reach.
    for _ in 0..24 {
        let there = with(change);
        if let Ok(there) = &there
            && ir.surfaces.iter().zip(&there.surfaces).all(|(here, there)| here.shape == there.shape)
        {
            return None;
        }
        match there.map(|there| moved(&there)) {
            Ok(moved) if moved < 1e-6 => change *= 1e3,
            Ok(moved) if moved <= MOVED => return Some(change * MOVED / moved),
            _ => change *= 1e-3,
        }
    }
    None
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

/// The error of a scene that a small change has made wrong.
fn changed_a_little(name: &str, error: Error) -> Error {
    Error::Usage(format!("`{}` cannot be changed a little, so it has no derivative: {error}", shown(name)))
}

/// True if a branch that no ray of the traced scene takes has light in another scene.
fn takes_undrawn(ir: &SceneIr, there: &SceneIr) -> bool {
    let by_fresnel = ir.sampling.reflect_prob == ReflectProb::Fresnel;
    let appears = |here: f64, there: f64| here == 0.0 && there != 0.0;
    ir.surfaces.iter().zip(&there.surfaces).any(|(here, there)| {
        let scatter = here.scatter.as_ref().zip(there.scatter.as_ref()).is_some_and(|(here, there)| {
            let lobes = [&here.bsdf, &there.bsdf].map(|bsdf| bsdf.transmissive_fraction());
            let shares = [[here.fraction, there.fraction], lobes];
            shares.iter().any(|[here, there]| appears(*here, *there) || appears(1.0 - here, 1.0 - there))
        });
        let coatings = here
            .coating
            .as_ref()
            .and_then(Coating::simple)
            .zip(there.coating.as_ref().and_then(Coating::simple));
        let any =
            |here: &[f64], there: &[f64]| here.iter().zip(there).any(|(&here, &there)| appears(here, there));
        let reflects = coatings.is_some_and(|(here, there)| any(&here.reflectance, &there.reflectance));
        let passes = coatings.is_some_and(|(here, there)| {
            let pass =
                |coating: &SimpleCoating| coating.reflectance.iter().map(|r| 1.0 - r).collect::<Vec<_>>();
            any(&pass(here), &pass(there))
        });
        scatter || by_fresnel && here.interaction == Interaction::Refractive && (reflects || passes)
    })
}

/// What shaders must allow for, so that all scenes about the traced one have its shaders.
fn allowance(ir: &SceneIr, parameters: &[Scaled]) -> Allowance {
    let scenes = || parameters.iter().flat_map(|scaled| &scaled.parameter.stencil).map(|(_, scene)| scene);
    let frames = |ir: &SceneIr| -> Vec<Frame> {
        let surfaces = ir.surfaces.iter().map(|surface| surface.frame);
        let sources = ir.sources.iter().map(|source| source.frame);
        surfaces.chain(ir.detectors.iter().map(|detector| detector.frame)).chain(sources).collect()
    };
    let is_turned = |ir: &SceneIr| -> Vec<bool> {
        frames(ir).iter().map(|frame| frame.rotation != DMat3::IDENTITY).collect()
    };
    let here = is_turned(ir);
    Allowance {
        turned: scenes().any(|scene| is_turned(scene) != here),
        absorbing: scenes().any(|scene| scene.media.iter().any(Medium::absorbs)),
        conic: scenes().any(|scene| !has_unit_gradients(scene)),
    }
}

/// From sums of tangents to derivatives in the units of maps. A flux is the total flux times a share, and a map's value is
/// a flux over the size of a cell: the parameter may change all three.
struct Chain {
    /// What a unit of weight is worth, and its derivative \[W, W per unit of the parameter\].
    unit: [f64; 2],
    /// The natural size of the parameter.
    size: f64,
    /// Sizes of the cells by detector, and their derivatives.
    cells: Vec<Option<[Vec<f64>; 2]>>,
    /// Shapes of maps by detector.
    shapes: Vec<Option<ndarray::IxDyn>>,
}

impl Chain {
    fn of(ir: &SceneIr, scaled: &Scaled, num_rays: u64) -> Result<Self> {
        let flux =
            |ir: &SceneIr| ir.sources.iter().map(|source| source.total_flux).sum::<f64>() / num_rays as f64;
        // Less the value of the scene itself: what does not change has a derivative of 0 exactly.
        let derivative = |value: &dyn Fn(&SceneIr) -> f64| {
            let changes =
                scaled.parameter.stencil.iter().map(|(factor, scene)| factor * (value(scene) - value(ir)));
            changes.sum::<f64>() / scaled.size
        };
        let (mut cells, mut shapes) = (Vec::new(), Vec::new());
        for number in 0..ir.detectors.len() {
            let Some((here, shape)) = sizes(ir, number)? else {
                cells.push(None);
                shapes.push(None);
                continue;
            };
            let mut slopes = vec![0.0; here.len()];
            for (factor, scene) in &scaled.parameter.stencil {
                let there = sizes(scene, number)?.map(|(sizes, _)| sizes).unwrap_or_default();
                let changes =
                    there.iter().zip(&here).map(|(there, here)| factor * (there - here) / scaled.size);
                slopes.iter_mut().zip(changes).for_each(|(slope, change)| *slope += change);
            }
            cells.push(Some([here, slopes]));
            shapes.push(Some(shape));
        }
        Ok(Chain { unit: [flux(ir), derivative(&flux)], size: scaled.size, cells, shapes })
    }

    /// True if the parameter changes neither fluxes of sources nor sizes of cells.
    fn is_constant(&self) -> bool {
        self.unit[1] == 0.0
            && self.cells.iter().flatten().all(|[_, slopes]| slopes.iter().all(|slope| *slope == 0.0))
    }

    /// The derivative of a flux \[W per unit of the parameter\].
    fn of_flux(&self, tangent: i128, quanta: u128) -> f64 {
        let [unit, slope] = self.unit;
        unit * (tangent as f64 * QUANTUM) / self.size + slope * (quanta as f64 * QUANTUM)
    }

    /// What a loss gains by a unit of the parameter of this number, from what the loss gains by a watt in each cell.
    fn of_loss(&self, tally: &Tally, number: usize, adjoints: &[Vec<f64>]) -> f64 {
        let mut gain = 0.0;
        for (detector, adjoints) in tally.detectors.iter().zip(adjoints) {
            let quanta = detector.quanta_of_cells();
            let tangents = detector.tangents.get(number * quanta.len()..).unwrap_or_default();
            for ((tangent, quanta), adjoint) in tangents.iter().zip(&quanta).zip(adjoints) {
                gain += adjoint * self.of_flux(*tangent, *quanta);
            }
        }
        gain
    }

    /// The derivatives of a detector's fluxes, then of all cells of maps, by the parameter of this number.
    fn derivatives(&self, tally: &Tally, number: usize) -> Vec<f64> {
        let [unit, _] = self.unit;
        let (mut fluxes, mut values) = (Vec::new(), Vec::new());
        for (detector, cells) in tally.detectors.iter().zip(&self.cells) {
            let num_cells = detector.quanta.len().max(1);
            let tangents =
                detector.tangents.get(number * num_cells..(number + 1) * num_cells).unwrap_or_default();
            fluxes.push(self.of_flux(tangents.iter().sum(), detector.total().quanta));
            let Some([sizes, slopes]) = cells else { continue };
            let per_size = num_cells / sizes.len().max(1);
            for (cell, (&tangent, &quanta)) in tangents.iter().zip(&detector.quanta).enumerate() {
                let (size, slope_of_size) = (sizes[cell / per_size], slopes[cell / per_size]);
                let value = unit * (quanta as f64 * QUANTUM) / size;
                values.push((self.of_flux(tangent, quanta) - value * slope_of_size) / size);
            }
        }
        fluxes.extend(values);
        fluxes
    }
}

/// The sizes of a map's cells, row by row, and the map's shape; none of a detector without a map.
fn sizes(ir: &SceneIr, number: usize) -> Result<Option<(Vec<f64>, ndarray::IxDyn)>> {
    let detector = &ir.detectors[number];
    if detector.num_cells() == 0 {
        return Ok(None);
    }
    let zeros = DetectorTally {
        quanta: vec![0; detector.num_cells()],
        hits: vec![0; detector.num_cells()],
        ..DetectorTally::default()
    };
    let empty = Detector::of_part(ir, &Tally::zeros(ir), FluxUnit::new(1.0, 1), detector, &zeros)?;
    Ok(empty.data.result().map().map(|map| (map.sizes.clone(), map.values.raw_dim())))
}
