//! An addition to the plain loop: what pays on adapters that are processors.
//!
//! On a processor an atomic is slow, and the device's memory is the host's. So rays log where they end, and the host
//! adds up ([`mod@log`]). Most rays of many scenes take one path. So a stage of its own follows that hot path without a
//! loop. Rays that fail a guard of the stage fall back on the plain stages ([`path`]).

pub mod log;
pub mod overrides;
pub mod request;
pub mod wgsl;

pub mod adapter_traits;
pub mod path;

pub use crate::cpu::overrides::{CpuOverrides, Override};

use crate::cpu::adapter_traits::AdapterTraits;
use crate::cpu::log::buffers::{LogBuffers, Rays};
use crate::cpu::path::{profile, side_trace};
use crate::cpu::request::{CpuRequest, CpuShader};
use crate::engine::Engine;
use crate::engine::addition::Addition;
use crate::engine::dispatch::Route;
use crate::engine::limits::{DispatchLimits, WORKGROUPS_PER_PROCESSOR};
use crate::engine::options::TraceOptions;
use crate::engine::plan::TracePlan;
use crate::engine::stages::{AddedStage, ExtraBindings};
use crate::error::Result;
use crate::gpu::Gpu;
use crate::model::SceneIr;
use crate::program::addition::{ProgramAddition, ShaderAddition};
use crate::program::input::ProgramInput;
use crate::program::layout::bindings;
use crate::program::{Program, ProgramOptions, RayRange};
use crate::result::Tally;
use std::sync::Arc;
use std::time::Instant;

/// Rays of a dispatch where rays log their ends. The log then stays in a processor's caches, and a dispatch is long
/// against the cost of its start.
const DEFAULT_LOGGED_BATCH: u32 = 1 << 17;
/// The same where rays log positions, alone or with weights. These are mostly few words a ray.
const DEFAULT_POSITIONS_BATCH: u32 = 1 << 18;
/// Most rays that an invocation follows one after the other.
const MOST_RAYS_PER_INVOCATION: u64 = 8;

/// How adapters that are processors trace.
pub(crate) struct Cpu {
    traits: AdapterTraits,
    overrides: CpuOverrides,
    /// What is wanted of the program, once rays were profiled.
    request: CpuRequest,
    /// Where rays log their ends.
    logs: Option<LogBuffers>,
    /// The ids of rays that fall back, as a dispatch reads them, where there is a hot path.
    ids: Option<wgpu::Buffer>,
}

/// The stages that follow paths, by their numbers: the stage of the hot path, then the stages of side traces.
const HOT_PATH: usize = 0;
const FIRST_SIDE_TRACE: usize = 1;

impl Cpu {
    /// What pays on an adapter. `None` where the plain loop does all, unless something is asked for. The stages of
    /// paths have the scene's numbers compiled in.
    pub(crate) fn for_adapter(gpu: &Gpu, options: &TraceOptions, overrides: &CpuOverrides) -> Option<Self> {
        if options.live {
            return None;
        }
        let traits = AdapterTraits::of(gpu);
        let is_asked_for = *overrides != CpuOverrides::default();
        (traits.processors.is_some() || is_asked_for).then(|| Cpu {
            traits,
            overrides: overrides.clone(),
            request: CpuRequest::default(),
            logs: None,
            ids: None,
        })
    }

    /// The stages that trace such rays, and the log that they write.
    fn route(&self, program: &Program, rays: &Rays) -> Route {
        let group = self.logs.as_ref().map_or(0, LogBuffers::turn);
        let added = CpuShader::of_program(program);
        let side_rays = added.side_rays_per_invocation();
        match rays {
            Rays::OfRange if added.hot_path.is_some() => {
                let rays_per_invocation = added.rays_per_hot_path_invocation();
                Route { group, added: Some(HOT_PATH), rays_per_invocation }
            }
            Rays::OfSide { side, .. } => {
                Route { group, added: Some(FIRST_SIDE_TRACE + side), rays_per_invocation: side_rays }
            }
            Rays::OfRange | Rays::Fallback => Route::plain(program, group),
        }
    }

    /// Dispatches rays.
    fn dispatch(&mut self, engine: &mut Engine, range: &RayRange, rays: Rays) -> Result<()> {
        let route = self.route(&engine.plan.program, &rays);
        if self.traits.processors.is_some() {
            // At a stage's first dispatch a driver may try what compiling it for the numbers of one range would save.
            // Lavapipe (Mesa 22.3) takes a shader that grew for one that shrank, and then compiles it anew for every
            // range. No shader grows for a range that begins at ray 0. So the first dispatch begins there, and has no
            // workgroups.
            engine.prime(route, range)?;
        }
        let start = Instant::now();
        let idle_time = engine.idle_time;
        let submitted = engine.submit_by(route, range)?;
        let asks = engine.asks_for_rays(route);
        if asks {
            // The host adds up the logs of earlier dispatches before it waits for this one.
            self.finish_logs(engine)?;
            engine.finish_rounds(route)?;
            // Without logs the engine waits for passes, and learns from their times.
            if !submitted.is_first && self.logs.is_some() {
                let time = start.elapsed().saturating_sub(engine.idle_time - idle_time);
                engine.size.note(range.count, time, engine.pass_time);
            }
        }
        if let Some(logs) = &mut self.logs {
            // Asked before the engine takes the times of stages. To take these waits for the dispatch, whose own time
            // begins here.
            let is_timed = route.added.is_none() && !submitted.is_first && !asks;
            logs.submitted(*range, rays, submitted.index, is_timed)?;
            let times = logs.take_times();
            times.iter().for_each(|&(rays, time)| engine.size.note(rays, time, engine.pass_time));
            note_first_end(engine, logs);
        }
        engine.end_dispatch()
    }

    /// Adds up the logs that are written.
    fn finish_logs(&mut self, engine: &mut Engine) -> Result<()> {
        let Some(logs) = &mut self.logs else { return Ok(()) };
        logs.finish()?;
        note_first_end(engine, logs);
        Ok(())
    }

    /// Most rays of an invocation: so few that a dispatch has several workgroups for each processor.
    fn most_rays_per_invocation(&self, options: &TraceOptions) -> u32 {
        let Some(processors) = self.traits.processors else { return 1 };
        let dispatch_rays = options.num_rays.min(options.batch_size.unwrap_or(DEFAULT_LOGGED_BATCH).into());
        let workgroups = u64::from(WORKGROUPS_PER_PROCESSOR) * u64::from(processors);
        let least_rays = workgroups * u64::from(options.workgroup_size.max(1));
        (dispatch_rays / least_rays).clamp(1, MOST_RAYS_PER_INVOCATION) as u32
    }
}

/// A stage for each path. The stages of side traces are compiled when they are first needed.
fn path_stages(program: &Program) -> Vec<AddedStage> {
    let added = CpuShader::of_program(program);
    let main = added.hot_path.iter().map(|_| AddedStage {
        name: "trace_hot_path",
        entry_point: "trace_hot_path".into(),
        at_once: true,
    });
    let side = |number| AddedStage {
        name: "trace_side",
        entry_point: side_trace::entry_point(number),
        at_once: false,
    };
    main.chain((0..added.side_traces.len()).map(side)).collect()
}

impl Cpu {
    /// For each stage of a path: how many rays of this trace were traced along the path, and how many of these failed a
    /// guard.
    pub(crate) fn num_along_paths(&self) -> Vec<[u64; 2]> {
        let counts = |logs: &LogBuffers| {
            std::iter::once(logs.num_followed_and_failed()).chain(logs.num_along_sides()).collect()
        };
        self.logs.as_ref().map_or_else(Vec::new, counts)
    }
}

fn note_first_end(engine: &mut Engine, logs: &LogBuffers) {
    engine.first_end = engine.first_end.or(logs.first_end());
}

impl ProgramAddition for CpuRequest {
    fn shader(&self, scene: &ProgramInput) -> Arc<dyn ShaderAddition> {
        Arc::new(CpuShader::of(scene, self))
    }
}

impl ProgramAddition for Cpu {
    fn shader(&self, scene: &ProgramInput) -> Arc<dyn ShaderAddition> {
        self.request.shader(scene)
    }
}

impl Addition for Cpu {
    fn specialise(
        &mut self,
        gpu: &Gpu,
        ir: &SceneIr,
        options: &TraceOptions,
        program: &mut ProgramOptions,
        is_alone: bool,
    ) -> Result<()> {
        let Cpu { traits, overrides, .. } = &*self;
        overrides.check(gpu)?;
        program.uniform_bytes = traits.uniform_bytes;
        program.texel_bytes = overrides.texel_bytes.unwrap_or(traits.texel_bytes);
        program.most_rays_per_invocation =
            overrides.rays_per_invocation.unwrap_or_else(|| self.most_rays_per_invocation(options));
        let mut request = CpuRequest {
            deferred_splats: overrides.deferred_splats.holds(|| traits.deferred_splats),
            side_by_side: overrides.side_by_side.holds(|| traits.processors.is_some()),
            ..Default::default()
        };
        // The stages of hot paths do nothing for another addition.
        if request.deferred_splats
            && is_alone
            && let Some(paths) = profile::find(gpu, ir, options, program, overrides.hot_path)?
        {
            request.hot_path = Some(paths.hot);
            request.side_traces =
                if overrides.side_traces == Override::Never { Vec::new() } else { paths.sides };
        }
        self.request = request;
        Ok(())
    }

    fn limits(&self, program: &Program, plain: DispatchLimits) -> DispatchLimits {
        let processors = self.traits.processors.unwrap_or(plain.processors);
        let added = CpuShader::of_program(program);
        let Some(log) = &added.deposit_log else { return DispatchLimits { processors, ..plain } };
        let default_rays =
            if added.path_log.is_some() { DEFAULT_POSITIONS_BATCH } else { DEFAULT_LOGGED_BATCH };
        DispatchLimits { default_rays, most_rays: log.max_rays(added.path_log.as_ref()), processors }
    }

    fn open(&mut self, gpu: &Gpu, plan: &TracePlan) -> Result<ExtraBindings> {
        let TracePlan { program, options, .. } = plan;
        let added = CpuShader::of_program(program);
        let Some(log) = &added.deposit_log else { return Ok(ExtraBindings::default()) };
        let mut logs = LogBuffers::new(gpu, log.clone(), added.path_log.clone(), &program.cells, plan.batch)?;
        let num_expected = (!options.may_end_early).then_some(options.num_rays);
        logs.follow_sides(&added.side_traces, num_expected, self.overrides.side_traces == Override::Always);
        if added.hot_path.is_some() {
            self.ids = Some(gpu.buffer("failed rays", u64::from(plan.batch) * 8)?);
        }
        let ids = self.ids.iter().map(|ids| (bindings::LISTED_IDS, ids.clone()));
        let groups = logs.buffers().map(|log| ids.clone().chain([(bindings::LOG, log.clone())]).collect());
        self.logs = Some(logs);
        Ok(ExtraBindings { groups: groups.into(), stages: path_stages(program) })
    }

    fn discard(&mut self, engine: &mut Engine) -> Result<()> {
        let Some(logs) = &mut self.logs else { return Ok(()) };
        logs.discard();
        if engine.undrained.counts > 0 {
            // What was added up before the failure is dropped.
            logs.take(&engine.plan.program.cells)?;
        }
        Ok(())
    }

    /// Dispatches along the hot path take so little time that each is a whole batch.
    fn range_rays(&self, engine: &Engine) -> Option<u32> {
        let follows_path = CpuShader::of_program(&engine.plan.program).hot_path.is_some()
            && self.path_pays(&engine.plan.program);
        follows_path.then_some(engine.plan.batch)
    }

    fn trace(&mut self, engine: &mut Engine, range: &RayRange) -> Result<bool> {
        let range = RayRange { log_stride: self.logs.as_ref().map_or(0, LogBuffers::stride), ..*range };
        let pays = self.path_pays(&engine.plan.program);
        match &mut self.logs {
            Some(logs) if !pays => logs.fallback().list(&range),
            _ => self.dispatch(engine, &range, Rays::OfRange)?,
        }
        // Enough for two, so that lists of many side traces do not grow long.
        self.follow_sides(engine, range.source, 2 * engine.plan.batch as usize)?;
        self.trace_fallback(engine, range.source, engine.size.rays())?;
        Ok(true)
    }

    /// Logs are added up while the device traces on.
    fn keeps_busy(&self) -> bool {
        self.logs.is_some()
    }

    fn finish_pending(&mut self, engine: &mut Engine) -> Result<()> {
        self.finish_logs(engine)?;
        while self.follow_last_sides(engine)? {
            self.finish_logs(engine)?;
        }
        for source in 0..engine.plan.rays.len() {
            self.trace_fallback(engine, source, 1)?;
        }
        self.finish_logs(engine)
    }

    fn drain(&mut self, engine: &mut Engine, tally: &mut Tally) -> Result<()> {
        self.mark_paths_reached(&engine.plan.program, tally);
        let Some(logs) = &mut self.logs else { return Ok(()) };
        let ends = logs.take(&engine.plan.program.cells)?;
        let mut readback = engine.readback(tally);
        let counts = (0..).zip(ends.counts.iter().copied());
        counts.filter(|(_, count)| *count > 0).for_each(|(counter, count)| readback.count(counter, count));
        let quanta = (0..).zip(ends.quanta());
        quanta.filter(|(_, sum)| *sum > 0).for_each(|(cell, sum)| readback.sum(cell, sum));
        readback.finish(engine.plan.reached_marks());
        Ok(())
    }
}
