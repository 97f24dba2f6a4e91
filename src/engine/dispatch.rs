//! The stages of a dispatch, in their order, and how they are recorded and submitted.

use crate::engine::device::DeviceState;
use crate::engine::dispatch_size::PASS_TIME;
use crate::engine::limits::{MAX_COUNTS_PER_PASS, grid, num_rounds};
use crate::engine::plan::TracePlan;
use crate::engine::rounds::{RoundsLeft, unasked};
use crate::error::Result;
use crate::gpu::Gpu;
use crate::gpu::profile::Profile;
use crate::program::{Program, RayRange};
use std::ops::Range;
use std::time::Instant;

/// How a device traces a range.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Route {
    /// The number of the bind group that holds the buffers of additions.
    pub(crate) group: usize,
    /// The number of a stage that an addition has brought; `None` for the plain stages.
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

/// The stages that are submitted with a range, in their order. The first stage follows new rays through their first
/// events. Few rounds may follow.
pub(super) fn stages<'d>(
    device: &'d DeviceState,
    plan: &TracePlan,
    route: Route,
    workgroups: [u32; 3],
) -> Result<Vec<Stage<'d>>> {
    let scene = &device.scenes[route.group];
    let first = device.stages.first(&plan.program, route.added)?;
    let mut stages = vec![Stage {
        name: first.name,
        pipeline: &first.pipeline,
        groups: [Some(scene), Some(&device.queues[0])],
        workgroups: Workgroups::Of(workgroups),
    }];
    stages.extend(rounds(device, route, unasked(num_rounds(&plan.program))));
    Ok(stages)
}

/// The stages of some rounds. In each, two stages take turns and follow the survivors. There are none after an added
/// stage, which follows its rays to their end.
pub(super) fn rounds(device: &DeviceState, route: Route, numbers: Range<usize>) -> Vec<Stage<'_>> {
    let rounds = device.rounds.as_ref().zip(device.stages.rounds.as_ref());
    let Some((rounds, compiled)) = rounds.filter(|_| route.added.is_none()) else { return Vec::new() };
    let round = |number: usize| {
        let advance = Stage {
            name: "advance",
            pipeline: &compiled.advance,
            groups: [Some(&rounds.advancing), None],
            workgroups: Workgroups::Of([1, 1, 1]),
        };
        let trace_queued = Stage {
            name: "trace_queued",
            pipeline: &compiled.trace_queued,
            groups: [Some(&device.scenes[route.group]), Some(&device.queues[number % 2])],
            workgroups: Workgroups::Counted(&rounds.workgroups),
        };
        [advance, trace_queued]
    };
    numbers.flat_map(round).collect()
}

/// The rounds of a range that are to be asked about, if there are any.
pub(super) fn rounds_left(device: &DeviceState, program: &Program, route: Route) -> Option<RoundsLeft> {
    let may_have = device.rounds.is_some() && route.added.is_none();
    RoundsLeft::of(num_rounds(program)).filter(|_| may_have)
}

/// The next rounds of so many rays, and the most that a counter may count in them.
pub(super) fn next_rounds(
    left: &mut RoundsLeft,
    program: &Program,
    num_queued: u32,
) -> Option<(Range<usize>, u64)> {
    let counts_per_round = u64::from(num_queued) * u64::from(program.options.events_per_dispatch + 1);
    let rounds = left.next(num_queued, MAX_COUNTS_PER_PASS / counts_per_round.max(1))?;
    let counts = rounds.len() as u64 * counts_per_round;
    Some((rounds, counts))
}

impl Route {
    /// The plain stages, with the buffers of this group.
    pub(crate) fn plain(program: &Program, group: usize) -> Self {
        let rays_per_invocation = program.options.rays_per_invocation(&program.features);
        Route { group, added: None, rays_per_invocation }
    }
}

/// Submits a range to a device, outside of a trace. `count` takes the most that a counter may count in further rounds,
/// before each group of them.
pub(super) fn submit_alone(
    device: &DeviceState,
    plan: &TracePlan,
    range: &RayRange,
    num_submissions: usize,
    mut count: impl FnMut(u64) -> Result<()>,
) -> Result<()> {
    write_range(device, &plan.program, range)?;
    let route = Route::plain(&plan.program, 0);
    let rays_per_workgroup = plan.options.workgroup_size * route.rays_per_invocation;
    let workgroups = grid(range.count.div_ceil(rays_per_workgroup), &device.gpu);
    let stages = stages(device, plan, route, workgroups)?;
    submit(&device.gpu, &stages, stages.len().div_ceil(num_submissions), None);
    device.gpu.check()?;
    let Some(mut left) = rounds_left(device, &plan.program, route) else { return Ok(()) };
    let mut num_queued = device.num_queued()?;
    while let Some((numbers, counts)) = next_rounds(&mut left, &plan.program, num_queued) {
        count(counts)?;
        let start = Instant::now();
        let stages = rounds(device, route, numbers);
        submit(&device.gpu, &stages, stages.len(), None);
        device.gpu.check()?;
        num_queued = device.num_queued()?;
        left.note(start.elapsed(), PASS_TIME);
    }
    Ok(())
}

/// Writes to a device which rays its next dispatch traces.
pub(super) fn write_range(device: &DeviceState, program: &Program, range: &RayRange) -> Result<()> {
    write_uniforms(device, program, range)?;
    if program.streams_rays(range.source) && !program.additions.any(|addition| addition.lists_rays()) {
        let ids: Vec<u64> = (range.first..range.first + u64::from(range.count)).collect();
        write_streamed(device, program, range.source, &ids)?;
    }
    Ok(())
}

/// The same without the rays of files, for a dispatch of no workgroups.
pub(super) fn write_uniforms(device: &DeviceState, program: &Program, range: &RayRange) -> Result<()> {
    let queue = &device.gpu.queue;
    if let Some(source) = program.source_uniforms.get(range.source) {
        queue.write_buffer(&device.source, 0, source);
    }
    for (buffer, (_, of_sources)) in device.uploads.iter().zip(&program.uploads) {
        queue.write_buffer(buffer, 0, &of_sources[range.source]);
    }
    queue.write_buffer(&device.range, 0, &program.range_bytes(range)?);
    Ok(())
}

/// Uploads the rays of a source's file that rays with these ids begin with, for the next dispatch. Nothing is done for other
/// sources.
pub(crate) fn write_streamed(
    device: &DeviceState,
    program: &Program,
    source: usize,
    ids: &[u64],
) -> Result<()> {
    if let (Some(tables), Some((first_byte, rows))) = (&device.tables, program.streamed_rows(source, ids)?) {
        device.gpu.queue.write_buffer(tables, first_byte, &rows);
    }
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
