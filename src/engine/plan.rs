//! What is to be traced: the program, the rays of each source, and their positions in the trace.
//!
//! Sources take turns: each pass takes the same share of every source's rays. So the rays done at any moment are a fair
//! sample of the scene. A position counts the rays of all sources, from 0 to their number.

use crate::engine::budget::SourceRays;
use crate::engine::dispatch_size::DispatchSize;
use crate::engine::limits::{DispatchLimits, counts_per_ray};
use crate::engine::moments::MomentSource;
use crate::engine::options::TraceOptions;
use crate::engine::pipeline_cache::PipelineCache;
use crate::engine::readback::Counted;
use crate::error::{Error, Result};
use crate::gpu::Gpu;
use crate::model::SceneIr;
use crate::program::layout::numbers::lie_in_uniforms;
use crate::program::layout::tables::ReachedMarks;
use crate::program::{self, Precision, Program, ProgramOptions, RayRange};
use crate::result::{FluxSum, QUANTA_PER_WEIGHT, RaySpan, RaySpans, Tally};

/// What is to be traced.
pub(crate) struct TracePlan {
    pub(crate) options: TraceOptions,
    pub(crate) program: Program,
    /// The rays of each source.
    pub(crate) rays: Vec<SourceRays>,
    /// The number of rays of all sources.
    pub(crate) num_rays: u64,
    pub(crate) moments: MomentSource,
    pub(super) limits: DispatchLimits,
    /// Most rays of a dispatch; buffers are made for this number.
    pub(crate) batch: u32,
    /// Compiled shaders of earlier traces, for a trace of the same rays again.
    pub(crate) cache: Option<PipelineCache>,
}

/// The largest uniform buffer that WebGPU promises \[bytes\].
const UNIFORM_BYTES: u32 = 1 << 16;

/// Up to so many primitives are searched one after the other where numbers are live.
const MOST_LIVE_IN_TURN: usize = 256;

pub(super) fn roulette_threshold(ir: &SceneIr, options: &TraceOptions) -> f64 {
    // Rays that are sent towards rare light on purpose weigh little, and are wanted.
    let is_default = options.min_flux_fraction == TraceOptions::default().min_flux_fraction;
    let least = if is_default && !ir.scatter_sampling.is_empty() { 0.0 } else { options.min_flux_fraction };
    least.max(ir.sampling.rr_start_flux)
}

/// How the program is composed without additions.
pub(super) fn plain(
    gpu: &Gpu,
    ir: &SceneIr,
    options: &TraceOptions,
    weights: Vec<f64>,
    moments: MomentSource,
) -> ProgramOptions {
    let primitives = ir.surfaces.len() + ir.detectors.len();
    let events_per_dispatch = match moments {
        // Only the invocation that traces a ray knows the ray's crossings of detectors.
        MomentSource::Device if ir.detectors.iter().any(|detector| !detector.absorb) => options.max_depth,
        _ => options.events_per_dispatch.min(options.max_depth),
    };
    ProgramOptions {
        precision: options.precision,
        native: gpu.int64,
        baked: options.baked.unwrap_or(primitives <= program::MAX_BAKED_PRIMITIVES),
        // The shape of a tree depends on the numbers of the scene.
        tree: options.tree.unwrap_or(!options.live || primitives > MOST_LIVE_IN_TURN),
        uniform_bytes: if options.live && lie_in_uniforms(options.precision) { UNIFORM_BYTES } else { 0 },
        texel_bytes: 0,
        max_depth: options.max_depth,
        roulette_threshold: roulette_threshold(ir, options),
        events_per_dispatch,
        workgroup_size: options.workgroup_size,
        most_rays_per_invocation: 1,
        vector_lanes: gpu.vector_lanes(),
        paths: options.paths.sampling(options.budget()),
        weights,
        sampler: options.sampler,
        moments: moments.on_device(),
        part_bytes: options.part_bytes.unwrap_or(gpu.largest_binding()),
        live: options.live,
        copies_numbers: false,
        fixed_rays_per_invocation: None,
        has_long_loops: false,
        counts_wrong_sides: true,
    }
}

impl TracePlan {
    /// The size of dispatches, before any was timed.
    pub(crate) fn dispatch_size(&self) -> DispatchSize {
        let TracePlan { program, limits, batch, .. } = self;
        DispatchSize::new(*batch, limits.least_rays(program), counts_per_ray(program))
    }

    /// True if the trace is a part of a larger one.
    pub(crate) fn is_part(&self) -> bool {
        self.options.of_rays.is_some() || self.options.first_ray > 0
    }

    /// The number of rays done at a position.
    pub(crate) fn done(&self, position: u64) -> u64 {
        self.rays.iter().map(|rays| rays.done(position, self.num_rays)).sum()
    }

    /// The ids of the rays done at a position.
    fn rays_done(&self, position: u64) -> RaySpans {
        let mut set = RaySpans::default();
        for (source, rays) in (0..).zip(&self.rays) {
            set += RaySpan { first: rays.first, count: rays.done(position, self.num_rays), source };
        }
        set
    }

    /// The position from which a trace goes on that has come as far as `begun`.
    pub(crate) fn position_after(&self, begun: &Tally) -> Result<u64> {
        let (mut low, mut high) = (0, self.num_rays);
        while low < high {
            let middle = low + (high - low) / 2;
            if self.done(middle) < begun.launched.count { low = middle + 1 } else { high = middle }
        }
        if self.rays_done(low) == begun.rays {
            return Ok(low);
        }
        Err(Error::Usage("the rays that were traced before are not the first rays of this trace".into()))
    }

    /// The ranges of one dispatch and one source each, from position `first` to `end`. `reached` has a bit for each
    /// primitive that rays are known to have reached.
    pub(crate) fn ranges(&self, first: u64, end: u64, most: u32, reached: u32) -> Vec<RayRange> {
        let mut ranges = Vec::new();
        for (source, rays) in self.rays.iter().enumerate() {
            let last = rays.first + rays.done(end, self.num_rays);
            let mut next = rays.first + rays.done(first, self.num_rays);
            while next < last {
                let count = (last - next).min(u64::from(most)) as u32;
                ranges.push(RayRange { reached, ..RayRange::of(next, count, source) });
                next += u64::from(count);
            }
        }
        ranges
    }

    /// The count and flux of a range's new rays.
    pub(crate) fn births(&self, range: &RayRange) -> FluxSum {
        let quanta = self.birth_quanta(range.source);
        FluxSum { count: u64::from(range.count), quanta: quanta * u128::from(range.count) }
    }

    /// The weight of a source's new rays, quantised as the device does it.
    fn birth_quanta(&self, source: usize) -> u128 {
        let weight = self.options.precision.nearest(self.rays[source].weight);
        (weight * QUANTA_PER_WEIGHT).floor() as u128
    }

    /// How the device marks the primitives that rays have reached.
    pub(crate) fn reached_marks(&self) -> ReachedMarks {
        let Program { cells, features, options, .. } = &self.program;
        cells.reached_marks(features, options.baked)
    }

    /// What counts determine, beside themselves.
    pub(crate) fn counted(&self) -> Counted {
        Counted {
            quanta: self.program.constant_weights.then(|| self.birth_quanta(0)),
            square: (self.moments == MomentSource::Hits).then(|| self.square_of_birth_weight()),
        }
    }

    /// The square of the weight that rays of the first source are born with, as the device rounds it.
    pub(crate) fn square_of_birth_weight(&self) -> u128 {
        square_of_birth_weight(self.rays[0].weight, self.options.precision)
    }
}

/// The square that a ray of unchanged weight adds to the second moments, rounded up as on the device.
fn square_of_birth_weight(weight: f64, precision: Precision) -> u128 {
    let weight = precision.nearest(weight);
    (precision.nearest(weight * weight) * QUANTA_PER_WEIGHT).ceil() as u128
}
