//! Turns a scene and options into an engine that is ready to trace.

use crate::engine::Engine;
use crate::engine::device::DeviceState;
use crate::engine::limits::DispatchLimits;
use crate::engine::options::TraceOptions;
use crate::engine::plan::Draft;
use crate::engine::shelf::Shelf;
use crate::engine::stages::Additions;
use crate::engine::strategy::Strategy;
use crate::error::Result;
use crate::gpu::Gpu;
use crate::model::SceneIr;
use crate::program::Program;
use crate::program::parsed::Parsed;
use crate::program::wgsl::extension::NoExtension;
use std::sync::Arc;

/// Composes, compiles and packs a scene in the plain way, with the shaders of a shelf.
pub(crate) fn prepare_on_shelf<'a>(
    gpu: &'a Gpu,
    ir: &'a SceneIr,
    options: &TraceOptions,
    shelf: &Shelf,
) -> Result<Engine<'a>> {
    let parse = |wgsl, precision| shelf.parsed(wgsl, precision);
    let limits = |program: &Program| DispatchLimits::of(program);
    let plan = Draft::new(gpu, ir, options)?.compose(gpu, ir, &NoExtension, parse, limits)?;
    let stages = shelf.stages(gpu, &plan.program, options.is_strict(&gpu.info))?;
    let words = plan.path_table_words();
    let device = DeviceState::new(gpu, &plan.program, plan.batch, stages, &Additions::default(), words)?;
    Ok(Engine::new(gpu, ir, plan, device))
}

/// Composes, compiles and packs a scene, as a strategy wants it. `edit` changes the composed text.
pub(crate) fn prepare<'a>(
    gpu: &'a Gpu,
    ir: &'a SceneIr,
    options: &TraceOptions,
    strategy: &mut dyn Strategy,
    edit: impl FnOnce(String) -> String,
) -> Result<Engine<'a>> {
    let mut draft = Draft::new(gpu, ir, options)?;
    let extend = strategy.specialise(gpu, ir, options, &mut draft.program)?;
    let parse = |wgsl, precision| Parsed::of(edit(wgsl), precision).map(Arc::new);
    let plan = draft.compose(gpu, ir, extend.as_ref(), parse, |program| strategy.limits(program))?;
    let additions = strategy.open(gpu, &plan)?;
    let device = plan.open(gpu, &additions)?;
    Ok(Engine::new(gpu, ir, plan, device))
}
