//! Flux per area over the pixels of a rectangle.

use ndarray::{Array, Array1, Array2, Dimension, StrideShape};

use crate::error::{Error, Result};
use crate::model::PixelGrid;
use crate::result::npz::NpzFile;
use crate::result::tally::map_lit;
use crate::result::{DetectorTally, FluxUnit, Uncertainty};

/// Irradiance of a planar detector.
#[derive(Debug, Clone, PartialEq)]
pub struct IrradianceMap {
    /// Irradiance \[W/mm^2\], shape (ny, nx).
    pub irradiance: Array2<f64>,
    /// Pixel centres along local x \[mm\], shape (nx,).
    pub x_coords: Array1<f64>,
    /// Pixel centres along local y \[mm\], shape (ny,).
    pub y_coords: Array1<f64>,
    /// Rays that hit each pixel, whatever the splat, shape (ny, nx).
    pub hits: Array2<u64>,
    /// Standard error of `irradiance` \[W/mm^2\], shape (ny, nx); none where second moments were not summed. 0 where no ray
    /// came: that says nothing of what a longer trace would find.
    pub standard_error: Option<Array2<f64>>,
    /// Full width along local x \[mm\].
    pub width: f64,
    /// Full height along local y \[mm\].
    pub height: f64,
}

impl IrradianceMap {
    pub(crate) fn new(
        grid: &PixelGrid,
        sums: &DetectorTally,
        unit: FluxUnit,
        uncertainty: &Uncertainty,
    ) -> Result<Self> {
        let (nx, ny) = (grid.num_pixels_x as usize, grid.num_pixels_y as usize);
        let area = pixel_area(grid);
        Ok(IrradianceMap {
            irradiance: shaped((ny, nx), map_lit(&sums.quanta, |_, quanta| unit.watts(quanta) / area))?,
            x_coords: bin_centres(-grid.width / 2.0, grid.width / 2.0, nx),
            y_coords: bin_centres(-grid.height / 2.0, grid.height / 2.0, ny),
            hits: shaped((ny, nx), map_lit(&sums.hits, |_, hits| hits))?,
            standard_error: uncertainty
                .of_cells(sums, |_| area)
                .map(|errors| shaped((ny, nx), errors))
                .transpose()?,
            width: grid.width,
            height: grid.height,
        })
    }

    pub(crate) fn write(&self, file: &mut NpzFile) -> Result<()> {
        file.add("irradiance", &self.irradiance)?;
        file.add("x_coords", &self.x_coords)?;
        file.add("y_coords", &self.y_coords)?;
        file.add("hits", &self.hits)?;
        file.add_optional("standard_error", &self.standard_error)
    }

    /// Units of the arrays in the file.
    pub(crate) const UNITS: &'static [(&'static str, &'static str)] = &[
        ("irradiance", "W/mm^2"),
        ("x_coords", "mm"),
        ("y_coords", "mm"),
        ("total_flux", "W"),
        ("hits", "rays"),
        ("standard_error", "W/mm^2"),
        ("total_flux_standard_error", "W"),
    ];
}

/// Values as an array.
pub(crate) fn shaped<D: Dimension, T>(
    shape: impl Into<StrideShape<D>>,
    values: Vec<T>,
) -> Result<Array<T, D>> {
    Array::from_shape_vec(shape, values)
        .map_err(|error| Error::Internal(format!("cells of a detector: {error}")))
}

/// Area of one pixel \[mm^2\], rounded as Optiland rounds it.
pub(crate) fn pixel_area(grid: &PixelGrid) -> f64 {
    (grid.width / f64::from(grid.num_pixels_x)) * (grid.height / f64::from(grid.num_pixels_y))
}

/// The edges of `bins` equal bins, rounded as NumPy's `linspace` rounds them.
pub(crate) fn bin_edges(start: f64, stop: f64, bins: usize) -> Vec<f64> {
    let step = (stop - start) / bins as f64;
    (0..bins).map(|index| index as f64 * step + start).chain([stop]).collect()
}

/// The centres of `bins` equal bins.
pub(crate) fn bin_centres(start: f64, stop: f64, bins: usize) -> Array1<f64> {
    centres(&bin_edges(start, stop, bins))
}

/// The centres between edges.
pub(crate) fn centres(edges: &[f64]) -> Array1<f64> {
    edges.windows(2).map(|edge| 0.5 * (edge[0] + edge[1])).collect()
}
