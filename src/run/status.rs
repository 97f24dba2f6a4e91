//! How far a trace has come, and how it goes on.

use crate::run::Progress;
use crate::run::stopping::Stopping;
use std::time::Duration;

/// How a trace goes on after a pass.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Next {
    /// To its last ray.
    GoOn,
    /// It ends, and the rays that were traced are a partial result.
    Stop,
    /// It ends, and there is no result.
    Cancel,
}

impl Next {
    /// [`Next::Stop`] where a flag is raised, such as by Ctrl-C.
    pub fn stop_if(is_raised: bool) -> Self {
        if is_raised { Next::Stop } else { Next::GoOn }
    }
}

/// The state of a trace while it runs.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Status {
    /// Rays done, including those that the trace began with.
    pub rays: u64,
    /// Most rays of the whole trace.
    pub num_rays: u64,
    /// Rays done before the trace was resumed.
    pub begun: u64,
    /// Time since the trace began or was resumed.
    pub elapsed: Duration,
    /// The largest relative error, if known.
    pub relative_error: Option<f64>,
    /// The target for the relative error.
    pub target_error: Option<f64>,
    /// An estimate of the rays that the target takes.
    pub rays_to_target: Option<u64>,
    /// The time limit.
    pub time_limit: Option<Duration>,
}

impl Status {
    /// The state after a pass of a trace that began with `begun` rays.
    pub(crate) fn of(progress: &Progress<'_, '_>, stopping: &Stopping, begun: u64) -> Self {
        Status {
            begun,
            relative_error: stopping.relative_error(),
            target_error: stopping.target_error(),
            rays_to_target: stopping.rays_to_target(),
            time_limit: stopping.time_limit(),
            ..Status::of_rays(progress.done, progress.num_rays, progress.elapsed)
        }
    }

    /// The state of a trace that goes on to its last ray.
    pub(crate) fn of_rays(rays: u64, num_rays: u64, elapsed: Duration) -> Self {
        Status {
            rays,
            num_rays,
            begun: 0,
            elapsed,
            relative_error: None,
            target_error: None,
            rays_to_target: None,
            time_limit: None,
        }
    }

    /// Rays per second.
    pub fn rate(&self) -> f64 {
        (self.rays - self.begun.min(self.rays)) as f64 / self.elapsed.as_secs_f64().max(1e-9)
    }

    /// Time to the end \[s\]: the last ray, the target or the time limit, whichever comes first.
    pub fn eta_sec(&self) -> f64 {
        let end = self.rays_to_target.map_or(self.num_rays, |rays| rays.min(self.num_rays));
        let left = end.saturating_sub(self.rays) as f64 / self.rate().max(1e-9);
        let limit =
            self.time_limit.map_or(f64::INFINITY, |limit| limit.saturating_sub(self.elapsed).as_secs_f64());
        left.min(limit)
    }
}
