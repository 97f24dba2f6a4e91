//! Even aspheres: a conic and even powers of the distance from the axis.

use crate::Result;
use crate::model::mesh::Mesh;
use crate::model::shapes::profile::Profile;
use crate::model::shapes::{Entry, Extent, Geometry, Level, Normal, Shape, ShapeKind, ShapeWgsl};
use crate::shaders::shader;
use glam::{DVec2, DVec3};
use schemars::JsonSchema;
use serde::Deserialize;

/// The asphere.
pub const EVEN_ASPHERE: ShapeWgsl = ShapeWgsl {
    name: "even_asphere",
    file: shader!("shapes/even_asphere.wgsl"),
    num_arguments: 19,
    normal: Normal::Sag,
};

/// z = conic + the sum of coefficients\[i\] r^(2 i + 2), its normal along z at the vertex.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EvenAsphere(pub Profile);

/// An even asphere in a scene file.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
#[schemars(rename = "EvenAsphere")]
pub struct Written {
    /// Vertex radius of the conic part \[mm\].
    pub radius: f64,
    /// Conic constant.
    #[serde(default)]
    pub conic: f64,
    /// Semi-diameter \[mm\].
    pub aperture_radius: f64,
    /// Coefficients of r^2, r^4, r^6 and so on, up to ten.
    #[serde(default)]
    pub coefficients: Vec<f64>,
}

impl Entry for Written {
    fn check(&self, at: &dyn Fn(&str) -> String) -> Result<()> {
        Profile::check(self.radius, self.conic, self.aperture_radius, &self.coefficients, at)
    }

    fn shape(&self, _: &str, _: Option<usize>) -> Result<Shape> {
        let Written { radius, conic, aperture_radius, ref coefficients } = *self;
        Ok(Shape::EvenAsphere(EvenAsphere(Profile::new(radius, conic, aperture_radius, 2, coefficients))))
    }
}

impl Geometry for EvenAsphere {
    fn kind(&self) -> ShapeKind {
        ShapeKind::EvenAsphere
    }

    fn arguments(&self) -> Vec<f64> {
        self.0.arguments()
    }

    fn level(&self, p: DVec3) -> Option<Level> {
        Some(self.0.level(p))
    }

    fn holds(&self, p: DVec3) -> bool {
        self.0.holds(p)
    }

    fn extent(&self, _: &[Mesh]) -> Option<Extent> {
        Some(self.0.extent())
    }

    fn samples(&self) -> Vec<DVec3> {
        self.0.samples()
    }

    fn rims(&self) -> Vec<(f64, f64)> {
        self.0.rims()
    }

    fn section(&self) -> Vec<Vec<DVec2>> {
        self.0.section()
    }

    fn coincides(&self, other: &Shape) -> bool {
        let Shape::EvenAsphere(other) = other else { return false };
        Profile { aperture_radius: self.0.aperture_radius, ..other.0 } == self.0
    }

    fn crossings(&self, o: DVec3, d: DVec3) -> Vec<f64> {
        self.0.crossings(o, d)
    }
}
