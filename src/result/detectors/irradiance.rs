//! Flux per area over the pixels of a rectangle.

use crate::error::Result;
use crate::model::PixelGrid;
use crate::result::detectors::bins::{bin_centres, pixel_area, shaped};
use crate::result::detectors::{CellMap, DetectorResult, Sums};
use crate::result::npz::ArrayWriter;
use crate::result::png::charts::{self, Drawn, Head};
use crate::result::stored::Stored;
use crate::result::tally::map_lit;
use ndarray::{Array, Array1, Dimension, Ix2};
use serde_json::{Value, json};
use std::path::Path;

/// Irradiance over pixels; `D` counts its indices: rows and columns, and wavelength bins if there are any.
#[derive(Debug, Clone, PartialEq)]
pub struct PixelMap<D: Dimension> {
    /// Irradiance \[W/mm^2\], shape (ny, nx) or (ny, nx, n_lambda).
    pub irradiance: Array<f64, D>,
    /// Pixel centres along local x \[mm\], shape (nx,).
    pub x_coords: Array1<f64>,
    /// Pixel centres along local y \[mm\], shape (ny,).
    pub y_coords: Array1<f64>,
    /// Rays that hit each pixel, whatever the splat, in the shape of `irradiance`.
    pub hits: Array<u64, D>,
    /// Standard error of `irradiance` \[W/mm^2\], in its shape; `None` if second moments were not summed. It is 0
    /// where no ray came, which says nothing of a longer trace.
    pub standard_error: Option<Array<f64, D>>,
    /// Full width along local x \[mm\].
    pub width: f64,
    /// Full height along local y \[mm\].
    pub height: f64,
}

/// Irradiance of a planar detector.
pub type IrradianceMap = PixelMap<Ix2>;

impl<D: Dimension> PixelMap<D> {
    /// The map of a detector's sums, in this shape.
    pub(super) fn of_cells(grid: &PixelGrid, shape: D, sums: &Sums<'_>) -> Result<Self> {
        let Sums { cells, unit, uncertainty, .. } = *sums;
        let (nx, ny) = (grid.num_pixels_x as usize, grid.num_pixels_y as usize);
        let area = pixel_area(grid);
        let errors = uncertainty.of_cells(cells, |_| area);
        Ok(PixelMap {
            irradiance: shaped(shape.clone(), map_lit(&cells.quanta, |_, quanta| unit.watts(quanta) / area))?,
            x_coords: bin_centres(-grid.width / 2.0, grid.width / 2.0, nx),
            y_coords: bin_centres(-grid.height / 2.0, grid.height / 2.0, ny),
            hits: shaped(shape.clone(), map_lit(&cells.hits, |_, hits| hits))?,
            standard_error: errors.map(|errors| shaped(shape, errors)).transpose()?,
            width: grid.width,
            height: grid.height,
        })
    }

    pub(super) fn of_file(stored: &mut Stored) -> Result<Self> {
        let (width, height) = stored.size()?;
        let map = PixelMap {
            irradiance: stored.array("irradiance")?,
            x_coords: stored.array("x_coords")?,
            y_coords: stored.array("y_coords")?,
            hits: stored.array("hits")?,
            standard_error: stored.optional("standard_error")?,
            width,
            height,
        };
        let shape = map.irradiance.shape();
        stored.check(
            shape[..2] == [map.y_coords.len(), map.x_coords.len()]
                && map.hits.shape() == shape
                && map.standard_error.as_ref().is_none_or(|errors| errors.shape() == shape)
                && !map.hits.is_empty(),
        )?;
        Ok(map)
    }

    /// Adds the arrays to a file, with `more` after the pixels' centres.
    pub(super) fn add_to(&self, file: &mut ArrayWriter, more: &[(&str, &Array1<f64>)]) -> Result<()> {
        file.add("irradiance", &self.irradiance)?;
        file.add("x_coords", &self.x_coords)?;
        file.add("y_coords", &self.y_coords)?;
        more.iter().try_for_each(|(name, values)| file.add(name, *values))?;
        file.add("hits", &self.hits)?;
        file.add_optional("standard_error", &self.standard_error)
    }

    pub(super) fn cells(&self) -> CellMap<'_> {
        let size = (self.width, self.height);
        CellMap::of_pixels(size, &self.irradiance, self.standard_error.as_ref(), &self.hits)
    }

    pub(super) fn size(&self) -> Vec<(&'static str, Value)> {
        vec![("width", json!(self.width)), ("height", json!(self.height))]
    }
}

impl IrradianceMap {
    pub(crate) fn new(grid: &PixelGrid, sums: &Sums<'_>) -> Result<Self> {
        PixelMap::of_cells(grid, Ix2(grid.num_pixels_y as usize, grid.num_pixels_x as usize), sums)
    }

    pub(crate) fn read(mut stored: Stored) -> Result<Self> {
        PixelMap::of_file(&mut stored)
    }
}

impl DetectorResult for IrradianceMap {
    fn map(&self) -> Option<CellMap<'_>> {
        Some(self.cells())
    }

    fn write(&self, file: &mut ArrayWriter) -> Result<()> {
        self.add_to(file, &[])
    }

    fn units(&self) -> &'static [(&'static str, &'static str)] {
        &[
            ("irradiance", "W/mm^2"),
            ("x_coords", "mm"),
            ("y_coords", "mm"),
            ("total_flux", "W"),
            ("hits", "rays"),
            ("standard_error", "W/mm^2"),
            ("total_flux_standard_error", "W"),
        ]
    }

    fn picture(&self, path: &Path, head: &Head) -> Drawn {
        charts::map(path, head, (self.width, self.height), &self.irradiance)
    }

    fn entry(&self) -> Vec<(&'static str, Value)> {
        self.size()
    }
}
