//! Turns a scene and options into an engine that is ready to trace.

use crate::engine::Engine;
use crate::engine::options::TraceOptions;
use crate::engine::plan::Draft;
use crate::engine::strategy::Strategy;
use crate::error::Result;
use crate::gpu::Gpu;
use crate::model::SceneIr;

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
    let plan = draft.compose(gpu, ir, extend.as_ref(), edit, |program| strategy.limits(program))?;
    let additions = strategy.open(gpu, &plan)?;
    let device = plan.open(gpu, &additions)?;
    Ok(Engine::new(gpu, ir, plan, device))
}
