//! Faces in contact: surfaces so close that the precision cannot tell which comes first.
//!
//! Two touching plates have two faces in one place, and a ray must cross both, in the order that a vanishing gap would
//! give. Distances cannot decide that: they differ by rounding. So the host finds the groups of faces that coincide and
//! ranks each group along the normal of its first face, by the gap where there is one, else by the list;
//! shaders/lib/contact.wgsl crosses them by rank.

use super::Precision;
use super::lowered::{gradient, shape_constant};
use crate::ir::{Frame, Outline, SceneIr, Shape, Surface};
use glam::{DVec2, DVec3};

/// Where a surface stands among the faces that it touches.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Contact {
    /// The faces with this number coincide; 0 for a face that touches none.
    pub group: u32,
    /// Position in the group along the geometric normal of its first face.
    pub rank: u32,
    /// True if the face's own normal points the other way.
    pub flipped: bool,
}

/// Roundings of a coordinate within which faces coincide.
const ROUNDINGS: f64 = 16.0;

/// What a coordinate in df64 is rounded by: sums and products lose up to 5 u^2, u = 2^-24.
const DF64_EPSILON: f64 = 16.0 * (0.5 * f32::EPSILON as f64) * (0.5 * f32::EPSILON as f64);

/// Distance within which faces of this size coincide \[mm\].
pub fn tolerance(precision: Precision, size: f64) -> f64 {
    let epsilon = match precision {
        Precision::F32 => f64::from(f32::EPSILON),
        Precision::Df64 => DF64_EPSILON,
        Precision::F64 => f64::EPSILON,
    };
    ROUNDINGS * epsilon * size
}

/// True if some faces are in contact.
pub fn any(contacts: &[Contact]) -> bool {
    contacts.iter().any(|contact| contact.group != 0)
}

/// The widest tolerance of a scene's faces \[mm\].
pub fn widest_tolerance(ir: &SceneIr, centre: DVec3, precision: Precision) -> f64 {
    let sizes = ir.surfaces.iter().map(|surface| Face::new(surface, centre).size);
    tolerance(precision, sizes.fold(0.0, f64::max))
}

/// The contact of every surface, for positions relative to `centre`.
pub fn contacts(ir: &SceneIr, centre: DVec3, precision: Precision) -> Vec<Contact> {
    let faces: Vec<Face> = ir.surfaces.iter().map(|surface| Face::new(surface, centre)).collect();
    // Faces that coincide have the same distance from any point.
    let mut order: Vec<usize> = (0..faces.len()).filter(|&i| !faces[i].points.is_empty()).collect();
    order.sort_by(|&a, &b| faces[a].from_centre.total_cmp(&faces[b].from_centre));
    let mut groups: Vec<Vec<usize>> = Vec::new();
    let mut group_of: Vec<Option<usize>> = vec![None; faces.len()];
    for (place, &i) in order.iter().enumerate() {
        for &j in &order[place + 1..] {
            let within = tolerance(precision, faces[i].size.max(faces[j].size));
            if faces[j].from_centre - faces[i].from_centre > 4.0 * within {
                break;
            }
            if faces[i].overlaps(&faces[j]) && faces[i].coincides(&faces[j], within) {
                join(&mut groups, &mut group_of, i, j);
            }
        }
    }
    ranked(&faces, &groups)
}

fn join(groups: &mut Vec<Vec<usize>>, group_of: &mut [Option<usize>], i: usize, j: usize) {
    match (group_of[i], group_of[j]) {
        (None, None) => {
            group_of[i] = Some(groups.len());
            group_of[j] = Some(groups.len());
            groups.push(vec![i, j]);
        }
        (Some(group), None) => {
            group_of[j] = Some(group);
            groups[group].push(j);
        }
        (None, Some(group)) => {
            group_of[i] = Some(group);
            groups[group].push(i);
        }
        (Some(a), Some(b)) if a != b => {
            let moved = std::mem::take(&mut groups[b]);
            moved.iter().for_each(|&face| group_of[face] = Some(a));
            groups[a].extend(moved);
        }
        _ => {}
    }
}

fn ranked(faces: &[Face], groups: &[Vec<usize>]) -> Vec<Contact> {
    let mut contacts = vec![Contact::default(); faces.len()];
    for (number, group) in (1..).zip(groups.iter().filter(|group| !group.is_empty())) {
        let base = &faces[group.iter().copied().min().unwrap_or_default()];
        let mut members: Vec<(f64, usize)> =
            group.iter().map(|&i| (faces[i].height_above(base), i)).collect();
        members.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        for (rank, (_, i)) in (0..).zip(members) {
            let flipped = faces[i].slope(base.points[0]).dot(base.slope(base.points[0])) < 0.0;
            contacts[i] = Contact { group: number, rank, flipped };
        }
    }
    contacts
}

/// A surface with points on it, relative to the scene's centre.
struct Face {
    frame: Frame,
    gradient: [f64; 3],
    constant: f64,
    points: Vec<DVec3>,
    /// Radius of the ball about the frame's origin that holds the face \[mm\].
    reach: f64,
    /// Largest coordinate of its points \[mm\].
    size: f64,
    /// Distance of its quadric from the centre \[mm\], to first order.
    from_centre: f64,
}

impl Face {
    fn new(surface: &Surface, centre: DVec3) -> Self {
        let frame = Frame { origin: surface.frame.origin - centre, rotation: surface.frame.rotation };
        let points: Vec<DVec3> =
            points_on(&surface.shape).into_iter().map(|p| frame.rotation * p + frame.origin).collect();
        let size = points.iter().map(|p| p.abs().max_element()).fold(0.0, f64::max);
        let mut face = Face {
            frame,
            gradient: gradient(&surface.shape),
            constant: shape_constant(&surface.shape),
            points,
            reach: reach(&surface.shape),
            size,
            from_centre: 0.0,
        };
        face.from_centre = face.distance(DVec3::ZERO).abs();
        face
    }

    fn slope(&self, p: DVec3) -> DVec3 {
        let local = self.frame.rotation.transpose() * (p - self.frame.origin);
        let [radial, axial, offset] = self.gradient;
        self.frame.rotation * DVec3::new(radial * local.x, radial * local.y, axial * local.z + offset)
    }

    /// Signed distance of a point from the quadric along its normal, to first order.
    fn distance(&self, p: DVec3) -> f64 {
        let local = self.frame.rotation.transpose() * (p - self.frame.origin);
        let [radial, axial, offset] = self.gradient;
        let r2 = local.x * local.x + local.y * local.y;
        let value = 0.5 * (radial * r2 + axial * local.z * local.z + self.constant) + offset * local.z;
        value / self.slope(p).length().max(f64::MIN_POSITIVE)
    }

    fn overlaps(&self, other: &Face) -> bool {
        self.frame.origin.distance(other.frame.origin) <= self.reach + other.reach
    }

    fn coincides(&self, other: &Face, within: f64) -> bool {
        self.points.iter().all(|&p| other.distance(p).abs() <= within)
            && other.points.iter().all(|&p| self.distance(p).abs() <= within)
    }

    /// How far this face lies beyond another one that it coincides with, along that one's normal \[mm\]; 0 within
    /// rounding.
    fn height_above(&self, base: &Face) -> f64 {
        let heights = self.points.iter().map(|&p| base.distance(p));
        let mean = heights.sum::<f64>() / self.points.len() as f64;
        if mean.abs() <= tolerance(Precision::F64, self.size) { 0.0 } else { mean }
    }
}

/// Radius of the ball about the local origin that holds the shape \[mm\].
fn reach(shape: &Shape) -> f64 {
    match *shape {
        Shape::Conic { curvature, conic, aperture_radius } => {
            aperture_radius.hypot(sag(curvature, conic, aperture_radius))
        }
        Shape::Plane(Outline::Infinite) => f64::INFINITY,
        Shape::Plane(Outline::Rectangle { width, height }) => 0.5 * width.hypot(height),
        Shape::Plane(Outline::Disk { radius }) => radius,
        Shape::Annulus { outer_radius, z_offset, .. } => outer_radius.hypot(z_offset),
        Shape::Frustum { r_front, r_back, z_front, z_back } => {
            r_front.max(r_back).hypot(z_front.abs().max(z_back.abs()))
        }
        Shape::Sphere { radius, .. } => radius,
        Shape::Mesh(_) => 0.0,
    }
}

/// Height of a conic at this distance from its axis \[mm\].
fn sag(curvature: f64, conic: f64, radius: f64) -> f64 {
    let root = (1.0 - (1.0 + conic) * (curvature * radius).powi(2)).max(0.0).sqrt();
    curvature * radius * radius / (1.0 + root)
}

/// Points of a shape, spread over its aperture, in its frame. None of a mesh, which is in no contact.
fn points_on(shape: &Shape) -> Vec<DVec3> {
    const TURNS: [f64; 4] = [0.0, 0.27, 0.55, 0.8];
    let ring = |radius: f64, z: f64| {
        TURNS.map(|turn| (DVec2::from_angle(turn * std::f64::consts::TAU) * radius).extend(z))
    };
    let rings = |rings: &[(f64, f64)]| rings.iter().flat_map(|&(radius, z)| ring(radius, z)).collect();
    match *shape {
        Shape::Conic { curvature, conic, aperture_radius } => {
            let at = |share: f64| (share * aperture_radius, sag(curvature, conic, share * aperture_radius));
            rings(&[0.3, 0.6, 0.9].map(at))
        }
        Shape::Plane(Outline::Infinite) => rings(&[(1.0, 0.0), (100.0, 0.0)]),
        Shape::Plane(Outline::Rectangle { width, height }) => rings(&[(0.5 * width.min(height), 0.0)]),
        Shape::Plane(Outline::Disk { radius }) => rings(&[(0.9 * radius, 0.0)]),
        Shape::Annulus { inner_radius, outer_radius, z_offset } => {
            rings(&[(0.5 * (inner_radius + outer_radius), z_offset)])
        }
        Shape::Frustum { r_front, r_back, z_front, z_back } => rings(
            &[0.1, 0.5, 0.9].map(|t| (r_front + t * (r_back - r_front), z_front + t * (z_back - z_front))),
        ),
        Shape::Sphere { radius, .. } => {
            rings(&[-0.7, 0.1, 0.8].map(|z: f64| (radius * (1.0 - z * z).sqrt(), radius * z)))
        }
        // Triangles in contact with other faces are not looked for.
        Shape::Mesh(_) => Vec::new(),
    }
}
