//! A flat ring: rims of lenses, baffles, stops.

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

/// The ring.
pub const ANNULUS: ShapeWgsl = ShapeWgsl {
    name: "annulus",
    file: shader!("shapes/annulus.wgsl"),
    num_arguments: 3,
    normal: Normal::Quadric(|a| format!("Quadric(0.0, 0.0, 1.0, -2.0 * {})", a[2])),
};

/// The ring inner_radius <= r <= outer_radius at z = z_offset, its normal along z.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Annulus {
    /// Radius of the hole \[mm\].
    pub inner_radius: f64,
    /// Radius of the rim \[mm\].
    pub outer_radius: f64,
    /// Position along local z \[mm\].
    #[serde(default)]
    pub z_offset: f64,
}

/// In a scene file the same.
pub type Written = Annulus;

impl WrittenShape for Annulus {
    fn check(&self, at: &dyn Fn(&str) -> String) -> Result<()> {
        checks::between(at("inner_radius"), self.inner_radius, 0.0, checks::MAX_LENGTH)?;
        checks::size(at("outer_radius"), self.outer_radius)?;
        checks::position(at("z_offset"), self.z_offset)?;
        if self.inner_radius < self.outer_radius {
            return Ok(());
        }
        checks::refuse(at("outer_radius"), "the ring is empty", "give inner_radius < outer_radius")
    }

    fn shape(&self, _: &str, _: Option<usize>) -> Result<Shape> {
        Ok(Shape::Annulus(*self))
    }
}

impl Geometry for Annulus {
    fn kind(&self) -> ShapeKind {
        ShapeKind::Annulus
    }

    fn arguments(&self) -> Vec<f64> {
        let Annulus { inner_radius, outer_radius, z_offset } = *self;
        vec![inner_radius * inner_radius, outer_radius * outer_radius, z_offset]
    }

    fn quadric(&self) -> Option<Quadric> {
        Some(Quadric { constant: -2.0 * self.z_offset, ..Quadric::PLANE })
    }

    fn holds(&self, p: DVec3) -> bool {
        let Annulus { inner_radius, outer_radius, .. } = *self;
        (inner_radius * inner_radius..=outer_radius * outer_radius).contains(&p.truncate().length_squared())
    }

    fn extent(&self, _: &[Mesh]) -> Option<Extent> {
        let Annulus { outer_radius, z_offset, .. } = *self;
        Some(Extent::round(outer_radius, z_offset, z_offset, outer_radius + z_offset.abs()))
    }

    fn samples(&self) -> Vec<DVec3> {
        ring_samples(&[(0.5 * (self.inner_radius + self.outer_radius), self.z_offset)])
    }

    fn rims(&self) -> Vec<(f64, f64)> {
        vec![(self.inner_radius, self.z_offset), (self.outer_radius, self.z_offset)]
    }

    fn section(&self) -> Vec<Vec<DVec2>> {
        let Annulus { inner_radius, outer_radius, z_offset } = *self;
        let sides = [(inner_radius, outer_radius), (-outer_radius, -inner_radius)];
        sides.map(|(from, to)| section_between(from, to, |_| z_offset)).to_vec()
    }

    fn slab(&self) -> Option<Slab> {
        Some(Slab { ends: [self.z_offset; 2], steepness: None })
    }

    fn opening(&self) -> Option<f64> {
        Some(self.inner_radius)
    }

    fn flat(&self) -> Option<Flat> {
        let outline = Outline::Disk { radius: self.outer_radius };
        Some(Flat { outline, hole: self.inner_radius, z: self.z_offset })
    }
}
