//! The options of a trace.

use crate::engine::tuning::Tuning;
use crate::error::{Error, Result};
use crate::gpu::{AdapterInfo, Gpu};
use crate::model::guide::Guide;
use crate::model::{PathFilter, depth};
use crate::program::rewrite::jvp::Tangents;
use crate::program::{PathSampling, Precision, Sampler};
use crate::result::RunInfo;
use std::sync::Arc;

/// Most rows that a table of paths may be asked to have.
pub const MOST_PATH_ROWS: u32 = 1 << 22;

/// Most rows of the table of paths, by default.
pub const DEFAULT_PATH_ROWS: u32 = 1 << 18;

/// Options of a trace, with Optiland's defaults.
#[derive(Debug, Clone, PartialEq)]
pub struct TraceOptions {
    /// Rays to launch.
    pub num_rays: u64,
    /// Id of the first ray. Draws are keyed by ray ids, so that traces of disjoint ids add up.
    pub first_ray: u64,
    /// The number of rays of a larger trace, of which this trace is the part from `first_ray` on. The sources share the
    /// larger trace, and each source gives its own share of the part. If `None`, the sources share `num_rays`. For a
    /// single source, both are the same.
    pub of_rays: Option<u64>,
    /// By what the rays are shared among the sources \[W\]; `None`: by their fluxes. Two scenes of the same shares launch the
    /// same rays.
    pub shares: Option<Arc<[f64]>>,
    /// Seed of every draw.
    pub seed: u64,
    /// Largest number of events of a ray. The default is Optiland's; the command takes [`depth::of_scene`]. A
    /// [`crate::Run`] puts a depth of its own in this place.
    pub max_depth: u32,
    /// Roulette starts below the larger of this value and the scene's `rr_start_flux`, times the mean flux of a new
    /// ray.
    pub min_flux_fraction: f64,
    /// Most rays per dispatch; `None`: chosen automatically. The choice does not change a result.
    pub batch_size: Option<u32>,
    /// Precision of the physics. A [`crate::Run`] puts the precision that it chooses in this place.
    pub precision: Precision,
    /// Which paths are recorded.
    pub paths: RecordPaths,
    /// What is collected, beside what every detector records.
    pub collect: Collect,
    /// Maps, spectra, ray databases and detected flux have only the light whose path matches.
    pub path_filter: Option<Arc<PathFilter>>,
    /// Rays are guided to rare light.
    pub guide: Option<Arc<Guide>>,
    /// Whether second moments are summed as well, so that results have standard errors.
    pub standard_error: StandardError,
    /// True: the scene is compiled in. False: it lies in tables. `None`: its size decides.
    pub baked: Option<bool>,
    /// The kind of random or quasi-random draws.
    pub sampler: Sampler,
    /// True: a scene in tables is searched by a tree of boxes. False: one primitive after the other. `None`: by a tree.
    pub tree: Option<bool>,
    /// The trace may be ended before its last ray. Work that pays only in a long trace is then begun late. No result
    /// changes.
    pub may_end_early: bool,
    /// Invocations a workgroup.
    pub workgroup_size: u32,
    /// Events a ray goes through in registers before the survivors are compacted.
    pub events_per_dispatch: u32,
    /// Whether arithmetic is strict. With strict arithmetic, a scene gives the same bits compiled in and in tables.
    pub strict: Strict,
    /// The numbers of the scene lie in a table, so that a compiled shader serves all scenes of one shape ([`PipelineCache`]).
    /// With strict arithmetic no bit of a result changes.
    ///
    /// [`PipelineCache`]: crate::engine::pipeline_cache::PipelineCache
    pub live: bool,
    /// Most bytes of a part in which sums are bound; `None`: as many as the adapter binds. No result changes.
    #[doc(hidden)]
    pub part_bytes: Option<u64>,
}

/// What a trace collects, beside what every detector records.
#[derive(Debug, Clone, Default, PartialEq)]
pub enum Collect {
    /// Nothing more.
    #[default]
    Light,
    /// Light summed up by its path, in a table.
    Paths {
        /// Most rows of the table.
        rows: u32,
        /// The table has rows for rays that no detector records, too: absorbed, missed, ended by the depth limit or
        /// roulette.
        ends: bool,
    },
    /// So many maps of light by its path, and where that light lies, for paths that are known.
    PathMaps(u32),
    /// What happens to each ray of a list, with the ends of [`Collect::Paths`].
    Events {
        /// Ends without a detector, too.
        ends: bool,
    },
    /// Derivatives of the detectors' sums by these parameters. Such a trace has live numbers, all events of a ray in one
    /// dispatch, and no split rays.
    Tangents(Arc<Tangents>),
    /// Derivatives of a loss by all numbers of the scene: rays are walked back.
    Adjoints,
}

impl Collect {
    /// Light summed up by its path, of rays that detectors record, in a table of the default size.
    pub fn paths() -> Self {
        Collect::Paths { rows: DEFAULT_PATH_ROWS, ends: false }
    }
}

/// Whether arithmetic is strict: the driver then neither fuses nor reorders floating-point operations.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Strict {
    /// On for processors, where strict arithmetic costs nothing, if the driver takes strict shaders. Off elsewhere.
    #[default]
    Auto,
    /// On; where that is impossible, the trace is refused.
    On,
    /// Off.
    Off,
}

impl Strict {
    /// True if a trace on this adapter is strict. Two more rules ask for strict arithmetic where it is possible.
    /// They are `TraceOptions::is_strict`, for light by its path, and run/go.rs, for live numbers and proofs.
    pub fn holds(self, adapter: &AdapterInfo) -> bool {
        match self {
            Strict::Auto => adapter.strict && adapter.class.is_strict_by_default(),
            Strict::On => true,
            Strict::Off => false,
        }
    }
}

/// Whether second moments are summed.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum StandardError {
    /// Where second moments cost little, or where hits say nothing about the error. Never for Sobol points: independent
    /// scrambles of them would be spread less evenly.
    ///
    /// Second moments cost little where every detector ends a ray and takes it in one cell. A ray that is spread over
    /// pixels, or that comes several times, makes as many deposits again.
    ///
    /// Hits say nothing about the error where surfaces scatter by a table or a Harvey-Shack lobe, which leave rays
    /// without weight. Second moments are then summed if detectors end rays and have few cells.
    #[default]
    Auto,
    /// Always.
    On,
    /// Never.
    Off,
}

/// Which paths are recorded.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RecordPaths {
    /// None.
    None,
    /// About this many, chosen by a hash of the ray id.
    About(u64),
    /// All.
    All,
}

impl Default for TraceOptions {
    fn default() -> Self {
        TraceOptions {
            num_rays: 1_000_000,
            first_ray: 0,
            of_rays: None,
            shares: None,
            seed: 0,
            max_depth: depth::OPTILANDS,
            min_flux_fraction: 1e-6,
            batch_size: None,
            precision: Precision::F64,
            paths: RecordPaths::None,
            collect: Collect::Light,
            path_filter: None,
            guide: None,
            standard_error: StandardError::Auto,
            baked: None,
            sampler: Sampler::Pcg,
            tree: None,
            may_end_early: false,
            workgroup_size: Tuning::default().workgroup_size,
            events_per_dispatch: Tuning::default().events_per_dispatch,
            strict: Strict::Auto,
            live: false,
            part_bytes: None,
        }
    }
}

impl TraceOptions {
    /// The same options, with work cut as suits an adapter.
    pub fn tuned(self, adapter: &AdapterInfo) -> Self {
        let Tuning { workgroup_size, events_per_dispatch } = Tuning::of(adapter);
        TraceOptions { workgroup_size, events_per_dispatch, ..self }
    }

    /// The number of rays that the sources share.
    pub(crate) fn budget(&self) -> u64 {
        self.of_rays.unwrap_or(self.num_rays)
    }

    /// True if arithmetic is strict on this adapter. Light by its path asks for that where it is possible: a ray that is
    /// traced again, by another shader, must take the same path. Other light has the rule of [`Strict::holds`]. A run
    /// sets `strict` before, where numbers are live or sums have a proof (run/go.rs, `strict_where_possible`).
    pub(crate) fn is_strict(&self, adapter: &AdapterInfo) -> bool {
        match self.strict {
            Strict::Auto if matches!(self.collect, Collect::Paths { .. }) => adapter.strict,
            strict => strict.holds(adapter),
        }
    }

    /// The driver, and whether it rounds strictly: both decide about the last bits.
    pub fn driver(&self, adapter: &AdapterInfo) -> String {
        let rounding = if self.is_strict(adapter) { ", strict" } else { "" };
        format!("{}{rounding}", adapter.driver)
    }

    /// What a result records about a trace with these options on an adapter.
    pub fn run_info(&self, adapter: &AdapterInfo) -> RunInfo {
        RunInfo {
            num_rays: self.num_rays,
            seed: self.seed,
            max_depth: self.max_depth,
            min_flux_fraction: self.min_flux_fraction,
            precision: self.precision.name().into(),
            sampler: self.sampler.name().into(),
            adapter: adapter.name.clone(),
            driver: self.driver(adapter),
            filter: self.path_filter.as_ref().map(|filter| filter.text.clone()),
            first_ray: self.first_ray,
            of_rays: self.of_rays,
            ..RunInfo::default()
        }
    }
}

impl RecordPaths {
    /// Optiland's rule: a ray is recorded if its 32-bit hash is below the share n / num_rays of 2^32.
    pub(crate) fn sampling(self, num_rays: u64) -> PathSampling {
        match self {
            RecordPaths::None | RecordPaths::About(0) => PathSampling::None,
            RecordPaths::All => PathSampling::All,
            RecordPaths::About(n) if n >= num_rays => PathSampling::All,
            RecordPaths::About(n) => {
                let share = n as f64 / num_rays as f64;
                PathSampling::Hashed { threshold: (share * 4294967296.0) as u32 }
            }
        }
    }
}

/// The end of ray ids: NumPy and Optiland keep them in signed integers.
const MAX_RAY_ID: u64 = 1 << 63;

/// Refuses options that no device can fulfil, or that this device cannot.
pub(crate) fn check_options(gpu: &Gpu, options: &TraceOptions) -> Result<()> {
    let usage = |message: String| Err(Error::Usage(message));
    if options.num_rays == 0 {
        return usage("the number of rays is 0; at least one ray is needed".into());
    }
    let end = options.first_ray.checked_add(options.num_rays);
    if end.is_none_or(|end| end > MAX_RAY_ID) {
        return usage(format!(
            "{} rays from ray {} on: ray ids end at 2^63",
            options.num_rays, options.first_ray
        ));
    }
    if let Some(of_rays) = options.of_rays
        && end.is_some_and(|end| end > of_rays)
    {
        return usage(format!(
            "{} rays from ray {} on are no part of a trace of {of_rays} rays",
            options.num_rays, options.first_ray
        ));
    }
    if options.max_depth == 0 || options.max_depth > depth::LIMIT {
        return usage(format!("max_depth is {}; it must lie in 1..={}", options.max_depth, depth::LIMIT));
    }
    if !(0.0..=1.0).contains(&options.min_flux_fraction) {
        return usage(format!("min_flux_fraction is {}; it must lie in 0..=1", options.min_flux_fraction));
    }
    match options.collect {
        Collect::Paths { rows, .. } if !(1..=MOST_PATH_ROWS).contains(&rows) => {
            return usage(format!(
                "a table of paths of {rows} rows was asked for; it has 1 to {MOST_PATH_ROWS} rows"
            ));
        }
        Collect::Tangents(_) | Collect::Adjoints if options.sampler == Sampler::Sobol => {
            return usage("derivatives take random numbers; leave out --sampler sobol".into());
        }
        _ => {}
    }
    if options.batch_size == Some(0) {
        return usage("the batch size is 0; at least one ray is needed".into());
    }
    if options.precision == Precision::F64 && !gpu.f64 {
        return usage(format!(
            "the adapter `{}` has no 64-bit floats; use --precision df64 or f32",
            gpu.info.name
        ));
    }
    if options.precision == Precision::Df64 {
        gpu.check_df64()?;
    }
    Ok(())
}
