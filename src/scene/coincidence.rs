//! Warnings of coincident faces for which physics has no answer. Such are a detector in a surface, an absorber in a
//! mirror or a refracting face, and a source in a face whose sides differ.

use std::f64::consts::FRAC_PI_2;

use glam::{DMat3, DVec2, DVec3};
use obvhs::aabb::Aabb;
use obvhs::bvh2::Bvh2;
use obvhs::ploc::{PlocBuilder, PlocSearchDistance, SortPrecision};

use crate::model::key_path::quoted;
use crate::model::shapes;
use crate::model::{Frame, Interaction, Mesh, Outline, Shape, area_vector};
use crate::scene::detectors::lowered;
use crate::scene::frame::frame_of;
use crate::scene::json::{SceneFile, Source};
use crate::scene::media::MediaTable;
use crate::scene::surfaces::SceneSurface;

/// What `check` and `trace` say of them. The tracer meets what is named here first (program::geometry::contact).
pub(super) fn warnings(
    file: &SceneFile,
    surfaces: &[SceneSurface],
    meshes: &[Mesh],
    media: &MediaTable,
) -> Vec<String> {
    warnings_near(file, surfaces, meshes, media, Near::of)
}

/// The same, where `near` finds faces that may coincide with one.
fn warnings_near(
    file: &SceneFile,
    surfaces: &[SceneSurface],
    meshes: &[Mesh],
    media: &MediaTable,
    near: fn(Vec<(usize, Aabb)>) -> Near,
) -> Vec<String> {
    let limits: Vec<[DVec3; 2]> = meshes.iter().map(limits_of).collect();
    let face = |surface| Face::of(surface, meshes, &limits);
    let faces: Vec<Face<'_>> = surfaces.iter().map(face).collect();
    let absorbs = |surface: usize| surfaces[surface].interaction == Interaction::Absorbing;
    let boxes = |is_in: &dyn Fn(usize) -> bool| {
        (0..faces.len()).filter(|&face| is_in(face)).map(|face| (face, faces[face].bounds())).collect()
    };
    let (all, others) = (near(boxes(&|_| true)), near(boxes(&|face| !absorbs(face))));
    let detectors: Vec<_> = file.detectors.iter().map(|detector| lowered(detector, None)).collect();
    let detectors: Vec<Flat<'_>> = detectors
        .iter()
        .map(|detector| Flat::new(&detector.name, detector.frame, detector.outline(), 0.0))
        .collect();
    let mut warnings = hidden_detectors(&detectors, surfaces, &faces, &all, near);
    warnings.extend(absorbers_in_surfaces(surfaces, &faces, &others));
    let births = |source| births_in_faces(source, surfaces, &faces, &all, media);
    warnings.extend(file.sources.iter().filter_map(births));
    warnings
}

/// A source that lies in a refracting face leaves it on the side that the source shines to: in the medium there. A
/// source that shines to both sides of a face has a warning too: half of its light begins where it was hardly meant to.
fn births_in_faces(
    source: &Source,
    surfaces: &[SceneSurface],
    faces: &[Face<'_>],
    near: &Near,
    media: &MediaTable,
) -> Option<String> {
    /// Within which a direction lies in a face \[rad\].
    const ANGLE: f64 = 1e-9;
    let kind = source.kind();
    let frame = frame_of(source.cs());
    let half_angle = kind.half_angle();
    let outline = if kind.is_point() { Outline::Disk { radius: POINT } } else { kind.births() };
    let flat = Flat::new(source.name(), frame, outline, 0.0);
    near.to(&flat.bounds()).into_iter().find_map(|index| {
        let (surface, face) = (&surfaces[index], &faces[index]);
        let divides = match surface.interaction {
            Interaction::Refractive => media.id(&surface.front) != media.id(&surface.back),
            Interaction::Reflective { .. } => true,
            Interaction::Absorbing => false,
        };
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
fn hidden_detectors(
    detectors: &[Flat<'_>],
    surfaces: &[SceneSurface],
    faces: &[Face<'_>],
    near: &Near,
    near_of: fn(Vec<(usize, Aabb)>) -> Near,
) -> Vec<String> {
    let near_detectors = near_of(detectors.iter().map(Flat::bounds).enumerate().collect());
    let mut warnings = Vec::new();
    for (index, flat) in detectors.iter().enumerate() {
        let bounds = flat.bounds();
        let surface = near.to(&bounds).into_iter().find(|&face| faces[face].covers_flat(flat));
        let earlier = || {
            let mut before = near_detectors.to(&bounds).into_iter().take_while(|&other| other < index);
            before.find(|&other| detectors[other].covers(flat)).map(|other| detectors[other].name)
        };
        if let Some(other) = surface.map(|surface| surfaces[surface].name.as_str()).or_else(earlier) {
            warnings.push(format!(
                "detector {} lies in the plane of {}: where the two coincide, rays meet the latter alone, as in Optiland; \
                 move one by a micrometre",
                quoted(flat.name),
                quoted(other)
            ));
        }
    }
    warnings
}

/// Absorbers that coincide with a surface of another kind: the first in the list is met. `others` are the
/// surfaces of another kind.
fn absorbers_in_surfaces(surfaces: &[SceneSurface], faces: &[Face<'_>], others: &Near) -> Vec<String> {
    let mut warnings = Vec::new();
    let all = surfaces.iter().enumerate();
    for (i, absorber) in all.filter(|(_, surface)| surface.interaction == Interaction::Absorbing) {
        let near = others.to(&faces[i].bounds()).into_iter();
        for j in near.filter(|&j| faces[i].coincides(&faces[j])) {
            let other = &surfaces[j];
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

/// Finds faces by their boxes: among very many, few can coincide with one.
struct Near {
    items: Vec<usize>,
    tree: Bvh2,
}

impl Near {
    /// Items, ascending, each with its box.
    fn of(boxes: Vec<(usize, Aabb)>) -> Self {
        let (items, boxes): (Vec<usize>, Vec<Aabb>) = boxes.into_iter().unzip();
        let order = (0..boxes.len() as u32).collect();
        let (distance, precision) = (PlocSearchDistance::VeryLow, SortPrecision::U64);
        let tree = PlocBuilder::new().build(distance, &boxes, order, precision, 0);
        Near { items, tree }
    }

    /// The items whose boxes meet one, ascending.
    fn to(&self, bounds: &Aabb) -> Vec<usize> {
        let mut found = Vec::new();
        let mut to_do = Vec::from_iter((!self.items.is_empty()).then_some(0));
        while let Some(node) = to_do.pop() {
            let node = &self.tree.nodes[node];
            let first = node.first_index as usize;
            match (node.aabb().intersect_aabb(bounds), node.is_leaf()) {
                (false, _) => {}
                (true, false) => to_do.extend([first, first + 1]),
                (true, true) => {
                    let leaf = &self.tree.primitive_indices[first..first + node.prim_count as usize];
                    found.extend(leaf.iter().map(|&place| self.items[place as usize]));
                }
            }
        }
        found.sort_unstable();
        #[cfg(test)]
        tests::COMPARED.set(tests::COMPARED.get() + found.len());
        found
    }
}

/// The box of points about an origin, with room for roundings of f64 and of the box itself.
fn box_of(points: impl IntoIterator<Item = DVec3>, origin: DVec3, reach: f64) -> Aabb {
    /// More than f32 rounds.
    const SHARE: f64 = 1e-6;
    let mut points = points.into_iter();
    let first = points.next().unwrap_or(origin);
    let (low, high) = points.fold((first, first), |(low, high), point| (low.min(point), high.max(point)));
    let rounding = 64.0 * ROUNDINGS * (origin.abs().max_element() + reach);
    let room = (SHARE * low.abs().max(high.abs()).max(DVec3::ONE)).max(DVec3::splat(rounding));
    Aabb::new((low - room).as_vec3a(), (high + room).as_vec3a())
}

/// A surface, as far as it can coincide with others.
enum Face<'a> {
    Flat(Flat<'a>),
    Curved(Frame, Shape),
    /// With the least and the largest coordinates of the mesh in its frame.
    Mesh(Frame, &'a Mesh, [DVec3; 2]),
}

impl<'a> Face<'a> {
    fn of(surface: &'a SceneSurface, meshes: &'a [Mesh], limits: &[[DVec3; 2]]) -> Self {
        match (Flat::of_surface(surface), surface.shape.mesh()) {
            (Some(flat), _) => Face::Flat(flat),
            (None, Some(mesh)) => Face::Mesh(surface.frame, &meshes[mesh], limits[mesh]),
            (None, None) => Face::Curved(surface.frame, surface.shape.clone()),
        }
    }

    /// A box that meets the boxes of all faces that coincide with this one; of a curved face, a box around its origin alone.
    fn bounds(&self) -> Aabb {
        match self {
            Face::Flat(flat) => flat.bounds(),
            Face::Curved(frame, shape) => box_of([], frame.origin, reach_of(shape)),
            Face::Mesh(frame, _, limits) => {
                let corner = |i: usize| DVec3::new(limits[i & 1].x, limits[i >> 1 & 1].y, limits[i >> 2].z);
                let reach = limits[0].abs().max(limits[1].abs()).length();
                box_of((0..8).map(|i| frame.rotation * corner(i) + frame.origin), frame.origin, reach)
            }
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
            Face::Mesh(frame, mesh, _) => flat.facet_in_plane(frame, mesh),
        }
    }

    /// The geometric normal of a flat face, or of a facet, that a point lies in.
    fn normal_at(&self, point: DVec3) -> Option<DVec3> {
        let dot =
            |rotation| Flat::new("", Frame { origin: point, rotation }, Outline::Disk { radius: POINT }, 0.0);
        match self {
            Face::Flat(own) => self.normal_under(&dot(own.frame.rotation)),
            Face::Curved(..) => None,
            Face::Mesh(frame, mesh, _) => {
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
            (Face::Mesh(frame, mesh, _), Face::Mesh(other_frame, other, _)) => {
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
        let size = frame.origin.abs().max_element().max(reach_of(shape));
        (frame.origin - other_frame.origin).length() <= ROUNDINGS * size
    };
    shape.coincides(other)
        && if shape.is_round() { has_one_centre() } else { is_one_place(frame, other_frame, false) }
}

/// How far a round shape reaches from its centre \[mm\]; 0 of another.
fn reach_of(shape: &Shape) -> f64 {
    shape.extent(&[]).filter(|_| shape.is_round()).map_or(0.0, |extent| extent.reach)
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

    fn bounds(&self) -> Aabb {
        /// Of a face without end, so much on each side: more than any other face is away \[mm\].
        const ENDLESS: f64 = 1e15;
        let square =
            [(-1.0, -1.0), (1.0, 1.0), (-1.0, 1.0), (1.0, -1.0)].map(|(x, y)| ENDLESS * DVec2::new(x, y));
        let corners: &[DVec2] = if self.corners.is_empty() { &square } else { &self.corners };
        let reach = self.corners.iter().map(|corner| corner.length()).fold(0.0, f64::max);
        let place = |corner: &DVec2| self.frame.rotation * corner.extend(0.0) + self.frame.origin;
        box_of(corners.iter().map(place), self.frame.origin, reach)
    }

    /// The normal of a facet of a mesh that lies in the plane, within rounding, if the two have an area in common.
    fn facet_in_plane(&self, frame: &Frame, mesh: &Mesh) -> Option<DVec3> {
        let size = size_of(mesh);
        mesh.faces.iter().find_map(|&face| self.area_of_facet(mesh.corners(face), frame, size))
    }

    /// The area vector of a mesh's facet that lies in the plane and has an area in common with the face. `size` is the
    /// mesh's largest coordinate in its frame.
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

/// The least and the largest coordinates of a mesh in its frame \[mm\].
fn limits_of(mesh: &Mesh) -> [DVec3; 2] {
    let first = mesh.vertices.first().copied().unwrap_or_default();
    mesh.vertices.iter().fold([first; 2], |[low, high], &p| [low.min(p), high.max(p)])
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
    #![allow(clippy::unwrap_used, reason = "a test may fail")]

    use std::cell::Cell;

    use serde_json::{Value, json};

    use super::*;
    use crate::Scene;

    thread_local! {
        /// Pairs of faces that were compared.
        pub(super) static COMPARED: Cell<usize> = const { Cell::new(0) };
    }

    impl Near {
        /// Finds every item.
        fn everything(boxes: Vec<(usize, Aabb)>) -> Self {
            let whole = Aabb::new(DVec3::splat(-1e30).as_vec3a(), DVec3::splat(1e30).as_vec3a());
            Near::of(boxes.into_iter().map(|(item, _)| (item, whole)).collect())
        }
    }

    fn scene(surfaces: Vec<Value>, sources: Vec<Value>, detectors: Vec<Value>) -> Scene {
        let block =
            json!({"version": 1, "media": {"glass": {"type": "constant", "n": 1.5}}, "surfaces": surfaces});
        let file = json!({"nsq_schema_version": 1, "components": [], "sources": sources, "detectors": detectors,
            "nsq_gpu": block});
        Scene::from_json(&file.to_string()).unwrap()
    }

    fn source(name: &str, cs: Value) -> Value {
        json!({"type": "collimated", "name": name, "cs": cs, "total_flux": 1, "aperture_radius": 1,
            "spectrum": {"wavelengths": [0.5], "weights": [1]}})
    }

    fn detector(name: &str, cs: Value) -> Value {
        json!({"type": "irradiance", "name": name, "cs": cs, "width": 4, "height": 2, "num_pixels_x": 2,
            "num_pixels_y": 2})
    }

    /// Draws from 0 to `end`, without its end.
    struct Draws(u64);

    impl Draws {
        fn below(&mut self, end: usize) -> usize {
            self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (self.0 >> 33) as usize % end
        }

        fn of<'a, T>(&mut self, all: &'a [T]) -> &'a T {
            &all[self.below(all.len())]
        }

        /// A place of few, so that many faces coincide; near the origin, or far from it.
        fn cs(&mut self, far: f64) -> Value {
            let mut at = || far + self.below(3) as f64 - 1.0;
            let (x, y, z) = (at(), at(), at());
            let rx = *self.of(&[0.0, 0.0, 0.0, std::f64::consts::FRAC_PI_2, std::f64::consts::PI, 0.3]);
            json!({"x": x, "y": y, "z": z, "rx": rx})
        }

        fn surface(&mut self, number: usize, far: f64) -> Value {
            let cube: Vec<[f64; 3]> =
                (0..8).map(|i| [0, 1, 2].map(|axis| f64::from(i >> axis & 1) * 2.0 - 1.0)).collect();
            let faces =
                [[0, 2, 1], [1, 2, 3], [4, 5, 6], [5, 7, 6], [0, 1, 4], [1, 5, 4], [2, 6, 3], [3, 6, 7]];
            let shape = match self.below(7) {
                0 => json!({"type": "plane"}),
                1 => json!({"type": "plane", "width": 2, "height": 1 + self.below(3)}),
                2 => json!({"type": "plane", "aperture_radius": 1 + self.below(2)}),
                3 => {
                    json!({"type": "annulus", "inner_radius": 1, "outer_radius": 2, "z_offset": self.below(2)})
                }
                4 => json!({"type": "sphere", "radius": 1 + self.below(2)}),
                5 => json!({"type": "conic", "radius": 20, "conic": 0, "aperture_radius": 1 + self.below(3)}),
                _ => json!({"type": "mesh", "vertices": cube, "faces": faces}),
            };
            let interaction = *self.of(&["absorbing", "absorbing", "reflective", "refractive"]);
            let mut surface = json!({"name": format!("F{number}"), "cs": self.cs(far), "shape": shape, "interaction": interaction});
            match interaction {
                "reflective" => surface["reflectance"] = 0.5.into(),
                "refractive" => surface["material_back"] = json!({"type": "medium", "name": "glass"}),
                _ => {}
            }
            surface
        }
    }

    /// Faces that boxes leave out would give no warning.
    #[test]
    fn boxes_change_no_warning() {
        let mut num_warnings = 0;
        for seed in 0..3000 {
            let mut draws = Draws(seed);
            let far = *draws.of(&[0.0, 0.0, 1e3, -1e9, 9e11]);
            let num_surfaces = 1 + draws.below(12);
            let surfaces = (0..num_surfaces).map(|i| draws.surface(i, far)).collect();
            let sources = ["S", "T"].map(|name| source(name, draws.cs(far))).to_vec();
            let detectors = ["D", "E", "F"].map(|name| detector(name, draws.cs(far))).to_vec();
            let Scene { file, surfaces, meshes, media, .. } = scene(surfaces, sources, detectors);
            let warn = |near| warnings_near(&file, &surfaces, &meshes, &media, near);
            let found = warn(Near::of);
            assert_eq!(found, warn(Near::everything), "{seed}");
            num_warnings += found.len();
        }
        assert!(num_warnings > 5_000, "{num_warnings}");
    }

    /// The time of a check grows with the surfaces, not with their square.
    #[test]
    fn few_of_many_faces_are_compared() {
        const NUM: usize = 20_000;
        let surface = |i: usize| {
            let cs = json!({"x": 3 * (i % 150), "y": 3 * (i / 150), "z": 5});
            let shape = json!({"type": "plane", "aperture_radius": 1});
            match i % 2 {
                0 => json!({"name": i.to_string(), "cs": cs, "shape": shape, "interaction": "absorbing"}),
                _ => {
                    json!({"name": i.to_string(), "cs": cs, "shape": shape, "interaction": "reflective", "reflectance": 1})
                }
            }
        };
        let detectors = (0..1000).map(|i| detector(&i.to_string(), json!({"x": 5 * i, "z": 9})));
        let sources = (0..1000).map(|i| source(&i.to_string(), json!({"x": 5 * i})));
        let scene = scene((0..NUM).map(surface).collect(), sources.collect(), detectors.collect());
        COMPARED.set(0);
        warnings(&scene.file, &scene.surfaces, &scene.meshes, &scene.media);
        assert!(COMPARED.get() < 2 * NUM, "{}", COMPARED.get());
    }

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
