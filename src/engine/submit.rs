//! How the engine submits a range to one of its devices.

use crate::engine::Engine;
use crate::engine::device::DeviceState;
use crate::engine::dispatch::{Route, next_rounds, rounds, rounds_left, stages, submit, write_range};
use crate::engine::limits::grid;
use crate::error::Result;
use crate::program::RayRange;
use std::time::Instant;

/// A dispatch that has been submitted.
pub(crate) struct Submitted {
    pub(crate) index: wgpu::SubmissionIndex,
    /// True if the first stage had never before been dispatched on its device.
    pub(crate) is_first: bool,
}

impl Engine<'_> {
    /// Submits a range to the engine's device, in the plain way.
    pub(crate) fn submit(&mut self, range: &RayRange) -> Result<()> {
        let route = Route::plain(&self.plan.program, 0);
        self.submit_to(None, route, range)?;
        self.end_dispatch(None)?;
        self.finish_rounds(None, route)
    }

    /// True if the host asks how many rays are left after a dispatch of this route.
    pub(crate) fn asks_for_rays(&self, route: Route) -> bool {
        rounds_left(&self.device, &self.plan.program, route).is_some()
    }

    /// Follows the rays of a dispatch that live on, in groups of rounds, to their end. The device is `other`, or else the
    /// engine's.
    pub(crate) fn finish_rounds(&mut self, other: Option<&DeviceState>, route: Route) -> Result<()> {
        let Some(mut left) = rounds_left(&self.device, &self.plan.program, route) else { return Ok(()) };
        let mut num_queued = other.unwrap_or(&self.device).num_queued()?;
        while let Some((numbers, counts)) = next_rounds(&mut left, &self.plan.program, num_queued) {
            if self.undrained.go_on(counts, self.most_counts, other.is_some()) {
                self.spill(other)?;
            }
            let start = Instant::now();
            let device = other.unwrap_or(&self.device);
            let stages = rounds(device, route, numbers);
            submit(&device.gpu, &stages, stages.len(), self.profile.as_mut());
            self.num_submissions += 1;
            self.end_dispatch(other)?;
            let is_idle = !self.size.is_enough(num_queued);
            num_queued = other.unwrap_or(&self.device).num_queued()?;
            left.note(start.elapsed(), self.pass_time);
            if is_idle {
                self.idle_time += start.elapsed();
            }
        }
        Ok(())
    }

    /// Collects the times of a dispatch where stages are timed, and fails if the device has failed. The device is
    /// `other`, or else the engine's.
    pub(crate) fn end_dispatch(&mut self, other: Option<&DeviceState>) -> Result<()> {
        let gpu = &other.unwrap_or(&self.device).gpu;
        if let Some(profile) = &mut self.profile {
            profile.collect(gpu)?;
        }
        gpu.check()
    }

    /// Submits a range to the device `other`, or else to the engine's.
    pub(crate) fn submit_to(
        &mut self,
        other: Option<&DeviceState>,
        route: Route,
        range: &RayRange,
    ) -> Result<Submitted> {
        let device = other.unwrap_or(&self.device);
        let plan = &self.plan;
        write_range(device, &plan.program, range)?;
        let rays_per_workgroup = plan.options.workgroup_size * route.rays_per_invocation;
        let workgroups = grid(range.count.div_ceil(rays_per_workgroup), &device.gpu);
        let stages = stages(device, plan, route, workgroups)?;
        let per_submission = stages.len().div_ceil(self.size.submissions());
        self.num_submissions += stages.len().div_ceil(per_submission) as u64;
        let index = submit(&device.gpu, &stages, per_submission, self.profile.as_mut());
        let is_first = device.stages.first(&plan.program, route.added)?.begin();
        self.is_compiling |= is_first;
        Ok(Submitted { index, is_first })
    }

    /// Submits the stages of a range with no workgroups, as if the range began at ray 0. Nothing is done if the first
    /// stage has run before.
    pub(crate) fn prime(&self, other: Option<&DeviceState>, route: Route, range: &RayRange) -> Result<()> {
        let device = other.unwrap_or(&self.device);
        if device.stages.first(&self.plan.program, route.added)?.has_begun() {
            return Ok(());
        }
        write_range(device, &self.plan.program, &RayRange { first: 0, ..*range })?;
        let stages = stages(device, &self.plan, route, [0, 0, 1])?;
        submit(&device.gpu, &stages, stages.len(), None);
        Ok(())
    }
}
