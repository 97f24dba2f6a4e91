//! How fast a trace is, and how long it will take.

use std::time::Duration;

/// The rays and the time of all passes so far.
#[derive(Debug, Default)]
pub(crate) struct Pace {
    rays: u64,
    time: Duration,
}

impl Pace {
    /// The least time from which a rate can be estimated.
    const LEAST: Duration = Duration::from_millis(100);

    /// Takes note of a pass.
    pub(crate) fn note(&mut self, rays: u64, time: Duration) {
        self.rays += rays;
        self.time += time;
    }

    /// The time that this many rays will take \[s\]; `None` if it cannot be estimated yet.
    pub(crate) fn seconds_for(&self, rays: u64) -> Option<f64> {
        (self.time >= Self::LEAST).then(|| self.time.as_secs_f64() / self.rays as f64 * rays as f64)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rays_to_come_take_as_long_as_those_before() {
        let mut pace = Pace::default();
        assert_eq!(pace.seconds_for(1), None);
        pace.note(1000, Duration::from_millis(60));
        assert_eq!(pace.seconds_for(1), None, "too little to tell by");
        pace.note(3000, Duration::from_millis(140));
        assert_eq!(pace.seconds_for(40_000), Some(0.2 / 4000.0 * 40_000.0));
    }
}
