//! The triangles of meshes as shaders/shapes/mesh.wgsl reads them: one list, in the order of the trees over them.

use crate::model::{Mesh, SceneIr, unit_normal};
use crate::program::geometry::bvh::Forest;
use glam::DVec3;
use obvhs::aabb::Aabb;

/// Rows of a triangle: three times a corner and a component of the normal.
const TRIANGLE_ROWS: usize = 3;

/// The share of the mesh's size by which a box is larger than its contents. The share is 64 units of 2^-24, which cover
/// all rounding in f32. The box contributes, and so do the corners that the ray sees. The ray's base and direction
/// contribute 2 units each. The slabs contribute 16: two differences and three products, over a box and its grid, with
/// an inverse good to 2.5 ulp.
const PADDING: f64 = 1.0 / (1 << 18) as f64;

/// The triangles of all meshes.
#[derive(Debug, Default)]
pub struct Triangles {
    corners: Vec<[DVec3; 3]>,
    /// The face of the mesh that each triangle is.
    faces: Vec<u32>,
    /// The first triangle of each mesh.
    firsts: Vec<usize>,
}

impl Triangles {
    /// Builds a tree over each mesh.
    pub fn of(meshes: &[Mesh], forest: &mut Forest) -> Self {
        let mut triangles = Triangles::default();
        for (i, mesh) in meshes.iter().enumerate() {
            let order = forest.plant(root(i) as usize, &boxes(mesh), triangles.corners.len() as u32);
            let corners = |&face: &u32| mesh.corners(mesh.faces[face as usize]);
            triangles.firsts.push(triangles.corners.len());
            triangles.faces.extend(&order);
            triangles.corners.extend(order.iter().map(corners));
        }
        triangles
    }

    /// The number of a mesh's first triangle, and the faces of the mesh in the order of its triangles.
    pub fn of_mesh(&self, mesh: usize) -> (usize, &[u32]) {
        let first = self.firsts[mesh];
        let end = self.firsts.get(mesh + 1).copied().unwrap_or(self.faces.len());
        (first, &self.faces[first..end])
    }

    /// Rows of all triangles. In f32 they follow the trees; in the other tiers they have a buffer of their own.
    pub fn num_rows(&self) -> usize {
        TRIANGLE_ROWS * self.corners.len()
    }

    /// The contents of all rows, four numbers each. The rows include a triangle's normal, because rounded corners would
    /// tilt it.
    pub fn reals(&self) -> impl Iterator<Item = f64> + '_ {
        let rows = self.corners.iter().flat_map(|&corners| {
            let normal = unit_normal(corners);
            [0, 1, 2].map(|i| [corners[i].x, corners[i].y, corners[i].z, normal[i]])
        });
        rows.flatten()
    }
}

/// The root of a mesh's tree. The roots of meshes come first.
pub fn root(mesh: usize) -> u32 {
    mesh as u32
}

/// The largest distance in f32 between a ray and the facet that it leaves \[mm\]. The value is 16 units of 2^-24 of the
/// largest coordinate of any mesh.
pub fn edge_slack(ir: &SceneIr, centre: DVec3) -> f64 {
    const ROUNDINGS: f64 = 16.0;
    let size = |surface: &crate::model::Surface| {
        let mesh = surface.shape.mesh()?;
        let reach = ir.meshes[mesh].vertices.iter().map(|p| p.length()).fold(0.0, f64::max);
        Some((surface.frame.origin - centre).abs().max_element() + reach)
    };
    ROUNDINGS * 0.5 * f64::from(f32::EPSILON) * ir.surfaces.iter().filter_map(size).fold(0.0, f64::max)
}

fn boxes(mesh: &Mesh) -> Vec<Aabb> {
    let size = mesh.vertices.iter().map(|v| v.abs().max_element()).fold(0.0, f64::max);
    let padding = DVec3::splat(PADDING * size);
    let bounds = |face: &[u32; 3]| {
        let [a, b, c] = mesh.corners(*face);
        let (low, high) = (a.min(b).min(c) - padding, a.max(b).max(c) + padding);
        Aabb::new(low.as_vec3a(), high.as_vec3a())
    };
    mesh.faces.iter().map(bounds).collect()
}
