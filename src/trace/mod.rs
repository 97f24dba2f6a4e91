//! A scene ready to trace: the face of the engine ([`crate::engine::wavefront`]).
//!
//! [`Tracer`] picks how it is traced: in the plain way, or by a strategy that suits the adapter. The same bits come out.

use crate::engine::prepare::prepare;
use crate::engine::strategy::{Plain, Strategy};
use crate::engine::undrained::empty_tally;
use crate::engine::{Engine, wavefront};
use crate::error::Result;
use crate::gpu::Gpu;
use crate::gpu::profile::Profile;
use crate::model::SceneIr;
use crate::program::Program;
use crate::result::{Recorded, Recording, StageTime, Tally};
#[cfg(feature = "software")]
use crate::software::{Choices, Software};
use std::time::{Duration, Instant};

pub mod auto_precision;
pub mod checkpoint;
pub mod stopping;

pub use crate::engine::options::{RecordPaths, StandardError, Strict, TraceOptions};
pub use crate::engine::wavefront::Progress;

/// A scene ready to trace on a device.
pub struct Tracer<'a> {
    engine: Engine<'a>,
    strategy: Box<dyn Strategy>,
}

/// The strategy that suits the adapter, if it takes the scene; else the plain one.
#[cfg(feature = "software")]
fn strategy(gpu: &Gpu, ir: &SceneIr, options: &TraceOptions, choices: &Choices) -> Box<dyn Strategy> {
    match Software::for_adapter(gpu, choices) {
        Some(software) if software.takes(ir, options) => Box::new(software),
        Some(_) | None => Box::new(Plain),
    }
}

impl<'a> Tracer<'a> {
    /// Prepares a scene: composes, compiles and packs.
    ///
    /// # Errors
    /// [`crate::Error::Usage`] for options that make no sense or that the device cannot do, [`crate::Error::Device`] if the
    /// scene does not fit it.
    pub fn new(gpu: &'a Gpu, ir: &'a SceneIr, options: &TraceOptions) -> Result<Self> {
        #[cfg(feature = "software")]
        let strategy = strategy(gpu, ir, options, &Choices::default());
        #[cfg(not(feature = "software"))]
        let strategy = Box::new(Plain);
        Self::with_strategy(gpu, ir, options, strategy, |wgsl| wgsl)
    }

    fn with_strategy(
        gpu: &'a Gpu,
        ir: &'a SceneIr,
        options: &TraceOptions,
        mut strategy: Box<dyn Strategy>,
        edit: impl FnOnce(String) -> String,
    ) -> Result<Self> {
        let engine = prepare(gpu, ir, options, strategy.as_mut(), edit)?;
        Ok(Tracer { engine, strategy })
    }

    /// As [`Tracer::new`], with a change of the composed text, for tests that must notice a wrong shader; and with what the
    /// software wing is to do, for tests that want it where it does not pay.
    #[cfg(feature = "software")]
    #[doc(hidden)]
    pub fn with_choices(
        gpu: &'a Gpu,
        ir: &'a SceneIr,
        options: &TraceOptions,
        choices: &Choices,
        edit: impl FnOnce(String) -> String,
    ) -> Result<Self> {
        Self::with_strategy(gpu, ir, options, strategy(gpu, ir, options, choices), edit)
    }

    /// The composed program.
    pub fn program(&self) -> &Program {
        &self.engine.plan.program
    }

    /// Devices that trace.
    #[doc(hidden)]
    pub fn num_devices(&self) -> usize {
        1 + self.strategy.devices().len()
    }

    /// Submissions of all traces.
    #[doc(hidden)]
    pub fn num_submissions(&self) -> u64 {
        self.engine.num_submissions
    }

    /// How many rays of the last trace were to keep to the main path, and how many of them it rejected; then the same of each
    /// side path.
    #[doc(hidden)]
    pub fn num_along_paths(&self) -> Vec<[u64; 2]> {
        self.strategy.num_along_paths()
    }

    /// Other draws from now on, with what was compiled for the ones before.
    pub fn set_seed(&mut self, seed: u64) {
        self.engine.set_seed(self.strategy.devices(), seed);
    }

    /// Passes should take about so long from now on, but a dispatch at least, whose rays then take no longer, unless they are
    /// few. It never changes a result.
    pub fn set_pass_time(&mut self, time: Duration) {
        self.engine.pass_time = time;
    }

    /// When the first rays of this tracer's first trace were traced; none before.
    pub fn first_end(&self) -> Option<Instant> {
        self.engine.first_end
    }

    /// Times the stages of what is traced from now on, on one device: the stages of two devices side by side would wait for
    /// each other. The sums stay the same bits; the trace becomes slower.
    ///
    /// # Errors
    /// [`crate::Error::Usage`] if the adapter has no timestamps, or too few for so deep a trace.
    pub fn enable_profile(&mut self) -> Result<()> {
        let num_stages = 2 * self.engine.plan.num_rounds() as u64;
        self.engine.profile = Some(Profile::new(self.engine.gpu, num_stages)?);
        self.strategy.keep_one_device();
        Ok(())
    }

    /// Gives the rows of what is traced from now on to recordings, pass by pass, instead of the tally: so memory need not
    /// grow with the rays. Each source has its own, which gets them in the order of (ray id, event), because a source's ids
    /// ascend from pass to pass.
    pub fn record_to(&mut self, recording: impl Fn() -> Recording) {
        self.engine.rows.record_to(self.engine.plan.rays.len(), recording);
    }

    /// What was recorded since [`Tracer::record_to`], sources in order; none without it.
    ///
    /// # Errors
    /// [`crate::Error::File`] if a file cannot be read or written.
    pub fn take_recorded(&mut self) -> Result<Option<Recorded>> {
        self.engine.rows.take_recorded()
    }

    /// What the stages took on the device; nothing unless they were timed.
    pub fn stage_times(&self) -> Vec<StageTime> {
        let sums = self.engine.profile.iter().flat_map(Profile::times);
        sums.map(|sum| StageTime {
            stage: sum.stage.into(),
            num_dispatches: sum.num_dispatches,
            time_sec: sum.seconds,
        })
        .collect()
    }

    /// Traces every ray, in passes of about 40 ms; after each one `keep_going` is given the number of rays that are done, and
    /// stops the trace by returning false.
    ///
    /// # Errors
    /// [`crate::Error::Device`] if the device fails.
    pub fn trace(&mut self, mut keep_going: impl FnMut(u64) -> bool) -> Result<Tally> {
        self.go_on(self.empty_tally(), |progress| Ok(keep_going(progress.done)))
    }

    /// Traces the rays that `begun` lacks, and gives the sum of all. After each pass `keep_going` is shown the progress,
    /// may take a snapshot of the sums, and stops the trace by returning false.
    ///
    /// # Errors
    /// [`crate::Error::Usage`] if `begun` is not the beginning of this trace, [`crate::Error::Device`] if the device fails,
    /// and whatever `keep_going` fails with.
    pub fn go_on(
        &mut self,
        begun: Tally,
        keep_going: impl FnMut(&mut Progress<'_, 'a>) -> Result<bool>,
    ) -> Result<Tally> {
        wavefront::trace(&mut self.engine, self.strategy.as_mut(), begun, keep_going)
    }

    /// Rays in all.
    pub fn num_rays(&self) -> u64 {
        self.engine.plan.num_rays
    }

    /// Ends a pass at a position, if it lies ahead: so that what is decided there does not depend on the batch size or on
    /// the speed of the device.
    pub fn pause_at(&mut self, position: u64) {
        self.engine.pause = Some(position);
    }

    /// Where a trace goes on that has come as far as `begun`.
    ///
    /// # Errors
    /// [`crate::Error::Usage`] if `begun` is not the beginning of this trace.
    pub fn position_after(&self, begun: &Tally) -> Result<u64> {
        self.engine.plan.position_after(begun)
    }

    /// A tally of no rays, in the scene's shape.
    pub fn empty_tally(&self) -> Tally {
        empty_tally(self.engine.ir)
    }
}
