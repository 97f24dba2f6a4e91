//! Flux per area and wavelength bin over the pixels of a rectangle.

use ndarray::{Array1, Array2, Array3, Axis};

use crate::error::Result;
use crate::model::PixelGrid;
use crate::result::irradiance::{bin_centres, centres, pixel_area, shaped};
use crate::result::npz::NpzFile;
use crate::result::tally::map_lit;
use crate::result::{DetectorTally, FluxUnit, Uncertainty};

/// Irradiance of a planar detector per wavelength bin.
#[derive(Debug, Clone, PartialEq)]
pub struct SpectralMap {
    /// Irradiance in each bin \[W/mm^2\], shape (ny, nx, n_lambda).
    pub irradiance: Array3<f64>,
    /// Pixel centres along local x \[mm\], shape (nx,).
    pub x_coords: Array1<f64>,
    /// Pixel centres along local y \[mm\], shape (ny,).
    pub y_coords: Array1<f64>,
    /// Centres of the wavelength bins \[um\], shape (n_lambda,).
    pub wavelengths: Array1<f64>,
    /// Edges of the wavelength bins \[um\], shape (n_lambda + 1,).
    pub wavelength_edges: Array1<f64>,
    /// Rays that hit each pixel, whatever the splat, per bin, shape (ny, nx, n_lambda).
    pub hits: Array3<u64>,
    /// Standard error of `irradiance` \[W/mm^2\], shape (ny, nx, n_lambda); none where second moments were not summed. 0 where no ray
    /// came: that says nothing of what a longer trace would find.
    pub standard_error: Option<Array3<f64>>,
    /// Full width along local x \[mm\].
    pub width: f64,
    /// Full height along local y \[mm\].
    pub height: f64,
    /// Flux in each wavelength bin \[W\], shape (n_lambda,).
    pub spectrum: Array1<f64>,
}

impl SpectralMap {
    pub(crate) fn new(
        grid: &PixelGrid,
        edges: &[f64],
        sums: &DetectorTally,
        unit: FluxUnit,
        uncertainty: &Uncertainty,
    ) -> Result<Self> {
        let (nx, ny, bins) = (grid.num_pixels_x as usize, grid.num_pixels_y as usize, edges.len() - 1);
        let area = pixel_area(grid);
        let shape = (ny, nx, bins);
        let flux_of_bin = |bin: usize| unit.watts(sums.quanta.iter().skip(bin).step_by(bins).sum());
        Ok(SpectralMap {
            irradiance: shaped(shape, map_lit(&sums.quanta, |_, quanta| unit.watts(quanta) / area))?,
            x_coords: bin_centres(-grid.width / 2.0, grid.width / 2.0, nx),
            y_coords: bin_centres(-grid.height / 2.0, grid.height / 2.0, ny),
            wavelengths: centres(edges),
            wavelength_edges: edges.iter().copied().collect(),
            hits: shaped(shape, map_lit(&sums.hits, |_, hits| hits))?,
            standard_error: uncertainty
                .of_cells(sums, |_| area)
                .map(|errors| shaped(shape, errors))
                .transpose()?,
            width: grid.width,
            height: grid.height,
            spectrum: (0..bins).map(flux_of_bin).collect(),
        })
    }

    /// Irradiance over all wavelengths \[W/mm^2\], shape (ny, nx).
    pub fn broadband(&self) -> Array2<f64> {
        self.irradiance.sum_axis(Axis(2))
    }

    pub(crate) fn write(&self, file: &mut NpzFile) -> Result<()> {
        file.add("irradiance", &self.irradiance)?;
        file.add("x_coords", &self.x_coords)?;
        file.add("y_coords", &self.y_coords)?;
        file.add("wavelengths", &self.wavelengths)?;
        file.add("wavelength_edges", &self.wavelength_edges)?;
        file.add("hits", &self.hits)?;
        file.add_optional("standard_error", &self.standard_error)
    }

    /// Units of the arrays in the file.
    pub(crate) const UNITS: &'static [(&'static str, &'static str)] = &[
        ("irradiance", "W/mm^2 per wavelength bin"),
        ("x_coords", "mm"),
        ("y_coords", "mm"),
        ("wavelengths", "um"),
        ("wavelength_edges", "um"),
        ("total_flux", "W"),
        ("hits", "rays"),
        ("standard_error", "W/mm^2 per wavelength bin"),
        ("total_flux_standard_error", "W"),
    ];
}
