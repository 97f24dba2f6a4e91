//! Contacts: faces so close that distances of this precision cannot order them.
//!
//! Two touching plates have two faces in one place. A ray must cross both, in the order that a vanishing gap would
//! give. Distances cannot decide the order, because distances differ by rounding.
//!
//! So the host finds the groups of faces that coincide: surfaces, detectors, facets of meshes. The shader
//! (shaders/geometry/contact.on.wgsl) lets a ray meet each face of a group at most once on its way through. Sides and
//! media decide there which face comes next.

use crate::error::{Error, Result};
use crate::model::Precision;
use crate::model::shapes::{Level, Quadric};
use crate::model::{
    Detector, FAR_FIELD_RADIUS, Frame, Interaction, Mesh, Outline, SceneIr, Shape, Source, Surface,
    area_vector, unit_normal,
};
use glam::{DVec2, DVec3};
use std::collections::HashMap;

/// The medium of a side that borders on no medium.
pub const NO_MEDIUM: u32 = u32::MAX;

/// Most layers of a group. A ray keeps in one word, a bit each, which faces of a group lie below it. One more bit marks
/// a ray that arrives.
const MOST_LAYERS: usize = 31;

/// The layer of all faces that no ray crosses. A ray stands on the side of such a face from which it came.
const OPAQUE_LAYER: usize = MOST_LAYERS - 1;

/// The position of a primitive, or of a facet of a mesh, among the faces in its place.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Contact {
    /// The number of the group of coinciding faces; 0 for a face that touches none.
    pub group: u32,
    /// The number of the face's bit in a ray's memory. Faces that overlap have different layers.
    pub layer: u32,
    /// Position in the group along the normal of its first face. Faces whose heights are the same within the rounding
    /// of f64 share a level.
    pub level: u32,
    /// True if the face's own normal points the other way.
    pub flipped: bool,
    /// Decides which face of a level is met, where physics has no answer.
    pub role: Role,
}

/// Decides whether a face of a level is met first. The shader has the same discriminants.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Role {
    /// A mirror or a refracting surface. Among several, sides and media decide.
    #[default]
    Surface = 0,
    /// An absorber. Of an absorber and another surface, only the first in the list is met.
    Absorber = 1,
    /// A detector. A detector is met only where there is no surface; of several detectors, only the first in the list
    /// is met.
    Detector = 2,
}

/// The contacts of a scene.
#[derive(Debug, Clone, Default)]
pub struct Contacts {
    /// The contact of every primitive: surfaces, then detectors. For a mesh with facets in contact: what its facets
    /// share.
    pub primitives: Vec<Contact>,
    /// The contacts of the faces of each mesh, by the number of the surface.
    pub facets: HashMap<usize, Vec<Contact>>,
    /// True for a primitive on which some source lies.
    pub born_on: Vec<bool>,
    /// The largest distance between faces in contact where a ray meets them \[mm\].
    pub tolerance: f64,
    /// The largest distance of a ray's birth from a face on which its source lies \[mm\].
    pub birth_tolerance: f64,
}

/// The number of roundings of a coordinate within which faces coincide.
const ROUNDINGS: f64 = 16.0;

/// The rounding of a coordinate in df64: sums and products lose up to 5 u^2, with u = 2^-24.
const DF64_EPSILON: f64 = 16.0 * (0.5 * f32::EPSILON as f64) * (0.5 * f32::EPSILON as f64);

/// The distance within which faces of this size coincide \[mm\].
pub fn tolerance(precision: Precision, size: f64) -> f64 {
    let epsilon = match precision {
        Precision::F32 => f64::from(f32::EPSILON),
        Precision::Df64 => DF64_EPSILON,
        Precision::F64 => f64::EPSILON,
    };
    ROUNDINGS * epsilon * size
}

impl Contacts {
    /// The contacts of a scene, for positions relative to `centre`.
    ///
    /// # Errors
    /// [`Error::Usage`] if more faces lie in one place than a ray can number.
    pub fn of(ir: &SceneIr, centre: DVec3, precision: Precision) -> Result<Self> {
        let mut search = Search::new(ir, centre, precision);
        search.join_primitives();
        search.join_meshes();
        let born_on = search.born_on();
        search.contacts(born_on)
    }

    /// True if some faces, or a source and a face, are in contact.
    pub fn any(&self) -> bool {
        self.has_groups() || self.born_on.contains(&true)
    }

    /// True if some faces coincide.
    pub fn has_groups(&self) -> bool {
        !self.facets.is_empty() || self.primitives.iter().any(|contact| contact.group != 0)
    }

    /// True if the primitive, or a facet of it, is in contact with other faces.
    pub fn touches(&self, primitive: usize) -> bool {
        self.primitives.get(primitive).is_some_and(|contact| contact.group != 0)
            || self.facets.contains_key(&primitive)
    }

    /// True if a source lies on the primitive.
    pub fn is_born_on(&self, primitive: usize) -> bool {
        self.born_on.get(primitive).copied().unwrap_or_default()
    }
}

/// A search for contacts, and what it found. A node is a primitive, or the facets of a mesh in one plane.
struct Search<'a> {
    ir: &'a SceneIr,
    centre: DVec3,
    precision: Precision,
    /// The face of every primitive that is not a mesh.
    faces: Vec<Option<Face>>,
    meshes: Vec<PlacedMesh<'a>>,
    groups: Groups,
    /// The largest distance within which the faces found coincide \[mm\].
    tolerance: f64,
    birth_tolerance: f64,
    /// The size of the region where rays are \[mm\]. Far-field detectors do not count, with their radius of 1e6 mm.
    extent: f64,
    /// The rounding of places in f64 before they were re-centred \[mm\].
    rounding: f64,
}

/// Something that can be in contact.
#[derive(Debug, Clone, Copy)]
enum Node {
    Primitive(usize),
    /// The facets of a placed mesh in one plane.
    Plane {
        mesh: usize,
        plane: u32,
    },
}

/// Nodes by number, joined to groups.
#[derive(Default)]
struct Groups {
    nodes: Vec<Node>,
    parents: Vec<usize>,
    /// True for a node that is joined with another, or with itself.
    touches: Vec<bool>,
}

impl Groups {
    fn add(&mut self, node: Node) -> usize {
        self.nodes.push(node);
        self.parents.push(self.parents.len());
        self.touches.push(false);
        self.parents.len() - 1
    }

    fn root(&mut self, mut node: usize) -> usize {
        while self.parents[node] != node {
            self.parents[node] = self.parents[self.parents[node]];
            node = self.parents[node];
        }
        node
    }

    fn join(&mut self, a: usize, b: usize) {
        (self.touches[a], self.touches[b]) = (true, true);
        let (a, b) = (self.root(a), self.root(b));
        self.parents[a.max(b)] = a.min(b);
    }

    /// The nodes of each group.
    fn members(&mut self) -> Vec<Vec<usize>> {
        let mut of_root: HashMap<usize, usize> = HashMap::new();
        let mut members: Vec<Vec<usize>> = Vec::new();
        for node in (0..self.nodes.len()).filter(|&node| self.touches[node]).collect::<Vec<_>>() {
            let root = self.root(node);
            let group = *of_root.entry(root).or_insert_with(|| {
                members.push(Vec::new());
                members.len() - 1
            });
            members[group].push(node);
        }
        members
    }
}

impl<'a> Search<'a> {
    fn new(ir: &'a SceneIr, centre: DVec3, precision: Precision) -> Self {
        let of_surface = |surface: &Surface| Face::of(surface.frame, &surface.shape, centre);
        let of_detector =
            |detector: &Detector| Face::of(detector.frame, &Shape::Plane(detector.outline()), centre);
        let faces: Vec<Option<Face>> =
            ir.surfaces.iter().map(of_surface).chain(ir.detectors.iter().map(of_detector)).collect();
        let mut groups = Groups::default();
        for i in 0..faces.len() {
            groups.add(Node::Primitive(i));
        }
        let mut planes: HashMap<usize, Vec<u32>> = HashMap::new();
        let placed = ir.surfaces.iter().enumerate().filter_map(|(surface, of)| {
            let mesh = of.shape.mesh()?;
            let plane_of = planes.entry(mesh).or_insert_with(|| planes_of(&ir.meshes[mesh])).clone();
            Some(PlacedMesh::new(surface, &ir.meshes[mesh], &of.frame.relative_to(centre), plane_of))
        });
        let meshes: Vec<PlacedMesh<'_>> = placed.collect();
        let is_finite = |face: &&Face| face.reach < FAR_FIELD_RADIUS;
        let extent = faces.iter().flatten().filter(is_finite).map(|face| face.size);
        let births = ir.sources.iter().map(|source| Births::of(source, centre).size);
        let extent = extent.chain(births).chain(meshes.iter().map(|mesh| mesh.size)).fold(0.0, f64::max);
        let surfaces = ir.surfaces.iter().map(|surface| surface.frame);
        let frames = surfaces.chain(ir.detectors.iter().map(|detector| detector.frame));
        let frames = frames.chain(ir.sources.iter().map(|source| source.frame));
        let farthest = frames.map(|frame| frame.origin.abs().max_element()).fold(0.0, f64::max);
        let rounding = tolerance(Precision::F64, farthest);
        let [tolerance, birth_tolerance] = [0.0; 2];
        Search { ir, centre, precision, faces, meshes, groups, tolerance, birth_tolerance, extent, rounding }
    }

    /// The distance within which faces of this size coincide \[mm\].
    fn within(&self, size: f64) -> f64 {
        let by_tier = tolerance(self.precision, size.min(self.extent));
        by_tier.max(self.within_f64(size))
    }

    /// The same in f64, whatever the tier \[mm\].
    fn within_f64(&self, size: f64) -> f64 {
        tolerance(Precision::F64, size) + self.rounding
    }

    fn join(&mut self, a: Node, b: Node, within: f64) {
        let [a, b] = [a, b].map(|node| self.number(node));
        self.groups.join(a, b);
        self.tolerance = self.tolerance.max(within);
    }

    fn number(&mut self, node: Node) -> usize {
        match node {
            Node::Primitive(i) => i,
            Node::Plane { mesh, plane } => {
                let number = &mut self.meshes[mesh].planes[plane as usize].node;
                *number.get_or_insert_with(|| self.groups.add(node))
            }
        }
    }

    /// Joins surfaces and detectors that coincide.
    fn join_primitives(&mut self) {
        // Faces that coincide have the same distance from any point.
        let of = |i: usize| self.faces[i].as_ref().map(|face| (i, face));
        let mut order: Vec<(usize, &Face)> = (0..self.faces.len()).filter_map(of).collect();
        order.sort_by(|a, b| a.1.from_centre.total_cmp(&b.1.from_centre));
        let widest = order.iter().map(|(_, face)| self.within(face.size)).fold(0.0, f64::max);
        let mut joined = Vec::new();
        for (place, (i, face)) in order.iter().enumerate() {
            for (j, other) in &order[place + 1..] {
                if other.from_centre - face.from_centre > 4.0 * widest {
                    break;
                }
                if face.overlaps(other) && self.coincide(face, other) {
                    let within = self.within(face.size.min(other.size));
                    joined.push((Node::Primitive(*i), Node::Primitive(*j), within));
                }
            }
        }
        joined.into_iter().for_each(|(a, b, within)| self.join(a, b, within));
    }

    /// True if each face's points lie on the other face. A point is as exact as the face to which it belongs.
    fn coincide(&self, a: &Face, b: &Face) -> bool {
        let lies = |on: &Face, face: &Face| {
            let within = self.within(face.size);
            face.points.iter().all(|&p| on.distance(p).abs() <= within)
        };
        lies(a, b) && lies(b, a)
    }

    /// Joins facets in one plane of a mesh, on flat faces, and on facets of other meshes.
    fn join_meshes(&mut self) {
        let mut joined = Vec::new();
        for (k, placed) in self.meshes.iter().enumerate() {
            let in_plane = |plane: u32| Node::Plane { mesh: k, plane };
            let several = (0..).zip(&placed.planes).filter(|(_, plane)| plane.faces.len() > 1);
            let within = self.within_f64(placed.size);
            joined.extend(several.map(|(plane, _)| (in_plane(plane), in_plane(plane), within)));
            for (i, face) in self.faces.iter().enumerate() {
                let Some(face) = face.as_ref().filter(|face| face.is_flat()) else { continue };
                let within = self.within(placed.size.min(face.size));
                if !face.reaches(placed, within) {
                    continue;
                }
                let on_face = (0..placed.mesh.faces.len()).filter(|&facet| {
                    let corners = placed.corners(facet);
                    corners.iter().all(|&p| face.distance(p).abs() <= within) && is_resolved(corners, within)
                });
                joined.extend(
                    on_face.map(|facet| (Node::Primitive(i), in_plane(placed.plane_of[facet]), within)),
                );
            }
            for (l, other) in self.meshes.iter().enumerate().skip(k + 1) {
                let within = self.within(placed.size.min(other.size));
                let pairs = facets_in_contact(placed, other, within);
                joined.extend(pairs.into_iter().map(|[a, b]| {
                    (in_plane(placed.plane_of[a]), Node::Plane { mesh: l, plane: other.plane_of[b] }, within)
                }));
            }
        }
        joined.into_iter().for_each(|(a, b, within)| self.join(a, b, within));
    }

    /// The primitives on which some source lies.
    fn born_on(&mut self) -> Vec<bool> {
        let mut born_on = vec![false; self.faces.len()];
        for source in &self.ir.sources {
            let births = Births::of(source, self.centre);
            for (i, face) in self.faces.iter().enumerate() {
                let Some(face) = face else { continue };
                let within = self.within(births.size.max(face.frame.origin.abs().max_element()));
                let is_near = births.middle.distance(face.middle) <= births.reach + face.reach + within;
                if is_near && births.points.iter().all(|&p| face.distance(p).abs() <= within) {
                    born_on[i] = true;
                    self.birth_tolerance = self.birth_tolerance.max(within);
                }
            }
            for placed in &self.meshes {
                let within = self.within(births.size.max(placed.size));
                if !born_on[placed.surface] && placed.has_births(&births, within) {
                    born_on[placed.surface] = true;
                    self.birth_tolerance = self.birth_tolerance.max(within);
                }
            }
        }
        born_on
    }

    fn contacts(mut self, born_on: Vec<bool>) -> Result<Contacts> {
        let mut primitives: Vec<Contact> =
            (0..self.faces.len()).map(|i| Contact { role: self.role(i), ..Contact::default() }).collect();
        let mut facets: HashMap<usize, Vec<Contact>> = HashMap::new();
        for (group, nodes) in (1..).zip(self.groups.members()) {
            for (face, contact) in self.ranked(group, &nodes)? {
                match face {
                    Member::Primitive(i) => primitives[i] = contact,
                    Member::Facet { mesh, facet } => {
                        let placed = &self.meshes[mesh];
                        let none = || vec![Contact::default(); placed.mesh.faces.len()];
                        facets.entry(placed.surface).or_insert_with(none)[facet] = contact;
                    }
                }
            }
        }
        let [tolerance, birth_tolerance] = [4.0 * self.tolerance, 4.0 * self.birth_tolerance];
        Ok(Contacts { primitives, facets, born_on, tolerance, birth_tolerance })
    }

    /// True for an absorber, and for a mirror that does not scatter.
    fn is_never_crossed(&self, primitive: usize) -> bool {
        self.ir.surfaces.get(primitive).is_some_and(|surface| match surface.interaction {
            Interaction::Absorbing => true,
            Interaction::Reflective { .. } => surface.scatter.is_none(),
            Interaction::Refractive => false,
        })
    }

    fn role(&self, primitive: usize) -> Role {
        match self.ir.surfaces.get(primitive).map(|surface| &surface.interaction) {
            Some(Interaction::Absorbing) => Role::Absorber,
            Some(Interaction::Refractive | Interaction::Reflective { .. }) => Role::Surface,
            None => Role::Detector,
        }
    }

    /// The contacts of a group's faces.
    fn ranked(&self, group: u32, nodes: &[usize]) -> Result<Vec<(Member, Contact)>> {
        let members: Vec<Unit> = nodes.iter().map(|&node| self.unit(self.groups.nodes[node])).collect();
        let Some(base) = members.iter().min_by_key(|unit| unit.primitive) else { return Ok(Vec::new()) };
        let levels = self.levels(&members, base);
        let faces: Vec<(Member, usize, bool)> =
            members.iter().enumerate().flat_map(|(k, unit)| self.faces_of(unit, k, base)).collect();
        let layers = self.layers(&members, &levels, &faces)?;
        let contacts = faces.into_iter().map(|(face, k, flipped)| {
            let primitive = members[k].primitive;
            let layer = layers.get(&(primitive, flipped)).copied().unwrap_or_default() as u32;
            (face, Contact { group, layer, level: levels[k], flipped, role: self.role(primitive) })
        });
        Ok(contacts.collect())
    }

    /// The level of each member, by its height above `base`. Members whose heights are the same within the rounding of
    /// f64 share a level.
    fn levels(&self, members: &[Unit], base: &Unit) -> Vec<u32> {
        let height = |unit: &Unit| {
            let sum: f64 = unit.points.iter().map(|&p| self.height(base, p)).sum();
            sum / unit.points.len() as f64
        };
        let mut heights: Vec<(f64, usize)> = (0..).zip(members).map(|(k, unit)| (height(unit), k)).collect();
        heights.sort_by(|a, b| a.0.total_cmp(&b.0));
        let mut levels = vec![0; members.len()];
        let mut level = 0;
        for pair in heights.windows(2) {
            let [(below, _), (above, k)] = [pair[0], pair[1]];
            level += u32::from(above - below > self.within_f64(members[k].size));
            levels[k] = level;
        }
        levels
    }

    /// The faces of a member, its number, and for each face whether its normal points against the normal of the group's
    /// first member.
    fn faces_of(&self, unit: &Unit, number: usize, base: &Unit) -> Vec<(Member, usize, bool)> {
        let is_flipped = |normal: DVec3| normal.dot(base.normal) < 0.0;
        match unit.node {
            Node::Primitive(i) => {
                let normal = self.faces[i].as_ref().map_or(DVec3::ZERO, |face| face.slope(base.points[0]));
                vec![(Member::Primitive(i), number, is_flipped(normal))]
            }
            Node::Plane { mesh, plane } => {
                let placed = &self.meshes[mesh];
                let facets = placed.planes[plane as usize].faces.iter().map(|&facet| facet as usize);
                let face = |facet| (Member::Facet { mesh, facet }, number, is_flipped(placed.normal(facet)));
                facets.map(face).collect()
            }
        }
    }

    /// A layer for each primitive and orientation of its faces. Faces that overlap get different layers. Faces of one
    /// primitive with the same orientation share a layer: where two of its facets coincide, the second adds nothing.
    fn layers(
        &self,
        members: &[Unit],
        levels: &[u32],
        faces: &[(Member, usize, bool)],
    ) -> Result<HashMap<(usize, bool), usize>> {
        let mut keys: Vec<(usize, bool, usize)> =
            faces.iter().map(|&(_, k, flipped)| (members[k].primitive, flipped, k)).collect();
        keys.sort_unstable();
        keys.dedup_by_key(|key| (key.0, key.1));
        let is_detector = |primitive: usize| primitive >= self.ir.surfaces.len();
        let overlap = |a: &Unit, b: &Unit| {
            a.primitive == b.primitive || a.middle.distance(b.middle) <= a.reach + b.reach
        };
        let mut layers: HashMap<(usize, bool), usize> = HashMap::new();
        for (place, &(primitive, flipped, k)) in keys.iter().enumerate() {
            if self.is_never_crossed(primitive) {
                layers.insert((primitive, flipped), OPAQUE_LAYER);
                continue;
            }
            let others = keys[..place].iter().filter(|&&(other, _, l)| {
                // Of detectors of one level, only the first is met.
                let hides = is_detector(other) && is_detector(primitive) && levels[l] == levels[k];
                overlap(&members[l], &members[k]) && !hides
            });
            let taken: Vec<usize> =
                others.filter_map(|&(other, flipped, _)| layers.get(&(other, flipped)).copied()).collect();
            let layer = (0..).find(|layer| !taken.contains(layer)).unwrap_or_default();
            if layer >= OPAQUE_LAYER {
                return Err(Error::scene(
                    self.name(primitive),
                    format!("more than {OPAQUE_LAYER} faces that light crosses lie in one place with it"),
                    "move some of them by a micrometre",
                ));
            }
            layers.insert((primitive, flipped), layer);
        }
        Ok(layers)
    }

    fn name(&self, primitive: usize) -> &str {
        match primitive.checked_sub(self.ir.surfaces.len()) {
            None => &self.ir.surfaces[primitive].name,
            Some(detector) => &self.ir.detectors[detector].name,
        }
    }

    fn unit(&self, node: Node) -> Unit {
        match node {
            Node::Primitive(i) => match &self.faces[i] {
                Some(face) => Unit {
                    node,
                    primitive: i,
                    normal: face.slope(face.points[0]),
                    points: face.points.clone(),
                    middle: face.middle,
                    reach: face.reach,
                    size: face.size,
                },
                None => Unit::empty(node, i),
            },
            Node::Plane { mesh, plane } => {
                let placed = &self.meshes[mesh];
                let facets = &placed.planes[plane as usize].faces;
                let Some(&first) = facets.first() else { return Unit::empty(node, placed.surface) };
                Unit {
                    node,
                    primitive: placed.surface,
                    normal: placed.normal(first as usize),
                    points: facets.iter().take(8).flat_map(|&f| placed.corners(f as usize)).collect(),
                    middle: 0.5 * (placed.low + placed.high),
                    reach: 0.5 * (placed.high - placed.low).length(),
                    size: placed.size,
                }
            }
        }
    }

    /// Signed distance of a point from the face of a unit, along its normal \[mm\].
    fn height(&self, base: &Unit, p: DVec3) -> f64 {
        match base.node {
            Node::Primitive(i) => self.faces[i].as_ref().map_or(0.0, |face| face.distance(p)),
            Node::Plane { .. } => (p - base.points[0]).dot(base.normal),
        }
    }
}

/// A face of a group.
#[derive(Debug, Clone, Copy)]
enum Member {
    Primitive(usize),
    Facet { mesh: usize, facet: usize },
}

/// A node of a group, with the data that determine its position in the group.
struct Unit {
    node: Node,
    primitive: usize,
    normal: DVec3,
    points: Vec<DVec3>,
    /// The ball that holds the node.
    middle: DVec3,
    reach: f64,
    size: f64,
}

impl Unit {
    fn empty(node: Node, primitive: usize) -> Self {
        let [normal, middle] = [DVec3::Z, DVec3::ZERO];
        Unit { node, primitive, normal, points: vec![middle], middle, reach: 0.0, size: 0.0 }
    }
}

/// A surface or a detector, relative to the scene's centre.
struct Face {
    frame: Frame,
    shape: Shape,
    points: Vec<DVec3>,
    /// The ball that holds the face \[mm\].
    middle: DVec3,
    reach: f64,
    /// Largest coordinate of its points \[mm\].
    size: f64,
    /// Distance of its surface from the centre \[mm\], to first order.
    from_centre: f64,
}

impl Face {
    /// The face of a shape; `None` for a shape without sample points, such as a mesh.
    fn of(frame: Frame, shape: &Shape, centre: DVec3) -> Option<Self> {
        let frame = frame.relative_to(centre);
        let points: Vec<DVec3> =
            shape.samples().into_iter().map(|p| frame.rotation * p + frame.origin).collect();
        if points.is_empty() {
            return None;
        }
        let size = points.iter().map(|p| p.abs().max_element()).fold(0.0, f64::max);
        let mut face = Face {
            frame,
            shape: shape.clone(),
            points,
            middle: frame.origin,
            reach: shape.extent(&[]).map_or(f64::INFINITY, |extent| extent.reach),
            size,
            from_centre: 0.0,
        };
        face.from_centre = face.distance(DVec3::ZERO).abs();
        Some(face)
    }

    fn level(&self, p: DVec3) -> Level {
        let local = self.frame.rotation.transpose() * (p - self.frame.origin);
        self.shape.level(local).unwrap_or(Quadric::PLANE.level(local))
    }

    fn slope(&self, p: DVec3) -> DVec3 {
        self.frame.rotation * self.level(p).gradient
    }

    /// Signed distance of a point from the shape along its normal, to first order.
    fn distance(&self, p: DVec3) -> f64 {
        let Level { value, gradient, .. } = self.level(p);
        value / (self.frame.rotation * gradient).length().max(f64::MIN_POSITIVE)
    }

    fn is_flat(&self) -> bool {
        self.shape.quadric().is_some_and(|quadric| quadric.is_flat())
    }

    fn overlaps(&self, other: &Face) -> bool {
        self.middle.distance(other.middle) <= self.reach + other.reach
    }

    fn reaches(&self, placed: &PlacedMesh, within: f64) -> bool {
        let nearest = self.middle.clamp(placed.low, placed.high);
        self.middle.distance(nearest) <= self.reach + within
    }
}

/// A mesh in the place that a surface gives it, relative to the scene's centre.
struct PlacedMesh<'a> {
    surface: usize,
    mesh: &'a Mesh,
    vertices: Vec<DVec3>,
    /// The number of the plane of each face.
    plane_of: Vec<u32>,
    planes: Vec<FacetPlane>,
    low: DVec3,
    high: DVec3,
    /// Largest coordinate \[mm\].
    size: f64,
}

/// The facets of a mesh that lie in one plane.
#[derive(Debug, Clone, Default)]
struct FacetPlane {
    faces: Vec<u32>,
    node: Option<usize>,
}

impl<'a> PlacedMesh<'a> {
    fn new(surface: usize, mesh: &'a Mesh, frame: &Frame, plane_of: Vec<u32>) -> Self {
        let vertices: Vec<DVec3> = mesh.vertices.iter().map(|&p| frame.rotation * p + frame.origin).collect();
        let low = vertices.iter().copied().fold(DVec3::INFINITY, DVec3::min);
        let high = vertices.iter().copied().fold(DVec3::NEG_INFINITY, DVec3::max);
        let num_planes = plane_of.iter().max().map_or(0, |&plane| plane as usize + 1);
        let mut planes = vec![FacetPlane::default(); num_planes];
        for (facet, &plane) in (0..).zip(&plane_of) {
            planes[plane as usize].faces.push(facet);
        }
        let size = low.abs().max(high.abs()).max_element();
        PlacedMesh { surface, mesh, vertices, plane_of, planes, low, high, size }
    }

    fn corners(&self, facet: usize) -> [DVec3; 3] {
        self.mesh.faces[facet].map(|vertex| self.vertices[vertex as usize])
    }

    fn normal(&self, facet: usize) -> DVec3 {
        unit_normal(self.corners(facet))
    }

    fn bounds(&self, facet: usize) -> (DVec3, DVec3) {
        let [a, b, c] = self.corners(facet);
        (a.min(b).min(c), a.max(b).max(c))
    }

    /// True if births lie in the plane of a facet, and near the facet.
    fn has_births(&self, births: &Births, within: f64) -> bool {
        let room = DVec3::splat(within);
        let (low, high) = (births.low - room, births.high + room);
        let meets = |(below, above): (DVec3, DVec3)| below.cmple(high).all() && low.cmple(above).all();
        meets((self.low, self.high))
            && (0..self.mesh.faces.len()).filter(|&facet| meets(self.bounds(facet))).any(|facet| {
                let (corner, normal) = (self.corners(facet)[0], self.normal(facet));
                births.points.iter().all(|&p| (p - corner).dot(normal).abs() <= within)
            })
    }
}

/// The places where the rays of a source are born, relative to the scene's centre.
struct Births {
    points: Vec<DVec3>,
    middle: DVec3,
    reach: f64,
    low: DVec3,
    high: DVec3,
    /// Largest coordinate \[mm\].
    size: f64,
}

impl Births {
    fn of(source: &Source, centre: DVec3) -> Self {
        let frame = source.frame.relative_to(centre);
        let half = match source.kind.births() {
            Outline::Rectangle { width, height } => 0.5 * DVec2::new(width, height),
            Outline::Disk { radius } => DVec2::splat(radius),
            Outline::Infinite => DVec2::ZERO,
        };
        let signs = [DVec2::new(-1.0, -1.0), DVec2::new(1.0, -1.0), DVec2::new(-1.0, 1.0), DVec2::ONE];
        let is_point = half == DVec2::ZERO;
        let [bottom, top] = source.kind.heights();
        let heights = if bottom < top { vec![bottom, top] } else { vec![0.0] };
        let corners = signs.into_iter().filter(|_| !is_point).map(|sign| sign * half);
        let corners = corners.flat_map(|corner| heights.iter().map(move |height| corner.extend(*height)));
        let points: Vec<DVec3> =
            std::iter::once(DVec3::ZERO).chain(corners).map(|p| frame.rotation * p + frame.origin).collect();
        let low = points.iter().copied().fold(DVec3::INFINITY, DVec3::min);
        let high = points.iter().copied().fold(DVec3::NEG_INFINITY, DVec3::max);
        let size = low.abs().max(high.abs()).max_element();
        Births {
            points,
            middle: frame.origin,
            reach: half.length().hypot(top.abs().max(bottom.abs())),
            low,
            high,
            size,
        }
    }
}

/// The number of the plane of each face of a mesh. Faces in one plane agree within the rounding of f64, whatever the
/// tier. Facets that are flat in a coarser tier still bound a solid.
fn planes_of(mesh: &Mesh) -> Vec<u32> {
    /// Planes whose keys differ by more are not compared.
    const KEYS_APART: f64 = 1e-9;
    let size = mesh.vertices.iter().map(|p| p.abs().max_element()).fold(f64::MIN_POSITIVE, f64::max);
    let within = tolerance(Precision::F64, size);
    // The key is the same for both orientations, and differs between nearly all planes.
    let key = |normal: DVec3, p: DVec3| {
        (normal.dot(DVec3::new(0.754_877_666, 0.569_840_291, 0.430_159_709))
            + 0.324_717_957 * normal.dot(p) / size)
            .abs()
    };
    let mut facets: Vec<(f64, u32)> = (0..)
        .zip(&mesh.faces)
        .map(|(facet, &face)| {
            let corners = mesh.corners(face);
            (key(unit_normal(corners), corners[0]), facet)
        })
        .collect();
    facets.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    let mut plane_of = vec![0; mesh.faces.len()];
    // Key, corner and normal of the first facet of each plane, in the order of the keys.
    let mut firsts: Vec<(f64, DVec3, DVec3)> = Vec::new();
    for (key, facet) in facets {
        let corners = mesh.corners(mesh.faces[facet as usize]);
        let near = firsts.iter().enumerate().rev().take_while(|(_, first)| key - first.0 <= KEYS_APART);
        let normal = unit_normal(corners);
        let mut found = near.filter(|(_, (_, corner, of_first))| {
            let lies = corners.iter().all(|p| (*p - *corner).dot(*of_first).abs() <= within);
            lies && of_first.dot(normal).abs() > 0.5
        });
        let plane = found.next().map(|(plane, _)| plane);
        plane_of[facet as usize] = match plane {
            Some(plane) => plane as u32,
            None => {
                firsts.push((key, corners[0], normal));
                firsts.len() as u32 - 1
            }
        };
    }
    plane_of
}

/// Pairs of coinciding facets of two meshes.
fn facets_in_contact(a: &PlacedMesh, b: &PlacedMesh, within: f64) -> Vec<[usize; 2]> {
    let room = DVec3::splat(within);
    let (low, high) = (a.low.max(b.low) - room, a.high.min(b.high) + room);
    if !low.cmple(high).all() {
        return Vec::new();
    }
    let near = |mesh: &PlacedMesh| {
        let mut facets: Vec<(usize, DVec3, DVec3)> = (0..mesh.mesh.faces.len())
            .map(|facet| (facet, mesh.bounds(facet)))
            .filter(|(_, (below, above))| below.cmple(high).all() && low.cmple(*above).all())
            .map(|(facet, (below, above))| (facet, below - room, above + room))
            .collect();
        let axis = (high - low).max_position();
        facets.sort_by(|a, b| a.1[axis].total_cmp(&b.1[axis]));
        (facets, axis)
    };
    let ((of_a, axis), (of_b, _)) = (near(a), near(b));
    let mut pairs = Vec::new();
    // A sweep along the longest axis of the region that both meshes share.
    let longest = of_b.iter().map(|(_, below, above)| above[axis] - below[axis]).fold(0.0, f64::max);
    for (f, below, above) in &of_a {
        let corners = a.corners(*f);
        let (corner, normal) = (corners[0], a.normal(*f));
        let from = of_b.partition_point(|(_, other, _)| other[axis] < below[axis] - longest);
        let to = of_b.partition_point(|(_, other, _)| other[axis] <= above[axis]);
        for (g, other_below, other_above) in &of_b[from..to] {
            if !(below.cmple(*other_above).all() && other_below.cmple(*above).all()) {
                continue;
            }
            let others = b.corners(*g);
            let lies = others.iter().all(|&p| (p - corner).dot(normal).abs() <= within)
                && corners.iter().all(|&p| (p - others[0]).dot(b.normal(*g)).abs() <= within);
            if lies && is_resolved(corners, within) && is_resolved(others, within) {
                pairs.push([*f, *g]);
            }
        }
    }
    pairs
}

/// True if a facet is much larger than a tolerance. A smaller facet lies within the tolerance of anything that passes
/// by.
fn is_resolved(corners: [DVec3; 3], within: f64) -> bool {
    const TIMES: f64 = 8.0;
    let [a, b, c] = corners;
    let longest = (b - a).length().max((c - b).length()).max((a - c).length());
    area_vector(corners).length() > TIMES * within * longest
}
