//! Turns a scene and options into an engine that is ready to trace.

use crate::engine::Engine;
use crate::engine::addition::Additions;
use crate::engine::budget::{distribute, part};
use crate::engine::device::DeviceState;
use crate::engine::limits::check_families;
use crate::engine::moments::MomentSource;
use crate::engine::options::{TraceOptions, check_options};
use crate::engine::pipeline_cache::Shaders;
use crate::engine::plan::{TracePlan, plain, roulette_threshold};
use crate::error::Result;
use crate::gpu::Gpu;
use crate::model::SceneIr;
use crate::program::Program;

/// Composes, compiles and packs a scene, with additions.
pub(crate) fn prepare<'a>(
    gpu: &'a Gpu,
    ir: &'a SceneIr,
    options: &TraceOptions,
    additions: &mut Additions,
    shaders: Shaders,
) -> Result<Engine<'a>> {
    let plan = TracePlan::new(gpu, ir, options, additions, shaders)?;
    let extra = additions.open(gpu, &plan)?;
    let stages = shaders.stages(gpu, &plan.program, options.is_strict(&gpu.info), &extra)?;
    let device = DeviceState::new(gpu, &plan.program, plan.batch, stages, &extra)?;
    Ok(Engine::new(gpu, ir, plan, device))
}

impl TracePlan {
    /// Shares out the rays, and composes the program.
    pub(crate) fn new(
        gpu: &Gpu,
        ir: &SceneIr,
        options: &TraceOptions,
        additions: &mut Additions,
        shaders: Shaders,
    ) -> Result<Self> {
        check_options(gpu, options)?;
        let rays = part(distribute(ir, options.budget(), options.shares.as_deref())?, options)?;
        let weights: Vec<f64> = rays.iter().map(|rays| rays.weight).collect();
        let draws_branches = additions.of_program().iter().any(|addition| addition.draws_branches());
        let moments =
            MomentSource::of(ir, options, &weights, roulette_threshold(ir, options), draws_branches);
        let mut program = plain(gpu, ir, options, weights, moments);
        additions.specialise(gpu, ir, options, &mut program)?;
        let parse = |wgsl, precision, of_additions: &_| shaders.parsed(wgsl, precision, of_additions);
        let mut program = Program::parsed_by(ir, program, &additions.of_program(), options.seed, parse)?;
        additions.pack(ir, options, &mut program)?;
        check_families(&program, options)?;
        let limits = additions.limits(&program);
        Ok(TracePlan {
            num_rays: rays.iter().map(|rays| rays.count).sum(),
            rays,
            moments,
            batch: limits.batch(gpu, &program, options),
            options: options.clone(),
            limits,
            program,
            cache: shaders.cache.cloned(),
        })
    }
}

/// Sets the seed of the draws from now on. Nothing is compiled anew.
pub(crate) fn set_seed(engine: &mut Engine, additions: &mut Additions, seed: u64) {
    engine.plan.options.seed = seed;
    engine.plan.program.set_seed(seed);
    engine.device.set_draws(&engine.plan.program.rng_table);
    additions.all_mut().for_each(|addition| addition.set_seed(seed));
}
