//! A conic within an aperture that need be neither round nor on the axis: off-axis mirrors, mirrors with a hole, faces with
//! a rectangular rim.

use crate::Result;
use crate::model::checks;
use crate::model::mesh::Mesh;
use crate::model::shapes::aperture::{self, Aperture};
use crate::model::shapes::conic::{Conic, curvature};
use crate::model::shapes::{
    Extent, Geometry, Normal, Quadric, Shape, ShapeKind, ShapeWgsl, WrittenShape, circle,
};
use crate::shaders::shader;
use glam::{DVec2, DVec3};
use schemars::JsonSchema;
use serde::Deserialize;
use std::sync::Arc;

/// The clipped conic.
pub const CLIPPED_CONIC: ShapeWgsl = ShapeWgsl {
    name: "clipped_conic",
    file: shader!("shapes/clipped_conic.wgsl"),
    num_arguments: 4,
    normal: Normal::Quadric(|a| format!("clipped_conic_quadric({}, {})", a[1], a[2])),
};

/// A conic within its semi-diameter and within an aperture, its normal along z at the vertex.
#[derive(Debug, Clone, PartialEq)]
pub struct ClippedConic {
    /// The conic, whose `aperture_radius` bounds it as well.
    pub conic: Conic,
    /// The aperture.
    pub aperture: Arc<Aperture>,
    /// The aperture for the shaders.
    table: Arc<[f64]>,
}

/// A conic with an aperture in a scene file.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
#[schemars(rename = "ClippedConic")]
pub struct Written {
    /// Vertex radius \[mm\].
    pub radius: f64,
    /// Conic constant.
    #[serde(default)]
    pub conic: f64,
    /// Semi-diameter \[mm\], beyond which there is nothing whatever the aperture says.
    pub aperture_radius: f64,
    /// The part across the axis that there is.
    pub aperture: aperture::Written,
}

impl WrittenShape for Written {
    fn check(&self, at: &dyn Fn(&str) -> String) -> Result<()> {
        checks::radius(at("radius"), self.radius)?;
        checks::conic_constant(at("conic"), self.conic)?;
        checks::size(at("aperture_radius"), self.aperture_radius)?;
        let place = at("aperture");
        self.aperture.check(&|key| format!("{place}.{key}"))
    }

    fn shape(&self, place: &str, _: Option<usize>) -> Result<Shape> {
        let Written { radius, conic, aperture_radius, ref aperture } = *self;
        let conic = Conic { curvature: curvature(radius), conic, aperture_radius };
        let shape = ClippedConic::new(conic, aperture.aperture());
        aperture::check_rest(place, &shape.samples())?;
        Ok(Shape::ClippedConic(shape))
    }
}

impl ClippedConic {
    /// A conic within an aperture.
    pub fn new(conic: Conic, aperture: Aperture) -> Self {
        ClippedConic { conic, table: aperture::table(Some(&aperture)).into(), aperture: Arc::new(aperture) }
    }
}

impl Geometry for ClippedConic {
    fn kind(&self) -> ShapeKind {
        ShapeKind::ClippedConic
    }

    fn arguments(&self) -> Vec<f64> {
        let Conic { curvature, conic, aperture_radius } = self.conic;
        vec![0.0, curvature, (1.0 + conic) * curvature, aperture_radius * aperture_radius]
    }

    fn table(&self) -> Option<&[f64]> {
        Some(&self.table)
    }

    fn is_clipped(&self) -> bool {
        true
    }

    fn quadric(&self) -> Option<Quadric> {
        self.conic.quadric()
    }

    fn holds(&self, p: DVec3) -> bool {
        self.conic.holds(p) && self.aperture.holds(p.truncate())
    }

    fn extent(&self, meshes: &[Mesh]) -> Option<Extent> {
        self.conic.extent(meshes)
    }

    fn samples(&self) -> Vec<DVec3> {
        let widest = 0.999_999 * self.conic.aperture_radius.min(self.conic.widest());
        let samples = self.aperture.samples(widest);
        samples.into_iter().map(|p| p.extend(self.conic.sag(p.length()))).collect()
    }

    fn edges(&self, _: &[Mesh]) -> Vec<Vec<DVec3>> {
        let widest = self.conic.aperture_radius.min(self.conic.widest());
        let lifted = |p: DVec2| {
            let p = p.clamp_length_max(widest);
            p.extend(self.conic.sag(p.length()))
        };
        let mut curves: Vec<Vec<DVec3>> =
            self.aperture.curves().into_iter().map(|curve| curve.into_iter().map(lifted).collect()).collect();
        if self.aperture.inverted {
            curves.push(circle(widest, self.conic.sag(widest)));
        }
        curves
    }

    fn conic(&self) -> Option<Conic> {
        Some(self.conic)
    }
}
