//! How many rays a dispatch traces, and in how many submissions. Each submission keeps the device for a moment only, so
//! that a desktop stays usable and no watchdog fires.

use crate::engine::limits::DEFAULT_BATCH;
use std::time::Duration;

/// How long a pass should keep the device. A desktop then stays usable, and no watchdog fires.
pub(crate) const PASS_TIME: Duration = Duration::from_millis(40);
/// Events that a first dispatch may make, before any dispatch was timed: as many as the largest batch has at the
/// default depth, including ends.
const FIRST_EVENTS: u64 = DEFAULT_BATCH as u64 * 17;
/// The factor by which a dispatch may exceed the one before: rays of one scene differ in cost.
const GROWTH: f64 = 4.0;

/// The size of the next dispatch, learned from the times of earlier ones.
#[derive(Debug)]
pub(crate) struct DispatchSize {
    rays: u32,
    least: u32,
    most: u32,
    submissions: usize,
}

impl DispatchSize {
    /// The size of the first dispatch. `most` is the upper limit; with fewer rays than `least` the device would be
    /// mostly idle.
    pub(crate) fn new(most: u32, least: u32, events_per_ray: u64) -> Self {
        let least = least.min(most);
        let first = (FIRST_EVENTS / events_per_ray.max(1)).min(most.into()) as u32;
        let rays = first.max(least);
        let submissions = (u64::from(rays) * events_per_ray).div_ceil(FIRST_EVENTS).max(1) as usize;
        DispatchSize { rays, least, most, submissions }
    }

    /// Most rays of the next dispatch.
    pub(crate) fn rays(&self) -> u32 {
        self.rays
    }

    /// True if so many rays keep the device from idling.
    pub(crate) fn is_enough(&self, rays: u32) -> bool {
        rays >= self.least
    }

    /// Into how many submissions its stages should be divided: more than one where even the fewest rays take long.
    pub(crate) fn submissions(&self) -> usize {
        self.submissions
    }

    /// Learns from a dispatch that took `time`, where it should not have taken longer than `target`. A dispatch of few
    /// rays, as is common with many sources, counts only if it was too long.
    pub(crate) fn note(&mut self, rays: u32, time: Duration, target: Duration) {
        if time <= target && rays < self.rays.div_ceil(2) {
            return;
        }
        let ratio = target.as_secs_f64() / time.as_secs_f64().max(1e-6);
        let wanted = f64::from(rays) * ratio.min(GROWTH);
        self.rays = (wanted as u32).clamp(self.least, self.most);
        self.submissions = (f64::from(self.least) / wanted).ceil() as usize;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TARGET: Duration = Duration::from_millis(40);

    fn note(size: &mut DispatchSize, rays: u32, millis: u64) -> u32 {
        size.note(rays, Duration::from_millis(millis), TARGET);
        size.rays()
    }

    #[test]
    fn a_first_dispatch_is_small_where_rays_can_have_many_events() {
        let first = |most, events| {
            let size = DispatchSize::new(most, 1024, events);
            (size.rays(), size.submissions())
        };
        assert_eq!(first(DEFAULT_BATCH, 17), (DEFAULT_BATCH, 1));
        assert_eq!(first(DEFAULT_BATCH, 2 * 17), (DEFAULT_BATCH / 2, 1));
        assert_eq!(first(DEFAULT_BATCH, 1001), (4451, 1));
        assert_eq!(first(DEFAULT_BATCH, 17 << 10), (1024, 4), "so few keep the device from idling");
        assert_eq!(first(100, 1), (100, 1), "no more than there is room for");
    }

    #[test]
    fn a_dispatch_grows_to_its_target_time() {
        let mut size = DispatchSize::new(100_000, 1000, 17);
        assert_eq!(note(&mut size, 100_000, 20), 100_000);
        assert_eq!(note(&mut size, 100_000, 400), 10_000);
        assert_eq!(note(&mut size, 10_000, 40_000), 1000);
        assert_eq!(note(&mut size, 1000, 1), 4000, "it grows step by step");
        assert_eq!(note(&mut size, 4000, 40), 4000);
        assert_eq!(note(&mut size, 4000, 0), 16_000);
    }

    #[test]
    fn the_fewest_rays_are_submitted_bit_by_bit_where_they_take_long() {
        let mut size = DispatchSize::new(100_000, 1000, 17);
        for (rays, millis, submissions) in
            [(100_000, 400, 1), (10_000, 390, 1), (1000, 390, 10), (1000, 41, 2), (1000, 40, 1)]
        {
            note(&mut size, rays, millis);
            assert_eq!(size.submissions(), submissions, "{rays} rays in {millis} ms");
        }
    }

    #[test]
    fn a_small_dispatch_can_only_shrink_the_size() {
        let mut size = DispatchSize::new(100_000, 1000, 17);
        assert_eq!(note(&mut size, 30_000, 120), 10_000);
        assert_eq!(note(&mut size, 4999, 1), 10_000);
        assert_eq!(note(&mut size, 5000, 1), 20_000);
    }
}
