//! Biconics: two conic profiles, one along x and one along y, whose heights add up.

use crate::Result;
use crate::model::checks;
use crate::model::shapes::conic::curvature;
use crate::model::shapes::profile::AsphereProfile;
use crate::model::shapes::sag::{Bounds, ROOM, Sag, SagAt, SagSurface, check_aperture};
use crate::model::shapes::{Normal, Shape, ShapeKind, ShapeWgsl, WrittenShape, aperture};
use crate::shaders::shader;
use glam::{DMat2, DVec2};
use schemars::JsonSchema;
use serde::Deserialize;

/// The surface.
pub type BiconicSurface = SagSurface<Biconic>;

/// The biconic.
pub const BICONIC: ShapeWgsl = ShapeWgsl {
    name: "biconic",
    file: shader!("shapes/biconic.wgsl"),
    num_arguments: 11,
    normal: Normal::Sag,
};

/// z = the sum over x and y of c x^2 / (1 + sqrt(1 - (1 + conic) c^2 x^2)), within a semi-diameter.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Biconic {
    /// Vertex curvatures along x and y \[1/mm\].
    pub curvature: DVec2,
    /// Conic constants.
    pub conic: DVec2,
    /// Semi-diameter \[mm\].
    pub aperture_radius: f64,
}

/// A biconic in a scene file.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
#[schemars(rename = "Biconic")]
pub struct Written {
    /// Vertex radius along x \[mm\].
    pub radius_x: f64,
    /// Vertex radius along y \[mm\].
    pub radius_y: f64,
    /// Conic constant along x.
    #[serde(default)]
    pub conic_x: f64,
    /// Conic constant along y.
    #[serde(default)]
    pub conic_y: f64,
    /// Semi-diameter \[mm\].
    pub aperture_radius: f64,
    /// The part across the axis that there is; all if null.
    #[serde(default)]
    pub aperture: Option<aperture::Written>,
}

impl WrittenShape for Written {
    fn check(&self, at: &dyn Fn(&str) -> String) -> Result<()> {
        checks::size(at("aperture_radius"), self.aperture_radius)?;
        for (axis, radius, conic) in [("x", self.radius_x, self.conic_x), ("y", self.radius_y, self.conic_y)]
        {
            checks::radius(at(&format!("radius_{axis}")), radius)?;
            checks::conic_constant(at(&format!("conic_{axis}")), conic)?;
            AsphereProfile::check_reach(radius, conic, self.aperture_radius, at)?;
        }
        check_aperture(self.aperture.as_ref(), at)
    }

    fn shape(&self, place: &str, _: Option<usize>) -> Result<Shape> {
        let biconic = Biconic {
            curvature: DVec2::new(curvature(self.radius_x), curvature(self.radius_y)),
            conic: DVec2::new(self.conic_x, self.conic_y),
            aperture_radius: self.aperture_radius,
        };
        SagSurface::written(biconic, self.aperture.as_ref(), place).map(Shape::Biconic)
    }
}

impl Biconic {
    /// The profiles along x and y.
    fn profiles(&self) -> [AsphereProfile; 2] {
        [0, 1].map(|axis| AsphereProfile {
            curvature: self.curvature[axis],
            conic: self.conic[axis],
            ..AsphereProfile::new(0.0, 0.0, self.aperture_radius, 2, &[])
        })
    }
}

impl Sag for Biconic {
    fn aperture_radius(&self) -> f64 {
        self.aperture_radius
    }

    fn height(&self, p: DVec2) -> f64 {
        let [x, y] = self.profiles();
        x.sag(p.x) + y.sag(p.y)
    }

    fn kind(&self) -> ShapeKind {
        ShapeKind::Biconic
    }

    fn magnitude(&self) -> f64 {
        let [x, y] = self.profiles();
        x.conic_magnitude() + y.conic_magnitude()
    }

    fn numbers(&self) -> Vec<f64> {
        let [x, y] = self.profiles();
        vec![x.curvature, x.axial(), y.curvature, y.axial()]
    }

    fn is_one_with(&self, other: &Self) -> bool {
        Biconic { aperture_radius: self.aperture_radius, ..*other } == *self
    }

    fn of_shape(shape: &Shape) -> Option<&SagSurface<Self>> {
        let Shape::Biconic(surface) = shape else { return None };
        Some(surface)
    }

    fn at(&self, p: DVec2) -> SagAt {
        let [x, y] = self.profiles();
        let (x, y) = (x.at(DVec2::new(p.x, 0.0)), y.at(DVec2::new(p.y, 0.0)));
        SagAt {
            height: x.height + y.height,
            gradient: DVec2::new(x.gradient.x, y.gradient.x),
            hessian: DMat2::from_diagonal(DVec2::new(x.hessian.x_axis.x, y.hessian.x_axis.x)),
        }
    }

    /// Each profile and its derivatives grow or fall from the axis to the rim.
    fn bounds(&self) -> Bounds {
        let rim = DVec2::new(ROOM * self.aperture_radius, 0.0);
        let [x, y] = self.profiles().map(|profile| (profile.at(DVec2::ZERO), profile.at(rim)));
        let ends = |(vertex, rim): (SagAt, SagAt)| {
            let bend = vertex.hessian.x_axis.x.abs().max(rim.hessian.x_axis.x.abs());
            (rim.height.min(0.0), rim.height.max(0.0), rim.gradient.x, bend)
        };
        let (x, y) = (ends(x), ends(y));
        Bounds { lowest: x.0 + y.0, highest: x.1 + y.1, slope: x.2.hypot(y.2), bend: x.3.max(y.3) }
            .with_room(self.aperture_radius)
    }
}
