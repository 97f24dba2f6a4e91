//! The parameter Jacobian: how all numbers that a program reads change with a parameter of the user. The Jacobian is
//! found by differences of scenes in which one parameter is a little larger or smaller.
//!
//! A thickness moves a face, an edge and a volume. So the program's numbers are functions of the user's. Derivatives by
//! parameters are taken where the program is packed, and shaders know nothing of parameters. A difference takes six
//! scenes, or seven on one side, and is exact to about 1e-12.

use crate::engine::budget::distribute;
use crate::engine::options::TraceOptions;
use crate::error::{Error, Result};
use crate::format::shown;
use crate::model::{Precision, SceneIr};
use crate::program::addition::ProgramAddition;
use crate::program::layout::bindings;
use crate::program::parsed::Parsed;
use crate::program::rewrite::jvp::{BINDING_STRIDE, Parameter, place_reals, take_reals};
use crate::program::{Program, ProgramOptions};
use rayon::prelude::*;
use std::sync::Arc;

/// The numbers that a program reads, by binding. The numbers of sources stand apart, one source after the other.
pub(crate) struct ProgramNumbers {
    pub(crate) buffers: Vec<(u32, Vec<f64>)>,
    pub(crate) sources: Vec<Vec<f64>>,
}

impl ProgramNumbers {
    /// The numbers of a scene, composed as another program is. `base` is the module of the traced scene's text. Scenes
    /// of one shape have the same text, because their numbers are live. `None` if this scene's text is another.
    fn of(
        ir: &SceneIr,
        options: &TraceOptions,
        like: &ProgramOptions,
        base: &Arc<Parsed>,
        all: &[&dyn ProgramAddition],
    ) -> Result<Option<Self>> {
        let mut is_alike = true;
        let program = composed(ir, options, like, all, |wgsl| {
            is_alike = base.wgsl == wgsl;
            // What another text reads has no place in this one's tables.
            if is_alike { Ok(base.clone()) } else { Err(Error::Internal("another text".into())) }
        });
        if !is_alike {
            return Ok(None);
        }
        Ok(Some(ProgramNumbers::in_program(&program?)))
    }

    fn in_program(program: &Program) -> Self {
        let reals =
            |binding: u32, bytes: &[u8]| take_reals(&program.module, binding, bytes).unwrap_or_default();
        let buffers = program.buffers.iter().map(|(binding, bytes)| (*binding, reals(*binding, bytes)));
        let sources = program.source_uniforms.iter().map(|bytes| reals(bindings::SOURCE, bytes)).collect();
        let buffers = buffers.filter(|(_, reals)| !reals.is_empty()).collect();
        ProgramNumbers { buffers, sources }
    }

    fn all_mut(&mut self) -> impl Iterator<Item = &mut f64> {
        self.buffers.iter_mut().flat_map(|(_, reals)| reals).chain(self.sources.iter_mut().flatten())
    }
}

/// A scene as another program is composed, in f64. `parse` gives the module of its text.
fn composed(
    ir: &SceneIr,
    options: &TraceOptions,
    like: &ProgramOptions,
    all: &[&dyn ProgramAddition],
    parse: impl FnOnce(String) -> Result<Arc<Parsed>>,
) -> Result<Program> {
    let rays = distribute(ir, options.budget(), options.shares.as_deref())?;
    let weights = rays.iter().map(|rays| rays.weight).collect();
    let like = ProgramOptions { precision: Precision::F64, weights, ..like.clone() };
    Program::parsed_by(ir, like, all, options.seed, |wgsl, _, _| parse(wgsl))
}

/// A program as it is composed in f64.
pub(crate) struct ComposedInF64 {
    /// Its text: where its numbers lie.
    pub(crate) parsed: Arc<Parsed>,
    /// Its numbers, one after the other.
    numbers: Vec<f64>,
}

/// A program of the traced scene as it is composed in f64.
pub(crate) fn composed_in_f64(
    ir: &SceneIr,
    options: &TraceOptions,
    program: &Program,
    all: &[&dyn ProgramAddition],
) -> Result<ComposedInF64> {
    let parse = |wgsl: String| match wgsl == program.parsed.wgsl {
        // Rewriting leaves the buffers of numbers as they are.
        true => Ok(program.parsed.clone()),
        false => Parsed::as_composed(wgsl).map(Arc::new),
    };
    let composed = composed(ir, options, &program.options, all, parse)?;
    let numbers = ProgramNumbers::in_program(&composed).all_mut().map(|value| *value).collect();
    Ok(ComposedInF64 { parsed: composed.parsed, numbers })
}

/// The derivatives of a program's numbers by each parameter. `base` is the program of the traced scene ([`composed_in_f64`]). A
/// number that no scene changes has a derivative of 0 exactly.
pub(crate) fn parameter_jacobian(
    options: &TraceOptions,
    program: &Program,
    base: &ComposedInF64,
    parameters: &[Parameter],
    all: &[&dyn ProgramAddition],
) -> Result<Vec<ProgramNumbers>> {
    let mut found = Vec::new();
    for parameter in parameters {
        let of_scene = |(factor, scene): &(f64, SceneIr)| {
            let mut numbers = ProgramNumbers::of(scene, options, &program.options, &base.parsed, all)?.ok_or_else(|| {
                Error::Usage(format!(
                    "`{}` has no derivative here: a small change of it changes what the scene is made of, such as whether faces touch",
                    shown(&parameter.name)
                ))
            })?;
            numbers.all_mut().zip(&base.numbers).for_each(|(value, here)| *value = (*value - here) * factor);
            Ok(numbers)
        };
        let all = parameter.stencil.par_iter().map(of_scene).collect::<Result<Vec<ProgramNumbers>>>()?;
        let sum = all.into_iter().reduce(|mut sum, mut numbers| {
            sum.all_mut().zip(numbers.all_mut()).for_each(|(sum, value)| *sum += *value);
            sum
        });
        found.push(sum.unwrap_or_else(|| ProgramNumbers { buffers: Vec::new(), sources: Vec::new() }));
    }
    Ok(found)
}

/// Gives a program the tangents of its numbers.
pub(super) fn add_tangents(
    options: &TraceOptions,
    program: &mut Program,
    base: &ComposedInF64,
    parameters: &[Parameter],
    all: &[&dyn ProgramAddition],
) -> Result<()> {
    let mut added = Vec::new();
    for (number, sum) in (1..).zip(parameter_jacobian(options, program, base, parameters, all)?) {
        let place = |binding: u32, num_bytes: usize, reals: &[f64]| {
            let twin = binding + number * BINDING_STRIDE;
            place_reals(&program.module, twin, program.options.precision, num_bytes, reals)
        };
        for (binding, reals) in &sum.buffers {
            let bytes = program
                .buffers
                .iter()
                .find(|(other, _)| other == binding)
                .map_or(0, |(_, bytes)| bytes.len());
            if let Some(bytes) = place(*binding, bytes, reals)? {
                added.push((binding + number * BINDING_STRIDE, bytes));
            }
        }
        let mut of_sources = Vec::new();
        for (reals, bytes) in sum.sources.iter().zip(&program.source_uniforms) {
            of_sources.extend(place(bindings::SOURCE, bytes.len(), reals)?);
        }
        if !of_sources.is_empty() {
            program.uploads.push((bindings::SOURCE + number * BINDING_STRIDE, of_sources));
        }
    }
    program.buffers.extend(added);
    Ok(())
}
