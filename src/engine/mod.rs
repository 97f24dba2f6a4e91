//! The engine traces a scene on a device, and sums up what its rays leave. A trace is a fold:
//! `Tally += pass(range of ray ids)`.
//!
//! [`wavefront`] is the whole loop on one page. [`plan`] says what is traced, [`limits`] and [`passes`] how much at once,
//! [`submit`] lists the stages that a range goes through, [`rows`] fetches rows for the host, and [`drain`] fetches the sums.
//!
//! Each part of the loop that may be done otherwise is a method of a [`strategy`]. The engine is complete without any: it
//! then runs with [`strategy::Plain`].

pub mod budget;
pub mod device;
pub mod dispatch_size;
pub mod double_word;
pub mod drain;
pub mod intake;
pub mod limits;
pub mod moments;
pub mod options;
pub mod pace;
pub mod passes;
pub mod plan;
pub mod prepare;
pub mod rates;
pub mod rows;
pub mod strategy;
pub mod submit;
pub mod sums;
pub mod tuning;
pub mod undrained;
pub mod wavefront;

use crate::engine::device::DeviceState;
use crate::engine::dispatch_size::DispatchSize;
use crate::engine::plan::Plan;
use crate::engine::rows::Rows;
use crate::engine::undrained::Undrained;
use crate::gpu::Gpu;
use crate::gpu::profile::Profile;
use crate::model::SceneIr;
use std::time::{Duration, Instant};

/// A pass should keep the device for about so long: a desktop stays usable and no watchdog fires.
const PASS_TIME: Duration = Duration::from_millis(40);

/// A scene on a device, ready to trace.
pub(crate) struct Engine<'a> {
    pub(crate) gpu: &'a Gpu,
    pub(crate) ir: &'a SceneIr,
    pub(crate) plan: Plan,
    pub(crate) device: DeviceState,
    /// Rays of a dispatch, and the submissions of its stages.
    pub(crate) size: DispatchSize,
    /// How long a pass should take.
    pub(crate) pass_time: Duration,
    /// What was launched since the sums were drained.
    pub(crate) undrained: Undrained,
    /// Rows for the host that no tally has yet.
    pub(crate) rows: Rows,
    /// Times the stages, where that was asked for.
    pub(crate) profile: Option<Profile>,
    /// A pass ends at this position, if it lies ahead.
    pub(crate) pause: Option<u64>,
    /// A stage has begun since the pass did. Drivers compile at that, so the time of the pass tells nothing of others.
    pub(crate) is_compiling: bool,
    /// Submissions of all traces.
    pub(crate) num_submissions: u64,
    /// When the first rays of all were traced, as far as was waited for them.
    pub(crate) first_end: Option<Instant>,
}

impl<'a> Engine<'a> {
    /// A plan on a device, before its first ray.
    fn new(gpu: &'a Gpu, ir: &'a SceneIr, plan: Plan, device: DeviceState) -> Self {
        Engine {
            gpu,
            ir,
            device,
            size: plan.dispatch_size(),
            plan,
            pass_time: PASS_TIME,
            undrained: Undrained::default(),
            rows: Rows::default(),
            profile: None,
            pause: None,
            is_compiling: false,
            num_submissions: 0,
            first_end: None,
        }
    }

    /// Other draws from now on, on this device and others, with what was compiled for the ones before.
    pub(crate) fn set_seed(&mut self, others: &[DeviceState], seed: u64) {
        self.plan.options.seed = seed;
        self.plan.program.set_seed(seed);
        self.devices(others).for_each(|device| device.set_draws(&self.plan.program.rng_table));
    }

    /// The engine's device, and others.
    fn devices<'d>(&'d self, others: &'d [DeviceState]) -> impl Iterator<Item = &'d DeviceState> {
        std::iter::once(&self.device).chain(others)
    }
}
