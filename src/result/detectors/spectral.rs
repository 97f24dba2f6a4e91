//! Flux per area and wavelength bin over the pixels of a rectangle.

use crate::error::Result;
use crate::model::Spectral;
use crate::result::detectors::bins::{bin_centres, centres, pixel_area, shaped};
use crate::result::detectors::{CellMap, DetectorResult, Sums};
use crate::result::npz::ArrayWriter;
use crate::result::png::figures::{self, Drawn, Head};
use crate::result::stored::Stored;
use crate::result::tally::map_lit;
use ndarray::{Array1, Array2, Array3, Axis};
use serde_json::{Value, json};
use std::path::Path;

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
    pub(crate) fn new(Spectral { grid, wavelength_edges }: &Spectral, sums: &Sums<'_>) -> Result<Self> {
        let Sums { cells, unit, uncertainty, .. } = *sums;
        let bins = wavelength_edges.len() - 1;
        let (nx, ny) = (grid.num_pixels_x as usize, grid.num_pixels_y as usize);
        let area = pixel_area(grid);
        let shape = (ny, nx, bins);
        let flux_of_bin = |bin: usize| unit.watts(cells.quanta.iter().skip(bin).step_by(bins).sum());
        Ok(SpectralMap {
            irradiance: shaped(shape, map_lit(&cells.quanta, |_, quanta| unit.watts(quanta) / area))?,
            x_coords: bin_centres(-grid.width / 2.0, grid.width / 2.0, nx),
            y_coords: bin_centres(-grid.height / 2.0, grid.height / 2.0, ny),
            wavelengths: centres(wavelength_edges),
            wavelength_edges: wavelength_edges.iter().copied().collect(),
            hits: shaped(shape, map_lit(&cells.hits, |_, hits| hits))?,
            standard_error: uncertainty
                .of_cells(cells, |_| area)
                .map(|errors| shaped(shape, errors))
                .transpose()?,
            width: grid.width,
            height: grid.height,
            spectrum: (0..bins).map(flux_of_bin).collect(),
        })
    }

    pub(crate) fn read(mut stored: Stored) -> Result<Self> {
        let (width, height) = stored.size()?;
        let irradiance: Array3<f64> = stored.array("irradiance")?;
        let (ny, nx, bins) = irradiance.dim();
        let area = (width / nx as f64) * (height / ny as f64);
        let map = SpectralMap {
            x_coords: stored.array("x_coords")?,
            y_coords: stored.array("y_coords")?,
            wavelengths: stored.array("wavelengths")?,
            wavelength_edges: stored.array("wavelength_edges")?,
            hits: stored.array("hits")?,
            standard_error: stored.optional("standard_error")?,
            width,
            height,
            spectrum: irradiance.sum_axis(Axis(0)).sum_axis(Axis(0)) * area,
            irradiance,
        };
        stored.check(
            (map.y_coords.len(), map.x_coords.len(), map.wavelengths.len()) == (ny, nx, bins)
                && map.hits.dim() == (ny, nx, bins)
                && map.standard_error.as_ref().is_none_or(|errors| errors.dim() == (ny, nx, bins))
                && map.wavelength_edges.len() == bins + 1
                && !map.hits.is_empty(),
        )?;
        Ok(map)
    }

    /// Irradiance over all wavelengths \[W/mm^2\], shape (ny, nx).
    pub fn broadband(&self) -> Array2<f64> {
        self.irradiance.sum_axis(Axis(2))
    }
}

impl DetectorResult for SpectralMap {
    fn map(&self) -> Option<CellMap<'_>> {
        let size = (self.width, self.height);
        Some(CellMap::of_pixels(size, &self.irradiance, self.standard_error.as_ref(), &self.hits))
    }

    fn write(&self, file: &mut ArrayWriter) -> Result<()> {
        file.add("irradiance", &self.irradiance)?;
        file.add("x_coords", &self.x_coords)?;
        file.add("y_coords", &self.y_coords)?;
        file.add("wavelengths", &self.wavelengths)?;
        file.add("wavelength_edges", &self.wavelength_edges)?;
        file.add("hits", &self.hits)?;
        file.add_optional("standard_error", &self.standard_error)
    }

    fn units(&self) -> &'static [(&'static str, &'static str)] {
        &[
            ("irradiance", "W/mm^2 per wavelength bin"),
            ("x_coords", "mm"),
            ("y_coords", "mm"),
            ("wavelengths", "um"),
            ("wavelength_edges", "um"),
            ("total_flux", "W"),
            ("hits", "rays"),
            ("standard_error", "W/mm^2 per wavelength bin"),
            ("total_flux_standard_error", "W"),
        ]
    }

    fn picture(&self, path: &Path, head: &Head) -> Drawn {
        let spectrum = (&self.wavelength_edges.to_vec()[..], &self.spectrum.to_vec()[..]);
        figures::map_and_spectrum(path, head, (self.width, self.height), &self.broadband(), spectrum)
    }

    fn entry(&self) -> Vec<(&'static str, Value)> {
        vec![("width", json!(self.width)), ("height", json!(self.height))]
    }

    fn tells_wavelengths(&self) -> bool {
        true
    }
}
