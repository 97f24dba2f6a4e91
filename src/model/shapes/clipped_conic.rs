//! A conic within an aperture that need be neither round nor on the axis: off-axis mirrors, mirrors with a hole, faces with
//! a rectangular rim.

use crate::Result;
use crate::model::checks;
use crate::model::mesh::Mesh;
use crate::model::shapes::conic::{Conic, curvature};
use crate::model::shapes::{Entry, Extent, Geometry, Normal, Quadric, Shape, ShapeKind, ShapeWgsl, circle};
use crate::shaders::shader;
use glam::{DVec2, DVec3};
use schemars::JsonSchema;
use serde::Deserialize;
use std::f64::consts::{SQRT_2, TAU};

/// The clipped conic.
pub const CLIPPED_CONIC: ShapeWgsl = ShapeWgsl {
    name: "clipped_conic",
    file: shader!("shapes/clipped_conic.wgsl"),
    num_arguments: 9,
    normal: Normal::Quadric(|a| format!("clipped_conic_quadric({}, {})", a[0], a[1])),
};

/// A conic within its semi-diameter and within an aperture, its normal along z at the vertex.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ClippedConic {
    /// The conic, whose `aperture_radius` bounds it as well.
    pub conic: Conic,
    /// The aperture.
    pub aperture: Aperture,
}

/// A part of the plane across the axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Aperture {
    /// Its outline.
    pub outline: ApertureOutline,
    /// Its middle \[mm\].
    pub middle: DVec2,
    /// Its semi-axes along x and y \[mm\].
    pub semi_axes: DVec2,
    /// Radius of a round hole about its middle \[mm\]; 0 for none.
    pub hole: f64,
    /// True for all that it leaves out.
    pub inverted: bool,
}

/// What an aperture is bounded by.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum ApertureOutline {
    /// An ellipse, or a circle.
    Ellipse,
    /// A rectangle.
    Rectangle,
}

impl Aperture {
    fn mode(&self) -> f64 {
        let outline = match self.outline {
            ApertureOutline::Ellipse => 0.0,
            ApertureOutline::Rectangle => 1.0,
        };
        outline + if self.inverted { 2.0 } else { 0.0 }
    }

    fn holds(&self, p: DVec2) -> bool {
        let from_middle = p - self.middle;
        let scaled = from_middle / self.semi_axes;
        let inside = match self.outline {
            ApertureOutline::Ellipse => scaled.length_squared() <= 1.0,
            ApertureOutline::Rectangle => scaled.abs().max_element() <= 1.0,
        } && from_middle.length_squared() >= self.hole * self.hole;
        inside != self.inverted
    }

    /// Its outline as a closed curve.
    fn curve(&self) -> Vec<DVec2> {
        const STEPS: i32 = 64;
        let corners = [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0)];
        let scaled: Vec<DVec2> = match self.outline {
            ApertureOutline::Ellipse => {
                (0..=STEPS).map(|step| DVec2::from_angle(TAU * f64::from(step) / f64::from(STEPS))).collect()
            }
            ApertureOutline::Rectangle => corners
                .windows(2)
                .flat_map(|pair| {
                    let [from, to] = [DVec2::from(pair[0]), DVec2::from(pair[1])];
                    (0..=STEPS / 4).map(move |step| from.lerp(to, 4.0 * f64::from(step) / f64::from(STEPS)))
                })
                .collect(),
        };
        scaled.into_iter().map(|p| self.middle + p * self.semi_axes).collect()
    }
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
    pub aperture: WrittenAperture,
}

/// An aperture in a scene file.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
#[schemars(rename = "Aperture")]
pub struct WrittenAperture {
    /// What bounds it.
    pub outline: ApertureOutline,
    /// Its semi-axis along x \[mm\].
    pub semi_axis_x: f64,
    /// Its semi-axis along y \[mm\].
    pub semi_axis_y: f64,
    /// Its middle along x \[mm\].
    #[serde(default)]
    pub x: f64,
    /// Its middle along y \[mm\].
    #[serde(default)]
    pub y: f64,
    /// Radius of a round hole about its middle \[mm\]; 0 for none.
    #[serde(default)]
    pub hole_radius: f64,
    /// True for all that it leaves out.
    #[serde(default)]
    pub inverted: bool,
}

impl Entry for Written {
    fn check(&self, at: &dyn Fn(&str) -> String) -> Result<()> {
        checks::radius(at("radius"), self.radius)?;
        checks::conic_constant(at("conic"), self.conic)?;
        checks::size(at("aperture_radius"), self.aperture_radius)?;
        let place = at("aperture");
        let at = |key: &str| format!("{place}.{key}");
        let aperture = &self.aperture;
        checks::size(at("semi_axis_x"), aperture.semi_axis_x)?;
        checks::size(at("semi_axis_y"), aperture.semi_axis_y)?;
        checks::position(at("x"), aperture.x)?;
        checks::position(at("y"), aperture.y)?;
        checks::between(at("hole_radius"), aperture.hole_radius, 0.0, checks::MAX_LENGTH)
    }

    fn shape(&self, place: &str, _: Option<usize>) -> Result<Shape> {
        let Written { radius, conic, aperture_radius, ref aperture } = *self;
        let shape = ClippedConic {
            conic: Conic { curvature: curvature(radius), conic, aperture_radius },
            aperture: Aperture {
                outline: aperture.outline,
                middle: DVec2::new(aperture.x, aperture.y),
                semi_axes: DVec2::new(aperture.semi_axis_x, aperture.semi_axis_y),
                hole: aperture.hole_radius,
                inverted: aperture.inverted,
            },
        };
        if shape.samples().is_empty() {
            checks::refuse(
                place,
                "its aperture leaves nothing of the conic",
                "give an aperture within aperture_radius",
            )?;
        }
        Ok(Shape::ClippedConic(shape))
    }
}

impl Geometry for ClippedConic {
    fn kind(&self) -> ShapeKind {
        ShapeKind::ClippedConic
    }

    fn arguments(&self) -> Vec<f64> {
        let Conic { curvature, conic, aperture_radius } = self.conic;
        let Aperture { middle, semi_axes, hole, .. } = self.aperture;
        vec![
            curvature,
            (1.0 + conic) * curvature,
            aperture_radius * aperture_radius,
            middle.x,
            middle.y,
            1.0 / semi_axes.x,
            1.0 / semi_axes.y,
            hole * hole,
            self.aperture.mode(),
        ]
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

    /// Points of a spiral over the aperture, or over what it leaves of the conic, as far as they belong to the shape.
    fn samples(&self) -> Vec<DVec3> {
        const POINTS: i32 = 4096;
        /// The turn that repeats itself least.
        const GOLDEN: f64 = 0.618_033_988_749_894_9;
        let widest = 0.999_999 * self.conic.aperture_radius.min(self.conic.widest());
        let Aperture { middle, semi_axes, .. } = self.aperture;
        let spiral = |middle: DVec2, semi_axes: DVec2| {
            (0..POINTS).map(move |i| {
                let share = ((f64::from(i) + 0.5) / f64::from(POINTS)).sqrt();
                middle + DVec2::from_angle(f64::from(i) * GOLDEN * TAU) * share * semi_axes
            })
        };
        let is_part = |p: &DVec2| p.length() <= widest && self.aperture.holds(*p);
        // One of both may be far larger than the other. A rectangle reaches farther than the ellipse within it.
        let over_both = [(middle, SQRT_2 * semi_axes), (DVec2::ZERO, DVec2::splat(widest))];
        let candidates = over_both
            .map(|(middle, semi_axes)| spiral(middle, semi_axes).filter(is_part).collect::<Vec<_>>());
        let inside = candidates.iter().max_by_key(|points| points.len()).map_or(&[][..], Vec::as_slice);
        // Not every 34th or 89th, which are turned by next to nothing.
        let chosen =
            (0..12.min(inside.len())).map(|k| inside[(k * inside.len() / 12 + 5 * k) % inside.len()]);
        chosen.map(|p| p.extend(self.conic.sag(p.length()))).collect()
    }

    fn edges(&self, _: &[Mesh]) -> Vec<Vec<DVec3>> {
        let widest = self.conic.aperture_radius.min(self.conic.widest());
        let lifted = |p: DVec2| {
            let p = p.clamp_length_max(widest);
            p.extend(self.conic.sag(p.length()))
        };
        let mut curves = vec![self.aperture.curve().into_iter().map(lifted).collect()];
        if self.aperture.inverted {
            curves.push(circle(widest, self.conic.sag(widest)));
        }
        if self.aperture.hole > 0.0 {
            let hole = Aperture {
                outline: ApertureOutline::Ellipse,
                semi_axes: DVec2::splat(self.aperture.hole),
                ..self.aperture
            };
            curves.push(hole.curve().into_iter().map(lifted).collect());
        }
        curves
    }

    fn conic(&self) -> Option<Conic> {
        Some(self.conic)
    }
}
