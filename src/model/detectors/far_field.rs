//! Flux over directions.

use crate::Result;
use crate::model::checks;
use crate::model::detectors::grid::{self, ArrivalError, GridRow};
use crate::model::detectors::{
    ColorSpace, Detection, DetectorExtra, DetectorFunction, DetectorKind, DetectorWgsl, Records,
    WrittenDetector, written,
};
use crate::model::shapes::Outline;
use crate::shaders::shader;
use std::f64::consts::{FRAC_PI_2, PI, TAU};

/// Its function, which deposits into bins of directions.
pub const FAR_FIELD: DetectorWgsl =
    DetectorWgsl { name: "far_field", file: shader!("detectors/far_field.wgsl"), records: Records::Cells };

/// The function of a far field over the sphere: two far fields, forwards and backwards, of which the second lies behind the
/// first.
pub const FAR_FIELD_SPHERE: DetectorWgsl = DetectorWgsl {
    name: "far_field_sphere",
    file: shader!("detectors/far_field_sphere.wgsl"),
    records: Records::Cells,
};

/// Radius of the disk that stands for a far-field detector \[mm\].
pub const FAR_FIELD_RADIUS: f64 = 1e6;

/// Flux over directions: polar angle from local z, azimuth -180 to 180 degrees. The polar angle goes to 90 degrees, with both
/// hemispheres folded into one, or to 180. The detector is a disk of radius [`FAR_FIELD_RADIUS`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FarField {
    /// Bins of the polar angle.
    pub num_theta: u32,
    /// True if the polar angle goes to 180 degrees. Then `num_theta` is even.
    pub sphere: bool,
    /// Bins of the azimuth.
    pub num_phi: u32,
}

written! {
    /// Flux over directions.
    #[schemars(rename = "FarFieldDetector")]
    pub struct Written {
        /// Bins of the polar angle. By default one a degree.
        #[serde(default)]
        pub num_bins_theta: Option<u32>,
        /// True: the polar angle goes from 0 to 180 degrees. False: from 0 to 90, forwards and backwards together.
        #[serde(default)]
        pub sphere: bool,
        /// Bins of the azimuth, -180 to 180 degrees.
        #[serde(default = "full_circle")]
        pub num_bins_phi: u32,
        /// `xyz`: the detector sees colour, and results are photometric.
        #[serde(default)]
        pub color: Option<ColorSpace>,
    }
}

impl WrittenDetector for Written {
    fn sees_color(&self) -> bool {
        self.color.is_some()
    }

    fn check(&self, at: &dyn Fn(&str) -> String) -> Result<()> {
        grid::check_count(at("num_bins_theta"), self.num_theta())?;
        grid::check_count(at("num_bins_phi"), self.num_bins_phi)?;
        if self.sphere && !self.num_theta().is_multiple_of(2) {
            return checks::refuse(
                at("num_bins_theta"),
                format!("{} bins do not part at 90 degrees, as a sphere's must", self.num_theta()),
                "give an even number",
            );
        }
        Ok(())
    }

    fn num_cells(&self) -> Option<u64> {
        grid::product(&[self.num_theta(), self.num_bins_phi])
    }

    fn kind(&self, _: Option<&DetectorExtra>) -> DetectorKind {
        DetectorKind::FarField(FarField {
            num_theta: self.num_theta(),
            num_phi: self.num_bins_phi,
            sphere: self.sphere,
        })
    }
}

impl Written {
    /// Bins of the polar angle: one a degree, unless the user gives a number.
    fn num_theta(&self) -> u32 {
        self.num_bins_theta.unwrap_or(if self.sphere { 180 } else { 90 })
    }
}

fn full_circle() -> u32 {
    360
}

impl FarField {
    /// The largest polar angle \[rad\].
    fn reach(&self) -> f64 {
        if self.sphere { PI } else { FRAC_PI_2 }
    }

    /// Values of cells in the order of their polar angles. The backward half of a sphere is summed as a far field of its own,
    /// from the backward axis on.
    pub fn by_polar_angle<T: Clone>(&self, mut values: Vec<T>) -> Vec<T> {
        if self.sphere {
            let backward = values.split_off(values.len() / 2);
            values.extend(backward.chunks_exact(self.num_phi as usize).rev().flatten().cloned());
        }
        values
    }
}

impl Detection for FarField {
    fn function(&self) -> DetectorFunction {
        if self.sphere { DetectorFunction::FarFieldSphere } else { DetectorFunction::FarField }
    }

    fn outline(&self) -> Outline {
        Outline::Disk { radius: FAR_FIELD_RADIUS }
    }

    fn num_cells(&self) -> usize {
        self.num_theta as usize * self.num_phi as usize
    }

    fn with_single_cell(&self) -> DetectorKind {
        DetectorKind::FarField(FarField {
            num_theta: if self.sphere { 2 } else { 1 },
            num_phi: 1,
            sphere: self.sphere,
        })
    }

    fn grid_row(&self) -> GridRow {
        GridRow {
            half_width: PI,
            half_height: 0.0,
            pitch_x: TAU / f64::from(self.num_phi),
            pitch_y: self.reach() / f64::from(self.num_theta),
            num_x: self.num_phi,
            num_y: if self.sphere { self.num_theta / 2 } else { self.num_theta },
        }
    }

    fn cells_off(&self, error: &ArrivalError) -> Option<f64> {
        let (theta, phi) = (self.reach() / f64::from(self.num_theta), 2.0 * PI / f64::from(self.num_phi));
        // In the ring at the pole the azimuth is rounding noise in every precision.
        let sine = error.direction.truncate().length().max(theta.sin());
        Some((error.bent / theta).max(error.bent / (sine * phi)))
    }

    fn is_placed(&self) -> bool {
        false
    }
}
