//! The unit of flux: what a weight and a quantum are worth in watts.

use crate::model::SceneIr;
use crate::result::QUANTA_PER_WEIGHT;

/// Converts weights and quanta to watts.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FluxUnit {
    total_flux: f64,
    num_rays: f64,
}

impl FluxUnit {
    /// The unit of a trace of `num_rays` rays through a scene whose sources emit `total_flux` \[W\].
    pub fn new(total_flux: f64, num_rays: u64) -> Self {
        FluxUnit { total_flux, num_rays: num_rays.max(1) as f64 }
    }

    /// The unit of a trace of `num_rays` rays through a scene.
    pub fn of_scene(ir: &SceneIr, num_rays: u64) -> Self {
        FluxUnit::new(ir.emitted_flux(), num_rays)
    }

    /// The unit of another quantity, of which 1 W has so much.
    pub(crate) fn times(self, factor: f64) -> Self {
        FluxUnit { total_flux: self.total_flux * factor, ..self }
    }

    /// Flux of a sum \[W\]. The ratio comes first, so that all quanta launched are exactly the flux emitted.
    pub fn watts(self, quanta: u128) -> f64 {
        self.total_flux * (quanta as f64 / (QUANTA_PER_WEIGHT * self.num_rays))
    }

    /// Flux of one ray \[W\].
    pub fn watts_of_weight(self, weight: f64) -> f64 {
        self.total_flux * (weight / self.num_rays)
    }
}
