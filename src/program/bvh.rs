//! Trees of boxes whose nodes have up to four children, as shaders/lib/boxes.wgsl walks them: those over the triangles
//! of each mesh ([`super::mesh`]), and the one over primitives ([`super::tree`]).

use crate::error::{Error, Result};
use obvhs::BvhBuildParams;
use obvhs::aabb::Aabb;
use obvhs::bvh2::builder::build_bvh2;
use obvhs::bvh2::node::Bvh2Node;

/// Binding of the rows in group 0.
pub const ROWS: u32 = 19;
/// Rows of a node, four words each.
const NODE_ROWS: usize = 3;
/// Most children of a node.
const NODE_CHILDREN: usize = 4;
/// Largest number of cells along a box's side, but for what the last one is rounded up by.
const MOST_CELLS: f64 = 254.0;
/// More cells than the shader's arithmetic in a grid is in error by: 4 units of 2^-24 of its side.
const GRID_SLACK: f64 = 1.0 / (1 << 12) as f64;
/// A ray keeps what waits at a node in one word, of which 24 bits tell the first sibling.
const MOST_NODES: usize = (1 << 24) - 1;

/// Deepest tree: a ray keeps one group of siblings a level waiting.
pub const MAX_DEPTH: u32 = 64;

type Node = [[u32; 4]; NODE_ROWS];

/// Trees. Their roots come first; all other nodes stand beside their siblings.
#[derive(Debug)]
pub struct Forest {
    nodes: Vec<Node>,
    /// Levels of nodes of the deepest tree, at least 1.
    pub depth: u32,
}

/// A tree of the forest.
#[derive(Debug)]
pub struct Planted {
    /// What is in the boxes, in the order of the tree's items.
    pub order: Vec<u32>,
    /// Levels of nodes.
    pub depth: u32,
}

impl Forest {
    /// Trees without items.
    pub fn of_roots(num_roots: usize) -> Self {
        Forest { nodes: vec![Node::default(); num_roots], depth: 1 }
    }

    /// Builds a tree over boxes; its items count from `first_item` on.
    pub fn plant(&mut self, root: usize, boxes: &[Aabb], first_item: u32) -> Planted {
        let mut planted = Planted { order: Vec::new(), depth: 1 };
        if boxes.is_empty() {
            return planted;
        }
        let bvh = build_bvh2(boxes, effort(boxes.len()), &mut std::time::Duration::default());
        // By levels: siblings are next to one another, and what most rays visit is close together.
        let mut level = vec![(root, children(&bvh.nodes, 0))];
        while !level.is_empty() {
            let mut below = Vec::new();
            for (place, children) in level {
                let (inner, leaves): (Vec<&Bvh2Node>, Vec<&Bvh2Node>) =
                    children.iter().map(|&i| &bvh.nodes[i]).partition(|node| node.prim_count == 0);
                let boxes: Vec<Aabb> = inner.iter().chain(&leaves).map(|node| node.aabb).collect();
                let first_node = self.nodes.len();
                let item = first_item + planted.order.len() as u32;
                self.nodes[place] = packed(&boxes, inner.len(), first_node as u32, item);
                self.nodes.resize(first_node + inner.len(), Node::default());
                planted
                    .order
                    .extend(leaves.iter().map(|leaf| bvh.primitive_indices[leaf.first_index as usize]));
                let opened = children.into_iter().filter(|&i| bvh.nodes[i].prim_count == 0);
                below.extend((first_node..).zip(opened.map(|i| self::children(&bvh.nodes, i))));
            }
            planted.depth += u32::from(!below.is_empty());
            level = below;
        }
        self.depth = self.depth.max(planted.depth);
        planted
    }

    /// Rows of all nodes.
    pub fn num_rows(&self) -> usize {
        NODE_ROWS * self.nodes.len()
    }

    /// The contents of the buffer.
    ///
    /// # Errors
    /// [`Error::Usage`] if there are more nodes than a walk can tell apart.
    pub fn words(&self) -> Result<impl Iterator<Item = u32> + '_> {
        if self.nodes.len() > MOST_NODES {
            return Err(Error::Usage(format!(
                "the trees over triangles and surfaces have {} nodes, and at most {MOST_NODES} can be searched; \
                 give the meshes fewer triangles",
                self.nodes.len()
            )));
        }
        Ok(self.nodes.iter().flatten().flatten().copied())
    }
}

/// How a tree is built: the fewer boxes, the more often each is taken out and put back where it costs least. A thousand are
/// done in some 20 ms, and a ray visits a tenth fewer nodes.
fn effort(num_boxes: usize) -> BvhBuildParams {
    const MOST_REINSERTIONS: f32 = 4.0;
    const REINSERTED_BOXES: f32 = 2000.0;
    let medium = BvhBuildParams::medium_build();
    let share = (REINSERTED_BOXES / num_boxes as f32).min(MOST_REINSERTIONS);
    let reinsertion_batch_ratio = share.max(medium.reinsertion_batch_ratio);
    BvhBuildParams { max_prims_per_leaf: 1, reinsertion_batch_ratio, ..medium }
}

/// Of a tree with two children a node: the widest inner child is replaced by its own until there are enough.
fn children(nodes: &[Bvh2Node], parent: usize) -> Vec<usize> {
    let below = |i: usize| [nodes[i].first_index as usize, nodes[i].first_index as usize + 1];
    if nodes[parent].prim_count > 0 {
        return vec![parent];
    }
    let mut children = below(parent).to_vec();
    while children.len() < NODE_CHILDREN {
        let inner = (0..children.len()).filter(|&k| nodes[children[k]].prim_count == 0);
        let area = |k: usize| nodes[children[k]].aabb.half_area();
        let Some(widest) = inner.max_by(|&a, &b| area(a).total_cmp(&area(b))) else { break };
        let opened = children.swap_remove(widest);
        children.extend(below(opened));
    }
    children
}

/// A node with the boxes of its children, of which the first `num_inner` are nodes. In its grid boxes grow, and never
/// shrink: f64 holds all of that exactly, or to far less than boxes are padded by.
fn packed(boxes: &[Aabb], num_inner: usize, first_node: u32, first_item: u32) -> Node {
    let mut node = Node::default();
    let all = boxes.iter().copied().reduce(|a, b| a.union(&b)).unwrap_or_default();
    for axis in 0..3 {
        let origin = all.min[axis];
        let along = |coordinate: f32| f64::from(coordinate) - f64::from(origin);
        let exponent = exponent_of(along(all.max[axis]) / MOST_CELLS);
        let cell = f64::from(exponent).exp2();
        node[0][axis] = origin.to_bits();
        node[0][3] |= ((exponent + 127) as u32) << (8 * axis);
        for (k, bounds) in boxes.iter().enumerate() {
            node[1][axis] |= ((along(bounds.min[axis]) / cell - GRID_SLACK).floor() as u32) << (8 * k);
            node[2][axis] |= ((along(bounds.max[axis]) / cell + GRID_SLACK).ceil() as u32) << (8 * k);
        }
    }
    node[0][3] |= (num_inner as u32) << 24 | (boxes.len() as u32) << 28;
    node[1][3] = first_node;
    node[2][3] = first_item.wrapping_sub(num_inner as u32);
    node
}

/// Of the smallest power of two that is no less, among those that an f32 holds in full.
fn exponent_of(size: f64) -> i32 {
    let about = size.log2().clamp(-126.0, 127.0).floor() as i32;
    if f64::from(about).exp2() < size { about + 1 } else { about }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What random rays that meet so many cubes visit of the nodes between the root and them: areas are chances.
    fn visits(num_boxes: usize, params: BvhBuildParams) -> f64 {
        let mut bits = 1_u64;
        let mut coordinate = || {
            bits = bits.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            (bits >> 40) as f32 / 16_777_216.0
        };
        let side = 0.5 / (num_boxes as f32).cbrt();
        let cube = |low: [f32; 3]| Aabb::new(low.into(), low.map(|x| x + side).into());
        let boxes: Vec<Aabb> =
            (0..num_boxes).map(|_| cube([coordinate(), coordinate(), coordinate()])).collect();
        let nodes = build_bvh2(&boxes, params, &mut std::time::Duration::default()).nodes;
        let inner = nodes.iter().filter(|node| node.prim_count == 0);
        inner.map(|node| f64::from(node.aabb.half_area() / nodes[0].aabb.half_area())).sum()
    }

    #[test]
    fn small_trees_are_worth_more_effort() {
        let medium = BvhBuildParams { max_prims_per_leaf: 1, ..BvhBuildParams::medium_build() };
        for num_boxes in [100, 300, 1000] {
            let [usual, ours] = [medium, effort(num_boxes)].map(|params| visits(num_boxes, params));
            assert!(ours < 0.97 * usual, "{num_boxes} boxes: {ours} of {usual}");
        }
        assert_eq!(effort(1_000_000).reinsertion_batch_ratio, medium.reinsertion_batch_ratio);
    }

    #[test]
    fn cells_are_as_small_as_they_can_be() {
        for (size, exponent) in [(1.0, 0), (1.0 + 1e-15, 1), (0.75, 0), (0.5, -1), (3.0, 2), (0.0, -126)] {
            assert_eq!(exponent_of(size), exponent, "{size}");
        }
    }
}
