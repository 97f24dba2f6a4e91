//! When a trace may stop: at a target for the error, or at a time limit.
//!
//! Whether the target is met is decided at fixed positions of the trace. So the same trace stops after the same ray on
//! every machine. A time limit stops by the clock.

use crate::error::Result;
use crate::model::SceneIr;
use crate::result::uncertainty::Errors;
use crate::result::{StoppedBy, Tally};
use crate::run::{Progress, Tracer};
use std::time::Duration;

/// Decides after each pass whether to go on.
#[derive(Debug, Clone, PartialEq)]
pub struct Stopping {
    target_error: Option<f64>,
    time_limit: Option<Duration>,
    first_check: u64,
    /// The state at the last check of the error.
    known: Option<Known>,
}

/// The largest relative error, and an estimate of all rays that the target takes, if there is one.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Known {
    error: f64,
    rays_to_target: Option<u64>,
}

/// The least position of the first check: before, an estimated error is little more than chance.
const FIRST_CHECK: u64 = 1 << 14;

/// Cells that are checked in about the time of a ray.
const CELLS_PER_RAY: u64 = 16;

/// The position of the first check after `position`, where `first` is the first of all. Checks lie 6 % apart. So few
/// rays are traced in vain, and checks take only a small part of a long trace.
fn next_check(first: u64, position: u64) -> u64 {
    std::iter::successors(Some(first), |check| check.checked_add(check / 16))
        .find(|check| *check > position)
        .unwrap_or(u64::MAX)
}

impl Stopping {
    /// Stops a trace when the largest relative error of all detectors is at most `target_error`, or after `time_limit`.
    /// See [`crate::result::uncertainty::worst_relative_error`].
    pub fn new(ir: &SceneIr, target_error: Option<f64>, time_limit: Option<Duration>) -> Self {
        let num_cells: u64 = ir.detectors.iter().map(|detector| detector.num_cells() as u64).sum();
        let first_check = FIRST_CHECK.max(num_cells / CELLS_PER_RAY);
        Stopping { target_error, time_limit, first_check, known: None }
    }

    fn next_check(&self, position: u64) -> u64 {
        next_check(self.first_check, position)
    }

    /// Must be called before the trace goes on from the end of `begun`.
    ///
    /// # Errors
    /// [`crate::Error::Usage`] if `begun` is not the beginning of this trace.
    pub fn begin(&self, tracer: &mut Tracer, begun: &Tally) -> Result<()> {
        if self.target_error.is_some() {
            let position = tracer.position_after(begun)?;
            tracer.pause_at(self.next_check(position));
        }
        Ok(())
    }

    /// The reason to stop after this pass, if there is one.
    ///
    /// # Errors
    /// [`crate::Error::Device`] if the device fails.
    pub fn after_pass(&mut self, ir: &SceneIr, progress: &mut Progress) -> Result<Option<StoppedBy>> {
        if let Some(target) = self.target_error {
            let position = progress.position();
            if position > 0 && self.next_check(position - 1) == position {
                let errors = Errors::of(ir, progress.tally()?);
                // A trace stops only at a check.
                let stops_after = |position: f64| self.next_check((position.ceil() as u64).saturating_sub(1));
                let more = |factor: f64| stops_after(position as f64 * factor).saturating_sub(position);
                let rays_to_target =
                    errors.factor_to(target).map(|factor| progress.done.saturating_add(more(factor)));
                self.known = errors.worst().map(|error| Known { error, rays_to_target });
                if self.relative_error().is_some_and(|error| error <= target) {
                    return Ok(Some(StoppedBy::TargetError));
                }
            }
            progress.pause_at(self.next_check(position));
        }
        Ok(self.time_limit.filter(|limit| progress.elapsed >= *limit).map(|_| StoppedBy::TimeLimit))
    }

    /// The target for the relative error.
    pub fn target_error(&self) -> Option<f64> {
        self.target_error
    }

    /// The time limit.
    pub fn time_limit(&self) -> Option<Duration> {
        self.time_limit
    }

    /// The largest relative error at the last check.
    pub fn relative_error(&self) -> Option<f64> {
        self.known.map(|known| known.error)
    }

    /// All rays that the target takes, estimated from the errors at the last check; `None` where no estimate is
    /// possible. With random numbers the estimate is right within a factor of 2 once a hundredth of the rays are
    /// traced. From a quarter on it is right within 15 %. Sobol points need fewer rays.
    pub fn rays_to_target(&self) -> Option<u64> {
        self.known?.rays_to_target
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn checks_lie_at_fixed_places_and_never_far_apart() {
        let (mut position, mut checks) = (0, Vec::new());
        while position < 1 << 40 {
            position = next_check(FIRST_CHECK, position);
            checks.push(position);
            // From any ray before it, the next check is the same.
            assert_eq!(next_check(FIRST_CHECK, position - 1), position);
        }
        assert_eq!(checks[0], FIRST_CHECK);
        assert!(checks.windows(2).all(|pair| pair[0] < pair[1] && pair[1] <= pair[0] + pair[0] / 16));
        assert!(checks.len() < 320, "{}", checks.len());
        assert!(next_check(FIRST_CHECK, u64::MAX - 1) > u64::MAX / 2);
    }
    #[test]
    fn a_large_map_is_looked_at_later() {
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/scenes/bench_lens.json");
        let mut ir = crate::Scene::from_path(path.as_ref()).unwrap().lower().unwrap();
        assert_eq!(Stopping::new(&ir, None, None).next_check(0), FIRST_CHECK);
        if let crate::model::DetectorKind::Irradiance(grid) = &mut ir.detectors[0].kind {
            (grid.num_pixels_x, grid.num_pixels_y) = (8192, 8192);
        }
        assert_eq!(Stopping::new(&ir, None, None).next_check(0), 1 << 22);
    }
}
