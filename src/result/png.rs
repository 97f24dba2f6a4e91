//! One picture per detector: linear from zero or logarithmic ([`Style`]), perceptual colours, axes at round numbers, a colour bar with its unit.

mod canvas;
pub(crate) mod charts;
pub(crate) mod diagram;
mod style;

use std::path::Path;

pub use crate::result::png::style::{Style, Unit};

use crate::error::{Error, Result};
use crate::format::{significant, with_prefix};
use crate::result::picture::true_color::TrueColors;
use crate::result::png::charts::Head;
use crate::result::{Detector, DetectorData, DetectorDifference};
use ndarray::{Axis, Ix2};

/// Draws what a detector recorded to `path`, a `.png` file.
///
/// # Errors
/// [`Error::File`] if the file cannot be written.
pub fn write_detector(path: &Path, detector: &Detector, style: Style) -> Result<()> {
    write(path, detector, style, None)
}

/// Draws what a detector recorded in the colours of its light. Nothing is done for a detector that saw no colour.
///
/// # Errors
/// [`Error::File`] if the file cannot be written.
pub fn write_true_colors(path: &Path, detector: &Detector, style: Style) -> Result<()> {
    let Some(color) = detector.luminous.as_ref().and_then(|seen| seen.color.as_ref()) else { return Ok(()) };
    let colors =
        TrueColors::of(color).ok_or_else(|| Error::Internal("a map of colours has no rows".into()))?;
    write(path, detector, style, Some(&colors))
}

fn write(path: &Path, detector: &Detector, style: Style, colors: Option<&TrueColors>) -> Result<()> {
    canvas::register_fonts();
    let name = detector.title.as_ref().unwrap_or(&detector.name);
    let quantity = detector.data.result().map().map_or(("", ""), |map| map.quantity);
    let num_rays_hit = detector.num_rays_hit;
    let head = Head { name, num_rays_hit, flux: (detector.total_flux, "W"), quantity, style, colors };
    let drawn = match detector.luminous.as_ref().filter(|_| colors.is_some() || !style.is_in_watts()) {
        Some(seen) => {
            let head = Head { flux: (seen.flux_lm, "lm"), quantity: seen.quantity(), ..head };
            let map = seen.map.view().into_dimensionality::<Ix2>();
            let map = map.map_err(|error| Error::internal("a photometric map", &error))?.to_owned();
            match &detector.data {
                DetectorData::Irradiance(pixels) => {
                    charts::map(path, &head, (pixels.width, pixels.height), &map)
                }
                DetectorData::FarField(pattern) => {
                    diagram::far_field(path, &head, &map, (pattern.reach(), &pattern.solid_angles()))
                }
                DetectorData::Spectral(_) | DetectorData::RayDatabase(_) => {
                    detector.data.result().picture(path, &head)
                }
            }
        }
        None => detector.data.result().picture(path, &head),
    };
    drawn.map_err(|error| Error::file(path, error))
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
    let head = Head {
        name: &flux.name,
        num_rays_hit: 0,
        flux: (flux.difference, "W"),
        quantity: of_a.quantity,
        style,
        colors: None,
    };
    charts::difference(path, &head, &numbers, [of_a.x, of_a.y], of_a.quantity, &values)
        .map_err(|error| Error::file(path, error))
}
