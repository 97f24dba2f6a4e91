//! The stages of a dispatch, in their order, and how they are recorded and submitted.

use crate::engine::device::DeviceState;
use crate::engine::limits::grid;
use crate::engine::plan::Plan;
use crate::error::Result;
use crate::gpu::Gpu;
use crate::gpu::profile::Profile;
use crate::program::{Program, RayRange};

/// How a device traces a range.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Route {
    /// The number of the bind group that holds the strategy's buffers.
    pub(crate) group: usize,
    /// The number of a stage that a strategy has added; `None` for the plain stages.
    pub(crate) added: Option<usize>,
    /// Rays that an invocation of the first stage follows.
    pub(crate) rays_per_invocation: u32,
}

/// One dispatch of a stage.
pub(super) struct Stage<'a> {
    name: &'static str,
    pipeline: &'a wgpu::ComputePipeline,
    groups: [Option<&'a wgpu::BindGroup>; 2],
    workgroups: Workgroups<'a>,
}

#[derive(Clone, Copy)]
pub(super) enum Workgroups<'a> {
    Of([u32; 3]),
    /// The device has counted them in this buffer.
    Counted(&'a wgpu::Buffer),
}

/// All stages of a dispatch, in their order. The first stage follows new rays through their first events. Then two
/// stages take turns and follow the survivors, until no ray can be left.
pub(super) fn stages<'d>(
    device: &'d DeviceState,
    plan: &Plan,
    way: Route,
    workgroups: [u32; 3],
) -> Result<Vec<Stage<'d>>> {
    let scene = &device.scenes[way.group];
    let first = device.stages.first(&plan.program, way.added)?;
    let mut stages = vec![Stage {
        name: first.name,
        pipeline: &first.pipeline,
        groups: [Some(scene), Some(&device.queues[0])],
        workgroups: Workgroups::Of(workgroups),
    }];
    // An added stage follows its rays to their end.
    let rounds = device.rounds.as_ref().zip(device.stages.rounds.as_ref());
    let Some((rounds, compiled)) = rounds.filter(|_| way.added.is_none()) else { return Ok(stages) };
    for round in 1..plan.num_rounds() {
        stages.push(Stage {
            name: "advance",
            pipeline: &compiled.advance,
            groups: [Some(&rounds.advancing), None],
            workgroups: Workgroups::Of([1, 1, 1]),
        });
        stages.push(Stage {
            name: "trace_queued",
            pipeline: &compiled.trace_queued,
            groups: [Some(scene), Some(&device.queues[round % 2])],
            workgroups: Workgroups::Counted(&rounds.workgroups),
        });
    }
    Ok(stages)
}

impl Route {
    /// The plain stages, with the buffers of this group.
    pub(crate) fn plain(program: &Program, group: usize) -> Self {
        let rays_per_invocation = program.options.rays_per_invocation(&program.features);
        Route { group, added: None, rays_per_invocation }
    }
}

/// Submits a range to a device, outside of a trace.
pub(super) fn submit_alone(
    device: &DeviceState,
    plan: &Plan,
    range: &RayRange,
    num_submissions: usize,
) -> Result<()> {
    write_range(device, &plan.program, range)?;
    let way = Route::plain(&plan.program, 0);
    let rays_per_workgroup = plan.options.workgroup_size * way.rays_per_invocation;
    let workgroups = grid(range.count.div_ceil(rays_per_workgroup), &device.gpu);
    let stages = stages(device, plan, way, workgroups)?;
    submit(&device.gpu, &stages, stages.len().div_ceil(num_submissions), None);
    device.gpu.check()
}

/// Writes to a device which rays its next dispatch traces.
pub(super) fn write_range(device: &DeviceState, program: &Program, range: &RayRange) -> Result<()> {
    let queue = &device.gpu.queue;
    if let Some(source) = program.source_uniforms.get(range.source) {
        queue.write_buffer(&device.source, 0, source);
    }
    for (buffer, (_, of_sources)) in device.source_tangents.iter().zip(&program.source_tangents) {
        queue.write_buffer(buffer, 0, &of_sources[range.source]);
    }
    queue.write_buffer(&device.range, 0, &program.range_bytes(range)?);
    Ok(())
}

impl Stage<'_> {
    fn record(&self, pass: &mut wgpu::ComputePass) {
        pass.set_pipeline(self.pipeline);
        for (index, group) in (0..).zip(self.groups.into_iter().flatten()) {
            pass.set_bind_group(index, group, &[]);
        }
        match self.workgroups {
            Workgroups::Of([x, y, z]) => pass.dispatch_workgroups(x, y, z),
            Workgroups::Counted(counts) => pass.dispatch_workgroups_indirect(counts, 0),
        }
    }
}

/// Submits stages, `per_submission` at a time, timed if there is a profile. Returns the last submission.
pub(super) fn submit(
    gpu: &Gpu,
    stages: &[Stage],
    per_submission: usize,
    mut profile: Option<&mut Profile>,
) -> wgpu::SubmissionIndex {
    let mut parts = stages.chunks(per_submission).peekable();
    loop {
        let part = parts.next().unwrap_or_default();
        let is_last = parts.peek().is_none();
        let mut encoder = gpu.device.create_command_encoder(&Default::default());
        match &mut profile {
            Some(profile) => {
                let mut record =
                    |stage: &Stage| stage.record(&mut profile.begin_pass(&mut encoder, stage.name));
                part.iter().for_each(&mut record);
                if is_last {
                    profile.resolve(&mut encoder);
                }
            }
            None => {
                let descriptor = wgpu::ComputePassDescriptor { label: Some("trace"), timestamp_writes: None };
                let mut pass = encoder.begin_compute_pass(&descriptor);
                part.iter().for_each(|stage| stage.record(&mut pass));
            }
        }
        let submission = gpu.queue.submit([encoder.finish()]);
        if is_last {
            return submission;
        }
    }
}
