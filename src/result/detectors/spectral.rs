//! Flux per area and wavelength bin over the pixels of a rectangle.

use crate::error::Result;
use crate::model::Spectral;
use crate::result::detectors::bins::centres;
use crate::result::detectors::irradiance::PixelMap;
use crate::result::detectors::{CellMap, DetectorResult, Sums};
use crate::result::npz::ArrayWriter;
use crate::result::png::charts::{self, Drawn, Head};
use crate::result::stored::Stored;
use ndarray::{Array1, Array2, Axis, Ix3};
use serde_json::Value;
use std::path::Path;

/// Irradiance of a planar detector per wavelength bin.
#[derive(Debug, Clone, PartialEq)]
pub struct SpectralMap {
    /// Irradiance in each bin, shape (ny, nx, n_lambda).
    pub pixels: PixelMap<Ix3>,
    /// Centres of the wavelength bins \[um\], shape (n_lambda,).
    pub wavelengths: Array1<f64>,
    /// Edges of the wavelength bins \[um\], shape (n_lambda + 1,).
    pub wavelength_edges: Array1<f64>,
    /// Flux in each wavelength bin \[W\], shape (n_lambda,).
    pub spectrum: Array1<f64>,
}

impl SpectralMap {
    pub(crate) fn new(Spectral { grid, wavelength_edges }: &Spectral, sums: &Sums<'_>) -> Result<Self> {
        let Sums { cells, unit, .. } = *sums;
        let bins = wavelength_edges.len() - 1;
        let shape = Ix3(grid.num_pixels_y as usize, grid.num_pixels_x as usize, bins);
        let flux_of_bin = |bin: usize| unit.watts(cells.quanta.iter().skip(bin).step_by(bins).sum());
        Ok(SpectralMap {
            pixels: PixelMap::of_cells(grid, shape, sums)?,
            wavelengths: centres(wavelength_edges),
            wavelength_edges: wavelength_edges.iter().copied().collect(),
            spectrum: (0..bins).map(flux_of_bin).collect(),
        })
    }

    pub(crate) fn read(mut stored: Stored) -> Result<Self> {
        let pixels: PixelMap<Ix3> = PixelMap::of_file(&mut stored)?;
        let (ny, nx, bins) = pixels.irradiance.dim();
        let area = (pixels.width / nx as f64) * (pixels.height / ny as f64);
        let map = SpectralMap {
            wavelengths: stored.array("wavelengths")?,
            wavelength_edges: stored.array("wavelength_edges")?,
            spectrum: pixels.irradiance.sum_axis(Axis(0)).sum_axis(Axis(0)) * area,
            pixels,
        };
        stored.check(map.wavelengths.len() == bins && map.wavelength_edges.len() == bins + 1)?;
        Ok(map)
    }

    /// Irradiance over all wavelengths \[W/mm^2\], shape (ny, nx).
    pub fn broadband(&self) -> Array2<f64> {
        self.pixels.irradiance.sum_axis(Axis(2))
    }
}

impl DetectorResult for SpectralMap {
    fn map(&self) -> Option<CellMap<'_>> {
        Some(self.pixels.cells())
    }

    fn write(&self, file: &mut ArrayWriter) -> Result<()> {
        let bins = [("wavelengths", &self.wavelengths), ("wavelength_edges", &self.wavelength_edges)];
        self.pixels.add_to(file, &bins)
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
        let size = (self.pixels.width, self.pixels.height);
        charts::map_and_spectrum(path, head, size, &self.broadband(), spectrum)
    }

    fn entry(&self) -> Vec<(&'static str, Value)> {
        self.pixels.size()
    }

    fn tells_wavelengths(&self) -> bool {
        true
    }
}
