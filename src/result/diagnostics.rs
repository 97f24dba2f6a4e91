//! Signs that a result should be read with care: Optiland's figures, and figures of the exact ledger.

use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

use crate::result::StageTime;

/// How well one detector was sampled.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct DetectorDiagnostic {
    /// The detector.
    pub name: String,
    /// Rays recorded; 0 for a ray database, as in Optiland, whose database keeps no count. The table of detectors has
    /// the true number.
    pub num_rays_hit: u64,
    /// Pixels or directions; none for a ray database.
    pub num_pixels: Option<u64>,
    /// `num_rays_hit / num_pixels`; none for a ray database.
    pub mean_hits_per_pixel: Option<f64>,
    /// True below 10 mean hits per pixel: Optiland's figure. The warnings go by the error of the map.
    pub undersampled: bool,
    /// Rays that would bring 400 hits to each pixel on average: Optiland's figure; none for a ray database or without any
    /// hit.
    pub rays_needed_for_5pct: Option<u64>,
}

/// Rays that took the inside of a solid for its outside, and what that means.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct WrongSides {
    /// By surface, how often a ray passed it from another medium than the surface has on that side.
    pub entered_twice: BTreeMap<String, u64>,
    /// By detector, or by the surface that they left last: rays that ended in a medium in which they were not born.
    pub ended_inside: BTreeMap<String, u64>,
    /// The sentences on them, which stand among all warnings as well.
    pub warnings: Vec<String>,
    /// True if some face is known to be turned.
    #[serde(skip)]
    pub(crate) has_turned: bool,
}

/// Optiland's `Diagnostics`, field by field, and the warnings that follow.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Diagnostics {
    /// Fraction of the launched flux that ended at the depth limit.
    pub depth_truncated_flux_fraction: f64,
    /// Fraction of the launched flux that Russian roulette ended.
    pub rr_killed_flux_fraction: f64,
    /// Copy of [`TraceResult::flux_conservation_error`].
    pub flux_conservation_error: f64,
    /// Surfaces that no ray hit.
    pub unreached_geometry: Vec<String>,
    /// Detectors in scene order.
    pub detectors: Vec<DetectorDiagnostic>,
    /// Rays that left a solid which they had never entered.
    pub medium_stack_underflows: u64,
    /// Rays that took the inside of a solid for its outside; left out where there are none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub wrong_sides: Option<WrongSides>,
    /// True if some launched ray had no more rays in its budget where it was to be split: there branches were drawn.
    pub split_budget_saturated: bool,
    /// What the stages took on the device; left out unless they were timed.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub stage_times: Vec<StageTime>,
    /// One sentence per finding, the gravest first.
    pub warnings: Vec<String>,
    /// The part of `warnings` that says that numbers of the result are not what was asked for. The Python package gives
    /// each as a warning of its own.
    #[serde(default)]
    pub grave: Vec<String>,
}
