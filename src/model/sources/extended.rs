//! Emitting areas.

use crate::model::Outline;
use crate::model::sources::{Emission, SourceFunction, SourceWgsl, cap_height};
use crate::shaders::shader;
use std::f64::consts::FRAC_PI_2;

/// The rectangle.
pub const RECTANGLE: SourceWgsl =
    SourceWgsl { name: "extended_rectangle", file: shader!("sources/extended_rectangle.wgsl"), num_steps: 1 };

/// The disk.
pub const DISK: SourceWgsl =
    SourceWgsl { name: "extended_disk", file: shader!("sources/extended_disk.wgsl"), num_steps: 1 };

/// Rays from an area at local z = 0; uniform in a cap below 90 degrees of half-angle, else Lambertian.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Extended {
    /// The emitting area: a rectangle or a disk.
    pub area: Outline,
    /// Half-angle of the cap \[rad\].
    pub half_angle: f64,
}

impl Emission for Extended {
    fn kind(&self) -> SourceFunction {
        match self.area {
            Outline::Disk { .. } => SourceFunction::ExtendedDisk,
            Outline::Rectangle { .. } | Outline::Infinite => SourceFunction::ExtendedRectangle,
        }
    }

    fn arguments(&self) -> Vec<f64> {
        const LAMBERTIAN: f64 = -1.0;
        let height = if self.is_lambertian() { LAMBERTIAN } else { cap_height(self.half_angle) };
        match self.area {
            Outline::Rectangle { width, height: area_height } => vec![width, area_height, height],
            Outline::Disk { radius } => vec![radius, 0.0, height],
            Outline::Infinite => vec![0.0, 0.0, height],
        }
    }

    fn births(&self) -> Outline {
        self.area
    }

    fn half_angle(&self) -> f64 {
        self.half_angle
    }

    fn is_lambertian(&self) -> bool {
        self.half_angle >= FRAC_PI_2
    }
}
