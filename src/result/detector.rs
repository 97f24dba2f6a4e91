//! What one detector recorded.

use crate::error::Result;
use crate::model::{self, SceneIr};
use crate::result::detectors::Sums;
use crate::result::luminous::Luminous;
use crate::result::uncertainty::relative_error_of_map;
use crate::result::{DetectorData, DetectorTally, FewRays, FluxSum, FluxUnit, Tally, Uncertainty};

/// What one detector recorded.
#[derive(Debug, Clone, PartialEq)]
pub struct Detector {
    /// The user's name for it.
    pub name: String,
    /// True if it ended the rays that it recorded.
    pub absorb: bool,
    /// Flux recorded \[W\]; of a ray database, of the rows kept.
    pub total_flux: f64,
    /// Standard error of `total_flux` \[W\]; `None` if second moments were not summed, or a ray database dropped rows.
    pub total_flux_standard_error: Option<f64>,
    /// An upper bound of `total_flux` if it rests on few rays; `None` if it rests on enough, or a ray database dropped rows.
    pub few_rays: Option<FewRays>,
    /// What pictures are titled, where that is not the name: the path of light that it shows.
    pub title: Option<String>,
    /// Rays recorded, those included that a ray database did not keep.
    pub num_rays_hit: u64,
    /// The recording.
    pub data: DetectorData,
    /// The same in photometric units, where the trace was asked for them.
    pub luminous: Option<Luminous>,
}

impl Detector {
    pub(crate) fn new(sums: &Sums<'_>) -> Result<Self> {
        let detector = sums.detector;
        let FluxSum { count: num_rays_hit, quanta } = sums.cells.total();
        let data = DetectorData::new(sums)?;
        let kept_flux = data.result().kept_flux();
        let of_total = || sums.uncertainty.of_total(sums.cells);
        Ok(Detector {
            name: detector.name.clone(),
            absorb: detector.absorb,
            total_flux: kept_flux.unwrap_or_else(|| sums.unit.watts(quanta)),
            few_rays: sums.uncertainty.few_rays(sums.cells, detector.absorb).filter(|_| kept_flux.is_none()),
            title: None,
            total_flux_standard_error: if kept_flux.is_some() { None } else { of_total() },
            num_rays_hit,
            data,
            luminous: None,
        })
    }

    /// The result of sums that are a part of what a detector saw, such as the light of one path.
    pub(crate) fn of_part(
        ir: &SceneIr,
        tally: &Tally,
        unit: FluxUnit,
        detector: &model::Detector,
        cells: &DetectorTally,
    ) -> Result<Self> {
        let uncertainty = Uncertainty::new(ir, tally, unit);
        let (uncertainty, wavelengths) = (&uncertainty, &ir.wavelengths);
        Detector::new(&Sums { detector, cells, rows: None, unit, uncertainty, wavelengths })
    }

    /// Standard error of `total_flux` relative to it. `None` if flux or error is missing.
    pub fn total_flux_relative_error(&self) -> Option<f64> {
        self.total_flux_standard_error.filter(|_| self.total_flux > 0.0).map(|error| error / self.total_flux)
    }

    /// Error of the map: the sum of the cells' standard errors over the sum of their values, in flux. It is the mean of the
    /// cells' relative errors, each weighted by the cell's flux. None of a dark map, or without errors.
    pub fn mean_relative_error(&self) -> Option<f64> {
        let map = self.data.result().map()?;
        let errors = map.errors.as_ref()?;
        if map.are_alike {
            return relative_error_of_map(&map.values, errors, std::iter::repeat(1.0));
        }
        let cells_per_row = map.values.len() / map.sizes.len().max(1);
        let sizes = map.sizes.iter().flat_map(|size| std::iter::repeat_n(*size, cells_per_row));
        relative_error_of_map(&map.values, errors, sizes)
    }
}
