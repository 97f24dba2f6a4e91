//! A conic of revolution: spheres, paraboloids, hyperboloids and ellipsoids as faces of lenses and mirrors.

use crate::Result;
use crate::model::checks;
use crate::model::mesh::Mesh;
use crate::model::shapes::{
    Extent, Flat, Geometry, Normal, Outline, Quadric, Shape, ShapeKind, ShapeWgsl, Slab, WrittenShape,
    ring_samples, section_between,
};
use crate::shaders::shader;
use glam::{DVec2, DVec3};
use schemars::JsonSchema;
use serde::Deserialize;

/// The curved conic; a flat one is drawn by [`crate::model::shapes::plane::DISK`].
pub const CONIC: ShapeWgsl = ShapeWgsl {
    name: "conic",
    file: shader!("shapes/conic.wgsl"),
    num_arguments: 3,
    normal: Normal::Quadric(|a| format!("conic_quadric({}, {})", a[0], a[1])),
};

/// The curvature of a radius \[1/mm\]; 0 and infinity both mean flat.
pub fn curvature(radius: f64) -> f64 {
    if radius == 0.0 || radius.is_infinite() { 0.0 } else { 1.0 / radius }
}

/// z = c r^2 / (1 + sqrt(1 - (1 + conic) c^2 r^2)) for r <= aperture_radius, its normal along z at the vertex.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Conic {
    /// Vertex curvature c = 1/R; 0 for a flat surface \[1/mm\].
    pub curvature: f64,
    /// Conic constant.
    pub conic: f64,
    /// Semi-diameter \[mm\].
    pub aperture_radius: f64,
}

impl Conic {
    /// Height at a distance from the axis \[mm\]; beyond the widest point of a closed conic, the formula's real part.
    pub fn sag(&self, radius: f64) -> f64 {
        let r2 = radius * radius;
        self.curvature * r2 / (1.0 + self.under_root(r2).max(0.0).sqrt())
    }

    /// 1 - (1 + conic) c^2 r^2. Its root is 1 - (1 + conic) c z on the sheet through the vertex.
    fn under_root(&self, r2: f64) -> f64 {
        1.0 - (1.0 + self.conic) * self.curvature * self.curvature * r2
    }

    /// Where the sheet through the vertex ends, or infinity \[mm\].
    pub fn widest(&self) -> f64 {
        1.0 / (self.curvature.abs() * (1.0 + self.conic).max(0.0).sqrt())
    }
}

/// A conic in a scene file.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Written {
    /// Vertex radius \[mm\].
    pub radius: f64,
    /// Conic constant.
    #[serde(default)]
    pub conic: f64,
    /// Semi-diameter \[mm\].
    pub aperture_radius: f64,
}

impl WrittenShape for Written {
    fn check(&self, at: &dyn Fn(&str) -> String) -> Result<()> {
        checks::radius(at("radius"), self.radius)?;
        checks::conic_constant(at("conic"), self.conic)?;
        checks::size(at("aperture_radius"), self.aperture_radius)
    }

    fn shape(&self, _: &str, _: Option<usize>) -> Result<Shape> {
        let Written { radius, conic, aperture_radius } = *self;
        Ok(Shape::Conic(Conic { curvature: curvature(radius), conic, aperture_radius }))
    }
}

impl Geometry for Conic {
    fn kind(&self) -> ShapeKind {
        if self.curvature == 0.0 { ShapeKind::Disk } else { ShapeKind::Conic }
    }

    fn arguments(&self) -> Vec<f64> {
        let aperture = self.aperture_radius * self.aperture_radius;
        match self.curvature == 0.0 {
            true => vec![aperture],
            false => vec![self.curvature, (1.0 + self.conic) * self.curvature, aperture],
        }
    }

    fn quadric(&self) -> Option<Quadric> {
        let Conic { curvature, conic, .. } = *self;
        Some(Quadric { radial: -curvature, axial: -(1.0 + conic) * curvature, ..Quadric::PLANE })
    }

    fn holds(&self, p: DVec3) -> bool {
        let is_on_sheet = 1.0 - (1.0 + self.conic) * self.curvature * p.z >= 0.0;
        p.truncate().length_squared() <= self.aperture_radius * self.aperture_radius && is_on_sheet
    }

    fn extent(&self, _: &[Mesh]) -> Option<Extent> {
        // Where the sheet ends the root is 0 but for rounding, which `sag` allows for.
        let radius = self.aperture_radius.min(self.widest());
        let sag = self.sag(radius);
        Some(Extent::round(radius, sag.min(0.0), sag.max(0.0), radius + sag.abs()))
    }

    fn samples(&self) -> Vec<DVec3> {
        let at = |share: f64| (share * self.aperture_radius, self.sag(share * self.aperture_radius));
        ring_samples(&[0.3, 0.6, 0.9].map(at))
    }

    fn rims(&self) -> Vec<(f64, f64)> {
        vec![(self.aperture_radius, self.sag(self.aperture_radius))]
    }

    fn section(&self) -> Vec<Vec<DVec2>> {
        vec![section_between(-self.aperture_radius, self.aperture_radius, |r| self.sag(r))]
    }

    fn slab(&self) -> Option<Slab> {
        let steepness = self.under_root(self.aperture_radius * self.aperture_radius).sqrt();
        Some(Slab { ends: [0.0, self.sag(self.aperture_radius)], steepness: Some(steepness) })
    }

    fn flat(&self) -> Option<Flat> {
        let outline = Outline::Disk { radius: self.aperture_radius };
        (self.curvature == 0.0).then_some(Flat { outline, hole: 0.0, z: 0.0 })
    }

    fn conic(&self) -> Option<Conic> {
        Some(*self)
    }
}
