//! Turns a scene and options into an engine that is ready to trace.

use crate::engine::Engine;
use crate::engine::addition::Additions;
use crate::engine::device::DeviceState;
use crate::engine::options::TraceOptions;
use crate::engine::pipeline_cache::Shaders;
use crate::engine::plan::TracePlan;
use crate::error::Result;
use crate::gpu::Gpu;
use crate::model::SceneIr;

/// Composes, compiles and packs a scene, with additions.
pub(crate) fn prepare<'a>(
    gpu: &'a Gpu,
    ir: &'a SceneIr,
    options: &TraceOptions,
    additions: &mut Additions,
    shaders: Shaders,
) -> Result<Engine<'a>> {
    let plan = TracePlan::new(gpu, ir, options, additions, shaders)?;
    let (extra, num_bound) = additions.open(gpu, &plan)?;
    let stages = shaders.stages(gpu, &plan.program, options.is_strict(&gpu.info), &extra)?;
    let device = DeviceState::new(gpu, &plan.program, plan.batch, stages, &extra)?;
    Ok(Engine::new(gpu, ir, plan, device, num_bound))
}
