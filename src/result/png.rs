//! One picture per detector: linear from zero, perceptual colours, axes at round numbers, a colour bar with its unit.
//! Benchmarks draw their bars and curves with the same parts.

pub mod bars;
mod canvas;
pub mod curves;
pub(crate) mod figures;
mod raster;

#[cfg(feature = "viewer")]
pub(crate) use crate::result::png::canvas::ticks;
use std::path::Path;

use crate::error::{Error, Result};
use crate::result::Detector;
use crate::result::png::figures::Head;

/// Draws what a detector recorded to `path`, a `.png` file.
///
/// # Errors
/// [`Error::File`] if the file cannot be written.
pub fn write_detector(path: &Path, detector: &Detector) -> Result<()> {
    canvas::register_fonts();
    let head =
        Head { name: &detector.name, num_rays_hit: detector.num_rays_hit, total_flux: detector.total_flux };
    detector.data.result().picture(path, &head).map_err(|error| Error::file(path, error))
}
