//! A point source.

use crate::model::Outline;
use crate::model::sources::{Emission, SourceFunction, SourceWgsl, cap_height};
use crate::shaders::shader;

/// The point.
pub const POINT: SourceWgsl = SourceWgsl { name: "point", file: shader!("sources/point.wgsl"), num_steps: 1 };

/// Rays from the local origin, uniform in solid angle within a cap about local +z.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Point {
    /// Half-angle of the cap \[rad\], up to pi.
    pub half_angle: f64,
}

impl Emission for Point {
    fn kind(&self) -> SourceFunction {
        SourceFunction::Point
    }

    fn arguments(&self) -> Vec<f64> {
        vec![cap_height(self.half_angle)]
    }

    fn births(&self) -> Outline {
        Outline::Disk { radius: 0.0 }
    }

    fn half_angle(&self) -> f64 {
        self.half_angle
    }

    fn is_point(&self) -> bool {
        true
    }
}
