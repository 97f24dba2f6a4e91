//! Warnings of faces in one place for which physics has no answer: a detector in a surface, an absorber in a mirror or a
//! refracting face, a source in a face whose sides differ.

use std::f64::consts::FRAC_PI_2;

use glam::{DMat3, DVec2, DVec3};

use crate::model::place::quoted;
use crate::model::shapes;
use crate::model::{Frame, Interaction, Mesh, Outline, Shape, area_vector};
use crate::scene::detectors::lowered;
use crate::scene::frame::frame_of;
use crate::scene::json::{SceneFile, Source};
use crate::scene::media::MediaTable;
use crate::scene::surfaces::SceneSurface;

/// What `check` and `trace` say of them. The tracer meets what is named here first (program::contact).
pub(super) fn warnings(
    file: &SceneFile,
    surfaces: &[SceneSurface],
    meshes: &[Mesh],
    media: &MediaTable,
) -> Vec<String> {
    let mut warnings = hidden_detectors(file, surfaces, meshes);
    warnings.extend(absorbers_in_surfaces(surfaces, meshes));
    warnings
        .extend(file.sources.iter().filter_map(|source| births_in_faces(source, surfaces, meshes, media)));
    warnings
}

/// A source that lies in a refracting face leaves it on the side that the source shines to: in the medium there. One that
/// shines to both sides of a face is told too: half of its light begins where it was hardly meant to.
fn births_in_faces(
    source: &Source,
    surfaces: &[SceneSurface],
    meshes: &[Mesh],
    media: &MediaTable,
) -> Option<String> {
    /// Within which a direction lies in a face \[rad\].
    const ANGLE: f64 = 1e-9;
    let kind = source.kind();
    let frame = frame_of(source.cs());
    let half_angle = kind.half_angle();
    let outline = if kind.is_point() { Outline::Disk { radius: POINT } } else { kind.births() };
    let flat = Flat::new(source.name(), frame, outline, 0.0);
    surfaces.iter().find_map(|surface| {
        let divides = match surface.interaction {
            Interaction::Refractive => media.id(&surface.front) != media.id(&surface.back),
            Interaction::Reflective { .. } => true,
            Interaction::Absorbing => false,
        };
        let face = Face::of(surface, meshes);
        let normal = if kind.is_point() { face.normal_at(frame.origin)? } else { face.normal_under(&flat)? };
        let rise = normal.normalize().dot(frame.rotation.z_axis);
        let crosses = half_angle > FRAC_PI_2 + ANGLE || rise.abs() < half_angle.sin() - ANGLE;
        if divides && crosses {
            return Some(format!(
                "source {} lies in the face {} and shines to both sides of it: move it by a micrometre to the side that it \
                 belongs to",
                quoted(source.name()),
                quoted(&surface.name)
            ));
        }
        let ahead = if rise > 0.0 { &surface.back } else { &surface.front };
        let differs = media.id(ahead) != media.id(source.medium());
        (surface.interaction == Interaction::Refractive && differs).then(|| {
            format!(
                "source {} lies in the face {} and shines away from it into {}, but is said to be in {}: set its medium, or \
                 move it by a micrometre to the other side",
                quoted(source.name()),
                quoted(&surface.name),
                quoted(ahead.name()),
                quoted(source.medium().name())
            )
        })
    })
}

/// Detectors in the plane of a surface, or of a detector before them in the list.
fn hidden_detectors(file: &SceneFile, surfaces: &[SceneSurface], meshes: &[Mesh]) -> Vec<String> {
    let detectors: Vec<_> = file.detectors.iter().map(|detector| lowered(detector, None)).collect();
    let faces: Vec<Face<'_>> = surfaces.iter().map(|surface| Face::of(surface, meshes)).collect();
    let mut before: Vec<Flat<'_>> = Vec::new();
    let mut warnings = Vec::new();
    for detector in &detectors {
        let flat = Flat::new(&detector.name, detector.frame, detector.outline(), 0.0);
        let surface = surfaces.iter().zip(&faces).find(|(_, face)| face.covers_flat(&flat));
        let earlier = || before.iter().find(|other| other.covers(&flat)).map(|other| other.name);
        if let Some(other) = surface.map(|(surface, _)| surface.name.as_str()).or_else(earlier) {
            warnings.push(format!(
                "detector {} lies in the plane of {}: where the two coincide, rays meet the latter alone, as in Optiland; \
                 move one by a micrometre",
                quoted(&detector.name),
                quoted(other)
            ));
        }
        before.push(flat);
    }
    warnings
}

/// Absorbers that coincide with a surface of another kind: the first in the list is met.
fn absorbers_in_surfaces(surfaces: &[SceneSurface], meshes: &[Mesh]) -> Vec<String> {
    let absorbs = |surface: &SceneSurface| surface.interaction == Interaction::Absorbing;
    let faces: Vec<Face<'_>> = surfaces.iter().map(|surface| Face::of(surface, meshes)).collect();
    let mut warnings = Vec::new();
    for (i, absorber) in surfaces.iter().enumerate().filter(|(_, surface)| absorbs(surface)) {
        let others = surfaces.iter().enumerate().filter(|(_, surface)| !absorbs(surface));
        for (j, other) in others.filter(|(j, _)| faces[i].coincides(&faces[*j])) {
            let first = if i < j { absorber } else { other };
            warnings.push(format!(
                "absorber {} lies in {}: where the two coincide, rays meet {} alone, the first in the list; move one by a \
                 micrometre to where it belongs",
                quoted(&absorber.name),
                quoted(&other.name),
                quoted(&first.name)
            ));
        }
    }
    warnings
}

/// A surface, as far as it can coincide with others.
enum Face<'a> {
    Flat(Flat<'a>),
    Curved(Frame, Shape),
    Mesh(Frame, &'a Mesh),
}

impl<'a> Face<'a> {
    fn of(surface: &'a SceneSurface, meshes: &'a [Mesh]) -> Self {
        match (Flat::of_surface(surface), surface.shape.mesh()) {
            (Some(flat), _) => Face::Flat(flat),
            (None, Some(mesh)) => Face::Mesh(surface.frame, &meshes[mesh]),
            (None, None) => Face::Curved(surface.frame, surface.shape.clone()),
        }
    }

    fn covers_flat(&self, flat: &Flat<'_>) -> bool {
        self.normal_under(flat).is_some()
    }

    /// The geometric normal where the face coincides with a flat one, if it does.
    fn normal_under(&self, flat: &Flat<'_>) -> Option<DVec3> {
        match self {
            Face::Flat(own) => own.covers(flat).then_some(own.frame.rotation.z_axis),
            Face::Curved(..) => None,
            Face::Mesh(frame, mesh) => flat.facet_in_plane(frame, mesh),
        }
    }

    /// The geometric normal of a flat face, or of a facet, that a point lies in.
    fn normal_at(&self, point: DVec3) -> Option<DVec3> {
        let dot =
            |rotation| Flat::new("", Frame { origin: point, rotation }, Outline::Disk { radius: POINT }, 0.0);
        match self {
            Face::Flat(own) => self.normal_under(&dot(own.frame.rotation)),
            Face::Curved(..) => None,
            Face::Mesh(frame, mesh) => {
                let size = size_of(mesh);
                mesh.faces.iter().find_map(|&face| {
                    let corners = mesh.corners(face);
                    let normal = (frame.rotation * area_vector(corners)).try_normalize()?;
                    let (x, y) = normal.any_orthonormal_pair();
                    dot(DMat3::from_cols(x, y, normal)).area_of_facet(corners, frame, size)
                })
            }
        }
    }

    fn coincides(&self, other: &Face<'_>) -> bool {
        match (self, other) {
            // Each may have a hole that the other fills.
            (Face::Flat(one), Face::Flat(two)) => one.covers(two) && two.covers(one),
            (Face::Flat(flat), face) | (face, Face::Flat(flat)) => face.covers_flat(flat),
            (Face::Curved(frame, shape), Face::Curved(other_frame, other_shape)) => {
                is_one_surface((frame, shape), (other_frame, other_shape))
            }
            (Face::Mesh(frame, mesh), Face::Mesh(other_frame, other)) => {
                std::ptr::eq(*mesh, *other) && is_one_place(frame, other_frame, true)
            }
            (Face::Curved(..), Face::Mesh(..)) | (Face::Mesh(..), Face::Curved(..)) => false,
        }
    }
}

/// Radius of a disk that stands for a point, an area as far as faces are concerned \[mm\].
const POINT: f64 = 1e-6;

/// Roundings of a coordinate within which places coincide.
const ROUNDINGS: f64 = 16.0 * f64::EPSILON;

/// True if two frames share their origin and their z axis, and where it matters all axes.
fn is_one_place(a: &Frame, b: &Frame, all_axes: bool) -> bool {
    let size = a.origin.abs().max(b.origin.abs()).max_element().max(1.0);
    let axes = [(a.rotation.z_axis, b.rotation.z_axis), (a.rotation.x_axis, b.rotation.x_axis)];
    let checked = if all_axes { 2 } else { 1 };
    (a.origin - b.origin).length() <= ROUNDINGS * size
        && axes[..checked].iter().all(|(one, other)| (*one - *other).length() <= ROUNDINGS)
}

/// True if two curved shapes lie in one surface, and share its axis unless it is round.
fn is_one_surface((frame, shape): (&Frame, &Shape), (other_frame, other): (&Frame, &Shape)) -> bool {
    let has_one_centre = || {
        let reach = shape.extent(&[]).map_or(0.0, |extent| extent.reach);
        let size = frame.origin.abs().max_element().max(reach);
        (frame.origin - other_frame.origin).length() <= ROUNDINGS * size
    };
    shape.coincides(other)
        && if shape.is_round() { has_one_centre() } else { is_one_place(frame, other_frame, false) }
}

/// A flat face.
struct Flat<'a> {
    name: &'a str,
    frame: Frame,
    /// Corners of a polygon within its plane \[mm\]; none if it has no end.
    corners: Vec<DVec2>,
    /// Radius of the hole in its middle \[mm\].
    hole: f64,
}

impl<'a> Flat<'a> {
    fn new(name: &'a str, frame: Frame, outline: Outline, hole: f64) -> Self {
        const CORNERS: u32 = 32;
        let corners = match outline {
            Outline::Infinite => Vec::new(),
            Outline::Rectangle { width, height } => {
                let corner = |x: f64, y: f64| 0.5 * DVec2::new(x * width, y * height);
                vec![corner(-1.0, -1.0), corner(1.0, -1.0), corner(1.0, 1.0), corner(-1.0, 1.0)]
            }
            Outline::Disk { radius } => (0..CORNERS)
                .map(|i| {
                    DVec2::from_angle(f64::from(i) * std::f64::consts::TAU / f64::from(CORNERS)) * radius
                })
                .collect(),
        };
        Flat { name, frame, corners, hole }
    }

    fn of_surface(surface: &'a SceneSurface) -> Option<Self> {
        let shapes::Flat { outline, hole, z } = surface.shape.flat()?;
        Some(Flat::new(&surface.name, crate::scene::frame::shifted(&surface.frame, z), outline, hole))
    }

    /// The normal of a facet of a mesh that lies in the plane, within rounding, if the two have an area in common.
    fn facet_in_plane(&self, frame: &Frame, mesh: &Mesh) -> Option<DVec3> {
        let size = size_of(mesh);
        mesh.faces.iter().find_map(|&face| self.area_of_facet(mesh.corners(face), frame, size))
    }

    /// The area vector of a facet that lies in the plane and has an area in common with the face, of a mesh whose largest
    /// coordinate in its frame is `size`.
    fn area_of_facet(&self, corners: [DVec3; 3], frame: &Frame, size: f64) -> Option<DVec3> {
        let size = size + frame.origin.abs().max(self.frame.origin.abs()).max_element();
        let corners = corners.map(|p| frame.rotation * p + frame.origin - self.frame.origin);
        let normal = self.frame.rotation.z_axis;
        if corners.iter().any(|corner| corner.dot(normal).abs() > ROUNDINGS * size) {
            return None;
        }
        let flat = corners.map(|corner| (self.frame.rotation.transpose() * corner).truncate());
        let is_in_hole = flat.iter().all(|corner| corner.length() <= self.hole);
        (!is_in_hole && overlap(&self.corners, &flat, ROUNDINGS * size)).then(|| area_vector(corners))
    }

    /// True if the two lie in one plane, within rounding, and have an area in common.
    fn covers(&self, other: &Flat<'_>) -> bool {
        let (apart, normal) = (other.frame.origin - self.frame.origin, self.frame.rotation.z_axis);
        let size = self.frame.origin.abs().max(other.frame.origin.abs()).max_element().max(1.0);
        let is_parallel = normal.cross(other.frame.rotation.z_axis).length() <= ROUNDINGS;
        if !is_parallel || normal.dot(apart).abs() > ROUNDINGS * size {
            return false;
        }
        let local = |point: DVec3| (self.frame.rotation.transpose() * (point - self.frame.origin)).truncate();
        let corners: Vec<DVec2> = other
            .corners
            .iter()
            .map(|c| local(other.frame.origin + other.frame.rotation * c.extend(0.0)))
            .collect();
        let fits_the_hole = !corners.is_empty() && corners.iter().all(|corner| corner.length() <= self.hole);
        !fits_the_hole && overlap(&self.corners, &corners, ROUNDINGS * size)
    }
}

/// The largest coordinate of a mesh in its frame \[mm\], at least 1.
fn size_of(mesh: &Mesh) -> f64 {
    mesh.vertices.iter().map(|p| p.abs().max_element()).fold(1.0, f64::max)
}

/// True if two convex polygons have an area in common: no edge of either has all of the other beyond it, within a rounding
/// \[mm\].
fn overlap(a: &[DVec2], b: &[DVec2], rounding: f64) -> bool {
    let separates = |edges: &[DVec2], others: &[DVec2]| {
        let around: f64 = pairs(edges).map(|(from, to)| from.perp_dot(to)).sum();
        pairs(edges).any(|(from, to)| {
            let edge = (to - from) * around.signum();
            let touch = edge.length() * (rounding + 1e-12 * edge.length());
            others.iter().all(|point| edge.perp_dot(*point - from) <= touch)
        })
    };
    a.is_empty() || b.is_empty() || !(separates(a, b) || separates(b, a))
}

fn pairs(corners: &[DVec2]) -> impl Iterator<Item = (DVec2, DVec2)> {
    corners.iter().copied().zip(corners.iter().copied().cycle().skip(1))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn faces_in_one_plane_overlap_where_they_have_an_area_in_common() {
        let square = Outline::Rectangle { width: 2.0, height: 2.0 };
        let at = |x: f64, z: f64, turn: f64| Frame {
            origin: DVec3::new(x, 0.0, z),
            rotation: DMat3::from_rotation_z(turn),
        };
        let flat = |frame, outline, hole| Flat::new("", frame, outline, hole);
        let middle = flat(at(0.0, 0.0, 0.0), square, 0.0);
        for (frame, outline, covered) in [
            (at(0.0, 0.0, 0.0), square, true),
            (at(1.9, 0.0, 0.0), square, true),
            (at(2.0, 0.0, 0.0), square, false),
            (at(2.3, 0.0, 0.785), square, true),
            (at(2.5, 0.0, 0.785), square, false),
            (at(0.0, 1e-9, 0.0), square, false),
            (at(50.0, 0.0, 0.0), Outline::Infinite, true),
            (at(5.0, 0.0, 0.0), Outline::Disk { radius: 3.9 }, false),
            (at(5.0, 0.0, 0.0), Outline::Disk { radius: 4.1 }, true),
        ] {
            let other = flat(frame, outline, 0.0);
            assert_eq!(middle.covers(&other), covered, "{frame:?} {outline:?}");
            assert_eq!(other.covers(&middle), covered, "{frame:?} {outline:?}");
        }
        let ring = flat(at(0.0, 0.0, 0.0), Outline::Disk { radius: 9.0 }, 1.5);
        assert!(!ring.covers(&middle));
        assert!(ring.covers(&flat(at(1.0, 0.0, 0.0), square, 0.0)));
        let turned = Frame { origin: DVec3::ZERO, rotation: DMat3::from_rotation_x(1e-6) };
        assert!(!middle.covers(&flat(turned, square, 0.0)));
        let flipped = Frame { origin: DVec3::ZERO, rotation: DMat3::from_rotation_x(std::f64::consts::PI) };
        assert!(middle.covers(&flat(flipped, square, 0.0)));
    }
}
