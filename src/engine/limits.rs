//! How many rays a dispatch and a pass may have. Buffers, counters and ids set upper limits, and a busy device a lower
//! one.

use crate::engine::device::stride_of_queue;
use crate::engine::options::TraceOptions;
use crate::engine::rounds::unasked;
use crate::error::{Error, Result};
use crate::gpu::Gpu;
use crate::model::ray_id;
use crate::program::Program;

/// Rays in one dispatch, where nothing else limits them.
pub(crate) const DEFAULT_BATCH: u32 = 1 << 18;
/// The size of a family above which batches shrink no further: families are seldom larger, whatever they are allowed.
const MANY_RAYS: u64 = 8;
/// Workgroups per processor that keep a processor busy until the end of a dispatch.
pub(crate) const WORKGROUPS_PER_PROCESSOR: u32 = 4;
/// The processors assumed of a graphics processor, which has at least this many.
const PROCESSORS: u32 = 16;
/// Most rows for the host in one pass.
const MAX_EVENTS: u32 = 1 << 18;
/// Most counts between drains. Counters are 32 bits wide, and are drained before they can overflow.
pub(crate) const MAX_COUNTS_UNDRAINED: u64 = 1 << 31;
pub(crate) const MAX_COUNTS_PER_PASS: u64 = MAX_COUNTS_UNDRAINED / 4;

/// How large dispatches should be.
#[derive(Debug, Clone, Copy)]
pub(crate) struct DispatchLimits {
    /// Rays of a dispatch, unless the user asks for a number.
    pub(crate) default_rays: u32,
    /// Most rays of a dispatch for which the buffers have room.
    pub(crate) most_rays: u32,
    /// Processors of the device, each of which should have several workgroups.
    pub(crate) processors: u32,
}

impl DispatchLimits {
    /// The limits of a device about which nothing is known.
    pub(crate) fn of(program: &Program) -> Self {
        let default_rays = DEFAULT_BATCH / program.most_rays().min(MANY_RAYS) as u32;
        DispatchLimits { default_rays, most_rays: u32::MAX, processors: PROCESSORS }
    }

    /// Most rays of a dispatch.
    pub(crate) fn batch(&self, gpu: &Gpu, program: &Program, options: &TraceOptions) -> u32 {
        let asked = options.batch_size.unwrap_or(self.default_rays);
        let wanted = asked.min(options.num_rays.min(1 << 30) as u32);
        let events = match program.max_events_per_ray {
            0 => u32::MAX,
            per_ray => (u64::from(MAX_EVENTS) / per_ray).max(1) as u32,
        };
        let queued = match (program.options.has_queue(), stride_of_queue(program)) {
            (true, Ok(stride)) => {
                (gpu.device.limits().max_storage_buffer_binding_size / stride).min(1 << 30) as u32
            }
            _ => u32::MAX,
        };
        let counted = (MAX_COUNTS_PER_PASS / counts_unasked(program)).min(1 << 30) as u32;
        let families = program.splitting.map_or(u32::MAX, |splitting| 1 << splitting.index_bits());
        wanted
            .min(self.most_rays)
            .min(events)
            .min(queued)
            .min(counted)
            .min(program.most_uploaded())
            .min(families)
            .max(1)
    }

    /// The fewest rays with which every processor still has enough workgroups.
    pub(crate) fn least_rays(&self, program: &Program) -> u32 {
        let rays_per_workgroup =
            program.options.workgroup_size * program.options.rays_per_invocation(&program.features);
        WORKGROUPS_PER_PROCESSOR * self.processors * rays_per_workgroup
    }
}

/// Fails if the rays that splitting can make could exceed the range of ids or of counters.
pub(crate) fn check_families(program: &Program, options: &TraceOptions) -> Result<()> {
    if program.splitting.is_none() {
        return Ok(());
    }
    // A larger id would coincide with the id of another ray's child.
    if options.first_ray.saturating_add(options.num_rays) > ray_id::MOST_LAUNCHED {
        return Err(Error::Usage(format!(
            "{} rays from ray {} on are too many where rays are split: their ids end at {}",
            options.num_rays,
            options.first_ray,
            ray_id::MOST_LAUNCHED
        )));
    }
    if counts_per_ray(program) > MAX_COUNTS_PER_PASS {
        return Err(Error::Usage(format!(
            "a launched ray may become {} rays of up to {} events each, more than can be counted; lower split_budget or \
             max_depth",
            program.most_rays(),
            options.max_depth
        )));
    }
    Ok(())
}

/// Most events of one launched ray and its children, their ends included.
pub(crate) fn counts_per_ray(program: &Program) -> u64 {
    program.most_rays() * u64::from(program.options.max_depth + 1)
}

/// Most events of one launched ray, its end included, before the host asks how many rays live on
/// ([`crate::engine::rounds`]). An addition may have sums that are not read within a range. Where detectors let rays pass,
/// one of them may count every event of a ray.
pub(crate) fn counts_unasked(program: &Program) -> u64 {
    let counts_passes =
        program.features.transmissive && program.additions.any(|addition| addition.counts_events_unread());
    match unasked(num_rounds(program)).end == num_rounds(program) || counts_passes {
        true => counts_per_ray(program),
        false => u64::from(program.options.events_per_dispatch + 1),
    }
}

/// The first stage and the rounds after which no ray can be left.
pub(crate) fn num_rounds(program: &Program) -> usize {
    program.options.max_depth.div_ceil(program.options.events_per_dispatch) as usize
}

/// Workgroups as a grid, within the limit of one dimension.
pub(crate) fn grid(workgroups: u32, gpu: &Gpu) -> [u32; 3] {
    let limit = gpu.device.limits().max_compute_workgroups_per_dimension;
    let y = workgroups.div_ceil(limit).max(1);
    [workgroups.div_ceil(y), y, 1]
}
