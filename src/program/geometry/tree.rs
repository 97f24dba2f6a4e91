//! A tree of boxes over the primitives of a scene, as shaders/geometry/primitives.tree.wgsl walks it.
//!
//! The boxes are f32 in both tiers. A box must hold all that the shaders' own arithmetic counts as a hit. Rounding of
//! coordinates limits that arithmetic: of the ray's position o, of the primitive's place and size s, and of points on
//! the way. None of these coordinates is larger than |o| + s.
//!
//! Errors are in units of u (|o| + s), with u = 2^-24. The box and its corners contribute 1 each, and the position 1.
//! The direction and the frame's rotation contribute 3 each, over the way. The place, the subtraction and the point
//! that is tested against the aperture contribute 2 each. The slabs contribute 16: two differences, a sum and three
//! products, with an inverse good to 2.5 ulp. The crossing of a quadric contributes 10. Rounding of a box to its node's
//! grid has room of its own (crate::program::geometry::bvh).
//!
//! The sum is less than 48. A box is larger by 64 times s, and the shader widens it by 64 times |o|. The same margin
//! along the ray keeps the entry into a box before any hit in it.

use crate::error::Result;
use crate::model::Precision;
use crate::model::{Frame, Mesh, SceneIr, Shape};
use crate::program::geometry::bvh::Forest;
use crate::program::geometry::contact::Contacts;
use crate::program::layout::row_table::RowTable;
use glam::DVec3;
use obvhs::aabb::Aabb;

/// The share of its coordinates and its size by which a box is larger than its contents. A ray's slack is the same
/// share of the ray's own coordinates.
pub const SLACK: f64 = 1.0 / (1 << 18) as f64;

/// The tree over the primitives that have a box, and the list of the others.
#[derive(Debug)]
pub struct PrimitiveTree {
    /// The number of the tree's root.
    pub root: u32,
    /// The primitives, in the order of the tree, then those without a box.
    primitives: Vec<u32>,
    num_boxed: usize,
    /// The records that shaders read, if they are stored in the rows that follow the nodes. Otherwise these rows hold
    /// numbers alone.
    pub records: Option<RowTable>,
}

impl PrimitiveTree {
    /// Builds the tree from a root. `boxes` has the box of each primitive, or `None`.
    pub fn of(boxes: &[Option<Aabb>], forest: &mut Forest, root: usize) -> Self {
        let (mut boxed, mut bounds, mut boundless) = (Vec::new(), Vec::new(), Vec::new());
        for (i, of_primitive) in (0..).zip(boxes) {
            match *of_primitive {
                Some(of_primitive) => {
                    boxed.push(i);
                    bounds.push(of_primitive);
                }
                None => boundless.push(i),
            }
        }
        let order = forest.plant(root, &bounds, 0);
        let in_order = order.iter().map(|&place| boxed[place as usize]);
        let primitives = in_order.chain(boundless).collect();
        PrimitiveTree { root: root as u32, primitives, num_boxed: boxed.len(), records: None }
    }

    /// The primitives, in the order of the tree, then those without a box.
    pub fn primitives(&self) -> &[u32] {
        &self.primitives
    }

    /// The number of primitives that have a box.
    pub fn num_boxed(&self) -> usize {
        self.num_boxed
    }

    /// Rows of one primitive, after the nodes.
    pub fn rows_each(&self, precision: Precision) -> usize {
        self.records.as_ref().map_or(1, |records| records.num_texels(precision))
    }

    /// Rows of all primitives.
    pub fn num_rows(&self, precision: Precision) -> usize {
        self.rows_each(precision) * self.primitives.len()
    }

    /// The rows that follow the nodes.
    ///
    /// # Errors
    /// [`Error::Usage`] if the precision cannot hold a number.
    pub fn words(&self, precision: Precision) -> Result<Vec<u32>> {
        match &self.records {
            Some(records) => records.texel_words(precision),
            None => Ok(self.primitives.iter().flat_map(|&i| [i, 0, 0, 0]).collect()),
        }
    }
}

/// The boxes of all primitives, relative to `centre`; `None` for an unbounded primitive.
pub fn boxes(ir: &SceneIr, centre: DVec3, contacts: &Contacts) -> Vec<Option<Aabb>> {
    let primitives = crate::model::primitives::primitives(ir).into_iter().enumerate();
    let of = |(i, (frame, shape)): (usize, (Frame, Shape))| {
        // Faces in contact are met together, even as far apart as the tolerance.
        let touch = if contacts.touches(i) { contacts.tolerance } else { 0.0 };
        bounds(&frame.relative_to(centre), &shape, &ir.meshes, touch)
    };
    primitives.map(of).collect()
}

/// The box of a primitive, larger by `margin`; `None` if the primitive is unbounded or its crossings are
/// ill-conditioned.
pub fn bounds(frame: &Frame, shape: &Shape, meshes: &[Mesh], margin: f64) -> Option<Aabb> {
    let extent = shape.extent(meshes)?;
    let middle = frame.rotation * extent.middle + frame.origin;
    let reach = extent.reach_along(&frame.rotation);
    let size = frame.origin.abs().max_element() + extent.size;
    let padding = DVec3::splat(SLACK * size + margin);
    let (low, high) = (middle - reach - padding, middle + reach + padding);
    let fits = |corner: DVec3| corner.abs().max_element() < f64::from(f32::MAX);
    (fits(low) && fits(high)).then(|| Aabb::new(low.as_vec3a(), high.as_vec3a()))
}
