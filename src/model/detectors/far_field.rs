//! Flux over directions.

use crate::Result;
use crate::model::detectors::grid::{self, ArrivalError, GridRow};
use crate::model::detectors::{
    Detection, DetectorExtra, DetectorFunction, DetectorKind, DetectorWgsl, Records, WrittenDetector, written,
};
use crate::model::shapes::Outline;
use crate::shaders::shader;
use std::f64::consts::{FRAC_PI_2, PI, TAU};

/// Its function, which deposits into bins of directions.
pub const FAR_FIELD: DetectorWgsl =
    DetectorWgsl { name: "far_field", file: shader!("detectors/far_field.wgsl"), records: Records::Cells };

/// Radius of the disk that stands for a far-field detector \[mm\].
pub const FAR_FIELD_RADIUS: f64 = 1e6;

/// Flux over directions: polar angle 0 to 90 degrees from local z (both hemispheres folded), azimuth -180 to 180.
/// The detector is a disk of radius [`FAR_FIELD_RADIUS`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FarField {
    /// Bins of the polar angle.
    pub num_theta: u32,
    /// Bins of the azimuth.
    pub num_phi: u32,
}

written! {
    /// Flux over directions.
    #[schemars(rename = "FarFieldDetector")]
    pub struct Written {
        /// Bins of the polar angle, 0 to 90 degrees from the axis, forwards and backwards together.
        #[serde(default = "ninety")]
        pub num_bins_theta: u32,
        /// Bins of the azimuth, -180 to 180 degrees.
        #[serde(default = "full_circle")]
        pub num_bins_phi: u32,
    }
}

impl WrittenDetector for Written {
    fn check(&self, at: &dyn Fn(&str) -> String) -> Result<()> {
        grid::check_count(at("num_bins_theta"), self.num_bins_theta)?;
        grid::check_count(at("num_bins_phi"), self.num_bins_phi)
    }

    fn num_cells(&self) -> Option<u64> {
        grid::product(&[self.num_bins_theta, self.num_bins_phi])
    }

    fn kind(&self, _: Option<&DetectorExtra>) -> DetectorKind {
        DetectorKind::FarField(FarField { num_theta: self.num_bins_theta, num_phi: self.num_bins_phi })
    }
}

fn ninety() -> u32 {
    90
}

fn full_circle() -> u32 {
    360
}

impl Detection for FarField {
    fn function(&self) -> DetectorFunction {
        DetectorFunction::FarField
    }

    fn outline(&self) -> Outline {
        Outline::Disk { radius: FAR_FIELD_RADIUS }
    }

    fn num_cells(&self) -> usize {
        self.num_theta as usize * self.num_phi as usize
    }

    fn with_single_cell(&self) -> DetectorKind {
        DetectorKind::FarField(FarField { num_theta: 1, num_phi: 1 })
    }

    fn grid_row(&self) -> GridRow {
        GridRow {
            half_width: PI,
            half_height: 0.0,
            pitch_x: TAU / f64::from(self.num_phi),
            pitch_y: FRAC_PI_2 / f64::from(self.num_theta),
            num_x: self.num_phi,
            num_y: self.num_theta,
        }
    }

    fn cells_off(&self, error: &ArrivalError) -> Option<f64> {
        let (theta, phi) = (FRAC_PI_2 / f64::from(self.num_theta), 2.0 * PI / f64::from(self.num_phi));
        // In the ring at the pole the azimuth is rounding noise in every precision.
        let sine = error.direction.truncate().length().max(theta.sin());
        Some((error.bent / theta).max(error.bent / (sine * phi)))
    }

    fn is_placed(&self) -> bool {
        false
    }
}
