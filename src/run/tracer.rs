//! A scene ready to trace: the face of the engine ([`crate::engine::pass_loop`]).
//!
//! [`Tracer`] holds the plain loop with what its options ask for, and with what pays on the adapter ([`additions`]).

#[cfg(feature = "cpu")]
use crate::cpu::Cpu;
use crate::engine::addition::Additions;
use crate::engine::limits::num_rounds;
use crate::engine::options::TraceOptions;
use crate::engine::pass_loop::Progress;
use crate::engine::pipeline_cache::Shaders;
use crate::engine::prepare::{prepare, set_seed};
use crate::engine::rounds::MOST_IN_GROUP;
use crate::engine::undrained::empty_tally;
use crate::engine::{Engine, pass_loop};
use crate::error::{Error, Result};
use crate::gpu::Gpu;
use crate::gpu::profile::Profile;
use crate::model::{SceneIr, Sequence};
use crate::paths::totals::PathTotals;
use crate::program::Program;
use crate::result::{Recorded, Recording, StageTime, Tally};
use crate::run::additions::{self, ForAdapter};
use glam::DVec3;
use std::collections::HashMap;
use std::time::{Duration, Instant};

/// A scene ready to trace on a device.
pub struct Tracer<'a> {
    engine: Engine<'a>,
    additions: Additions,
}

impl<'a> Tracer<'a> {
    /// Prepares a scene: composes, compiles and packs it.
    ///
    /// # Errors
    /// [`crate::Error::Usage`] for options that make no sense, or that the device cannot do. [`crate::Error::Device`]
    /// if the scene does not fit the device.
    pub fn new(gpu: &'a Gpu, ir: &'a SceneIr, options: &TraceOptions) -> Result<Self> {
        Self::with(gpu, ir, options, ForAdapter::WhatPays, Shaders::default())
    }

    /// As [`Tracer::new`], with shaders from elsewhere, and with other additions than what pays on the adapter. With
    /// [`TraceOptions::live`], scenes of one shape share a compiled shader of a cache. No choice changes a bit of a result.
    ///
    /// # Errors
    /// As [`Tracer::new`].
    #[doc(hidden)]
    pub fn with(
        gpu: &'a Gpu,
        ir: &'a SceneIr,
        options: &TraceOptions,
        for_adapter: ForAdapter,
        shaders: Shaders,
    ) -> Result<Self> {
        let mut additions = additions::of(gpu, options, for_adapter);
        let engine = prepare(gpu, ir, options, &mut additions, shaders)?;
        Ok(Tracer { engine, additions })
    }

    /// The composed program.
    pub fn program(&self) -> &Program {
        &self.engine.plan.program
    }

    /// The number of submissions, over all traces.
    #[doc(hidden)]
    pub fn num_submissions(&self) -> u64 {
        self.engine.num_submissions
    }

    /// How many rays of the last trace were traced along the hot path, and how many of them failed a guard. The same for
    /// each side trace follows.
    #[cfg(feature = "cpu")]
    #[doc(hidden)]
    pub fn num_along_paths(&self) -> Vec<[u64; 2]> {
        self.additions.get::<Cpu>().map(Cpu::num_along_paths).unwrap_or_default()
    }

    /// Sets the seed of the draws from now on. Nothing is compiled anew.
    pub fn set_seed(&mut self, seed: u64) {
        set_seed(&mut self.engine, &mut self.additions, seed);
    }

    /// Sets how long passes should take from now on. A pass has at least one dispatch, whose rays then also take no
    /// longer, unless they are few. No result changes.
    pub fn set_pass_time(&mut self, time: Duration) {
        self.engine.pass_time = time;
    }

    /// When the first rays of this tracer's first trace had been traced; `None` before.
    pub fn first_end(&self) -> Option<Instant> {
        self.engine.first_end
    }

    /// Times the stages of traces from now on. The sums stay the same bits. The trace becomes slower.
    ///
    /// # Errors
    /// [`crate::Error::Usage`] if the adapter has no timestamps.
    pub fn enable_profile(&mut self) -> Result<()> {
        let num_rounds = num_rounds(&self.engine.plan.program).min(MOST_IN_GROUP);
        let num_stages = 2 * num_rounds as u64;
        self.engine.profile = Some(Profile::new(self.engine.gpu, num_stages)?);
        Ok(())
    }

    /// From now on, rows go to recordings, pass by pass, instead of the tally. So memory need not grow with the rays.
    /// Each source has its own recording, with rows in the order of (ray id, event): the ids of a source ascend from
    /// pass to pass.
    pub fn record_to(&mut self, recording: impl Fn() -> Recording) {
        self.engine.rows.record_to(self.engine.plan.rays.len(), recording);
    }

    /// The rows recorded since [`Tracer::record_to`], with sources in order; `None` without that call.
    ///
    /// # Errors
    /// [`crate::Error::File`] if a file cannot be read or written.
    pub fn take_recorded(&mut self) -> Result<Option<Recorded>> {
        self.engine.rows.take_recorded()
    }

    /// The times of the stages on the device; empty unless they were timed.
    pub fn stage_times(&self) -> Vec<StageTime> {
        let sums = self.engine.profile.iter().flat_map(Profile::times);
        sums.map(|sum| StageTime {
            stage: sum.stage.into(),
            num_dispatches: sum.num_dispatches,
            time_sec: sum.seconds,
        })
        .collect()
    }

    /// Traces every ray, in passes of about 40 ms. After each pass, `keep_going` gets the number of rays done, and
    /// stops the trace by returning false.
    ///
    /// # Errors
    /// [`crate::Error::Device`] if the device fails.
    pub fn trace(&mut self, mut keep_going: impl FnMut(u64) -> bool) -> Result<Tally> {
        self.go_on_checked(self.empty_tally(), |progress| Ok(keep_going(progress.done)))
    }

    /// Traces the rays that `begun` lacks, and returns the sum of all rays. After each pass, `keep_going` gets the
    /// progress, may take a snapshot of the sums, and stops the trace by returning false.
    ///
    /// # Errors
    /// [`crate::Error::Usage`] if `begun` is not the beginning of this trace. [`crate::Error::Device`] if the device
    /// fails. Any error of `keep_going`.
    pub fn go_on(
        &mut self,
        begun: Tally,
        keep_going: impl FnMut(&mut Progress<'_, 'a>) -> Result<bool>,
    ) -> Result<Tally> {
        let refused = |problem| Error::Usage(format!("what the trace should go on from {problem}"));
        begun.check(self.engine.ir).map_err(refused)?;
        self.go_on_checked(begun, keep_going)
    }

    /// As [`Tracer::go_on`], from sums that were checked, or that a tracer of this scene made. The check looks at every
    /// cell, and blocks of a trace go on often.
    pub(crate) fn go_on_checked(
        &mut self,
        begun: Tally,
        keep_going: impl FnMut(&mut Progress<'_, 'a>) -> Result<bool>,
    ) -> Result<Tally> {
        pass_loop::trace(&mut self.engine, &mut self.additions, begun, keep_going)
    }

    /// The number of rays of the whole trace.
    pub fn num_rays(&self) -> u64 {
        self.engine.plan.num_rays
    }

    /// Ends a pass at a position, if the position lies ahead. A decision taken there depends neither on the batch size
    /// nor on the speed of the device.
    pub fn pause_at(&mut self, position: u64) {
        self.engine.pause = Some(position);
    }

    /// Ends a pass at a position, or before it where [`Tracer::pause_at`] says so, in a trace that goes on from `at`.
    pub(crate) fn pause_before(&mut self, at: u64, position: u64) {
        self.engine.pause_before(at, position);
    }

    /// The position from which a trace goes on that has come as far as `begun`.
    ///
    /// # Errors
    /// [`crate::Error::Usage`] if `begun` is not the beginning of this trace.
    pub fn position_after(&self, begun: &Tally) -> Result<u64> {
        self.engine.plan.position_after(begun)
    }

    /// Where some ray came to the end of each path that this tracer found, in the scene's frame \[mm\].
    pub fn found_paths(&self) -> HashMap<&Sequence, DVec3> {
        self.additions.get::<PathTotals>().map(PathTotals::found).unwrap_or_default()
    }

    /// A tally without rays, in the scene's shape.
    pub fn empty_tally(&self) -> Tally {
        empty_tally(self.engine.ir)
    }
}
