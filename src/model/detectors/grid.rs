//! Grids of cells: pixels, how a ray's flux is spread over them, and what shaders have of a grid.

use crate::Result;
use crate::model::checks;
use glam::DVec3;
use schemars::JsonSchema;
use serde::Deserialize;

/// Widest Gaussian splat \[pixels\].
const MAX_SPLAT_SIGMA: f64 = 100.0;

/// A rectangle of pixels, centred on the local origin.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PixelGrid {
    /// Full width along local x \[mm\].
    pub width: f64,
    /// Full height along local y \[mm\].
    pub height: f64,
    /// Pixels along local x.
    pub num_pixels_x: u32,
    /// Pixels along local y.
    pub num_pixels_y: u32,
    /// How a ray's flux is spread over pixels.
    pub splat: Splat,
}

/// How a ray's flux is spread over pixels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Splat {
    /// All in the pixel that was hit.
    Hard,
    /// Over the four nearest pixels.
    Bilinear,
    /// Over a Gaussian of this standard deviation \[pixels\], truncated at ceil(3 sigma) (at least 1) and renormalised.
    Gaussian {
        /// Standard deviation \[pixels\], above 0.
        sigma: f64,
    },
}

impl Splat {
    /// How far a Gaussian splat reaches \[pixels\]; 0 of other splats.
    pub fn radius(self) -> u32 {
        match self {
            Splat::Gaussian { sigma } => (3.0 * sigma).ceil().max(1.0) as u32,
            Splat::Hard | Splat::Bilinear => 0,
        }
    }
}

/// How flux is spread over pixels.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum SplatKind {
    /// Over the four nearest pixels.
    #[default]
    Bilinear,
    /// Over a Gaussian.
    Gaussian,
    /// All in the pixel that was hit.
    Hard,
}

impl SplatKind {
    /// The splat of this standard deviation \[pixels\].
    pub(super) fn of_width(self, sigma: f64) -> Splat {
        match self {
            SplatKind::Hard => Splat::Hard,
            SplatKind::Bilinear => Splat::Bilinear,
            // A Gaussian without width is a point, as in Optiland.
            SplatKind::Gaussian if sigma == 0.0 => Splat::Hard,
            SplatKind::Gaussian => Splat::Gaussian { sigma },
        }
    }

    pub(super) fn check(self, at: &dyn Fn(&str) -> String, sigma: f64) -> Result<()> {
        let high = if self == SplatKind::Gaussian { MAX_SPLAT_SIGMA } else { f64::MAX };
        checks::between(at("splat_sigma"), sigma, 0.0, high)
    }
}

/// A grid of cells as shaders have it. Of directions, x is the azimuth from -pi, and y the polar angle from 0.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GridRow {
    /// Half of its width.
    pub half_width: f64,
    /// Half of its height.
    pub half_height: f64,
    /// Width of a cell.
    pub pitch_x: f64,
    /// Height of a cell.
    pub pitch_y: f64,
    /// Cells along x.
    pub num_x: u32,
    /// Cells along y.
    pub num_y: u32,
}

/// By how much a ray may arrive elsewhere than it should, in the detector's frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ArrivalError {
    /// Along x \[mm\].
    pub x: f64,
    /// Along y \[mm\].
    pub y: f64,
    /// Of the direction \[rad\].
    pub bent: f64,
    /// The direction itself.
    pub direction: DVec3,
}

impl PixelGrid {
    /// Number of pixels.
    pub fn num_pixels(&self) -> usize {
        self.num_pixels_x as usize * self.num_pixels_y as usize
    }

    /// Width and height of a pixel \[mm\].
    pub fn pitch(&self) -> (f64, f64) {
        (self.width / f64::from(self.num_pixels_x), self.height / f64::from(self.num_pixels_y))
    }

    /// The same rectangle as a single pixel.
    pub(super) fn with_single_pixel(&self) -> Self {
        PixelGrid { num_pixels_x: 1, num_pixels_y: 1, splat: Splat::Hard, ..*self }
    }

    pub(super) fn row(&self) -> GridRow {
        let (pitch_x, pitch_y) = self.pitch();
        GridRow {
            half_width: self.width / 2.0,
            half_height: self.height / 2.0,
            pitch_x,
            pitch_y,
            num_x: self.num_pixels_x,
            num_y: self.num_pixels_y,
        }
    }

    pub(super) fn pixels_off(&self, error: &ArrivalError) -> f64 {
        let (pitch_x, pitch_y) = self.pitch();
        (error.x / pitch_x).max(error.y / pitch_y)
    }
}

/// Refuses a rectangle of no size.
pub(super) fn check_rectangle(at: &dyn Fn(&str) -> String, width: f64, height: f64) -> Result<()> {
    checks::size(at("width"), width)?;
    checks::size(at("height"), height)
}

/// Refuses a number of cells that leaves none.
pub(super) fn check_count(place: String, value: u32) -> Result<()> {
    if value > 0 {
        return Ok(());
    }
    checks::refuse(place, "0 leaves nothing to record in", "give 1 or more")
}

/// The number of all cells of so many along each axis, if it can be counted.
pub(super) fn product(factors: &[u32]) -> Option<u64> {
    factors.iter().try_fold(1u64, |cells, n| cells.checked_mul(u64::from(*n)))
}

// What scene files leave out of a grid

pub(super) fn default_pixels() -> u32 {
    256
}

pub(super) fn default_sigma() -> f64 {
    0.5
}
