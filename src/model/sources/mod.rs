//! Sources of rays: the list of them, and what each must say of itself.
//!
//! Each source stands in one file here, and its function in one file of shaders/sources/. docs/adding-a-kind.md tells how
//! to add one. Everything is said in the source's own frame: rays are born at z = 0 and go towards +z. Lengths are in mm,
//! angles in rad.

pub mod collimated;
pub mod extended;
pub mod point;

pub use crate::model::sources::collimated::{CollimatedGaussian, CollimatedTophat};
pub use crate::model::sources::extended::Extended;
pub use crate::model::sources::point::Point;

use crate::model::Outline;
use crate::model::list::kinds;
use crate::shaders::ShaderFile;

kinds! {
    SourceKind: Emission, functions SourceFunction: SourceWgsl;
    /// Rays from one point, uniform in solid angle within a cap about local +z.
    Point(point::Point) by Point = POINT;
    /// Parallel rays along local +z from a disk, uniform.
    CollimatedTophat(collimated::CollimatedTophat) by CollimatedTophat = TOPHAT;
    /// Parallel rays along local +z from a disk, Gaussian and truncated at the rim.
    CollimatedGaussian(collimated::CollimatedGaussian) by CollimatedGaussian = GAUSSIAN;
    /// Rays from an area at local z = 0; uniform in a cap below 90 degrees of half-angle, else Lambertian.
    Extended(extended::Extended) by ExtendedRectangle = RECTANGLE, ExtendedDisk = DISK;
}

/// What the shaders have of a source.
#[derive(Debug)]
pub struct SourceWgsl {
    /// Its function is `emit_<name>(key: RayKey, e: Source) -> LocalRay`, which reads `e.p0`, `e.p1` and so on.
    pub name: &'static str,
    /// The file that holds it.
    pub file: ShaderFile,
    /// Steps of the random generator that it may take.
    pub num_steps: u32,
}

/// What the program, the checks of scenes and the viewer ask of a source.
pub trait Emission: std::fmt::Debug {
    /// The function that emits its rays.
    fn kind(&self) -> SourceFunction;

    /// The numbers `p0`, `p1` and so on of the function.
    fn arguments(&self) -> Vec<f64>;

    /// Where rays are born; of a point, a disk without an extent.
    fn births(&self) -> Outline;

    /// The largest angle between a ray and the axis \[rad\].
    fn half_angle(&self) -> f64;

    /// True if all rays are born in one point.
    fn is_point(&self) -> bool {
        false
    }

    /// True if directions are drawn by Lambert's law.
    fn is_lambertian(&self) -> bool {
        false
    }
}

impl SourceFunction {
    /// The name in the shaders.
    pub fn name(self) -> &'static str {
        self.wgsl().name
    }

    /// The function that emits a source's rays.
    pub fn of(kind: &SourceKind) -> Self {
        kind.kind()
    }
}

/// 1 - cos(half angle), without cancellation.
fn cap_height(half_angle: f64) -> f64 {
    let s = (half_angle / 2.0).sin();
    2.0 * s * s
}
