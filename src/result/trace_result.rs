//! What users read of a trace, with Optiland's names and meanings.

use serde::{Deserialize, Serialize};

use crate::result::figures::Figures;
use crate::result::luminous::LuminousSource;
use crate::result::{Detector, Diagnostics, Gradient, Ledger, PathTable, RayPaths, RunInfo};
use std::collections::BTreeMap;

/// The results of one trace. Fluxes and counts have the names and meanings of Optiland's `SimulationResult`.
/// `report.json` has its fields under the same names.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct TraceResult {
    /// How the trace was run.
    #[serde(skip)]
    pub run: RunInfo,
    /// Detectors in scene order.
    #[serde(skip)]
    pub detectors: Vec<Detector>,
    /// Surfaces in scene order.
    pub surfaces: Vec<SurfaceResult>,
    /// Rays launched.
    pub num_rays_total: u64,
    /// Rays that ended on absorbing surfaces.
    pub num_rays_absorbed: u64,
    /// Rays that met nothing any more.
    pub num_rays_escaped: u64,
    /// Rays ended by Russian roulette.
    pub num_rays_flux_killed: u64,
    /// Rays that reached the largest number of events.
    pub num_rays_depth_killed: u64,
    /// Flux of all sources \[W\]. A partial trace shares all that the sources emit among the rays launched, for every flux.
    pub total_flux_in: f64,
    /// Sum over all detectors of what they read, transmissive ones included \[W\]. Of a ray database with `max_rays`
    /// it counts the rows that were kept, as Optiland does.
    pub total_flux_detected: f64,
    /// The part of `total_flux_detected` that transmissive detectors read in passing \[W\].
    pub total_flux_tapped: f64,
    /// Flux that ended on absorbing surfaces \[W\].
    pub total_flux_absorbed: f64,
    /// Flux taken by absorbing media \[W\].
    pub total_flux_bulk_absorbed: f64,
    /// Flux of the rays that escaped \[W\].
    pub total_flux_escaped: f64,
    /// Flux ended by the depth limit and by roulette \[W\].
    pub total_flux_lost: f64,
    /// Optiland's figure: |in - (detected - tapped) - absorbed - bulk_absorbed - escaped - lost| / in. It has no bin
    /// for what mirrors take nor for weight gained and lost by sampling; [`Ledger`] has them all and closes.
    pub flux_conservation_error: f64,
    /// The largest of all detectors' relative errors ([`crate::result::uncertainty::worst_relative_error`]). `None` if no
    /// detector was hit, or second moments were not summed.
    pub relative_error: Option<f64>,
    /// Where every quantum went.
    pub ledger: Ledger,
    /// Signs that the result should be read with care.
    pub diagnostics: Diagnostics,
    /// Light by its path, each sequence a row, if it was summed up so.
    #[serde(skip)]
    pub paths: Option<PathTable>,
    /// What sources give in photometric units, by name, where the trace was asked for them.
    #[serde(skip)]
    pub sources: Vec<(String, LuminousSource)>,
    /// How even, how wide and how strong the light of each detector is, where that was asked for.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub figures: BTreeMap<String, Figures>,
    /// Derivatives by parameters, if any were asked for.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub gradients: Vec<Gradient>,
    /// Recorded paths, if any.
    #[serde(skip)]
    pub ray_paths: Option<RayPaths>,
}

/// What happened at one surface.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SurfaceResult {
    /// Optiland's label, such as `L1.front`; `component_3` if it has none.
    pub name: String,
    /// What the surface does to rays.
    pub kind: SurfaceKind,
    /// True if some ray hit it.
    pub reached: bool,
    /// Rays that ended there (absorbing), or events with a loss (reflective).
    pub num_rays_absorbed: u64,
    /// Flux left there \[W\].
    pub total_flux_absorbed: f64,
}

/// What a surface does to rays.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
#[allow(missing_docs, reason = "the names say it")]
pub enum SurfaceKind {
    Refractive,
    Reflective,
    Absorbing,
}

impl TraceResult {
    /// The result of the detector of this name.
    pub fn detector(&self, name: &str) -> Option<&Detector> {
        self.detectors.iter().find(|detector| detector.name == name)
    }

    /// A fraction of the launched flux; 0 where nothing was launched.
    pub fn fraction_of_launched(&self, flux: f64) -> f64 {
        if self.total_flux_in > 0.0 { flux / self.total_flux_in } else { 0.0 }
    }

    pub(crate) fn conservation_error(&self) -> f64 {
        let unaccounted = self.total_flux_in
            - (self.total_flux_detected - self.total_flux_tapped)
            - self.total_flux_absorbed
            - self.total_flux_bulk_absorbed
            - self.total_flux_escaped
            - self.total_flux_lost
            - self.ledger.filtered_out.flux;
        self.fraction_of_launched(unaccounted.abs())
    }
}
