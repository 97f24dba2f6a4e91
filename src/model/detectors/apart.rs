//! Detectors that keep light of each wavelength apart: so that a result can be weighted by wavelength, as the eye does.
//!
//! No scene file has them. They take the place of irradiance and far-field detectors while a trace runs
//! (`result::wavelengths_apart`). Summed over wavelengths, their quanta equal the quanta of the replaced detector to
//! the bit.

use crate::model::detectors::grid::{ArrivalError, GridRow, PixelGrid};
use crate::model::detectors::{Detection, DetectorFunction, DetectorKind, DetectorWgsl, Records};
use crate::model::shapes::Outline;
use crate::shaders::shader;

/// The function of a far field, which finds the cell as [`crate::model::detectors::far_field::FAR_FIELD`] does.
pub const APART_FAR_FIELD: DetectorWgsl = DetectorWgsl {
    name: "far_field_apart",
    file: shader!("detectors/far_field_apart.wgsl"),
    records: Records::Bins,
};

/// The function of a far field over the sphere.
pub const APART_SPHERE: DetectorWgsl = DetectorWgsl {
    name: "far_field_sphere_apart",
    file: shader!("detectors/far_field_sphere_apart.wgsl"),
    records: Records::Bins,
};

/// A detector whose light of each wavelength is kept apart.
#[derive(Debug, Clone, PartialEq)]
pub struct Apart {
    /// The detector of the scene: irradiance or far field.
    pub of: Box<DetectorKind>,
    /// The wavelengths of the scene, ascending \[um\].
    pub wavelengths: Vec<f64>,
}

impl Apart {
    /// The detector, if light of each wavelength can be kept apart there.
    pub fn new(of: &DetectorKind, wavelengths: &[f64]) -> Option<Self> {
        let can = matches!(of, DetectorKind::Irradiance(_) | DetectorKind::FarField(_));
        can.then(|| Apart { of: Box::new(of.clone()), wavelengths: wavelengths.to_vec() })
    }

    /// The cell of the scene's detector, and the place of the wavelength, of each of its own cells. Bins of a pixel lie side by
    /// side; far fields lie one behind the other.
    pub fn place_of(&self, cell: usize) -> (usize, usize) {
        match self.of.grid() {
            Some(_) => (cell / self.wavelengths.len(), cell % self.wavelengths.len()),
            None => (cell % self.of.num_cells(), cell / self.of.num_cells()),
        }
    }
}

impl Detection for Apart {
    fn function(&self) -> DetectorFunction {
        let DetectorKind::FarField(far_field) = &*self.of else { return DetectorFunction::Spectral };
        if far_field.sphere { DetectorFunction::ApartSphere } else { DetectorFunction::ApartFarField }
    }

    fn outline(&self) -> Outline {
        self.of.outline()
    }

    fn num_cells(&self) -> usize {
        self.of.num_cells() * self.wavelengths.len()
    }

    fn with_single_cell(&self) -> DetectorKind {
        let of = Box::new(self.of.with_single_cell());
        DetectorKind::Apart(Apart { of, wavelengths: self.wavelengths.clone() })
    }

    fn grid_row(&self) -> GridRow {
        self.of.grid_row()
    }

    fn grid(&self) -> Option<&PixelGrid> {
        self.of.grid()
    }

    fn num_bins(&self) -> u32 {
        self.wavelengths.len() as u32
    }

    fn bin(&self, wavelength: f64) -> u32 {
        self.wavelengths.partition_point(|known| *known < wavelength) as u32
    }

    fn cells_off(&self, error: &ArrivalError) -> Option<f64> {
        self.of.cells_off(error)
    }

    fn is_placed(&self) -> bool {
        self.of.is_placed()
    }
}
