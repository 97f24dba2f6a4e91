//! Flux per area over the pixels of a rectangle.

use crate::error::Result;
use crate::model::PixelGrid;
use crate::result::detectors::bins::{bin_centres, pixel_area, shaped};
use crate::result::detectors::{CellMap, DetectorResult, Sums};
use crate::result::npz::ArrayWriter;
use crate::result::png::figures::{self, Drawn, Head};
use crate::result::stored::Stored;
use crate::result::tally::map_lit;
use ndarray::{Array1, Array2};
use serde_json::{Value, json};
use std::path::Path;

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
    pub(crate) fn new(grid: &PixelGrid, sums: &Sums<'_>) -> Result<Self> {
        let Sums { cells, unit, uncertainty, .. } = *sums;
        let (nx, ny) = (grid.num_pixels_x as usize, grid.num_pixels_y as usize);
        let area = pixel_area(grid);
        Ok(IrradianceMap {
            irradiance: shaped((ny, nx), map_lit(&cells.quanta, |_, quanta| unit.watts(quanta) / area))?,
            x_coords: bin_centres(-grid.width / 2.0, grid.width / 2.0, nx),
            y_coords: bin_centres(-grid.height / 2.0, grid.height / 2.0, ny),
            hits: shaped((ny, nx), map_lit(&cells.hits, |_, hits| hits))?,
            standard_error: uncertainty
                .of_cells(cells, |_| area)
                .map(|errors| shaped((ny, nx), errors))
                .transpose()?,
            width: grid.width,
            height: grid.height,
        })
    }

    pub(crate) fn read(mut stored: Stored) -> Result<Self> {
        let (width, height) = stored.size()?;
        let map = IrradianceMap {
            irradiance: stored.array("irradiance")?,
            x_coords: stored.array("x_coords")?,
            y_coords: stored.array("y_coords")?,
            hits: stored.array("hits")?,
            standard_error: stored.optional("standard_error")?,
            width,
            height,
        };
        let shape = (map.y_coords.len(), map.x_coords.len());
        stored.check(
            map.irradiance.dim() == shape
                && map.hits.dim() == shape
                && map.standard_error.as_ref().is_none_or(|errors| errors.dim() == shape)
                && !map.hits.is_empty(),
        )?;
        Ok(map)
    }
}

impl DetectorResult for IrradianceMap {
    fn map(&self) -> Option<CellMap<'_>> {
        let size = (self.width, self.height);
        Some(CellMap::of_pixels(size, &self.irradiance, self.standard_error.as_ref(), &self.hits))
    }

    fn write(&self, file: &mut ArrayWriter) -> Result<()> {
        file.add("irradiance", &self.irradiance)?;
        file.add("x_coords", &self.x_coords)?;
        file.add("y_coords", &self.y_coords)?;
        file.add("hits", &self.hits)?;
        file.add_optional("standard_error", &self.standard_error)
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
        figures::map(path, head, (self.width, self.height), &self.irradiance)
    }

    fn entry(&self) -> Vec<(&'static str, Value)> {
        vec![("width", json!(self.width)), ("height", json!(self.height))]
    }
}
