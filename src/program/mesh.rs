//! Meshes as shaders/shapes/mesh.wgsl reads them: one list of triangles, and a tree of boxes over those of each mesh.

use crate::error::{Error, Result};
use crate::ir::{Mesh, unit_normal};
use glam::DVec3;
use obvhs::BvhBuildParams;
use obvhs::aabb::Aabb;
use obvhs::bvh2::builder::build_bvh2;

/// Binding of the trees and triangles in group 0.
pub const ROWS: u32 = 17;
/// Rows of a node: (lower corner, first), (upper corner, count).
const NODE_ROWS: u32 = 2;
/// Rows of a triangle: three times a corner and a component of the normal.
const TRIANGLE_ROWS: u32 = 3;

/// A box is larger than what it holds by this share of the mesh's size, which covers all rounding in f32: of the box
/// itself, of the ray's base and direction (2 units of 2^-24 of the size each), of the slabs (subtraction, an inverse
/// good to 2.5 ulp, product) and of the corners that the ray sees.
const PADDING: f64 = 1.0 / (1 << 18) as f64;

/// Deepest tree: a ray keeps one node a level waiting.
const MAX_DEPTH: u32 = 64;

/// The trees of all meshes. The roots come first, in the order of the meshes; all other nodes stand beside their
/// siblings.
#[derive(Debug)]
pub struct Forest {
    nodes: Vec<Node>,
    triangles: Vec<[DVec3; 3]>,
    /// Levels of inner nodes of the deepest tree, at least 1.
    pub depth: u32,
}

/// A node, with its place among all nodes or triangles.
#[derive(Debug, Clone, Copy)]
struct Node {
    bounds: Aabb,
    /// The first of two children, or of `count` triangles.
    first: u32,
    count: u32,
}

impl Forest {
    /// Builds a tree over each mesh.
    ///
    /// # Errors
    /// [`Error::Usage`] if a mesh is so uneven that its tree gets too deep.
    pub fn of(meshes: &[Mesh]) -> Result<Self> {
        let mut roots = Vec::new();
        let mut others = Vec::new();
        let mut triangles = Vec::new();
        let mut depth = 1;
        for mesh in meshes {
            let tree = build(mesh);
            // The root moves to the front, so that the node after it has this place among all.
            let next = (meshes.len() + others.len()) as u32;
            let place = |node: &Node| match node.count {
                0 => Node { first: next + node.first - 1, ..*node },
                _ => Node { first: triangles.len() as u32 + node.first, ..*node },
            };
            let mut nodes = tree.nodes.iter().map(place);
            roots.extend(nodes.next());
            others.extend(nodes);
            triangles.extend(tree.order.iter().map(|&face| mesh.corners(mesh.faces[face as usize])));
            depth = depth.max(depth_of(&tree.nodes));
        }
        if depth > MAX_DEPTH {
            return Err(Error::Usage(format!(
                "the tree over a mesh is {depth} levels deep, and at most {MAX_DEPTH} can be searched; \
                 its triangles lie too unevenly: split it into several meshes"
            )));
        }
        roots.append(&mut others);
        Ok(Forest { nodes: roots, triangles, depth })
    }

    /// The contents of the buffer, four numbers a row: all nodes, then all triangles. A triangle's normal stands there
    /// because corners that are rounded would tilt it.
    pub fn reals(&self) -> impl Iterator<Item = f64> + '_ {
        let first_triangle = NODE_ROWS * self.nodes.len() as u32;
        let nodes = self.nodes.iter().flat_map(move |node| {
            let first = match node.count {
                0 => NODE_ROWS * node.first,
                _ => first_triangle + TRIANGLE_ROWS * node.first,
            };
            [
                row(node.bounds.min.as_dvec3(), first.into()),
                row(node.bounds.max.as_dvec3(), node.count.into()),
            ]
        });
        let triangles = self.triangles.iter().flat_map(|&corners| {
            let normal = unit_normal(corners);
            [0, 1, 2].map(|i| row(corners[i], normal[i]))
        });
        nodes.chain(triangles).flatten()
    }
}

fn row(point: DVec3, number: f64) -> [f64; 4] {
    [point.x, point.y, point.z, number]
}

/// The first row of a mesh's tree: the roots come first.
pub fn root_row(mesh: usize) -> u32 {
    NODE_ROWS * mesh as u32
}

/// A tree, and the faces in the order in which its leaves hold them. The root is the first node.
struct Tree {
    nodes: Vec<Node>,
    order: Vec<u32>,
}

fn build(mesh: &Mesh) -> Tree {
    let size = mesh.vertices.iter().map(|v| v.abs().max_element()).fold(0.0, f64::max);
    let padding = DVec3::splat(PADDING * size);
    let bounds = |face: &[u32; 3]| {
        let [a, b, c] = mesh.corners(*face);
        let (low, high) = (a.min(b).min(c) - padding, a.max(b).max(c) + padding);
        Aabb::new(low.as_vec3a(), high.as_vec3a())
    };
    let boxes: Vec<Aabb> = mesh.faces.iter().map(bounds).collect();
    let params = BvhBuildParams { max_prims_per_leaf: 4, ..BvhBuildParams::medium_build() };
    let bvh = build_bvh2(&boxes, params, &mut std::time::Duration::default());
    let node = |node: &obvhs::bvh2::node::Bvh2Node| Node {
        bounds: node.aabb,
        first: node.first_index,
        count: node.prim_count,
    };
    Tree { nodes: bvh.nodes.iter().map(node).collect(), order: bvh.primitive_indices }
}

/// Levels of inner nodes.
fn depth_of(nodes: &[Node]) -> u32 {
    let mut deepest = 0;
    let mut waiting = vec![(0, 0)];
    while let Some((index, depth)) = waiting.pop() {
        let Node { first, count: 0, .. } = nodes[index as usize] else {
            deepest = deepest.max(depth);
            continue;
        };
        waiting.extend([(first, depth + 1), (first + 1, depth + 1)]);
    }
    deepest
}
