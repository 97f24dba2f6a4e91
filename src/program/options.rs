//! How a program is specialised, and which rays a dispatch of it traces.

use crate::model::{Precision, SceneIr};
use crate::program::features::Features;
use crate::program::layout::kind_tables::KindTables;
use crate::program::layout::rng::Sampler;
use crate::program::layout::row_table::RowTable;
use crate::program::layout::tables;
use glam::DVec3;

/// Up to so many primitives the scene is compiled in; above, it lies in tables, and a tree finds the nearest. Measured
/// on lavapipe (Zen 3, both ways in turns). Most rays cross the boxes of lenses in a row. There the tree is as fast
/// from some 45 primitives on in f32, and from 25 to 40 in f64. For mirrors scattered off the axis the tree is as fast
/// from 18 (f32) and 14 (f64) on. Shaders that have 32 primitives compiled in take two to three times as long to
/// compile.
pub const MAX_BAKED_PRIMITIVES: usize = 24;
/// Up to so many detectors stand apart from the tree.
const MAX_DETECTORS_APART: usize = 8;
/// Events of an invocation whose loops never make many iterations.
const FEW_EVENTS: u32 = 1 << 8;

/// Which rays have their paths recorded.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PathSampling {
    /// None.
    None,
    /// Rays whose hash is below `threshold`, of 2^32.
    Hashed {
        /// The bound of the hash.
        threshold: u32,
    },
    /// All.
    All,
}

/// How a program is specialised.
#[derive(Debug, Clone, PartialEq)]
pub struct ProgramOptions {
    /// Precision of the physics.
    pub precision: Precision,
    /// 64-bit integers and atomics of the device, instead of pairs of 32-bit ones. The results are the same bits.
    pub native: bool,
    /// The scene compiled in, instead of in tables.
    pub baked: bool,
    /// Tables are searched by a tree of boxes, instead of one primitive after the other.
    pub tree: bool,
    /// Tables of at most so many bytes lie in uniform buffers.
    pub uniform_bytes: u32,
    /// Trees of at most so many bytes lie in images.
    pub texel_bytes: u64,
    /// Largest number of events of a ray.
    pub max_depth: u32,
    /// Roulette starts below this weight.
    pub roulette_threshold: f64,
    /// Events a ray goes through in registers before the survivors are compacted.
    pub events_per_dispatch: u32,
    /// Invocations a workgroup.
    pub workgroup_size: u32,
    /// Most rays that an invocation follows, see [`ProgramOptions::rays_per_invocation`]. The results are the same bits.
    pub most_rays_per_invocation: u32,
    /// Lanes of the driver's vectors, where their number can change: with it, shaders do. The results are the same bits.
    pub vector_lanes: u32,
    /// Which paths are recorded.
    pub paths: PathSampling,
    /// The weight that each source's rays are born with.
    pub weights: Vec<f64>,
    /// What the draws are.
    pub sampler: Sampler,
    /// What is summed so that results have standard errors.
    pub moments: SecondMoments,
    /// Sums are bound in parts of at most so many bytes.
    pub part_bytes: u64,
    /// The numbers of the scene lie in a table, so that scenes of one shape have the same text.
    pub live: bool,
    /// An invocation begins by copying the table of live numbers: for additions that read all of them at every event.
    pub copies_numbers: bool,
    /// Rays that an invocation follows, where an addition fixes their number.
    pub fixed_rays_per_invocation: Option<u32>,
    /// The loops of an addition may make more iterations than some driver allows.
    pub has_long_loops: bool,
    /// Rays on the wrong side of a face are counted, where media border on each other.
    pub counts_wrong_sides: bool,
}

/// What the device sums beside the first moments, so that results have standard errors.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum SecondMoments {
    /// Nothing.
    #[default]
    None,
    /// The squares of what each ray leaves. Where a detector lets rays pass, no ray may outlive a dispatch.
    Squares,
    /// The detectors' cells of each of [`crate::model::ray_id::NUM_REPLICATES`] independent scrambles of Sobol points.
    Replicates,
}

impl ProgramOptions {
    /// True if rays can outlive a dispatch.
    pub fn has_queue(&self) -> bool {
        self.events_per_dispatch < self.max_depth
    }

    /// The primitives, more than one, that are searched by a tree. Empty without a tree. Few detectors stand apart and
    /// are compiled in: most rays end on one of them.
    pub fn tree_primitives(&self, ir: &SceneIr) -> std::ops::Range<usize> {
        let (surfaces, detectors) = (ir.surfaces.len(), ir.detectors.len());
        let num = if detectors <= MAX_DETECTORS_APART { surfaces } else { surfaces + detectors };
        if self.tree && !self.baked && num > 1 { 0..num } else { 0..0 }
    }

    /// How many primitives, the first of all, are looked up in a table where the scene is not compiled in. Only
    /// primitives that stand apart from the tree are missing.
    pub fn num_in_table(&self, ir: &SceneIr) -> usize {
        match self.tree_primitives(ir).end {
            0 => ir.surfaces.len() + ir.detectors.len(),
            num => num,
        }
    }

    /// True if so many rows of trees lie in an image. In df64 they do not: the rewriting of f64 knows none.
    pub fn are_texels(&self, num_rows: usize) -> bool {
        const ROW_BYTES: u64 = 16;
        let fits = num_rows as u64 * ROW_BYTES <= self.texel_bytes;
        num_rows > 0 && fits && self.precision != Precision::Df64
    }

    /// What shaders read of primitives, if it is to lie in an image with so many other rows. Lenses are traced a tenth faster
    /// so; spheres alone a tenth slower, whose records are short.
    pub(super) fn records_in_texels(
        &self,
        ir: &SceneIr,
        centre: DVec3,
        primitives: &[u32],
        places: &KindTables,
        num_others: usize,
    ) -> Option<RowTable> {
        let records = tables::numbered_primitive_records(ir, centre, primitives, places);
        let makes_reals = match self.precision {
            Precision::F32 => true,
            Precision::F64 => self.native,
            Precision::Df64 => false,
        };
        let num_rows = num_others + records.num_texels(self.precision) * primitives.len();
        (makes_reals && records.has_varying("shape") && self.are_texels(num_rows)).then_some(records)
    }

    /// True if the records of surfaces and detectors are compiled in.
    pub fn bakes_records(&self) -> bool {
        self.baked && (!self.live || self.copies_numbers)
    }

    /// True if media are compiled in, where shaders read them. To choose from few rows is faster than to read a table
    /// in which each lane has its own row.
    pub fn bakes_media(&self, ir: &SceneIr) -> bool {
        const MOST_CHOSEN: usize = 16;
        self.bakes_records() && ir.media.len() * ir.wavelengths.len() <= MOST_CHOSEN
    }

    /// True if the loops of an invocation may make more iterations than some driver allows
    /// (shaders/cpu/loops.many.wgsl). False if an invocation only loops over its events, and events are few.
    pub fn has_long_loops(&self, features: &Features) -> bool {
        let [.., gaussian] = features.splats;
        features.splits
            || !self.baked
            || features.has_meshes()
            || gaussian
            || features.transmissive && self.moments == SecondMoments::Squares
            || self.events_per_dispatch > FEW_EVENTS
            || self.has_long_loops
    }

    /// Rays that an invocation of trace_new follows, one after the other. The atomics of its bins then cost little. An
    /// invocation follows one ray where rays outlive a dispatch, and where the loops of many could make too many
    /// iterations. The same holds where an invocation remembers a ray's visits (shaders/sums/visits.on.wgsl).
    pub fn rays_per_invocation(&self, features: &Features) -> u32 {
        if let Some(fixed) = self.fixed_rays_per_invocation {
            return fixed;
        }
        if self.has_queue() || self.has_long_loops(features) {
            return 1;
        }
        (FEW_EVENTS / self.events_per_dispatch).clamp(1, self.most_rays_per_invocation.max(1))
    }

    /// True if the plain loop sends rows to the host: rays of a database, or events of recorded paths.
    pub fn has_events(&self, features: &Features) -> bool {
        features.stores_rays() || self.paths != PathSampling::None
    }
}

/// Texels of an image from one line to the next.
pub const TEXELS_PER_LINE: u32 = 4096;

/// Rays `first..first + count` of one source.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RayRange {
    /// First ray id.
    pub first: u64,
    /// Number of rays.
    pub count: u32,
    /// The source they come from.
    pub source: usize,
    /// From an entry of a ray in the log to its next.
    pub log_stride: u32,
    /// Primitives that earlier passes reached, a bit each, where they are marked so.
    pub reached: u32,
}

impl RayRange {
    /// The rays `first..first + count` of a source, of which nothing is known from earlier passes.
    pub fn of(first: u64, count: u32, source: usize) -> Self {
        RayRange { first, count, source, log_stride: 0, reached: 0 }
    }
}
