//! The engine traces a scene on a device, and sums up what its rays leave. A trace is a fold: `Tally += pass(range of
//! ray ids)`.
//!
//! [`pass_loop`] is the whole loop on one page. [`plan`] holds what is traced; [`limits`] and [`passes`] decide how
//! much at once. [`submit`] lists the stages that a range goes through. [`rows`] fetches rows for the host, and
//! [`drain`] fetches the sums.
//!
//! Six words, each explained by the words before:
//! - a **dispatch** is one stage on the device;
//! - a **round** is two dispatches, which follow the rays that live on for some more events;
//! - a **range** is the rays of one source that one dispatch begins, at most a **batch**;
//! - a **submission** hands dispatches of a range to the device, all of them or some;
//! - a **pass** is ranges of all sources, after which the caller is asked whether to go on.
//!
//! What is added to the loop, or done otherwise on some adapters, is an [`addition`]. The engine is complete without
//! any.

pub mod addition;
pub mod budget;
pub mod device;
pub mod df64_test;
pub mod dispatch;
pub mod dispatch_size;
pub mod drain;
pub mod limits;
pub mod moments;
pub mod options;
pub mod pass_loop;
pub mod passes;
pub mod pipeline_cache;
pub mod plan;
pub mod prepare;
pub mod rates;
pub mod readback;
pub(crate) mod retrace;
pub mod rounds;
pub mod rows;
pub mod stages;
pub mod submit;
pub mod sums;
#[cfg(test)]
mod test_scenes;
pub mod tuning;
pub mod undrained;

use crate::engine::device::DeviceState;
use crate::engine::dispatch_size::{DispatchSize, PASS_TIME};
use crate::engine::limits::MAX_COUNTS_UNDRAINED;
use crate::engine::plan::TracePlan;
use crate::engine::rows::Rows;
use crate::engine::undrained::Undrained;
use crate::gpu::Gpu;
use crate::gpu::profile::Profile;
use crate::model::SceneIr;
use crate::result::Tally;
use std::time::{Duration, Instant};

/// A scene on a device, ready to trace.
pub(crate) struct Engine<'a> {
    pub(crate) gpu: &'a Gpu,
    pub(crate) ir: &'a SceneIr,
    pub(crate) plan: TracePlan,
    pub(crate) device: DeviceState,
    /// How many rays a dispatch has, and in how many submissions its stages are made.
    pub(crate) size: DispatchSize,
    /// How long a pass should take.
    pub(crate) pass_time: Duration,
    /// The rays launched since the sums were drained.
    pub(crate) undrained: Undrained,
    /// Sums that had to leave the device within a range, before counters could overflow.
    pub(crate) spilled: Option<Tally>,
    /// The most that a counter may count before sums leave the device within a range.
    pub(crate) most_counts: u64,
    /// Rows for the host that are not yet in a tally.
    pub(crate) rows: Rows,
    /// Times the stages, if the user asked for that.
    pub(crate) profile: Option<Profile>,
    /// A pass ends at this position, if the position lies ahead.
    pub(crate) pause: Option<u64>,
    /// True if a stage ran for the first time during this pass. Drivers compile at that moment, so the time of such a
    /// pass says nothing about other passes.
    pub(crate) is_compiling: bool,
    /// The number of submissions, over all traces.
    pub(crate) num_submissions: u64,
    /// The time of this pass in which so few rays were left that the device was mostly idle.
    pub(crate) idle_time: Duration,
    /// When the first rays of all had been traced; `None` until a pass was waited for.
    pub(crate) first_end: Option<Instant>,
}

impl<'a> Engine<'a> {
    /// A plan on a device, before the first ray.
    fn new(gpu: &'a Gpu, ir: &'a SceneIr, plan: TracePlan, device: DeviceState) -> Self {
        Engine {
            gpu,
            ir,
            device,
            size: plan.dispatch_size(),
            plan,
            pass_time: PASS_TIME,
            undrained: Undrained::default(),
            spilled: None,
            most_counts: MAX_COUNTS_UNDRAINED,
            rows: Rows::default(),
            profile: None,
            pause: None,
            is_compiling: false,
            num_submissions: 0,
            idle_time: Duration::ZERO,
            first_end: None,
        }
    }

    /// Also ends a pass at a position, where the position of the trace is `at`.
    pub(crate) fn pause_before(&mut self, at: u64, position: u64) {
        let next = self.pause.filter(|pause| *pause > at);
        self.pause = Some(next.map_or(position, |pause| pause.min(position)));
    }
}
