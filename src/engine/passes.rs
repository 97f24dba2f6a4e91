//! How long passes are, and what the time of one pass says about the next.

use crate::engine::Engine;
use crate::engine::limits::{MAX_COUNTS_PER_PASS, MAX_COUNTS_UNDRAINED, counts_unasked};
use crate::error::Result;
use std::time::{Duration, Instant};

impl Engine<'_> {
    /// The position where a pass of `pass_rays` rays ends, if it begins at `at`.
    pub(crate) fn end_of_pass(&self, at: u64, pass_rays: u64) -> u64 {
        let end = self.plan.num_rays.min(at + pass_rays);
        self.pause.filter(|pause| *pause > at).map_or(end, |pause| end.min(pause))
    }

    /// The rays of the next pass, such that it takes about as long as passes should. The last pass had `rays` rays and
    /// took `elapsed`. Ranges have at most `range_rays` rays.
    pub(crate) fn next_pass_rays(&self, range_rays: u32, rays: u64, elapsed: Duration) -> u64 {
        let ratio = self.pass_time.as_secs_f64() / elapsed.as_secs_f64().max(1e-6);
        let dispatch = u64::from(range_rays);
        let wanted = (rays as f64 * ratio.min(4.0)) as u64;
        let most = MAX_COUNTS_PER_PASS / counts_unasked(&self.plan.program);
        // Rows for the host are fetched once a pass, and the buffer holds the rows of one dispatch.
        let limit = if self.device.keeps_rows() { dispatch } else { most.max(dispatch) };
        wanted.clamp(1, limit).next_multiple_of(dispatch).min(limit.max(dispatch))
    }

    /// True if a further pass of this many rays could make a counter overflow, unless the sums are drained first.
    pub(crate) fn may_overflow(&self, pass_rays: u64) -> bool {
        let counts = pass_rays * counts_unasked(&self.plan.program);
        self.undrained.counts > MAX_COUNTS_UNDRAINED.saturating_sub(counts)
    }

    /// Waits for a pass that began at `start`, and adapts the size of dispatches to the time it took. The time in
    /// which few rays were left does not count: fewer rays in a dispatch would not shorten it.
    pub(crate) fn wait_for_pass(&mut self, rays: u64, num_ranges: usize, start: Instant) -> Result<()> {
        self.gpu.wait()?;
        self.first_end.get_or_insert_with(Instant::now);
        if !self.is_compiling {
            let num_ranges = num_ranges.max(1) as u32;
            self.size.note(
                (rays / u64::from(num_ranges)) as u32,
                start.elapsed().saturating_sub(self.idle_time) / num_ranges,
                self.pass_time,
            );
        }
        Ok(())
    }
}
