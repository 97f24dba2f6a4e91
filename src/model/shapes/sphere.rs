//! A sphere: ball lenses, integrating spheres.

use crate::Result;
use crate::model::checks;
use crate::model::mesh::Mesh;
use crate::model::shapes::{
    Extent, FrontSide, Geometry, Normal, Quadric, Shape, ShapeKind, ShapeWgsl, WrittenShape, ring_samples,
    section_between,
};
use crate::shaders::shader;
use glam::{DVec2, DVec3};
use schemars::JsonSchema;
use serde::Deserialize;

/// The sphere.
pub const SPHERE: ShapeWgsl = ShapeWgsl {
    name: "sphere",
    file: shader!("shapes/sphere.wgsl"),
    num_arguments: 2,
    normal: Normal::Quadric(|a| format!("sphere_quadric({})", a[0])),
};

/// A value beyond any distance of a scene that both tiers hold: "no limit".
const UNLIMITED: f64 = 1e38;

/// The sphere about the local origin, where r <= aperture_radius if one is given, its normal inward.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Sphere {
    /// Radius \[mm\].
    pub radius: f64,
    /// Limit of the distance from local z \[mm\].
    #[serde(default)]
    pub aperture_radius: Option<f64>,
}

impl Sphere {
    /// The largest distance from local z \[mm\].
    fn widest(&self) -> f64 {
        self.aperture_radius.map_or(self.radius, |aperture| aperture.min(self.radius))
    }
}

/// In a scene file the same.
pub type Written = Sphere;

impl WrittenShape for Sphere {
    fn check(&self, at: &dyn Fn(&str) -> String) -> Result<()> {
        checks::size(at("radius"), self.radius)?;
        // A limit beyond the radius limits nothing, as in Optiland.
        self.aperture_radius.map_or(Ok(()), |radius| checks::size(at("aperture_radius"), radius))
    }

    fn shape(&self, _: &str, _: Option<usize>) -> Result<Shape> {
        Ok(Shape::Sphere(*self))
    }
}

impl Geometry for Sphere {
    fn kind(&self) -> ShapeKind {
        ShapeKind::Sphere
    }

    fn front_side(&self) -> FrontSide {
        FrontSide::Outside
    }

    fn arguments(&self) -> Vec<f64> {
        vec![self.radius, self.aperture_radius.map_or(UNLIMITED, |a| a * a)]
    }

    fn quadric(&self) -> Option<Quadric> {
        let bend = -1.0 / self.radius;
        Some(Quadric { radial: bend, axial: bend, offset: 0.0, constant: self.radius })
    }

    fn holds(&self, p: DVec3) -> bool {
        self.aperture_radius.is_none_or(|aperture| p.truncate().length_squared() <= aperture * aperture)
    }

    fn extent(&self, _: &[Mesh]) -> Option<Extent> {
        let Sphere { radius, .. } = *self;
        Some(Extent { reach: radius, ..Extent::round(self.widest(), -radius, radius, radius) })
    }

    fn samples(&self) -> Vec<DVec3> {
        let at = |z: f64| (self.radius * (1.0 - z * z).sqrt(), self.radius * z);
        ring_samples(&[-0.7, 0.1, 0.8].map(at))
    }

    fn section(&self) -> Vec<Vec<DVec2>> {
        let height = |r: f64| (self.radius * self.radius - r * r).max(0.0).sqrt();
        let half = |sign: f64| section_between(-self.widest(), self.widest(), |r| sign * height(r));
        vec![half(1.0), half(-1.0)]
    }

    fn is_closed(&self) -> bool {
        self.aperture_radius.is_none()
    }

    fn coincides(&self, other: &Shape) -> bool {
        matches!(other, Shape::Sphere(other) if other.radius == self.radius)
    }

    fn is_round(&self) -> bool {
        true
    }
}
