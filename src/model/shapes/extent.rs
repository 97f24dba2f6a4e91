//! What a shape fills.

use glam::{DMat3, DVec2, DVec3};

/// A cylinder or a block about the axis that holds a shape, in its frame \[mm\].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Extent {
    /// The middle.
    pub middle: DVec3,
    /// How far it goes across the axis.
    pub across: Across,
    /// Half of how far it goes along the axis.
    pub half_height: f64,
    /// Radius of a ball about the origin that holds the shape.
    pub reach: f64,
    /// The scale of rounding errors: the largest coordinate that the formula of a crossing squares \[mm\]. It is infinite
    /// where crossings are so ill-conditioned that no box holds what a ray is found to hit.
    pub size: f64,
}

/// Across the axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Across {
    /// A disk of this radius \[mm\].
    Disk(f64),
    /// A rectangle of these half sides \[mm\].
    Rectangle(DVec2),
}

impl Extent {
    /// The extent of a shape of revolution with this outer radius, between two heights.
    pub fn round(radius: f64, low: f64, high: f64, size: f64) -> Self {
        Extent {
            middle: DVec3::new(0.0, 0.0, 0.5 * (low + high)),
            across: Across::Disk(radius),
            half_height: 0.5 * (high - low),
            reach: radius.hypot(low.abs().max(high.abs())),
            size,
        }
    }

    /// A block between two corners.
    pub fn block(low: DVec3, high: DVec3) -> Self {
        let half = 0.5 * (high - low);
        let farthest = low.abs().max(high.abs());
        Extent {
            middle: 0.5 * (low + high),
            across: Across::Rectangle(half.truncate()),
            half_height: half.z,
            reach: farthest.length(),
            size: farthest.max_element(),
        }
    }

    /// How far the shape reaches from its middle along the global axes, if its frame is rotated by this \[mm\]. For a
    /// disk it is exact, and less than for a box around the disk.
    pub fn reach_along(&self, rotation: &DMat3) -> DVec3 {
        let [x, y, z] = [rotation.x_axis, rotation.y_axis, rotation.z_axis];
        let across = match self.across {
            Across::Disk(radius) => radius * (x * x + y * y).map(f64::sqrt),
            Across::Rectangle(half) => half.x * x.abs() + half.y * y.abs(),
        };
        across + self.half_height * z.abs()
    }
}
