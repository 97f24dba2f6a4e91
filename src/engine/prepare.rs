//! Turns a scene and options into an engine that is ready to trace.

use crate::engine::Engine;
use crate::engine::addition::Additions;
use crate::engine::device::DeviceState;
use crate::engine::options::TraceOptions;
use crate::engine::plan::TracePlan;
use crate::engine::shelf::Shelf;
use crate::error::Result;
use crate::gpu::Gpu;
use crate::model::SceneIr;
use crate::program::parsed::Parsed;
use std::sync::Arc;

/// Composes, compiles and packs a scene, with the shaders of a shelf.
pub(crate) fn prepare_on_shelf<'a>(
    gpu: &'a Gpu,
    ir: &'a SceneIr,
    options: &TraceOptions,
    additions: &mut Additions,
    shelf: &Shelf,
) -> Result<Engine<'a>> {
    let parse = |wgsl, precision, shaders: &_| shelf.parsed(wgsl, precision, shaders);
    let plan = TracePlan::new(gpu, ir, options, additions, parse)?;
    let (extra, num_bound) = additions.open(gpu, &plan)?;
    let stages = shelf.stages(gpu, &plan.program, options.is_strict(&gpu.info))?;
    let device = DeviceState::new(gpu, &plan.program, plan.batch, stages, &extra)?;
    Ok(Engine::new(gpu, ir, plan, device, num_bound))
}

/// Composes, compiles and packs a scene, with additions. `edit` changes the composed text.
pub(crate) fn prepare<'a>(
    gpu: &'a Gpu,
    ir: &'a SceneIr,
    options: &TraceOptions,
    additions: &mut Additions,
    edit: impl FnOnce(String) -> String,
) -> Result<Engine<'a>> {
    let parse = |wgsl, precision, shaders: &_| Parsed::of(edit(wgsl), precision, shaders).map(Arc::new);
    let plan = TracePlan::new(gpu, ir, options, additions, parse)?;
    let (extra, num_bound) = additions.open(gpu, &plan)?;
    let device = plan.open(gpu, &extra)?;
    Ok(Engine::new(gpu, ir, plan, device, num_bound))
}
