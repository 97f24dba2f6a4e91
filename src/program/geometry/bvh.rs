//! Trees of boxes whose nodes have up to four children, for shaders/geometry/boxes.wgsl. There is a tree over the
//! triangles of each mesh ([`crate::program::geometry::mesh`]), and one over primitives
//! ([`crate::program::geometry::tree`]).

use crate::error::{Error, Result};
use obvhs::BvhBuildParams;
use obvhs::aabb::Aabb;
use obvhs::bvh2::Bvh2;
use obvhs::bvh2::node::Bvh2Node;
use obvhs::bvh2::reinsertion::ReinsertionOptimizer;
use obvhs::ploc::PlocBuilder;
use std::ops::Range;

/// Rows of a node, four words each.
const NODE_ROWS: usize = 3;
/// Most children of a node.
const NODE_CHILDREN: usize = 4;
/// Most cells along a box's side, before the last cell is rounded up.
const MOST_CELLS: f64 = 254.0;
/// The room in cells that each box gets: more than the error of the shader's arithmetic, 4 units of 2^-24 of the grid's
/// side.
const GRID_SLACK: f64 = 1.0 / (1 << 12) as f64;
/// Most nodes. A ray keeps the siblings that wait at a node in one word, in which the first sibling has 24 bits.
const MOST_NODES: usize = (1 << 24) - 1;

/// Most levels of nodes: a ray keeps one group of waiting siblings a level. Balanced nodes of so many levels hold 2^128
/// items.
const MAX_DEPTH: u32 = 64;

type Node = [[u32; 4]; NODE_ROWS];

/// Trees. Their roots come first; all other nodes are stored beside their siblings.
#[derive(Debug)]
pub struct Forest {
    nodes: Vec<Node>,
    /// Levels of nodes of the deepest tree, from 1 to [`MAX_DEPTH`].
    pub depth: u32,
}

impl Forest {
    /// Trees without items.
    pub fn of_roots(num_roots: usize) -> Self {
        Forest { nodes: vec![Node::default(); num_roots], depth: 1 }
    }

    /// Builds a tree over boxes. Its items are numbered from `first_item` on. Returns the indices of the boxes, in the
    /// order of the items.
    pub fn plant(&mut self, root: usize, boxes: &[Aabb], first_item: u32) -> Vec<u32> {
        let mut order = Vec::new();
        if boxes.is_empty() {
            return order;
        }
        let sapling = BinaryTree::over(boxes);
        // Nodes are stored by levels: siblings are neighbours, and the nodes that most rays visit are close together.
        let mut depth = 1;
        let mut level = vec![(root, sapling.children(sapling.bounded(Branch::Node(0), depth)))];
        loop {
            let mut below = Vec::new();
            for (place, children) in level {
                let (inner, leaves): (Vec<Branch>, Vec<Branch>) =
                    children.into_iter().partition(|child| sapling.leaf(child).is_none());
                let boxes: Vec<Aabb> =
                    inner.iter().chain(&leaves).map(|child| sapling.bounds(child)).collect();
                let first_node = self.nodes.len();
                let item = first_item + order.len() as u32;
                self.nodes[place] = packed(&boxes, inner.len(), first_node as u32, item);
                self.nodes.resize(first_node + inner.len(), Node::default());
                order.extend(leaves.iter().filter_map(|leaf| sapling.leaf(leaf)));
                below.extend((first_node..).zip(inner));
            }
            if below.is_empty() {
                self.depth = self.depth.max(depth);
                return order;
            }
            depth += 1;
            let opened = |(place, branch)| (place, sapling.children(sapling.bounded(branch, depth)));
            level = below.into_iter().map(opened).collect();
        }
    }

    /// Rows of all nodes.
    pub fn num_rows(&self) -> usize {
        NODE_ROWS * self.nodes.len()
    }

    /// The contents of the buffer.
    ///
    /// # Errors
    /// [`Error::Usage`] if there are more nodes than a walk can number.
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

/// How much work goes into a tree. The fewer boxes, the more often each is taken out and put back where it costs least.
/// The work takes some 20 ms for a thousand boxes, and spares a ray a tenth of its visits to nodes.
fn effort(num_boxes: usize) -> BvhBuildParams {
    const MOST_REINSERTIONS: f32 = 4.0;
    const REINSERTED_BOXES: f32 = 2000.0;
    let medium = BvhBuildParams::medium_build();
    let share = (REINSERTED_BOXES / num_boxes as f32).min(MOST_REINSERTIONS);
    let reinsertion_batch_ratio = share.max(medium.reinsertion_batch_ratio);
    BvhBuildParams { max_prims_per_leaf: 1, reinsertion_batch_ratio, ..medium }
}

/// A tree with two children a node, from which a tree with four is made. Where it is too deep for a walk, balanced
/// branches replace its own.
struct BinaryTree {
    nodes: Vec<Bvh2Node>,
    /// The items in the boxes, from left to right.
    items: Vec<u32>,
    /// The items' boxes.
    boxes: Vec<Aabb>,
    /// For each node, the items below it.
    spans: Vec<Range<u32>>,
}

/// A part of a sapling.
enum Branch {
    /// All below a node.
    Node(usize),
    /// Items in a row, to be halved and halved again.
    Row(Range<u32>),
}

impl BinaryTree {
    fn over(boxes: &[Aabb]) -> Self {
        let bvh = binary_tree(boxes, effort(boxes.len()));
        let mut sapling =
            BinaryTree { nodes: Vec::new(), items: Vec::new(), boxes: Vec::new(), spans: Vec::new() };
        sapling.spans.resize(bvh.nodes.len(), 0..0);
        traverse(&bvh.nodes, |visit| match visit {
            Visit::Enter { node, .. } => {
                let so_far = sapling.items.len() as u32;
                sapling.spans[node].start = so_far;
                if bvh.nodes[node].is_leaf() {
                    let item = bvh.primitive_indices[bvh.nodes[node].first_index as usize];
                    sapling.items.push(item);
                    sapling.boxes.push(boxes[item as usize]);
                }
            }
            Visit::Leave { node } => sapling.spans[node].end = sapling.items.len() as u32,
        });
        sapling.nodes = bvh.nodes;
        sapling
    }

    /// A branch whose root is on a level, counted from 1. Where the levels that are left would only just hold the
    /// branch, the result is a row of its items. A child holds no more items than its parent, and a row needs the
    /// fewest levels possible. So a branch that fits on one level has children that fit on the next, and no tree gets
    /// deeper than [`MAX_DEPTH`].
    fn bounded(&self, branch: Branch, level: u32) -> Branch {
        match branch {
            Branch::Node(node) if level + fewest_levels(self.spans[node].len()) > MAX_DEPTH => {
                Branch::Row(self.spans[node].clone())
            }
            Branch::Node(_) | Branch::Row(_) => branch,
        }
    }

    /// The item of a branch, if it has only one.
    fn leaf(&self, branch: &Branch) -> Option<u32> {
        let span = match branch {
            Branch::Node(node) => &self.spans[*node],
            Branch::Row(span) => span,
        };
        (span.len() == 1).then(|| self.items[span.start as usize])
    }

    fn bounds(&self, branch: &Branch) -> Aabb {
        match branch {
            Branch::Node(node) => self.nodes[*node].aabb,
            Branch::Row(span) => {
                let boxes = &self.boxes[span.start as usize..span.end as usize];
                boxes.iter().copied().reduce(|a, b| a.union(&b)).unwrap_or_default()
            }
        }
    }

    /// Up to four children. Where there are fewer, the widest inner child is replaced by its own children.
    fn children(&self, parent: Branch) -> Vec<Branch> {
        let parent = match parent {
            Branch::Row(span) => return quarters(span).into_iter().map(Branch::Row).collect(),
            Branch::Node(node) if self.nodes[node].is_leaf() => return vec![Branch::Node(node)],
            Branch::Node(node) => node,
        };
        let below = |i: usize| [self.nodes[i].first_index as usize, self.nodes[i].first_index as usize + 1];
        let mut children = below(parent).to_vec();
        while children.len() < NODE_CHILDREN {
            let inner = (0..children.len()).filter(|&k| !self.nodes[children[k]].is_leaf());
            let area = |k: usize| self.nodes[children[k]].aabb.half_area();
            let Some(widest) = inner.max_by(|&a, &b| area(a).total_cmp(&area(b))) else { break };
            let opened = children.swap_remove(widest);
            children.extend(below(opened));
        }
        children.into_iter().map(Branch::Node).collect()
    }
}

/// Levels of the flattest tree that holds this many items.
fn fewest_levels(num_items: usize) -> u32 {
    let mut levels = 1;
    let mut each = num_items;
    while each > NODE_CHILDREN {
        each = each.div_ceil(NODE_CHILDREN);
        levels += 1;
    }
    levels
}

/// Divides a row into up to four parts, none longer than a quarter rounded up.
fn quarters(row: Range<u32>) -> Vec<Range<u32>> {
    let length = row.end - row.start;
    let cut = |k: u32| row.start + (u64::from(length) * u64::from(k) / NODE_CHILDREN as u64) as u32;
    (0..NODE_CHILDREN as u32).map(|k| cut(k)..cut(k + 1)).filter(|part| !part.is_empty()).collect()
}

/// Builds a tree as `obvhs::bvh2::builder::build_bvh2` does, with one difference. Reinsertion searches with a stack for
/// the depth that the tree had at first, and a chain outgrows that. So each round here starts with the present depth.
fn binary_tree(boxes: &[Aabb], params: BvhBuildParams) -> Bvh2 {
    let indices = (0..boxes.len() as u32).collect();
    let mut bvh = PlocBuilder::with_capacity(boxes.len()).build(
        params.ploc_search_distance,
        boxes,
        indices,
        params.sort_precision,
        params.search_depth_threshold,
    );
    let mut optimizer = ReinsertionOptimizer::default();
    let again = params.reinsertion_batch_ratio * params.post_collapse_reinsertion_batch_ratio_multiplier;
    for share in [params.reinsertion_batch_ratio, again] {
        for part in (1..32).step_by(2) {
            bvh.max_depth = bvh.max_depth.max(depth_of(&bvh) + 1);
            optimizer.run(&mut bvh, share, Some(vec![1.0 / part as f32]));
        }
    }
    bvh
}

fn depth_of(bvh: &Bvh2) -> usize {
    let mut deepest = 0;
    traverse(&bvh.nodes, |visit| {
        if let Visit::Enter { level, .. } = visit {
            deepest = deepest.max(level);
        }
    });
    deepest
}

/// A step of a walk through a whole tree.
enum Visit {
    /// Before the nodes below; levels count from 1.
    Enter { node: usize, level: usize },
    /// After the nodes below.
    Leave { node: usize },
}

/// Visits a tree from left to right, without recursion: a chain is as deep as it is long.
fn traverse(nodes: &[Bvh2Node], mut each: impl FnMut(Visit)) {
    let mut to_do = vec![Visit::Enter { node: 0, level: 1 }];
    while let Some(visit) = to_do.pop() {
        if let Visit::Enter { node, level } = visit {
            to_do.push(Visit::Leave { node });
            if !nodes[node].is_leaf() {
                let left = nodes[node].first_index as usize;
                to_do.extend([left + 1, left].map(|node| Visit::Enter { node, level: level + 1 }));
            }
        }
        each(visit);
    }
}

/// A node with the boxes of its children, of which the first `num_inner` are nodes. In the node's grid boxes only grow.
/// f64 holds all of that exactly, or with errors far below the padding of boxes.
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

/// The exponent of the smallest power of two that is at least `size`, among those that an f32 holds in full.
fn exponent_of(size: f64) -> i32 {
    let about = size.log2().clamp(-126.0, 127.0).floor() as i32;
    if f64::from(about).exp2() < size { about + 1 } else { about }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The mean number of nodes that random rays visit between the root and the cubes: areas stand for chances.
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
        let nodes = binary_tree(&boxes, params).nodes;
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

    fn cube(low: [f32; 3], side: f32) -> Aabb {
        Aabb::new(low.into(), low.map(|x| x + side).into())
    }

    /// Depth of the tree over boxes; checks that it holds each of them once.
    fn planted(boxes: &[Aabb]) -> u32 {
        let mut forest = Forest::of_roots(1);
        let mut order = forest.plant(0, boxes, 0);
        // Each node but the root, and each item, is the child of one node.
        let nodes = forest.nodes.iter();
        let (inner, all) = nodes
            .fold((0, 0), |(inner, all), node| (inner + (node[0][3] >> 24 & 0xF), all + (node[0][3] >> 28)));
        assert_eq!(inner as usize, forest.nodes.len() - 1);
        assert_eq!((all - inner) as usize, boxes.len());
        order.sort_unstable();
        assert!(order.iter().copied().eq(0..boxes.len() as u32));
        forest.depth
    }

    #[test]
    fn no_tree_is_deeper_than_a_walk() {
        let steps = |n: u32, f: &dyn Fn(f32) -> Aabb| -> Vec<Aabb> { (0..n).map(|i| f(i as f32)).collect() };
        let fan = |n: f32| {
            move |i: f32| {
                let corner = |i: f32| (std::f32::consts::TAU * i / n).sin_cos();
                let (y, x) = corner(i);
                let (v, u) = corner(i + 1.0);
                Aabb::new(
                    [x.min(u).min(1.0), y.min(v).min(0.0), 0.0].into(),
                    [1.0, y.max(v).max(0.0), 0.0].into(),
                )
            }
        };
        let shapes = [
            ("a fan of 1440", steps(1440, &fan(1440.0)), true),
            ("nested boxes", steps(600, &|i| cube([-1.0 - i; 3], 2.0 * (1.0 + i))), true),
            ("boxes with a corner in common", steps(600, &|i| cube([0.0; 3], 1.0 + i)), true),
            ("a geometric progression", steps(400, &|i| cube([0.0; 3], (0.25 * i - 50.0).exp2())), true),
            ("boxes far and farther", steps(200, &|i| cube([(0.5 * i).exp2(); 3], 1.0)), false),
            ("one box, often", steps(1000, &|_| cube([1.0, 2.0, 3.0], 4.0)), false),
            ("a row", steps(1024, &|i| cube([i, 0.0, 0.0], 1.0)), false),
        ];
        for (what, boxes, is_chain) in shapes {
            let depth = planted(&boxes);
            assert!(depth <= MAX_DEPTH, "{what}: {depth}");
            // Else the shape would prove nothing.
            let unbounded = depth_of(&binary_tree(&boxes, effort(boxes.len())));
            assert!(!is_chain || unbounded > 2 * MAX_DEPTH as usize, "{what}: {unbounded}");
        }
    }

    #[test]
    fn rows_are_as_flat_as_they_can_be() {
        for num_items in (1..300).chain([1023, 1024, 1025, 1 << 21]) {
            let mut levels = 0;
            let mut longest = num_items;
            while longest > 1 {
                longest =
                    quarters(0..longest).into_iter().map(|part| part.end - part.start).max().unwrap_or(0);
                levels += 1;
            }
            assert_eq!(levels.max(1), fewest_levels(num_items as usize), "{num_items}");
        }
    }

    #[test]
    fn cells_are_as_small_as_they_can_be() {
        for (size, exponent) in [(1.0, 0), (1.0 + 1e-15, 1), (0.75, 0), (0.5, -1), (3.0, 2), (0.0, -126)] {
            assert_eq!(exponent_of(size), exponent, "{size}");
        }
    }
}
