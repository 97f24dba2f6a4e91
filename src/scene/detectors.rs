//! Detectors as scene files give them -> those of the model.

use crate::model::{Detector, DetectorKind, Frame, PixelGrid, Splat};
use crate::scene::frame::frame_of;
use crate::scene::json::{self, DetectorExtra, SplatKind};

/// The detector, with what the block says of it.
pub(crate) fn lowered(written: &json::Detector, extra: Option<&DetectorExtra>) -> Detector {
    let frame: Frame = frame_of(written.cs());
    let (kind, absorb) = match written {
        json::Detector::Irradiance(d) => {
            let splat = splat(d.splat, d.splat_sigma);
            (
                DetectorKind::Irradiance(grid(d.width, d.height, d.num_pixels_x, d.num_pixels_y, splat)),
                d.absorb,
            )
        }
        json::Detector::Spectral(d) => {
            let splat = splat(d.splat, d.splat_sigma);
            let grid = grid(d.width, d.height, d.num_pixels_x, d.num_pixels_y, splat);
            let wavelength_edges = edges(d.wl_min, d.wl_max, d.num_bins);
            (DetectorKind::Spectral { grid, wavelength_edges }, d.absorb)
        }
        json::Detector::FarField(d) => {
            (DetectorKind::FarField { num_theta: d.num_bins_theta, num_phi: d.num_bins_phi }, d.absorb)
        }
        json::Detector::RayDatabase(d) => {
            // Optiland's 0 stands for no limit.
            let max_rays = extra.and_then(|extra| extra.max_rays).filter(|limit| *limit > 0);
            (DetectorKind::RayDatabase { width: d.width, height: d.height, max_rays }, d.absorb)
        }
    };
    Detector { name: written.name().to_owned(), frame, kind, absorb }
}

fn grid(width: f64, height: f64, num_pixels_x: u32, num_pixels_y: u32, splat: Splat) -> PixelGrid {
    PixelGrid { width, height, num_pixels_x, num_pixels_y, splat }
}

fn splat(kind: SplatKind, sigma: f64) -> Splat {
    match kind {
        SplatKind::Hard => Splat::Hard,
        SplatKind::Bilinear => Splat::Bilinear,
        // A Gaussian without width is a point, as in Optiland.
        SplatKind::Gaussian if sigma == 0.0 => Splat::Hard,
        SplatKind::Gaussian => Splat::Gaussian { sigma },
    }
}

/// Bin edges by the arithmetic of `numpy.linspace`, so that a wavelength on an edge falls as it does in Optiland.
fn edges(start: f64, stop: f64, bins: u32) -> Vec<f64> {
    let step = (stop - start) / f64::from(bins);
    let mut edges: Vec<f64> = (0..=bins).map(|i| f64::from(i) * step + start).collect();
    if let Some(last) = edges.last_mut() {
        *last = stop;
    }
    edges
}
