//! Emitting areas.

use crate::Result;
use crate::model::sources::{
    Emission, SourceFunction, SourceKind, SourceWgsl, WrittenSource, cap_height, right_angle, written,
};
use crate::model::{Outline, checks};
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

written! {
    /// An emitting rectangle or disk.
    pub struct Written {
        /// Width \[mm\].
        #[serde(default = "one")]
        pub width: f64,
        /// Height \[mm\].
        #[serde(default = "one")]
        pub height: f64,
        /// Radius of a disk \[mm\], instead of width and height.
        #[serde(default)]
        pub aperture_radius: Option<f64>,
        /// Half-angle of the cone \[deg\]; Lambertian from 90.
        #[serde(default = "right_angle")]
        pub half_angle_deg: f64,
    }
}

fn one() -> f64 {
    1.0
}

impl WrittenSource for Written {
    fn check(&self, at: &dyn Fn(&str) -> String) -> Result<()> {
        checks::between(at("half_angle_deg"), self.half_angle_deg, 0.0, 180.0)?;
        // A disk, as in Optiland, whatever its width and height.
        if let Some(radius) = self.aperture_radius {
            return checks::size(at("aperture_radius"), radius);
        }
        checks::size(at("width"), self.width)?;
        checks::size(at("height"), self.height)
    }

    fn kind(&self) -> SourceKind {
        let area = match self.aperture_radius {
            Some(radius) => Outline::Disk { radius },
            None => Outline::Rectangle { width: self.width, height: self.height },
        };
        SourceKind::Extended(Extended { area, half_angle: self.half_angle_deg.to_radians() })
    }
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
