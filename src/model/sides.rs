//! Whether the faces of solids agree on what is inside, found by a few rays of the host's own.
//!
//! From points of each boundary between media a ray goes out on either side. The medium where the ray starts must be
//! the medium on this side of the next boundary. If nothing is met, it must be the medium around the scene. Each such
//! way is a link between two sides. A face that is turned inside out disagrees along most of its links, and agrees
//! once it is turned back.

use crate::model::primitives::primitives;
use crate::model::surface_optics::is_boundary;
use crate::model::{Detector, Frame, Interaction, MediumId, Mesh, SceneIr, Shape, area_vector, unit_normal};
use glam::DVec3;
use std::collections::BTreeMap;

/// What is wrong with the sides of a scene.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct SideFaults {
    /// Groups of faces that agree with all others once they are turned, as indices of surfaces.
    pub turned: Vec<Vec<usize>>,
    /// Ways on which faces still disagree then, one for each side that they start from.
    pub disagreements: Vec<Disagreement>,
    /// Boundaries that were not looked at, because the scene is large.
    pub num_unseen: usize,
}

/// A way from a face within a medium to where that medium should not be.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Disagreement {
    /// The surface from which it starts.
    pub from: usize,
    /// The medium there.
    pub medium: MediumId,
    /// The surface that is met, and the medium on this side of it; `None` if nothing is met.
    pub to: Option<(usize, MediumId)>,
}

/// Cost of a search by `check` at most: rays, times the surfaces or facets that each is compared with.
pub const MOST_WORK: usize = 1 << 25;
/// Facets of a mesh from which rays are sent out.
const MOST_FACETS: usize = 24;
/// Groups of faces that are turned at most.
const MOST_TURNED: usize = 64;
/// A turned face leaves at most one in so many of its disagreements.
const LEAST_GAIN: usize = 4;

/// Rays of a side that may go wrong before the side is named: a quarter of them, and at least so many.
const MOST_SLIPS: usize = 2;

/// One side of a boundary: its surface, and whether the side is the front.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Side {
    surface: usize,
    is_front: bool,
}

/// A way between two sides, or from one to where nothing is.
#[derive(Debug, Clone, Copy)]
struct Link {
    from: Side,
    to: Option<Side>,
}

/// Looks at the sides of boundaries. `most_work` limits the search, as [`MOST_WORK`] does for `check`.
pub fn wrong_sides(ir: &SceneIr, most_work: usize) -> SideFaults {
    let (links, num_unseen) = links(ir, most_work);
    let ambient = ambient(ir);
    let mut is_turned = vec![false; ir.surfaces.len()];
    let agrees = |link: &Link, is_turned: &dyn Fn(usize) -> bool| {
        let there = |side: Side| medium(ir, side, is_turned(side.surface));
        there(link.from) == link.to.map_or(ambient, there)
    };
    let mut found = SideFaults { num_unseen, ..SideFaults::default() };
    let is_in_order = links.iter().all(|link| agrees(link, &|_| false));
    if is_in_order {
        return found;
    }
    let mut touching = vec![Vec::new(); ir.surfaces.len()];
    for (number, link) in links.iter().enumerate() {
        touching[link.from.surface].push(number);
        if let Some(to) = link.to.filter(|to| to.surface != link.from.surface) {
            touching[to.surface].push(number);
        }
    }
    let mut candidates = candidates(ir, &links, |link| agrees(link, &|_| false));
    candidates.retain(|group| group.iter().any(|&i| !touching[i].is_empty()));
    for _ in 0..MOST_TURNED {
        let gain = |group: &&Vec<usize>| {
            let mut numbers: Vec<usize> = group.iter().flat_map(|&i| touching[i].iter().copied()).collect();
            numbers.sort_unstable();
            numbers.dedup();
            let wrong = |is_turned: &dyn Fn(usize) -> bool| {
                numbers.iter().filter(|&&number| !agrees(&links[number], is_turned)).count()
            };
            // A group has its surfaces in ascending order.
            let flipped = |i: usize| is_turned[i] != group.binary_search(&i).is_ok();
            let (before, after) = (wrong(&|i: usize| is_turned[i]), wrong(&flipped));
            if LEAST_GAIN * after <= before { before - after } else { 0 }
        };
        // Of groups that gain alike, the smallest.
        let best = candidates.iter().map(|group| (gain(&group), group));
        let best = best.max_by_key(|(gain, group)| (*gain, std::cmp::Reverse(group.len())));
        let Some((2.., group)) = best else { break };
        group.iter().for_each(|&i| is_turned[i] = !is_turned[i]);
        found.turned.push(group.clone());
    }
    let mut by_side: BTreeMap<(usize, bool), Vec<&Link>> = BTreeMap::new();
    for link in &links {
        by_side.entry((link.from.surface, link.from.is_front)).or_default().push(link);
    }
    for links in by_side.into_values() {
        let wrong = links.iter().filter(|link| !agrees(link, &|i: usize| is_turned[i]));
        // A ray or two may slip out at a rim.
        if wrong.clone().count() >= MOST_SLIPS.max(links.len().div_ceil(4)) {
            found.disagreements.extend(wrong.take(1).map(|link| Disagreement {
                from: link.from.surface,
                medium: medium(ir, link.from, is_turned[link.from.surface]),
                to: link.to.map(|side| (side.surface, medium(ir, side, is_turned[side.surface]))),
            }));
        }
    }
    found
}

/// The medium about the scene: vacuum, or the medium of all sources if no boundary borders on vacuum. Sources in one
/// solid, as in a light guide, say nothing of what lies about it.
fn ambient(ir: &SceneIr) -> MediumId {
    let medium = ir.sources.first().map_or(SceneIr::VACUUM, |source| source.medium);
    let mut boundaries = ir.surfaces.iter().filter(|surface| is_boundary(surface));
    let is_immersed = ir.sources.iter().all(|source| source.medium == medium)
        && boundaries.all(|surface| ![surface.front, surface.back].contains(&SceneIr::VACUUM));
    if is_immersed { medium } else { SceneIr::VACUUM }
}

fn medium(ir: &SceneIr, side: Side, is_turned: bool) -> MediumId {
    let surface = &ir.surfaces[side.surface];
    if side.is_front != is_turned { surface.front } else { surface.back }
}

/// Each boundary, and each set of boundaries that agree with each other along links.
fn candidates(ir: &SceneIr, links: &[Link], agrees: impl Fn(&Link) -> bool) -> Vec<Vec<usize>> {
    let mut parents: Vec<usize> = (0..ir.surfaces.len()).collect();
    fn root(parents: &mut [usize], mut of: usize) -> usize {
        while parents[of] != of {
            parents[of] = parents[parents[of]];
            of = parents[of];
        }
        of
    }
    for Link { from, to } in links.iter().filter(|link| agrees(link)) {
        if let Some(to) = to.filter(|to| is_boundary(&ir.surfaces[to.surface])) {
            let (one, other) = (root(&mut parents, from.surface), root(&mut parents, to.surface));
            parents[one] = other;
        }
    }
    let mut groups: BTreeMap<usize, Vec<usize>> = BTreeMap::new();
    let boundaries = (0..ir.surfaces.len()).filter(|&i| is_boundary(&ir.surfaces[i]));
    let mut candidates: Vec<Vec<usize>> = Vec::new();
    for i in boundaries {
        groups.entry(root(&mut parents, i)).or_default().push(i);
        candidates.push(vec![i]);
    }
    candidates.extend(groups.into_values().filter(|group| group.len() > 1));
    candidates
}

/// A point of a face, and the normal there, in the scene's frame.
struct Start {
    point: DVec3,
    normal: DVec3,
}

/// The links of the boundaries, and the number of boundaries that were left out.
fn links(ir: &SceneIr, most_work: usize) -> (Vec<Link>, usize) {
    let primitives = primitives(ir);
    let work_per_ray: usize = primitives.iter().map(|(_, shape)| num_facets(ir, shape)).sum::<usize>().max(1);
    let size = primitives.iter().map(|(frame, _)| frame.origin.abs().max_element()).fold(1.0, f64::max);
    let mut rays_left = most_work / work_per_ray;
    let (mut links, mut num_unseen) = (Vec::new(), 0);
    for (i, surface) in ir.surfaces.iter().enumerate().filter(|(_, surface)| is_boundary(surface)) {
        num_unseen += usize::from(rays_left == 0);
        for Start { point, normal } in starts(&ir.meshes, &surface.frame, &surface.shape) {
            for is_front in [true, false] {
                if rays_left == 0 {
                    break;
                }
                rays_left -= 1;
                let outward = if is_front { -normal } else { normal };
                // Off the normal a little: rays along an axis of symmetry meet edges and tips.
                let direction = (outward + 0.15 * normal.any_orthonormal_vector()).normalize();
                let ray = Ray { start: point, direction, from: i, touch: 1e-7 * size };
                match ray.next(ir, &primitives) {
                    Next::Nothing => links.push(Link { from: Side { surface: i, is_front }, to: None }),
                    Next::Side(to) => links.push(Link { from: Side { surface: i, is_front }, to: Some(to) }),
                    Next::Unknown => {}
                }
            }
        }
    }
    (links, num_unseen)
}

fn num_facets(ir: &SceneIr, shape: &Shape) -> usize {
    shape.mesh().map_or(1, |mesh| ir.meshes[mesh].faces.len())
}

/// Points of a shape from which rays are sent out.
fn starts(meshes: &[Mesh], frame: &Frame, shape: &Shape) -> Vec<Start> {
    let placed = |point: DVec3, normal: DVec3| Start {
        point: frame.rotation * point + frame.origin,
        normal: frame.rotation * normal,
    };
    if let Some(mesh) = shape.mesh() {
        let mesh = &meshes[mesh];
        let step = mesh.faces.len().div_ceil(MOST_FACETS).max(1);
        let corners = mesh.faces.iter().step_by(step).map(|face| mesh.corners(*face));
        return corners
            .map(|corners| {
                placed((0.3 * corners[0]) + 0.32 * corners[1] + 0.38 * corners[2], unit_normal(corners))
            })
            .collect();
    }
    let is_whole = shape.flat().is_some_and(|flat| flat.hole == 0.0);
    // Samples of a flat face may lie on its edge, where rays slip out.
    let inward = |p: DVec3| {
        if is_whole { [0.9, 0.45].map(|share| p * DVec3::new(share, share, 1.0)).to_vec() } else { vec![p] }
    };
    let samples = shape.samples().into_iter().flat_map(inward).filter(|&p| shape.holds(p));
    samples.filter_map(|p| Some(placed(p, shape.level(p)?.gradient.try_normalize()?))).collect()
}

/// What a ray comes to.
enum Next {
    /// Nothing at all.
    Nothing,
    /// The side of a surface that borders on known media.
    Side(Side),
    /// Something that leaves open which medium is before it.
    Unknown,
}

struct Ray {
    start: DVec3,
    direction: DVec3,
    /// The surface that it leaves.
    from: usize,
    /// Faces so close are in one place \[mm\].
    touch: f64,
}

impl Ray {
    fn next(&self, ir: &SceneIr, primitives: &[(Frame, Shape)]) -> Next {
        let mut nearest = (f64::INFINITY, usize::MAX, DVec3::ZERO);
        // Those whose boxes come first are looked at first, so that few are searched.
        let lets_pass = |i: usize| {
            ir.detectors.get(i.wrapping_sub(ir.surfaces.len())).is_some_and(|d: &Detector| !d.absorb)
        };
        let boxes = primitives.iter().enumerate().filter(|(i, _)| !lets_pass(*i));
        let mut boxes: Vec<(f64, usize)> =
            boxes.filter_map(|(i, p)| Some((self.reaches(ir, p)?, i))).collect();
        boxes.sort_by(|a, b| a.0.total_cmp(&b.0));
        for (entry, i) in boxes {
            if entry > nearest.0 {
                break;
            }
            for (t, normal) in self.crossings(ir, &primitives[i]) {
                if t.abs() <= self.touch && i != self.from {
                    return Next::Unknown;
                }
                if t > self.touch && t < nearest.0 {
                    nearest = (t, i, normal);
                }
            }
        }
        let (distance, i, normal) = nearest;
        if distance.is_infinite() {
            return Next::Nothing;
        }
        match ir.surfaces.get(i) {
            Some(surface) if surface.interaction == Interaction::Refractive => {
                Next::Side(Side { surface: i, is_front: self.direction.dot(normal) > 0.0 })
            }
            Some(_) => Next::Unknown,
            None => match &ir.detectors[i - ir.surfaces.len()].kind {
                kind if !kind.is_placed() => Next::Nothing,
                _ => Next::Unknown,
            },
        }
    }

    /// Where the ray comes into the box of a primitive \[mm\]; `None` if it misses the box.
    fn reaches(&self, ir: &SceneIr, (frame, shape): &(Frame, Shape)) -> Option<f64> {
        let Some(extent) = shape.extent(&ir.meshes) else { return Some(0.0) };
        let half = extent.reach_along(&frame.rotation) * (1.0 + 1e-9) + DVec3::splat(self.touch);
        let offset = frame.rotation * extent.middle + frame.origin - self.start;
        let inverse = 1.0 / self.direction;
        let (one, other) = ((offset - half) * inverse, (offset + half) * inverse);
        let (entry, exit) = (one.min(other).max_element(), one.max(other).min_element());
        (entry <= exit && exit >= -self.touch).then_some(entry.max(0.0))
    }

    /// Distances to a primitive and its normals there, in the scene's frame.
    fn crossings(&self, ir: &SceneIr, (frame, shape): &(Frame, Shape)) -> Vec<(f64, DVec3)> {
        let to_local = frame.rotation.transpose();
        let (o, d) = (to_local * (self.start - frame.origin), to_local * self.direction);
        if let Some(mesh) = shape.mesh() {
            let mesh = &ir.meshes[mesh];
            let facets = mesh.faces.iter().filter_map(|face| facet_crossing(o, d, mesh.corners(*face)));
            return facets.map(|(t, normal)| (t, frame.rotation * normal)).collect();
        }
        let normal = |t: f64| shape.level(o + t * d).map(|level| (t, frame.rotation * level.gradient));
        shape.crossings(o, d).into_iter().filter_map(normal).collect()
    }
}

/// Where a line crosses a triangle, and the triangle's normal times its doubled area.
fn facet_crossing(o: DVec3, d: DVec3, corners: [DVec3; 3]) -> Option<(f64, DVec3)> {
    let normal = area_vector(corners);
    let slope = normal.dot(d);
    if slope == 0.0 {
        return None;
    }
    let t = normal.dot(corners[0] - o) / slope;
    let p = o + t * d;
    let is_left = |i: usize| {
        let (from, to) = (corners[i], corners[(i + 1) % 3]);
        (to - from).cross(p - from).dot(normal) >= 0.0
    };
    (0..3).all(is_left).then_some((t, normal))
}
