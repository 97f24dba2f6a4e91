//! Toroids: a profile along y, turned about an axis parallel to y.

use crate::Result;
use crate::model::checks;
use crate::model::shapes::conic::curvature;
use crate::model::shapes::profile::{AsphereProfile, Ring};
use crate::model::shapes::sag::{Bounds, ROOM, Sag, SagAt, SagSurface, check_aperture, largest_bend};
use crate::model::shapes::{Normal, Shape, ShapeKind, ShapeWgsl, WrittenShape, aperture};
use crate::shaders::shader;
use glam::{DMat2, DVec2};
use schemars::JsonSchema;
use serde::Deserialize;

/// The surface.
pub type ToroidalSurface = SagSurface<Toroidal>;

/// The toroid.
pub const TOROIDAL: ShapeWgsl = ShapeWgsl {
    name: "toroidal",
    file: shader!("shapes/toroidal.wgsl"),
    num_arguments: 21,
    normal: Normal::Sag,
};

/// The profile turned about the line z = 1/c, x = 0. So z = h + c x^2 / (w + sqrt(w^2 - c^2 x^2)). Here h is the
/// profile's height at y, c is the curvature along x, and w = 1 - c h.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Toroidal {
    /// Curvature along x \[1/mm\].
    pub curvature_x: f64,
    /// The profile along y, with its semi-diameter.
    pub profile: AsphereProfile,
}

/// A toroid in a scene file.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
#[schemars(rename = "Toroidal")]
pub struct Written {
    /// Radius of rotation: the vertex radius along x \[mm\].
    pub radius_x: f64,
    /// Vertex radius of the profile along y \[mm\].
    pub radius_y: f64,
    /// Conic constant of the profile along y.
    #[serde(default)]
    pub conic: f64,
    /// Coefficients of y^2, y^4, y^6 and so on, up to ten.
    #[serde(default)]
    pub coeffs_poly_y: Vec<f64>,
    /// Semi-diameter \[mm\].
    pub aperture_radius: f64,
    /// The part across the axis that there is; all if null.
    #[serde(default)]
    pub aperture: Option<aperture::Written>,
}

impl Written {
    fn toroid(&self) -> Toroidal {
        let profile =
            AsphereProfile::new(self.radius_y, self.conic, self.aperture_radius, 2, &self.coeffs_poly_y);
        Toroidal { curvature_x: curvature(self.radius_x), profile }
    }
}

impl WrittenShape for Written {
    fn check(&self, at: &dyn Fn(&str) -> String) -> Result<()> {
        checks::radius(at("radius_x"), self.radius_x)?;
        let renamed = |key: &str| match key {
            "radius" => at("radius_y"),
            "coefficients" => at("coeffs_poly_y"),
            _ => at(key),
        };
        AsphereProfile::check(
            self.radius_y,
            self.conic,
            self.aperture_radius,
            &self.coeffs_poly_y,
            &renamed,
        )?;
        if self.toroid().strips().any(|strip| strip.is_none()) {
            let problem = format!("a toroid turned at {} mm ends within it", self.radius_x);
            return checks::refuse(
                at("aperture_radius"),
                problem,
                "give less: a toroid needs its slope at the rim",
            );
        }
        check_aperture(self.aperture.as_ref(), at)
    }

    fn shape(&self, place: &str, _: Option<usize>) -> Result<Shape> {
        SagSurface::written(self.toroid(), self.aperture.as_ref(), place).map(Shape::Toroidal)
    }
}

impl Toroidal {
    /// Bounds of strips of the aperture along x, each for a ring of the profile; none of one that has no slope somewhere.
    fn strips(&self) -> impl Iterator<Item = Option<Bounds>> {
        /// The least sqrt(w^2 - c^2 x^2): the slope grows with its inverse.
        const LEAST: f64 = 0.01;
        let (c, rim) = (self.curvature_x, ROOM * self.profile.aperture_radius);
        self.profile.rings().map(move |Ring { from, bounds }| {
            let x = (rim * rim - from * from).max(0.0).sqrt();
            let [one, other] = [bounds.lowest, bounds.highest].map(|height| 1.0 - c * height);
            let (least, most) = (one.min(other), one.max(other));
            let s = (least.max(0.0).powi(2) - (c * x).powi(2)).max(0.0).sqrt();
            let rise = c * x * x / (least + s);
            let (slope, bend) = (bounds.slope, bounds.bend);
            let xx = c.abs() * most * most / s.powi(3);
            let xy = c * c * x * most * slope / s.powi(3);
            let yy = c.abs() * slope * slope / s
                + most * bend / s
                + most * most * c.abs() * slope * slope / s.powi(3);
            (s > LEAST).then(|| Bounds {
                lowest: bounds.lowest + rise.min(0.0),
                highest: bounds.highest + rise.max(0.0),
                slope: (c * x / s).hypot(most * slope / s),
                bend: largest_bend(xx, xy, yy),
            })
        })
    }
}

impl Sag for Toroidal {
    fn aperture_radius(&self) -> f64 {
        self.profile.aperture_radius
    }

    fn height(&self, p: DVec2) -> f64 {
        let (h, bent) = (self.profile.sag(p.y.abs()), self.curvature_x * p.x);
        let w = 1.0 - self.curvature_x * h;
        h + bent * p.x / (w + ((w - bent) * (w + bent)).max(0.0).sqrt())
    }

    fn kind(&self) -> ShapeKind {
        ShapeKind::Toroidal
    }

    fn magnitude(&self) -> f64 {
        let x = AsphereProfile { curvature: self.curvature_x, conic: 0.0, ..self.profile };
        self.profile.magnitude() + x.conic_magnitude()
    }

    fn numbers(&self) -> Vec<f64> {
        let profile = &self.profile;
        let per_limit = profile.aperture_radius.powi(-2);
        let mut numbers = vec![per_limit, self.curvature_x, profile.curvature, profile.axial()];
        numbers.extend(profile.at_rim());
        numbers
    }

    fn is_one_with(&self, other: &Self) -> bool {
        self.curvature_x == other.curvature_x && self.profile.is_one_with(&other.profile)
    }

    fn of_shape(shape: &Shape) -> Option<&SagSurface<Self>> {
        let Shape::Toroidal(surface) = shape else { return None };
        Some(surface)
    }

    fn at(&self, p: DVec2) -> SagAt {
        // The profile is even: along its own x, of either sign.
        let along = self.profile.at(DVec2::new(p.y, 0.0));
        let (h, slope, bend) = (along.height, along.gradient.x, along.hessian.x_axis.x);
        let (c, x) = (self.curvature_x, p.x);
        let w = 1.0 - c * h;
        let s = ((w - c * x) * (w + c * x)).max(0.0).sqrt();
        let (xx, xy) = (c * w * w / s.powi(3), c * c * x * w * slope / s.powi(3));
        let yy = (w * bend - c * slope * slope) / s + w * w * c * slope * slope / s.powi(3);
        SagAt {
            height: h + c * x * x / (w + s),
            gradient: DVec2::new(c * x / s, w * slope / s),
            hessian: DMat2::from_cols(DVec2::new(xx, xy), DVec2::new(xy, yy)),
        }
    }

    fn bounds(&self) -> Bounds {
        Bounds::over(self.strips().flatten()).with_room(self.profile.aperture_radius)
    }
}
