//! The whole trace: the host's loop over passes. Each pass takes its share of every source's rays, in ranges of one
//! dispatch each.
//!
//! A pass is a pure function of its rays, because draws are keyed by the ray's id and sums are integers. So the sum
//! over passes does not depend on how the rays were cut into ranges. Progress, interruption, limits, targets and
//! checkpoints are callers of the loop. After each pass they may ask for the sums so far ([`Progress`]).

use crate::engine::Engine;
use crate::engine::addition::{Addition, Additions};
use crate::engine::drain::{discard, drain};
use crate::error::Result;
use crate::result::{Tally, check_shape};
use std::time::{Duration, Instant};

/// Traces the rays that `begun` lacks, and returns the sum of all rays. After each pass, `keep_going` gets the
/// progress, and stops the trace by returning false.
pub(crate) fn trace<'a>(
    engine: &mut Engine<'a>,
    additions: &mut Additions,
    begun: Tally,
    mut keep_going: impl FnMut(&mut Progress<'_, 'a>) -> Result<bool>,
) -> Result<Tally> {
    // What an earlier trace, which failed, left on the device.
    discard(engine, additions)?;
    let mut at = engine.plan.position_after(&begun)?;
    check_shape(engine.ir, &begun)?;
    let (mut tally, num_rays) = (begun, engine.plan.num_rays);
    additions.each(|addition| addition.begin(engine, &mut tally))?;
    let mut pass_rays = u64::from(additions.range_rays(engine));
    let start = Instant::now();
    while at < num_rays {
        let end = engine.end_of_pass(at, pass_rays);
        let time = trace_pass(engine, additions, at, end)?;
        // The time of a pass in which a driver compiled says nothing about other passes.
        if !std::mem::take(&mut engine.is_compiling) {
            pass_rays = engine.next_pass_rays(additions.range_rays(engine), end - at, time);
        }
        at = end;
        if engine.may_overflow(pass_rays) || additions.any(Addition::is_full) {
            drain(engine, additions, &mut tally)?;
        }
        let (done, elapsed) = (engine.plan.done(at), start.elapsed());
        let mut progress =
            Progress { done, num_rays, elapsed, position: at, engine, additions, tally: &mut tally };
        if !keep_going(&mut progress)? {
            break;
        }
    }
    drain(engine, additions, &mut tally)?;
    if at >= num_rays {
        additions.each(|addition| addition.finish(engine, &mut tally))?;
    }
    if engine.plan.rays.len() > 1 {
        tally.sort_rows(engine.ir);
    }
    Ok(tally)
}

/// Traces from one position to another into the device's sums, and returns the time taken.
fn trace_pass(engine: &mut Engine, additions: &mut Additions, first: u64, end: u64) -> Result<Duration> {
    let start = Instant::now();
    engine.idle_time = Duration::ZERO;
    let ranges = engine.plan.ranges(first, end, additions.range_rays(engine), engine.undrained.reached);
    for range in &ranges {
        additions.trace(engine, range)?;
        engine.undrained.launch(&engine.plan, range);
        engine.rows.fetch(&engine.device, &engine.plan, range)?;
    }
    if !additions.any(Addition::keeps_busy) {
        engine.wait_for_pass(end - first, ranges.len(), start)?;
    }
    // Shaders need not mark primitives that are known to be reached. Drivers may cut long loops, which must not pass.
    if engine.undrained.should_ask_after_pass() {
        engine.learn_reached()?;
        engine.check_loops()?;
        additions.each(|addition| addition.after_pass(engine))?;
    }
    Ok(start.elapsed())
}

/// How far a trace has come, after a pass.
pub struct Progress<'t, 'a> {
    /// Rays done, including those that the trace began with.
    pub done: u64,
    /// Rays in all.
    pub num_rays: u64,
    /// Time since the trace began or was resumed.
    pub elapsed: Duration,
    position: u64,
    engine: &'t mut Engine<'a>,
    additions: &'t mut Additions,
    tally: &'t mut Tally,
}

impl Progress<'_, '_> {
    /// The sums of all rays so far. The device's sums are fetched at most once a pass.
    ///
    /// # Errors
    /// [`crate::Error::Device`] if the device fails.
    pub fn tally(&mut self) -> Result<&Tally> {
        if self.engine.undrained.counts > 0 {
            drain(self.engine, self.additions, self.tally)?;
        }
        Ok(self.tally)
    }

    /// The position of the trace, between 0 and `num_rays`. For a single source this is the number of rays done.
    pub fn position(&self) -> u64 {
        self.position
    }

    /// Ends a pass at a position, or before it where [`Progress::pause_at`] says so.
    pub(crate) fn pause_before(&mut self, position: u64) {
        self.engine.pause_before(self.position, position);
    }

    /// See [`crate::Tracer::pause_at`].
    pub fn pause_at(&mut self, position: u64) {
        self.engine.pause = Some(position);
    }
}
