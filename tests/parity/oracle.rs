//! The committed results of the reference: what `python/tools/make_oracle.py` writes.

use std::collections::BTreeMap;

use serde::Deserialize;

use crate::zoo;

/// One scene's results.
#[derive(Debug, Clone, Deserialize)]
pub struct Oracle {
    pub num_rays: u64,
    pub seed: u64,
    /// True if rounding decides paths, so that the reference disagrees with itself.
    pub chaotic: bool,
    #[serde(flatten)]
    pub totals: Totals,
    pub flux_conservation_error: f64,
    pub interactions_per_ray: f64,
    pub surface_hits: BTreeMap<String, u64>,
    pub absorbers: BTreeMap<String, Absorber>,
    pub diagnostics: OracleDiagnostics,
    pub detectors: BTreeMap<String, Digest>,
    pub statistics: Option<Statistics>,
}

/// Counts and fluxes of a whole trace.
#[derive(Debug, Clone, Deserialize)]
pub struct Totals {
    pub num_rays_total: u64,
    pub num_rays_absorbed: u64,
    pub num_rays_escaped: u64,
    pub num_rays_flux_killed: u64,
    pub num_rays_depth_killed: u64,
    pub total_flux_in: f64,
    pub total_flux_detected: f64,
    pub total_flux_tapped: f64,
    pub total_flux_absorbed: f64,
    pub total_flux_bulk_absorbed: f64,
    pub total_flux_escaped: f64,
    pub total_flux_lost: f64,
}

/// What one absorbing surface took.
#[derive(Debug, Clone, Deserialize)]
pub struct Absorber {
    pub num_rays: u64,
    pub flux: f64,
}

/// Optiland's diagnostics.
#[derive(Debug, Clone, Deserialize)]
pub struct OracleDiagnostics {
    pub depth_truncated_flux_fraction: f64,
    pub rr_killed_flux_fraction: f64,
    pub unreached_geometry: Vec<String>,
    pub medium_stack_underflows: u64,
    pub split_budget_saturated: bool,
    pub detectors: Vec<OracleDetectorDiagnostic>,
}

/// How well the reference says that a detector was sampled.
#[derive(Debug, Clone, Deserialize)]
pub struct OracleDetectorDiagnostic {
    pub name: String,
    pub num_rays_hit: u64,
    pub num_pixels: Option<u64>,
    pub mean_hits_per_pixel: Option<f64>,
    pub undersampled: bool,
    pub rays_needed_for_5pct: Option<u64>,
}

/// One detector: totals, and a digest of its map or its rows.
#[derive(Debug, Clone, Deserialize)]
pub struct Digest {
    pub kind: String,
    pub total_flux: f64,
    pub num_rays_hit: u64,
    pub transmissive: bool,
    #[serde(flatten)]
    pub body: Body,
}

/// What is told of a map or of rows.
#[derive(Debug, Clone, Deserialize)]
#[serde(untagged)]
pub enum Body {
    Map(MapDigest),
    Rows(RowsDigest),
}

/// A small map whole; of a large one the sums over all axes but one, and some bins.
#[derive(Debug, Clone, Deserialize)]
pub struct MapDigest {
    pub shape: Vec<usize>,
    pub peak: f64,
    pub axis_ends: BTreeMap<String, [f64; 2]>,
    pub values: Option<Vec<f64>>,
    pub axis_sums: Option<Vec<Vec<f64>>>,
    pub bins: Option<Vec<usize>>,
    pub bin_values: Option<Vec<f64>>,
}

/// A ray database: sums of its columns, and the ends of its sorted rows.
#[derive(Debug, Clone, Deserialize)]
pub struct RowsDigest {
    pub columns: Vec<String>,
    pub rows: usize,
    pub column_sums: Vec<f64>,
    pub column_square_sums: Vec<f64>,
    pub first_rows: Vec<[f64; 8]>,
    pub last_rows: Vec<[f64; 8]>,
}

/// Means over independent runs.
#[derive(Debug, Clone, Deserialize)]
pub struct Statistics {
    pub runs: usize,
    pub num_rays_per_run: u64,
    #[serde(flatten)]
    pub totals: BTreeMap<String, Means>,
    pub detectors: BTreeMap<String, DetectorStatistics>,
}

/// Means of one detector's figures.
#[derive(Debug, Clone, Deserialize)]
pub struct DetectorStatistics {
    pub total_flux: Means,
    pub num_rays_hit: Means,
    pub map: Option<Means>,
}

/// Means and their standard errors.
#[derive(Debug, Clone, Deserialize)]
pub struct Means {
    pub mean: Vec<f64>,
    pub standard_error: Vec<f64>,
}

/// The committed results of a scene.
pub fn load(name: &str) -> Oracle {
    let path = zoo::repository(&format!("tests/oracle/{name}.json"));
    let text = std::fs::read_to_string(&path)
        .unwrap_or_else(|problem| panic!("scene `{name}` has no committed oracle: {problem}"));
    serde_json::from_str(&text).unwrap_or_else(|problem| panic!("{}: {problem}", path.display()))
}
