//! What a trace gives back: exact integer sums ([`Tally`]), and what users read ([`TraceResult`]).
//!
//! A ray's weight is dimensionless; one unit of weight is [`QUANTA_PER_WEIGHT`] quanta and stands for the mean flux of
//! a new ray, `total_flux_in / num_rays`. Watts appear only here, once per sum: [`FluxUnit`].
//!
//! ```text
//! Tally -> TraceResult  (one file per detector kind; ledger, diagnostics, ray paths; rows in memory or on disk)
//!       -> report.json, <detector>.npz, <detector>.png, ray_paths.npz, the text of report()
//! ```

pub mod coating_rank;
pub mod color;
pub mod comparison;
mod detector;
pub mod detectors;
mod diagnose;
pub mod diagnostics;
pub mod difference;
pub mod few_rays;
pub mod figures;
pub(crate) mod file_names;
mod flux_unit;
pub mod gradients;
pub mod integrity;
pub mod lamp;
pub mod ledger;
pub mod light_paths;
pub mod luminous;
pub mod npz;
pub mod npz_files;
pub mod output;
mod path_tally;
pub mod photometry;
pub mod picture;
pub mod png;
pub mod ray_paths;
pub mod ray_rows;
mod ray_spans;
mod read_out;
mod reader;
pub mod recoat;
pub mod report;
mod run_info;
mod stopped_by;
mod stored;
pub mod tally;
mod tally_check;
mod terminal;
pub mod total_reflection;
mod trace_result;
pub mod uncertainty;
pub mod wavelengths_apart;
mod wrong_side_warnings;

pub use crate::result::coating_rank::CoatingRank;
pub use crate::result::detector::Detector;
pub use crate::result::detectors::{
    DetectorData, FarFieldPattern, IrradianceMap, RayColumns, RayDatabase, SpectralMap,
};
pub use crate::result::diagnostics::{DetectorDiagnostic, Diagnostics, WrongSides};
pub use crate::result::difference::{DetectorDifference, FluxDifference, MapDifference, SceneDifference};
pub use crate::result::few_rays::FewRays;
pub use crate::result::flux_unit::FluxUnit;
pub use crate::result::gradients::{Gradient, WithEdges};
pub use crate::result::ledger::{Ledger, LedgerEntry};
pub use crate::result::light_paths::{Grouping, LightPath, PathTable, Sorting};
pub use crate::result::path_tally::{PathSum, PathTally};
pub use crate::result::ray_paths::{PathColumns, RayPaths};
pub use crate::result::ray_rows::{Recorded, Recording, RowWriter, Rows};
pub use crate::result::ray_spans::{RaySpan, RaySpans};
pub use crate::result::recoat::{NewCoating, Recoated, Recoating};
pub use crate::result::report::Report;
pub use crate::result::run_info::{GuideInfo, RunInfo, StageTime};
pub use crate::result::stopped_by::StoppedBy;
pub(crate) use crate::result::tally::check_shape;
pub use crate::result::tally::{
    DetectorTally, FluxSum, Moments, PathEvent, PathEventKind, RayRow, SurfaceTally, Tally,
};
pub use crate::result::trace_result::{SurfaceKind, SurfaceResult, TraceResult};
pub(crate) use crate::result::uncertainty::Uncertainty;

/// Quanta in one unit of weight: 2^52, so that an f64 weight of order one is counted to its last bits.
pub const QUANTA_PER_WEIGHT: f64 = (1u64 << 52) as f64;
