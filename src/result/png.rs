//! One picture per detector: linear from zero or logarithmic ([`Style`]), perceptual colours, axes at round numbers, a colour bar with its unit.

mod canvas;
pub(crate) mod figures;
mod style;

use std::path::Path;

pub use crate::result::png::style::{Style, Unit};

use crate::error::{Error, Result};
use crate::format::{significant, with_prefix};
use crate::result::png::figures::Head;
use crate::result::{Detector, DetectorDifference};
use ndarray::{Axis, Ix2};

/// Draws what a detector recorded to `path`, a `.png` file.
///
/// # Errors
/// [`Error::File`] if the file cannot be written.
pub fn write_detector(path: &Path, detector: &Detector, style: Style) -> Result<()> {
    canvas::register_fonts();
    let name = detector.title.as_ref().unwrap_or(&detector.name);
    let (num_rays_hit, total_flux) = (detector.num_rays_hit, detector.total_flux);
    let head = Head { name, num_rays_hit, total_flux, style };
    detector.data.result().picture(path, &head).map_err(|error| Error::file(path, error))
}

/// Draws what a detector's map differs by, summed over wavelengths, to `path`, a `.png` file.
///
/// # Errors
/// [`Error::File`] if the file cannot be written.
pub fn write_difference(path: &Path, detector: &DetectorDifference, style: Style) -> Result<()> {
    canvas::register_fonts();
    let Some(map) = &detector.map else { return Ok(()) };
    let Some(of_a) = map.sides[0].data.result().map() else { return Ok(()) };
    let values = match map.values.ndim() {
        3 => map.values.sum_axis(Axis(2)),
        _ => map.values.clone(),
    };
    let values = values.into_dimensionality::<Ix2>().map_err(|error| Error::Internal(error.to_string()))?;
    let flux = &detector.flux;
    let score = flux.score().map_or(String::new(), |score| format!(", {} sigmas", significant(score, 2)));
    let numbers = format!("A − B {}{score}", with_prefix(flux.difference, "W"));
    let head = Head { name: &flux.name, num_rays_hit: 0, total_flux: flux.difference, style };
    figures::difference(path, &head, &numbers, [of_a.x, of_a.y], of_a.quantity, &values)
        .map_err(|error| Error::file(path, error))
}
