//! A tree of boxes over the primitives of a scene, as shaders/geometry/primitives.tree.wgsl walks it.
//!
//! The boxes are f32 in both tiers, and must hold whatever the shaders' own arithmetic counts as a hit. Errors of that
//! come from rounding coordinates: of the ray's position o, of the primitive's place and size s, and of points on the
//! way between, none larger than |o| + s. With u = 2^-24, in units of u times those: the box and its corners 1 each,
//! the position 1, the direction and the frame's rotation 3 each over the way, place, subtraction and the point that is
//! tested against the aperture 2 each, the slabs (two differences, a sum and three products, with an inverse good to
//! 2.5 ulp; a box's place in a grid that is wider than it has room of its own, crate::program::geometry::bvh) 16, the crossing of a
//! quadric 10. That is less than 48; a box is larger by 64 times s, and the shader widens it by 64 times |o|. Along the
//! ray the same margin keeps the entry into a box before any hit within.

use crate::error::Result;
use crate::model::{Frame, Mesh, Outline, SceneIr, Shape};
use crate::program::Precision;
use crate::program::geometry::bvh::Forest;
use crate::program::geometry::contact::Contacts;
use crate::program::layout::records::Records;
use crate::program::layout::tables;
use glam::{DVec2, DVec3};
use obvhs::aabb::Aabb;

/// A box is larger than what it holds by this share of its coordinates and its size; a ray's slack is this share of its
/// own coordinates.
pub const SLACK: f64 = 1.0 / (1 << 18) as f64;
/// A cone whose apex is so many times farther than its ends are wide is left without a box: its quadric cancels.
const FARTHEST_APEX: f64 = 8.0;

/// The tree over the primitives that have a box, and the list of those that have none.
#[derive(Debug)]
pub struct PrimitiveTree {
    /// The tree's place among the roots.
    pub root: u32,
    /// In the order of the tree, then those without a box.
    primitives: Vec<u32>,
    num_boxed: usize,
    /// What shaders read of them, where it stands in the rows that follow the nodes; else those have their numbers alone.
    pub records: Option<Records>,
}

impl PrimitiveTree {
    /// Builds the tree from a root, over primitives with these boxes, or none.
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

    /// In the order of the tree, then those without a box.
    pub fn primitives(&self) -> &[u32] {
        &self.primitives
    }

    /// Primitives that have a box.
    pub fn num_boxed(&self) -> usize {
        self.num_boxed
    }

    /// Rows of a primitive, after the nodes.
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

/// The boxes of all primitives, relative to `centre`; none for those without an end.
pub fn boxes(ir: &SceneIr, centre: DVec3, contacts: &Contacts) -> Vec<Option<Aabb>> {
    let primitives = tables::primitives(ir).into_iter().enumerate();
    let of = |(i, (frame, shape)): (usize, (Frame, Shape))| {
        // Faces in contact are met together, as far apart as the tolerance.
        let touch = if contacts.touches(i) { contacts.tolerance } else { 0.0 };
        bounds(&relative(frame, centre), &shape, &ir.meshes, touch)
    };
    primitives.map(of).collect()
}

/// A frame as the device has it.
pub fn relative(frame: Frame, centre: DVec3) -> Frame {
    Frame { origin: frame.origin - centre, ..frame }
}

/// The box of a primitive, `margin` larger, or none if it has no end or its crossings are ill-conditioned.
pub fn bounds(frame: &Frame, shape: &Shape, meshes: &[Mesh], margin: f64) -> Option<Aabb> {
    let extent = Extent::of(shape, meshes)?;
    let middle = frame.rotation * extent.middle + frame.origin;
    let reach = extent.reach_along(frame);
    let size = frame.origin.abs().max_element() + extent.size;
    let padding = DVec3::splat(SLACK * size + margin);
    let (low, high) = (middle - reach - padding, middle + reach + padding);
    let fits = |corner: DVec3| corner.abs().max_element() < f64::from(f32::MAX);
    (fits(low) && fits(high)).then(|| Aabb::new(low.as_vec3a(), high.as_vec3a()))
}

/// What a shape fills, in its own frame.
struct Extent {
    middle: DVec3,
    across: Across,
    half_height: f64,
    /// The largest length that its crossings are computed from \[mm\].
    size: f64,
}

/// Across local z.
enum Across {
    Disk(f64),
    Rectangle(DVec2),
}

impl Extent {
    fn of(shape: &Shape, meshes: &[Mesh]) -> Option<Extent> {
        let round = |radius: f64, low: f64, high: f64, size: f64| Extent {
            middle: DVec3::new(0.0, 0.0, 0.5 * (low + high)),
            across: Across::Disk(radius),
            half_height: 0.5 * (high - low),
            size,
        };
        let rectangle = |middle: DVec3, half: DVec3, size: f64| Extent {
            middle,
            across: Across::Rectangle(half.truncate()),
            half_height: half.z,
            size,
        };
        match *shape {
            Shape::Plane(Outline::Infinite) => None,
            Shape::Plane(Outline::Disk { radius }) => Some(round(radius, 0.0, 0.0, radius)),
            Shape::Plane(Outline::Rectangle { width, height }) => {
                let half = 0.5 * DVec3::new(width, height, 0.0);
                Some(rectangle(DVec3::ZERO, half, half.max_element()))
            }
            Shape::Annulus { outer_radius, z_offset, .. } => {
                Some(round(outer_radius, z_offset, z_offset, outer_radius + z_offset.abs()))
            }
            Shape::Conic { curvature, conic, aperture_radius } => {
                // The sheet through the vertex ends where (1 + K) c^2 r^2 is 1.
                let bend = (1.0 + conic) * curvature * curvature;
                let end = if bend > 0.0 { 1.0 / bend.sqrt() } else { f64::INFINITY };
                let radius = aperture_radius.min(end);
                let root = (1.0 - bend * radius * radius).max(0.0).sqrt();
                let sag = curvature * radius * radius / (1.0 + root);
                Some(round(radius, sag.min(0.0), sag.max(0.0), radius + sag.abs()))
            }
            Shape::Sphere { radius, aperture_radius } => {
                let across = aperture_radius.map_or(radius, |aperture| aperture.min(radius));
                Some(round(across, -radius, radius, radius))
            }
            Shape::Frustum { r_front, r_back, z_front, z_back } => {
                let radius = r_front.max(r_back);
                let (low, high) = (z_front.min(z_back), z_front.max(z_back));
                let slope = (r_back - r_front) / (z_back - z_front);
                let at_origin = (r_front - slope * z_front).abs();
                (at_origin <= FARTHEST_APEX * radius).then(|| {
                    round(
                        radius,
                        low,
                        high,
                        FARTHEST_APEX * FARTHEST_APEX * radius + low.abs().max(high.abs()),
                    )
                })
            }
            Shape::Mesh(mesh) => {
                let vertices = &meshes[mesh].vertices;
                let low = vertices.iter().copied().reduce(DVec3::min)?;
                let high = vertices.iter().copied().reduce(DVec3::max)?;
                let size = low.abs().max(high.abs()).max_element();
                Some(rectangle(0.5 * (low + high), 0.5 * (high - low), size))
            }
        }
    }

    /// How far it reaches from its middle along the axes: for a disk exactly, which is less than a box about it.
    fn reach_along(&self, frame: &Frame) -> DVec3 {
        let [x, y, z] = [frame.rotation.x_axis, frame.rotation.y_axis, frame.rotation.z_axis];
        let across = match self.across {
            Across::Disk(radius) => radius * (x * x + y * y).map(f64::sqrt),
            Across::Rectangle(half) => half.x * x.abs() + half.y * y.abs(),
        };
        across + self.half_height * z.abs()
    }
}
