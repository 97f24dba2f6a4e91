//! Parallel beams.

use crate::model::Outline;
use crate::model::sources::{Emission, SourceFunction, SourceWgsl};
use crate::shaders::shader;

/// The uniform beam.
pub const TOPHAT: SourceWgsl =
    SourceWgsl { name: "collimated_tophat", file: shader!("sources/collimated_tophat.wgsl"), num_steps: 1 };

/// The Gaussian beam: it attempts 32 times, and then falls back on the rim.
pub const GAUSSIAN: SourceWgsl = SourceWgsl {
    name: "collimated_gaussian",
    file: shader!("sources/collimated_gaussian.wgsl"),
    num_steps: 33,
};

/// Parallel rays along local +z from a disk, uniform.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CollimatedTophat {
    /// Disk radius \[mm\].
    pub aperture_radius: f64,
}

/// Parallel rays along local +z from a disk, Gaussian and truncated at the rim.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CollimatedGaussian {
    /// Disk radius \[mm\].
    pub aperture_radius: f64,
    /// Standard deviation of x and of y before truncation \[mm\].
    pub sigma: f64,
}

impl Emission for CollimatedTophat {
    fn kind(&self) -> SourceFunction {
        SourceFunction::CollimatedTophat
    }

    fn arguments(&self) -> Vec<f64> {
        vec![self.aperture_radius]
    }

    fn births(&self) -> Outline {
        Outline::Disk { radius: self.aperture_radius }
    }

    fn half_angle(&self) -> f64 {
        0.0
    }
}

impl Emission for CollimatedGaussian {
    fn kind(&self) -> SourceFunction {
        SourceFunction::CollimatedGaussian
    }

    fn arguments(&self) -> Vec<f64> {
        vec![self.aperture_radius, self.sigma]
    }

    fn births(&self) -> Outline {
        Outline::Disk { radius: self.aperture_radius }
    }

    fn half_angle(&self) -> f64 {
        0.0
    }
}
