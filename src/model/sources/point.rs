//! A point source.

use crate::Result;
use crate::model::sources::{
    Emission, SourceFunction, SourceKind, SourceWgsl, WrittenSource, cap_height, right_angle, written,
};
use crate::model::{Outline, checks};
use crate::shaders::shader;

/// The point.
pub const POINT: SourceWgsl = SourceWgsl { name: "point", file: shader!("sources/point.wgsl"), num_steps: 1 };

/// Rays from the local origin, uniform in solid angle within a cap about local +z.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Point {
    /// Half-angle of the cap \[rad\], up to pi.
    pub half_angle: f64,
}

written! {
    /// A point source: uniform in solid angle within a cone about local +z.
    pub struct Written {
        /// Half-angle of the cone \[deg\], 180 for the full sphere.
        #[serde(default = "right_angle")]
        pub half_angle_deg: f64,
    }
}

impl WrittenSource for Written {
    fn check(&self, at: &dyn Fn(&str) -> String) -> Result<()> {
        checks::between(at("half_angle_deg"), self.half_angle_deg, 0.0, 180.0)
    }

    fn kind(&self) -> SourceKind {
        SourceKind::Point(Point { half_angle: self.half_angle_deg.to_radians() })
    }
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
