//! How the engine submits a range to its device.

use crate::engine::Engine;
use crate::engine::dispatch::{
    Route, next_rounds, rounds, rounds_left, stages, submit, write_range, write_uniforms,
};
use crate::engine::limits::grid;
use crate::error::Result;
use crate::program::RayRange;
use std::time::Instant;

/// A dispatch that has been submitted.
pub(crate) struct Submitted {
    pub(crate) index: wgpu::SubmissionIndex,
    /// True if the first stage had never before been dispatched.
    pub(crate) is_first: bool,
}

impl Engine<'_> {
    /// Submits a range in the plain way.
    pub(crate) fn submit(&mut self, range: &RayRange) -> Result<()> {
        let route = Route::plain(&self.plan.program, 0);
        self.submit_by(route, range)?;
        self.end_dispatch()?;
        self.finish_rounds(route)
    }

    /// True if the host asks how many rays are left after a dispatch of this route.
    pub(crate) fn asks_for_rays(&self, route: Route) -> bool {
        rounds_left(&self.device, &self.plan.program, route).is_some()
    }

    /// Follows the rays of a dispatch that live on, in groups of rounds, to their end.
    pub(crate) fn finish_rounds(&mut self, route: Route) -> Result<()> {
        let Some(mut left) = rounds_left(&self.device, &self.plan.program, route) else { return Ok(()) };
        let mut num_queued = self.device.num_queued()?;
        while let Some((numbers, counts)) = next_rounds(&mut left, &self.plan.program, num_queued) {
            if self.undrained.go_on(counts, self.most_counts) {
                self.spill()?;
            }
            let start = Instant::now();
            let stages = rounds(&self.device, route, numbers);
            submit(self.gpu, &stages, stages.len(), self.profile.as_mut());
            self.num_submissions += 1;
            self.end_dispatch()?;
            let is_idle = !self.size.is_enough(num_queued);
            num_queued = self.device.num_queued()?;
            left.note(start.elapsed(), self.pass_time);
            if is_idle {
                self.idle_time += start.elapsed();
            }
        }
        Ok(())
    }

    /// Collects the times of a dispatch where stages are timed, and fails if the device has failed.
    pub(crate) fn end_dispatch(&mut self) -> Result<()> {
        if let Some(profile) = &mut self.profile {
            profile.collect(self.gpu)?;
        }
        self.gpu.check()
    }

    /// Submits a range by a route.
    pub(crate) fn submit_by(&mut self, route: Route, range: &RayRange) -> Result<Submitted> {
        let Engine { gpu, device, plan, .. } = self;
        write_range(device, &plan.program, range)?;
        let rays_per_workgroup = plan.options.workgroup_size * route.rays_per_invocation;
        let workgroups = grid(range.count.div_ceil(rays_per_workgroup), gpu);
        let stages = stages(device, plan, route, workgroups)?;
        let per_submission = stages.len().div_ceil(self.size.submissions());
        self.num_submissions += stages.len().div_ceil(per_submission) as u64;
        let index = submit(gpu, &stages, per_submission, self.profile.as_mut());
        let is_first = device.stages.first(&plan.program, route.added)?.begin();
        self.is_compiling |= is_first;
        Ok(Submitted { index, is_first })
    }

    /// Submits the stages of a range with no workgroups, as if the range began at ray 0. Nothing is done if the first
    /// stage has run before.
    pub(crate) fn prime(&self, route: Route, range: &RayRange) -> Result<()> {
        let device = &self.device;
        if device.stages.first(&self.plan.program, route.added)?.has_begun() {
            return Ok(());
        }
        write_uniforms(device, &self.plan.program, &RayRange { first: 0, ..*range })?;
        let stages = stages(device, &self.plan, route, [0, 0, 1])?;
        submit(self.gpu, &stages, stages.len(), None);
        Ok(())
    }
}
