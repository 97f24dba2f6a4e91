//! The hot path: what most rays of a scene do, which shaders/cpu/path/hot_path.wgsl follows without a loop.
//!
//! Between two faces of a lens no other face of it needs a search. The ray stays in the box around the two primitives
//! of an event and the next. A primitive whose box lies apart cannot come between, and is not asked. Boxes and their
//! room for roundings are the tree's (crate::program::geometry::tree). A primitive in the box is not searched either,
//! if nearly all profiled rays miss it. A miss test then proves that each ray misses it (crate::cpu::path::miss_test).

use crate::cpu::log::format::{self, DepositLog};
use crate::cpu::path::miss_test::{self, MissTest, ProfiledRays};
pub use crate::cpu::path::sampled_path::{ProfiledPath, SampledPath};
use crate::model::{Frame, Interaction, SceneIr, Shape, Source, Surface};
use crate::program::geometry::contact::Contacts;
use crate::program::geometry::tree;
use crate::program::{Cells, Features, ProgramOptions, SecondMoments};
use glam::DVec3;
use obvhs::aabb::Aabb;

/// A longer path is not followed: its code would grow with it.
pub const MAX_EVENTS: u32 = 32;

/// A path on which more primitives are to be looked at is not followed either.
const MOST_LOOKED_AT: usize = 256;

/// A path behind which more primitives are to be missed is not followed either: a tree is sooner searched.
const MOST_MISSED: usize = 24;

/// Assumptions pay as long as all of them hold for this share of the rays: the others are traced twice.
pub const LEAST_ASSUMED: f64 = 0.995;

/// The path and what to look for on its way.
#[derive(Debug, Clone, PartialEq)]
pub struct HotPath {
    /// In their order.
    pub events: Vec<HotPathEvent>,
    /// Where rays escape behind the last event: what they could still meet there.
    pub missed: Option<Missed>,
}

/// What escaping rays could meet.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Missed {
    /// What is searched: ascending.
    pub candidates: Vec<usize>,
    /// All other primitives, each with the test that proves a miss.
    pub passed: Vec<(usize, MissTest)>,
}

/// One event of the path.
#[derive(Debug, Clone, PartialEq)]
pub struct HotPathEvent {
    /// The primitive that is met: surfaces first, then detectors.
    pub primitive: usize,
    /// The ray ends on it.
    pub ends: bool,
    /// The primitives that are searched, ascending: this one, and all that can be met before it.
    pub candidates: Vec<usize>,
    /// The primitive is a conic, and rays meet its crossing that is nearer to their line's closest approach to its
    /// origin.
    pub at_nearer_crossing: bool,
    /// Other primitives that could be met before it, each with the test that proves a miss.
    pub passed: Vec<(usize, MissTest)>,
    /// What the path does at a refracting surface, where its rays agree.
    pub crossing: Option<Crossing>,
}

/// How a ray comes to a refracting surface, and how it goes on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Crossing {
    /// It comes from the side of the front medium.
    pub entering_back: bool,
    /// It goes back to that side.
    pub reflected: bool,
}

impl HotPath {
    /// The path of the profiled rays. `None` if the path is too long, if no stage supports it ([`is_possible`]), or if it is
    /// incomplete.
    pub fn of(
        ir: &SceneIr,
        centre: DVec3,
        contacts: &Contacts,
        options: &ProgramOptions,
        profiled_path: &ProfiledPath,
    ) -> Option<Self> {
        let ProfiledPath { primitives, samples, escapes, .. } = profiled_path;
        let (&last, before) = primitives.split_last()?;
        let fits = primitives.len() <= MAX_EVENTS.min(options.max_depth) as usize;
        let goes_on = |i: usize| goes_on(ir, i, options.max_depth);
        let is_full = primitives.len() == options.max_depth as usize && goes_on(last);
        let has_end = if *escapes { goes_on(last) && !is_full } else { ends(ir, last) || is_full };
        let goes = has_end && before.iter().all(|&i| goes_on(i));
        // Of three faces within the tolerance, two of them in contact, their order decides which is the nearest. A tree
        // keeps no order.
        let has_order = !contacts.has_groups() || options.tree_primitives(ir).is_empty();
        if !(fits && goes && has_order && is_possible(ir, options)) {
            return None;
        }
        let boxes = tree::boxes(ir, centre, contacts);
        let legs: Vec<Leg> = legs(sources_box(ir, centre), primitives, &boxes).collect();
        if (*escapes && boxes.len() > MOST_MISSED)
            || legs.iter().map(|leg| leg.can_be_met(&boxes).count()).sum::<usize>() > MOST_LOOKED_AT
        {
            return None;
        }
        let shapes = crate::model::primitives::primitives(ir);
        let touches = |i: usize| contacts.touches(i);
        let mut profiled = ProfiledRays::new(samples, LEAST_ASSUMED);
        let events = legs.iter().enumerate().map(|(step, leg)| {
            let &Leg { leaves, primitive, bounds } = leg;
            profiled.step = step;
            let miss_test = |i: usize| {
                let bounds = bounds.filter(|_| i != primitive && !touches(i))?;
                let size = farthest(&bounds, shapes[i].0.origin - centre);
                MissTest::of(&shapes[i], leaves == Some(i), true, size, options.precision, &mut profiled)
            };
            let (candidates, passed) = parted(leg.can_be_met(&boxes), miss_test);
            let at_nearer_crossing = !touches(primitive)
                && leaves != Some(primitive)
                && miss_test::end_at_nearer_crossing(&shapes[primitive], &mut profiled);
            let is_last = step + 1 == primitives.len() && !escapes;
            let crossing = match is_last {
                true => None,
                false => crossing(&ir.surfaces, &shapes[primitive], primitive, &mut profiled),
            };
            let ends = is_last && !is_full;
            HotPathEvent { primitive, ends, candidates, at_nearer_crossing, passed, crossing }
        });
        let events = events.collect();
        profiled.step = legs.len();
        let missed = escapes.then(|| {
            let here = boxes.get(last).copied().flatten();
            let miss_test = |i: usize| {
                let bounds = here.zip(boxes[i]).filter(|_| !touches(i));
                let (here, there) = bounds?;
                let size = farthest(&here.union(&there), shapes[i].0.origin - centre);
                MissTest::of(&shapes[i], i == last, false, size, options.precision, &mut profiled)
            };
            let (candidates, passed) = parted(0..boxes.len(), miss_test);
            Missed { candidates, passed }
        });
        Some(HotPath { events, missed })
    }
}

/// Primitives to be searched, and those for which a miss test is found.
fn parted(
    primitives: impl Iterator<Item = usize>,
    mut miss_test: impl FnMut(usize) -> Option<MissTest>,
) -> (Vec<usize>, Vec<(usize, MissTest)>) {
    let (mut candidates, mut passed) = (Vec::new(), Vec::new());
    for i in primitives {
        match miss_test(i) {
            Some(miss_test) => passed.push((i, miss_test)),
            None => candidates.push(i),
        }
    }
    (candidates, passed)
}

/// How nearly all profiled rays cross a refracting surface at the end of the segment that is looked at.
fn crossing(
    surfaces: &[Surface],
    primitive: &(Frame, Shape),
    i: usize,
    profiled: &mut ProfiledRays,
) -> Option<Crossing> {
    let refracts = surfaces.get(i).is_some_and(|surface| surface.interaction == Interaction::Refractive);
    let [comes, leaves] = refracts.then(|| miss_test::sides(primitive, profiled)).flatten()?;
    Some(Crossing { entering_back: comes, reflected: comes != leaves })
}

/// The way of a path's rays to one of its events.
struct Leg {
    /// The primitive that it begins on. `None` where rays are born.
    leaves: Option<usize>,
    /// The one that it ends on.
    primitive: usize,
    /// The box that it lies in, with room for roundings, if it has one.
    bounds: Option<Aabb>,
}

impl Leg {
    /// The primitives that the way may meet, its last one included.
    fn can_be_met<'a>(&'a self, boxes: &'a [Option<Aabb>]) -> impl Iterator<Item = usize> + 'a {
        let overlaps = |of_primitive: &Option<Aabb>| match (self.bounds, of_primitive) {
            (Some(bounds), Some(of_primitive)) => overlap(&bounds, of_primitive),
            _ => true,
        };
        boxes.iter().enumerate().filter(move |(_, of_primitive)| overlaps(of_primitive)).map(|(i, _)| i)
    }
}

/// The legs of a path over these primitives, whose boxes are given, from the box where its rays are born.
fn legs(births: Option<Aabb>, primitives: &[usize], boxes: &[Option<Aabb>]) -> impl Iterator<Item = Leg> {
    let mut here = births;
    // The largest coordinate so far: a position keeps the rounding of the way that led to it.
    let mut reach = here.map(|bounds| largest(&bounds));
    let mut leaves = None;
    primitives.iter().map(move |&primitive| {
        let there = boxes.get(primitive).copied().flatten();
        reach = reach.zip(there).map(|(reach, there)| reach.max(largest(&there)));
        let bounds = here.zip(there).zip(reach);
        let bounds = bounds.map(|((here, there), reach)| widened(here.union(&there), reach));
        here = there;
        Leg { leaves: leaves.replace(primitive), primitive, bounds }
    })
}

/// Whether a stage can follow a path, if there is one, so that rays that fail its guards leave no trace. The log must
/// name these rays, and nothing that rays meet on their way may go to memory at once.
pub fn is_possible(ir: &SceneIr, options: &ProgramOptions) -> bool {
    let features = Features::of(ir, &options.weights, options.roulette_threshold, options.max_depth);
    let cells = Cells::of(ir);
    options.moments == SecondMoments::None
        && features.has_quadrics_alone()
        && !options.has_events(&features)
        && DepositLog::of(ir, &features, &cells, options, features.whole_weights).is_some()
}

/// Whether the path can go on from a primitive: what a ray leaves on a detector in passing must be logged.
fn goes_on(ir: &SceneIr, primitive: usize, max_depth: u32) -> bool {
    match primitive.checked_sub(ir.surfaces.len()) {
        None => ir.surfaces[primitive].scatter.is_none() && !ends(ir, primitive),
        Some(detector) => {
            ir.detectors.get(detector).is_some_and(|detector| format::logs_passes(detector, max_depth))
        }
    }
}

/// Whether the path can end on a primitive.
fn ends(ir: &SceneIr, primitive: usize) -> bool {
    match primitive.checked_sub(ir.surfaces.len()) {
        None => ir.surfaces[primitive].interaction == Interaction::Absorbing,
        Some(detector) => ir.detectors.get(detector).is_some_and(|detector| detector.absorb),
    }
}

/// The box of where rays are born.
fn sources_box(ir: &SceneIr, centre: DVec3) -> Option<Aabb> {
    let of = |source: &Source| {
        let frame = source.frame.relative_to(centre);
        let at = |height: f64| {
            let frame = Frame { origin: frame.origin + height * frame.rotation.z_axis, ..frame };
            tree::bounds(&frame, &Shape::Plane(source.kind.births()), &[], 0.0)
        };
        let [low, high] = source.kind.heights();
        Some(at(low)?.union(&at(high)?))
    };
    let boxes: Option<Vec<Aabb>> = ir.sources.iter().map(of).collect();
    boxes?.into_iter().reduce(|a, b| a.union(&b))
}

/// With room for the roundings of positions among coordinates so large, as the tree's shader has it.
fn widened(bounds: Aabb, reach: f32) -> Aabb {
    let room = glam::Vec3A::splat(tree::SLACK as f32 * reach);
    Aabb::new(bounds.min - room, bounds.max + room)
}

fn largest(bounds: &Aabb) -> f32 {
    bounds.min.abs().max(bounds.max.abs()).max_element()
}

/// How far the corners of a box are from a place.
fn farthest(bounds: &Aabb, place: DVec3) -> f64 {
    let corner = |corner: glam::Vec3A| (glam::Vec3::from(corner).as_dvec3() - place).abs();
    corner(bounds.min).max(corner(bounds.max)).length()
}

fn overlap(a: &Aabb, b: &Aabb) -> bool {
    a.min.cmple(b.max).all() && b.min.cmple(a.max).all()
}
