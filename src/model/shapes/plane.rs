//! A plane across the axis within an outline; also the plane of every detector.

use crate::model::checks;
use crate::model::mesh::Mesh;
use crate::model::shapes::{
    Extent, Flat, Geometry, Normal, Quadric, Shape, ShapeKind, ShapeWgsl, Slab, WrittenShape, circle,
    ring_samples,
};
use crate::shaders::shader;
use crate::{Error, Result};
use glam::DVec3;
use schemars::JsonSchema;
use serde::Deserialize;

/// The plane without an end.
pub const PLANE: ShapeWgsl = ShapeWgsl {
    name: "plane",
    file: shader!("shapes/plane.wgsl"),
    num_arguments: 0,
    normal: Normal::Quadric(|_| FLAT.into()),
};

/// A part of it.
pub const RECTANGLE: ShapeWgsl = ShapeWgsl { name: "rectangle", num_arguments: 2, ..PLANE };
/// A part of it.
pub const DISK: ShapeWgsl = ShapeWgsl { name: "disk", num_arguments: 1, ..PLANE };

/// [`Quadric::PLANE`], as WGSL has it.
pub const FLAT: &str = "Quadric(0.0, 0.0, 1.0, 0.0)";

/// The outline of the plane z = 0, its normal along z.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Outline {
    /// No limit.
    Infinite,
    /// |x| <= width/2 and |y| <= height/2.
    Rectangle {
        /// Full width along local x \[mm\].
        width: f64,
        /// Full height along local y \[mm\].
        height: f64,
    },
    /// r <= radius.
    Disk {
        /// Radius \[mm\].
        radius: f64,
    },
}

/// A plane in a scene file.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Written {
    /// Full width \[mm\].
    #[serde(default)]
    pub width: Option<f64>,
    /// Full height \[mm\].
    #[serde(default)]
    pub height: Option<f64>,
    /// Radius \[mm\].
    #[serde(default)]
    pub aperture_radius: Option<f64>,
}

impl WrittenShape for Written {
    fn check(&self, at: &dyn Fn(&str) -> String) -> Result<()> {
        let sizes =
            [("width", self.width), ("height", self.height), ("aperture_radius", self.aperture_radius)];
        sizes.into_iter().try_for_each(|(key, value)| value.map_or(Ok(()), |v| checks::size(at(key), v)))
    }

    fn shape(&self, place: &str, _: Option<usize>) -> Result<Shape> {
        // A disk wins over a rectangle, as in Optiland.
        match (self.aperture_radius, self.width, self.height) {
            (Some(radius), ..) => Ok(Shape::Plane(Outline::Disk { radius })),
            (None, Some(width), Some(height)) => Ok(Shape::Plane(Outline::Rectangle { width, height })),
            (None, None, None) => Ok(Shape::Plane(Outline::Infinite)),
            (None, Some(_), None) | (None, None, Some(_)) => Err(Error::scene(
                place,
                "a rectangle needs both `width` and `height`",
                "give both, or `aperture_radius` for a disk, or neither for an unlimited plane",
            )),
        }
    }
}

impl Geometry for Outline {
    fn kind(&self) -> ShapeKind {
        match self {
            Outline::Infinite => ShapeKind::Plane,
            Outline::Rectangle { .. } => ShapeKind::Rectangle,
            Outline::Disk { .. } => ShapeKind::Disk,
        }
    }

    fn arguments(&self) -> Vec<f64> {
        match *self {
            Outline::Infinite => vec![],
            Outline::Rectangle { width, height } => vec![width / 2.0, height / 2.0],
            Outline::Disk { radius } => vec![radius * radius],
        }
    }

    fn quadric(&self) -> Option<Quadric> {
        Some(Quadric::PLANE)
    }

    fn holds(&self, p: DVec3) -> bool {
        match *self {
            Outline::Infinite => true,
            Outline::Rectangle { width, height } => p.x.abs() <= width / 2.0 && p.y.abs() <= height / 2.0,
            Outline::Disk { radius } => p.truncate().length_squared() <= radius * radius,
        }
    }

    fn extent(&self, _: &[Mesh]) -> Option<Extent> {
        match *self {
            // An endless plane has no box.
            Outline::Infinite => None,
            Outline::Rectangle { width, height } => {
                let half = 0.5 * DVec3::new(width, height, 0.0);
                Some(Extent::block(-half, half))
            }
            Outline::Disk { radius } => Some(Extent::round(radius, 0.0, 0.0, radius)),
        }
    }

    fn samples(&self) -> Vec<DVec3> {
        match *self {
            Outline::Infinite => ring_samples(&[(1.0, 0.0), (100.0, 0.0)]),
            Outline::Rectangle { width, height } => ring_samples(&[(0.5 * width.min(height), 0.0)]),
            Outline::Disk { radius } => ring_samples(&[(0.9 * radius, 0.0)]),
        }
    }

    fn edges(&self, _: &[Mesh]) -> Vec<Vec<DVec3>> {
        match *self {
            // An endless plane has no outline that could be drawn.
            Outline::Infinite => Vec::new(),
            Outline::Disk { radius } => vec![circle(radius, 0.0)],
            Outline::Rectangle { width, height } => {
                let corner = |u: f64, v: f64| DVec3::new(u * width / 2.0, v * height / 2.0, 0.0);
                let corners = [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0)];
                vec![corners.map(|(u, v)| corner(u, v)).to_vec()]
            }
        }
    }

    fn slab(&self) -> Option<Slab> {
        Some(Slab { ends: [0.0; 2], steepness: None })
    }

    fn flat(&self) -> Option<Flat> {
        Some(Flat { outline: *self, hole: 0.0, z: 0.0 })
    }
}
