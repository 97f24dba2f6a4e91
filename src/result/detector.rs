//! What one detector recorded, by kind.

use crate::error::{Error, Result};
use crate::model::{self, DetectorKind};
use crate::result::uncertainty::relative_error_of_map;
use crate::result::{
    DetectorTally, FarFieldPattern, FluxSum, FluxUnit, IrradianceMap, RayDatabase, Rows, SpectralMap,
    Uncertainty,
};
use std::sync::Arc;

/// What one detector recorded.
#[derive(Debug, Clone, PartialEq)]
pub struct Detector {
    /// The user's name for it.
    pub name: String,
    /// True if it ended the rays that it recorded.
    pub absorb: bool,
    /// Flux recorded \[W\]; of a ray database, of the rows kept.
    pub total_flux: f64,
    /// Standard error of `total_flux` \[W\]; none where second moments were not summed, or where a ray database dropped
    /// rows.
    pub total_flux_standard_error: Option<f64>,
    /// Rays recorded, those included that a ray database did not keep.
    pub num_rays_hit: u64,
    /// The recording.
    pub data: DetectorData,
}

/// A recording, by kind of detector.
#[derive(Debug, Clone, PartialEq)]
pub enum DetectorData {
    /// Flux per area.
    Irradiance(IrradianceMap),
    /// Flux per area and wavelength bin.
    Spectral(SpectralMap),
    /// Flux per solid angle.
    FarField(FarFieldPattern),
    /// Rays.
    RayDatabase(RayDatabase),
}

impl Detector {
    pub(crate) fn new(
        detector: &model::Detector,
        sums: &DetectorTally,
        rows: Option<&Arc<Rows>>,
        unit: FluxUnit,
        uncertainty: &Uncertainty,
        wavelengths: &[f64],
    ) -> Result<Self> {
        let mut total_flux_standard_error = uncertainty.of_total(sums);
        let FluxSum { count: num_rays_hit, quanta } = sums.total();
        let mut total_flux = unit.watts(quanta);
        let data = match &detector.kind {
            DetectorKind::Irradiance(grid) => {
                DetectorData::Irradiance(IrradianceMap::new(grid, sums, unit, uncertainty)?)
            }
            DetectorKind::Spectral(model::Spectral { grid, wavelength_edges }) => {
                DetectorData::Spectral(SpectralMap::new(grid, wavelength_edges, sums, unit, uncertainty)?)
            }
            DetectorKind::FarField(model::FarField { num_theta, num_phi }) => {
                DetectorData::FarField(FarFieldPattern::new(*num_theta, *num_phi, sums, unit, uncertainty)?)
            }
            DetectorKind::RayDatabase(_) => {
                let rows = rows.ok_or_else(|| Error::Internal(format!("no rows for `{}`", detector.name)))?;
                let database = RayDatabase::new(detector.frame, rows.clone(), total_flux, unit, wavelengths)?;
                if database.truncated {
                    total_flux = database.kept_flux;
                    total_flux_standard_error = None;
                }
                DetectorData::RayDatabase(database)
            }
        };
        Ok(Detector {
            name: detector.name.clone(),
            absorb: detector.absorb,
            total_flux,
            total_flux_standard_error,
            num_rays_hit,
            data,
        })
    }

    /// Standard error of `total_flux` relative to it; none where there is no flux or no error.
    pub fn total_flux_relative_error(&self) -> Option<f64> {
        self.total_flux_standard_error.filter(|_| self.total_flux > 0.0).map(|error| error / self.total_flux)
    }

    /// Error of the map: the sum of the cells' standard errors over the sum of their values, in flux. It is the mean of the
    /// cells' relative errors, each weighted by the cell's flux. None of a dark map, or without errors.
    pub fn mean_relative_error(&self) -> Option<f64> {
        let alike = || std::iter::repeat(1.0);
        match &self.data {
            DetectorData::Irradiance(map) => {
                relative_error_of_map(&map.irradiance, map.standard_error.as_ref()?, alike())
            }
            DetectorData::Spectral(map) => {
                relative_error_of_map(&map.irradiance, map.standard_error.as_ref()?, alike())
            }
            DetectorData::FarField(pattern) => {
                let columns = pattern.phi.len();
                let sizes = pattern.solid_angles().into_iter();
                let sizes = sizes.flat_map(|size| std::iter::repeat_n(size, columns));
                relative_error_of_map(&pattern.intensity, pattern.standard_error.as_ref()?, sizes)
            }
            DetectorData::RayDatabase(_) => None,
        }
    }
}

impl DetectorData {
    /// Optiland's name of the kind.
    pub fn kind(&self) -> &'static str {
        match self {
            DetectorData::Irradiance(_) => "irradiance",
            DetectorData::Spectral(_) => "spectral",
            DetectorData::FarField(_) => "far_field",
            DetectorData::RayDatabase(_) => "ray_database",
        }
    }

    /// Pixels, or directions; none for a ray database. Wavelength bins do not count, as in Optiland's diagnostics.
    pub fn num_pixels(&self) -> Option<u64> {
        match self {
            DetectorData::Irradiance(map) => Some(map.irradiance.len() as u64),
            DetectorData::Spectral(map) => Some((map.x_coords.len() * map.y_coords.len()) as u64),
            DetectorData::FarField(pattern) => Some(pattern.intensity.len() as u64),
            DetectorData::RayDatabase(_) => None,
        }
    }
}
