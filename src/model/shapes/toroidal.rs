//! Toroids: a profile along y, turned about an axis parallel to y.

use crate::Result;
use crate::model::checks;
use crate::model::mesh::Mesh;
use crate::model::shapes::conic::curvature;
use crate::model::shapes::profile::{Profile, Ring};
use crate::model::shapes::sag::{Bounds, ROOM, Sag, SagAt, largest_bend};
use crate::model::shapes::{Entry, Extent, Geometry, Level, Normal, Shape, ShapeKind, ShapeWgsl};
use crate::shaders::shader;
use glam::{DMat2, DVec2, DVec3};
use schemars::JsonSchema;
use serde::Deserialize;

/// The toroid.
pub const TOROIDAL: ShapeWgsl = ShapeWgsl {
    name: "toroidal",
    file: shader!("shapes/toroidal.wgsl"),
    num_arguments: 20,
    normal: Normal::Sag,
};

/// z = h + c x^2 / (w + sqrt(w^2 - c^2 x^2)), where h is the profile's height at y, c the curvature along x, and w =
/// 1 - c h: the profile turned about the line z = 1/c, x = 0.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Toroidal {
    /// Curvature along x \[1/mm\].
    pub curvature_x: f64,
    /// The profile along y, with its semi-diameter.
    pub profile: Profile,
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
}

impl Written {
    fn toroid(&self) -> Toroidal {
        let profile = Profile::new(self.radius_y, self.conic, self.aperture_radius, 2, &self.coeffs_poly_y);
        Toroidal { curvature_x: curvature(self.radius_x), profile }
    }
}

impl Entry for Written {
    fn check(&self, at: &dyn Fn(&str) -> String) -> Result<()> {
        checks::radius(at("radius_x"), self.radius_x)?;
        let renamed = |key: &str| match key {
            "radius" => at("radius_y"),
            "coefficients" => at("coeffs_poly_y"),
            _ => at(key),
        };
        Profile::check(self.radius_y, self.conic, self.aperture_radius, &self.coeffs_poly_y, &renamed)?;
        if self.toroid().strips().any(|strip| strip.is_none()) {
            let problem = format!("a toroid turned at {} mm ends within it", self.radius_x);
            return checks::refuse(
                at("aperture_radius"),
                problem,
                "give less: a toroid needs its slope at the rim",
            );
        }
        Ok(())
    }

    fn shape(&self, _: &str, _: Option<usize>) -> Result<Shape> {
        Ok(Shape::Toroidal(self.toroid()))
    }
}

impl Toroidal {
    /// Bounds of strips of the aperture along x, each for a ring of the profile; none of one that has no slope somewhere.
    fn strips(&self) -> impl Iterator<Item = Option<Bounds>> {
        /// The least sqrt(w^2 - c^2 x^2): the slope grows with its inverse.
        const LEAST: f64 = 0.01;
        let (c, rim) = (self.curvature_x, ROOM * self.profile.aperture_radius);
        self.profile.rings().map(move |Ring { from, bounds, .. }| {
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
        let none = Bounds { lowest: 0.0, highest: 0.0, slope: 0.0, bend: 0.0 };
        let all = self.strips().flatten().fold(none, |all, strip| Bounds {
            lowest: all.lowest.min(strip.lowest),
            highest: all.highest.max(strip.highest),
            slope: all.slope.max(strip.slope),
            bend: all.bend.max(strip.bend),
        });
        all.with_room(self.profile.aperture_radius)
    }
}

impl Geometry for Toroidal {
    fn kind(&self) -> ShapeKind {
        ShapeKind::Toroidal
    }

    fn arguments(&self) -> Vec<f64> {
        let profile = &self.profile;
        let coefficients = profile.at_rim();
        let x = Profile { curvature: self.curvature_x, conic: 0.0, ..*profile };
        let along = coefficients.iter().map(|a| a.abs()).sum::<f64>() + profile.conic_magnitude();
        let mut arguments = self.search_arguments(along + x.conic_magnitude());
        let per_limit = profile.aperture_radius.powi(-2);
        arguments.extend([per_limit, self.curvature_x, profile.curvature, profile.axial()]);
        arguments.extend(coefficients);
        arguments
    }

    fn coincides(&self, other: &Shape) -> bool {
        let Shape::Toroidal(other) = other else { return false };
        let profile = Profile { aperture_radius: self.profile.aperture_radius, ..other.profile };
        Toroidal { profile, ..*other } == *self
    }

    fn level(&self, p: DVec3) -> Option<Level> {
        Some(self.sag_level(p))
    }

    fn holds(&self, p: DVec3) -> bool {
        p.truncate().length_squared() <= self.profile.aperture_radius.powi(2)
    }

    fn extent(&self, _: &[Mesh]) -> Option<Extent> {
        Some(self.sag_extent())
    }

    fn samples(&self) -> Vec<DVec3> {
        self.sag_samples()
    }

    fn section(&self) -> Vec<Vec<DVec2>> {
        self.sag_section()
    }

    fn edges(&self, _: &[Mesh]) -> Vec<Vec<DVec3>> {
        self.sag_edges()
    }

    fn crossings(&self, o: DVec3, d: DVec3) -> Vec<f64> {
        self.sag_crossings(o, d)
    }
}
