//! Traces rays of a trace again, beside it: one set-up and one loop for all that asks the same rays another question.
//!
//! A second trace has a program of its own. The program repeats the draws and decisions of the first trace, because
//! draws are keyed by ray ids. Light by its path takes one for its maps and one to learn sequences, and derivatives
//! walk rays back.

use crate::engine::addition::Additions;
use crate::engine::device::DeviceState;
use crate::engine::dispatch::submit_alone;
use crate::engine::options::TraceOptions;
use crate::engine::pipeline_cache::Shaders;
use crate::engine::plan::TracePlan;
use crate::engine::stages::{ExtraBindings, Stages};
use crate::error::Result;
use crate::gpu::Gpu;
use crate::model::SceneIr;
use crate::program::RayRange;
use crate::result::RaySpan;
use std::sync::Arc;
use std::time::Instant;

/// The program of a second trace, compiled.
pub(crate) struct Retrace {
    pub(crate) plan: TracePlan,
    pub(crate) additions: Additions,
    stages: Arc<Stages>,
    /// The bindings of its additions.
    extra: ExtraBindings,
}

impl Retrace {
    /// Composes and compiles a scene.
    pub(crate) fn new(
        gpu: &Gpu,
        ir: &SceneIr,
        options: &TraceOptions,
        mut additions: Additions,
        shaders: Shaders,
    ) -> Result<Self> {
        let plan = TracePlan::new(gpu, ir, options, &mut additions, shaders)?;
        let strict = options.is_strict(&gpu.info);
        let extra = additions.open(gpu, &plan)?;
        let stages = shaders.stages(gpu, &plan.program, strict, &extra)?;
        Ok(Retrace { plan, additions, stages, extra })
    }

    /// The program on a device, with these bindings beside the bindings of its additions.
    pub(crate) fn open(&self, gpu: &Gpu, extra: ExtraBindings) -> Result<DeviceState> {
        let extra = self.extra.clone().with(extra);
        DeviceState::new(gpu, &self.plan.program, self.plan.batch, self.stages.clone(), &extra)
    }
}

/// How the next rays are dispatched.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Batch {
    /// Most rays of a range.
    pub(crate) rays: u64,
    /// In how many submissions the stages are made.
    pub(crate) submissions: usize,
}

/// What follows a range.
pub(crate) enum After {
    /// The next rays.
    Next(Batch),
    /// The same rays again.
    Again(Batch),
    /// Nothing.
    Stop,
}

/// What a second trace does about its ranges.
pub(crate) trait Retracing {
    /// A range is going to be traced.
    fn before(&mut self, _range: &RayRange) {}

    /// In further rounds of a range, counters may count so much.
    fn rounds(&mut self, _counts: u64) -> Result<()> {
        Ok(())
    }

    /// A range was submitted, at this moment.
    fn after(&mut self, range: &RayRange, start: Instant) -> Result<After>;
}

/// Traces rays again, range by range. False if the work ended before the last ray.
pub(crate) fn trace_again(
    device: &DeviceState,
    plan: &TracePlan,
    spans: &[RaySpan],
    mut batch: Batch,
    work: &mut dyn Retracing,
) -> Result<bool> {
    for span in spans {
        let (mut next, end) = (span.first, span.end());
        while next < end {
            let count = (end - next).min(batch.rays);
            let range = RayRange::of(next, count as u32, span.source as usize);
            work.before(&range);
            let start = Instant::now();
            submit_alone(device, plan, &range, batch.submissions, |counts| work.rounds(counts))?;
            batch = match work.after(&range, start)? {
                After::Next(batch) => {
                    next += count;
                    batch
                }
                After::Again(batch) => batch,
                After::Stop => return Ok(false),
            };
        }
    }
    device.check_loops_of_second_trace(&plan.program)?;
    Ok(true)
}
