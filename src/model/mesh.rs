//! Triangle meshes.

use glam::DVec3;

/// A triangle mesh in its own frame, best about the origin, where coordinates are of its size \[mm\].
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Mesh {
    /// Corners that faces share.
    pub vertices: Vec<DVec3>,
    /// Indices of three vertices each, counter-clockwise seen from the side that the normal points to.
    pub faces: Vec<[u32; 3]>,
}

impl Mesh {
    /// The corners of a face.
    pub fn corners(&self, face: [u32; 3]) -> [DVec3; 3] {
        face.map(|vertex| self.vertices[vertex as usize])
    }
}

/// Twice the area of a triangle along its normal.
pub fn area_vector([a, b, c]: [DVec3; 3]) -> DVec3 {
    (b - a).cross(c - a)
}

/// The unit normal of a triangle that has an area.
pub fn unit_normal(corners: [DVec3; 3]) -> DVec3 {
    // Scaled first: the square of an area in mm^4 may leave the range of numbers.
    let area = area_vector(corners);
    (area / area.abs().max_element()).normalize()
}
