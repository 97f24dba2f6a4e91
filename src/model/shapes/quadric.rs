//! Quadrics of revolution: what all analytic shapes share.

use glam::{DMat3, DVec3};

/// The surface radial (x^2 + y^2) + axial z^2 + 2 offset z + constant = 0 in a shape's frame, coordinates in mm.
///
/// The gradient of half the left side points along the geometric normal. Its scale is chosen such that it has a unit
/// length at the vertex; shaders/geometry/quadric.wgsl has the same numbers.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Quadric {
    /// Factor of x^2 + y^2.
    pub radial: f64,
    /// Factor of z^2.
    pub axial: f64,
    /// Half the factor of z.
    pub offset: f64,
    /// What does not depend on the position.
    pub constant: f64,
}

/// The function that is zero on a shape, and its derivatives, at one point of the shape's frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Level {
    /// The value: positive on the side that the normal points to.
    pub value: f64,
    /// The gradient, along the geometric normal where the value is zero.
    pub gradient: DVec3,
    /// The second derivatives.
    pub hessian: DMat3,
}

impl Quadric {
    /// The plane z = 0, its normal along z.
    pub const PLANE: Quadric = Quadric { radial: 0.0, axial: 0.0, offset: 1.0, constant: 0.0 };

    /// True for a plane.
    pub fn is_flat(&self) -> bool {
        self.radial == 0.0 && self.axial == 0.0
    }

    /// True if the gradient has a unit length everywhere on the quadric: for planes and spheres.
    pub fn has_unit_gradient(&self) -> bool {
        self.radial == self.axial
    }

    /// Half the left side at a point, with its derivatives.
    pub fn level(&self, p: DVec3) -> Level {
        let Quadric { radial, axial, offset, constant } = *self;
        let r2 = p.x * p.x + p.y * p.y;
        Level {
            value: 0.5 * (radial * r2 + axial * p.z * p.z + constant) + offset * p.z,
            gradient: DVec3::new(radial * p.x, radial * p.y, axial * p.z + offset),
            hessian: DMat3::from_diagonal(DVec3::new(radial, radial, axial)),
        }
    }

    /// Where the line o + t d crosses the quadric, as values of t in no order; without cancellation.
    pub fn crossings(self, o: DVec3, d: DVec3) -> impl Iterator<Item = f64> {
        const TINY: f64 = 1e-30;
        let Quadric { radial, axial, offset, constant } = self;
        let dot = |p: DVec3, q: DVec3| radial * (p.x * q.x + p.y * q.y) + axial * p.z * q.z;
        let (a, b, c) =
            (dot(d, d), 2.0 * (dot(o, d) + offset * d.z), dot(o, o) + 2.0 * offset * o.z + constant);
        let discriminant = b * b - 4.0 * a * c;
        let q = -0.5 * (b + discriminant.sqrt().copysign(b));
        let is_crossed = discriminant >= 0.0;
        let first = (is_crossed && a.abs() > TINY).then(|| q / a);
        let second = (is_crossed && q.abs() > TINY).then(|| c / q);
        [first, second].into_iter().flatten()
    }
}
