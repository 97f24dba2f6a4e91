//! An addition to the plain loop: all that is done otherwise on adapters that are processors.
//!
//! An atomic is dear on a processor, and its memory is the host's: so rays log where they end, and the host adds up
//! ([`logs`], [`mod@log`]). Most rays of many scenes take one path: so a stage of its own follows that path without a loop, and rays
//! that leave it are rejected and traced again ([`path`]). In the largest traces a second device takes turns with the first.
//! The lens of `bench` is so traced at 87 million rays a second instead of 28.

pub mod added;
pub mod choices;
pub mod extension;
pub mod log;
pub mod logs;
pub mod path;
pub mod profile;
mod second_device;
pub mod vector_width;

pub use crate::cpu::choices::{Choices, When};

use crate::cpu::added::{CpuExtension, Wanted};
use crate::cpu::logs::{DeviceLogs, EndLogs, Rays};
use crate::cpu::path::{pilot, side_path};
use crate::cpu::profile::Profile;
use crate::engine::Engine;
use crate::engine::addition::Addition;
use crate::engine::device::DeviceState;
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

/// Rays of a dispatch where they log their ends: the log stays in a processor's caches, and dispatches are long against what
/// each costs.
const DEFAULT_LOGGED_BATCH: u32 = 1 << 17;
/// The same where they log positions alone, or with weights, which are mostly few words a ray.
const DEFAULT_POSITIONS_BATCH: u32 = 1 << 18;
/// Most rays that an invocation follows one after the other.
const MOST_RAYS_PER_INVOCATION: u64 = 8;

/// How adapters trace that are processors.
pub(crate) struct Cpu {
    profile: Profile,
    choices: Choices,
    /// What is wanted of the program, once the pilot has flown.
    wanted: Wanted,
    /// Where rays log their ends.
    logs: Option<EndLogs>,
    /// The ids of rejected rays, as a dispatch reads them; one for each device, where there is a main path.
    ids: Vec<wgpu::Buffer>,
    /// What logs and ids take of a device.
    bytes: u64,
    /// The second device, once it is opened.
    second: Vec<DeviceState>,
    /// The second device was not opened yet, nor tried in vain.
    takes_second_device: bool,
}

/// The stages that follow paths, by their numbers: that of the main path, then those of side paths.
const MAIN_PATH: usize = 0;
const FIRST_SIDE_PATH: usize = 1;

impl Cpu {
    /// What pays on an adapter; none where the plain loop does all, unless something is asked for. The stages of paths have
    /// the scene's numbers compiled in.
    pub(crate) fn for_adapter(gpu: &Gpu, options: &TraceOptions, choices: &Choices) -> Option<Self> {
        if options.live {
            return None;
        }
        let profile = Profile::of(gpu);
        let is_asked_for = *choices != Choices::default();
        (profile.processors.is_some() || is_asked_for).then(|| Cpu {
            profile,
            choices: choices.clone(),
            wanted: Wanted::default(),
            logs: None,
            ids: Vec::new(),
            bytes: 0,
            second: Vec::new(),
            takes_second_device: true,
        })
    }

    /// What the program needs of a device: logs, the ids of rejected rays, and a stage for each path.
    fn extra(&mut self, gpu: &Gpu, plan: &TracePlan, logs: &DeviceLogs) -> Result<ExtraBindings> {
        let program = &plan.program;
        let mut shared = Vec::new();
        if CpuExtension::of_program(program).main_path.is_some() {
            let ids = gpu.buffer("rejected rays", u64::from(plan.batch) * 8)?;
            shared.push((bindings::LISTED_IDS, ids.clone()));
            self.ids.push(ids);
        }
        let logs = logs.bindings().map(|(number, log)| (number, log.clone()));
        self.bytes = shared.iter().chain(&logs).map(|(_, buffer)| buffer.size()).sum();
        let groups = logs.map(|log| shared.iter().cloned().chain([log]).collect()).into();
        Ok(ExtraBindings { groups, stages: path_stages(program) })
    }

    /// The number of the device whose turn it is, and the one of its logs.
    fn turn(&self) -> (usize, usize) {
        self.logs.as_ref().map_or((0, 0), EndLogs::turn)
    }

    /// One of the devices; the engine's own is none.
    fn device(&self, number: usize) -> Option<&DeviceState> {
        self.second.get(number.checked_sub(1)?)
    }

    /// How the device whose turn it is traces such rays.
    fn way(&self, program: &Program, rays: &Rays) -> Route {
        let (_, group) = self.turn();
        let added = CpuExtension::of_program(program);
        let side_rays = added.side_rays_per_invocation();
        match rays {
            Rays::OfRange if added.main_path.is_some() => {
                let rays_per_invocation = added.rays_per_main_path_invocation();
                Route { group, added: Some(MAIN_PATH), rays_per_invocation }
            }
            Rays::OfSide { side, .. } => {
                Route { group, added: Some(FIRST_SIDE_PATH + side), rays_per_invocation: side_rays }
            }
            Rays::OfRange | Rays::Rejected => Route::plain(program, group),
        }
    }

    /// Dispatches rays to the device whose turn it is.
    fn dispatch(&mut self, engine: &mut Engine, range: &RayRange, rays: Rays) -> Result<()> {
        let way = self.way(&engine.plan.program, &rays);
        let (number, _) = self.turn();
        let device = self.device(number);
        if self.profile.processors.is_some() {
            // A driver may try at a stage's first dispatch what compiling it for the numbers of one range would save. Lavapipe
            // (Mesa 22.3) takes a shader that grew for one that shrank, and then compiles it anew for every range; one that
            // begins at ray 0 makes none grow. So the first dispatch is such a one, of no workgroups.
            engine.prime(device, way, range)?;
        }
        let start = Instant::now();
        let idle_time = engine.idle_time;
        let submitted = engine.submit_to(device, way, range)?;
        let asks = engine.asks_for_rays(way);
        if asks {
            // The host adds up the logs of earlier dispatches before it waits for this one.
            self.finish_logs(engine)?;
            engine.finish_rounds(self.device(number), way)?;
            // Without logs the engine waits for passes, and learns from their times.
            if !submitted.is_first && self.logs.is_some() {
                let time = start.elapsed().saturating_sub(engine.idle_time - idle_time);
                engine.size.note(range.count, time, engine.pass_time);
            }
        }
        if let Some(logs) = &mut self.logs {
            // Before the engine takes the times of stages: to take them waits for the dispatch, whose own time begins here.
            let is_timed = way.added.is_none() && !submitted.is_first && !asks;
            logs.submitted(*range, rays, submitted.index, is_timed)?;
            let times = logs.take_times();
            times.iter().for_each(|&(rays, time)| engine.size.note(rays, time, engine.pass_time));
            note_first_end(engine, logs);
        }
        engine.end_dispatch(self.device(number))
    }

    /// Adds up the logs that are written.
    fn finish_logs(&mut self, engine: &mut Engine) -> Result<()> {
        let Some(logs) = &mut self.logs else { return Ok(()) };
        logs.finish()?;
        note_first_end(engine, logs);
        Ok(())
    }

    /// So few rays an invocation that a dispatch has several workgroups for each processor.
    fn most_rays_per_invocation(&self, options: &TraceOptions) -> u32 {
        let Some(processors) = self.profile.processors else { return 1 };
        let dispatch_rays = options.num_rays.min(options.batch_size.unwrap_or(DEFAULT_LOGGED_BATCH).into());
        let workgroups = u64::from(WORKGROUPS_PER_PROCESSOR) * u64::from(processors);
        let least_rays = workgroups * u64::from(options.workgroup_size.max(1));
        (dispatch_rays / least_rays).clamp(1, MOST_RAYS_PER_INVOCATION) as u32
    }
}

/// A stage for each path. Those of side paths are compiled when they are first needed.
fn path_stages(program: &Program) -> Vec<AddedStage> {
    let added = CpuExtension::of_program(program);
    let main = added.main_path.iter().map(|_| AddedStage {
        name: "trace_main_path",
        entry_point: "trace_main_path".into(),
        at_once: true,
    });
    let side = |number| AddedStage {
        name: "trace_side",
        entry_point: side_path::entry_point(number),
        at_once: false,
    };
    main.chain((0..added.side_paths.len()).map(side)).collect()
}

impl Cpu {
    /// For each stage of a path: how many rays of this trace were traced along the path, and how many of them were
    /// rejected.
    pub(crate) fn num_along_paths(&self) -> Vec<[u64; 2]> {
        let counts = |logs: &EndLogs| {
            std::iter::once(logs.num_followed_and_rejected()).chain(logs.num_along_sides()).collect()
        };
        self.logs.as_ref().map_or_else(Vec::new, counts)
    }
}

fn note_first_end(engine: &mut Engine, logs: &EndLogs) {
    engine.first_end = engine.first_end.or(logs.first_end());
}

impl ProgramAddition for Wanted {
    fn shader(&self, scene: &ProgramInput) -> Arc<dyn ShaderAddition> {
        Arc::new(CpuExtension::of(scene, self))
    }
}

impl ProgramAddition for Cpu {
    fn shader(&self, scene: &ProgramInput) -> Arc<dyn ShaderAddition> {
        self.wanted.shader(scene)
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
        let Cpu { profile, choices, .. } = &*self;
        choices.check(gpu)?;
        program.uniform_bytes = profile.uniform_bytes;
        program.texel_bytes = choices.texel_bytes.unwrap_or(profile.texel_bytes);
        program.most_rays_per_invocation =
            choices.rays_per_invocation.unwrap_or_else(|| self.most_rays_per_invocation(options));
        let mut wanted = Wanted {
            host_sums: choices.host_sums.holds(|| profile.host_sums),
            side_by_side: choices.side_by_side.holds(|| profile.processors.is_some()),
            ..Default::default()
        };
        // The stages of main paths do nothing for another addition.
        if wanted.host_sums
            && is_alone
            && let Some(paths) = pilot::find(gpu, ir, options, program, choices.main_path)?
        {
            wanted.main_path = Some(paths.main);
            wanted.side_paths = if choices.side_paths == When::Never { Vec::new() } else { paths.sides };
        }
        self.wanted = wanted;
        Ok(())
    }

    fn limits(&self, program: &Program, plain: DispatchLimits) -> DispatchLimits {
        let processors = self.profile.processors.unwrap_or(plain.processors);
        let added = CpuExtension::of_program(program);
        let Some(log) = &added.end_log else { return DispatchLimits { processors, ..plain } };
        let default_rays =
            if added.path_log.is_some() { DEFAULT_POSITIONS_BATCH } else { DEFAULT_LOGGED_BATCH };
        DispatchLimits { default_rays, most_rays: log.max_rays(added.path_log.as_ref()), processors }
    }

    fn open(&mut self, gpu: &Gpu, plan: &TracePlan) -> Result<ExtraBindings> {
        let TracePlan { program, options, .. } = plan;
        let added = CpuExtension::of_program(program);
        let Some(log) = &added.end_log else { return Ok(ExtraBindings::default()) };
        let mut logs = EndLogs::new(gpu, log.clone(), added.path_log.clone(), &program.cells, plan.batch)?;
        let num_expected = (!options.may_end_early).then_some(options.num_rays);
        logs.follow_sides(&added.side_paths, num_expected, self.choices.side_paths == When::Always);
        let extra = self.extra(gpu, plan, &logs.devices()[0])?;
        self.logs = Some(logs);
        Ok(extra)
    }

    fn discard(&mut self) {
        self.logs.as_mut().into_iter().for_each(EndLogs::discard);
    }

    /// Those of the main path take so little time that they are always a batch.
    fn range_rays(&self, engine: &Engine) -> Option<u32> {
        let follows_path = CpuExtension::of_program(&engine.plan.program).main_path.is_some()
            && self.path_pays(&engine.plan.program);
        follows_path.then_some(engine.plan.batch)
    }

    fn trace(&mut self, engine: &mut Engine, range: &RayRange) -> Result<bool> {
        let range = RayRange { log_stride: self.logs.as_ref().map_or(0, EndLogs::stride), ..*range };
        let pays = self.path_pays(&engine.plan.program);
        match &mut self.logs {
            Some(logs) if !pays => logs.rejected().list(&range),
            _ => self.dispatch(engine, &range, Rays::OfRange)?,
        }
        // Enough for two, so that lists of many side paths do not grow long.
        self.follow_sides(engine, range.source, 2 * engine.plan.batch as usize)?;
        self.retrace_rejected(engine, range.source, engine.size.rays())?;
        Ok(true)
    }

    /// Logs are added up while the device traces on.
    fn keeps_busy(&self) -> bool {
        self.logs.is_some()
    }

    fn look_ahead(&mut self, engine: &mut Engine, rays_left: u64, seconds_left: Option<f64>) -> Result<()> {
        self.consider_second_device(engine, rays_left, seconds_left)
    }

    fn settle(&mut self, engine: &mut Engine) -> Result<()> {
        self.finish_logs(engine)?;
        while self.follow_last_sides(engine)? {
            self.finish_logs(engine)?;
        }
        for source in 0..engine.plan.rays.len() {
            self.retrace_rejected(engine, source, 1)?;
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

    fn devices(&self) -> &[DeviceState] {
        &self.second
    }

    fn keep_one_device(&mut self) {
        self.second.clear();
        self.ids.truncate(1);
        self.logs.as_mut().into_iter().for_each(EndLogs::keep_first_device);
    }
}
