//! One picture per detector: linear from zero, perceptual colours, axes at round numbers, a colour bar with its unit.
//! Benchmarks draw their bars and curves with the same parts.

pub mod bars;
mod canvas;
pub mod curves;
mod figures;
mod raster;

#[cfg(feature = "viewer")]
pub(crate) use crate::result::png::canvas::ticks;
use std::path::Path;

use crate::error::{Error, Result};
use crate::result::{Detector, DetectorData};

/// Draws what a detector recorded to `path`, a `.png` file.
///
/// # Errors
/// [`Error::File`] if the file cannot be written.
pub fn write_detector(path: &Path, detector: &Detector) -> Result<()> {
    canvas::register_fonts();
    let drawn = match &detector.data {
        DetectorData::Irradiance(map) => figures::irradiance(path, detector, map),
        DetectorData::Spectral(map) => figures::spectral(path, detector, map),
        DetectorData::FarField(pattern) => figures::far_field(path, detector, pattern),
        DetectorData::RayDatabase(rays) => figures::spots(path, detector, rays),
    };
    drawn.map_err(|error| Error::file(path, error))
}
