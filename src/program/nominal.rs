//! The nominal path: what most rays of a scene do, which shaders/nominal.wgsl follows without a loop.
//!
//! Between two events of the path a ray stays in the box around what it leaves and what it meets next; a primitive whose
//! box lies apart from that one cannot come between, and is not asked. The boxes are those of the tree (super::tree),
//! with the same room for roundings.

use super::contact::Contact;
use super::end_log::EndLog;
use super::{Cells, Features, ProgramOptions, SecondMoments, lowered, tree};
use crate::ir::{Emitter, EmitterKind, Frame, Outline, SceneIr, SensorKind, Shape};
use glam::DVec3;
use obvhs::aabb::Aabb;

/// Binding of the rays that strayed.
pub const STRAYS: u32 = 22;

/// A longer path is not followed: its code would grow with it.
const MAX_EVENTS: usize = 32;

/// The path and what to look for on its way.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct NominalPath {
    /// In their order.
    pub events: Vec<NominalEvent>,
}

/// One event of the path.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct NominalEvent {
    /// The primitive that is met: surfaces first, then sensors.
    pub primitive: usize,
    /// It, and what else can be met before it: ascending.
    pub candidates: Vec<usize>,
}

/// What a path is looked for in.
pub struct Scene<'a> {
    /// The scene.
    pub ir: &'a SceneIr,
    /// Its features.
    pub features: &'a Features,
    /// The centre of the scene \[mm\].
    pub centre: DVec3,
    /// Its cells.
    pub cells: &'a Cells,
    /// Which of its faces are in contact.
    pub contacts: &'a [Contact],
    /// The log of where rays end.
    pub end_log: Option<&'a EndLog>,
}

impl NominalPath {
    /// The path over these primitives. None where a stage of its own cannot follow it without a trace: where what rays
    /// meet on their way goes to memory at once, or they are told apart by more than where they end.
    pub fn of(scene: &Scene, options: &ProgramOptions) -> Option<Self> {
        let primitives = options.nominal.as_ref()?;
        let features = scene.features;
        let is_silent = scene.end_log.is_some()
            && options.baked
            && scene.cells.fit_reached_mask()
            && options.moments == SecondMoments::None
            && !options.has_events(features)
            && !features.has_meshes();
        let (&last, before) = primitives.split_last()?;
        let fits = primitives.len() <= MAX_EVENTS.min(options.max_depth as usize);
        if !is_silent || !fits || !ends(scene.ir, last) || !before.iter().all(|&i| passes(scene.ir, i)) {
            return None;
        }
        let boxes = boxes(scene, options);
        let mut here = emitters_box(scene);
        let events = primitives.iter().map(|&primitive| {
            let there = boxes.get(primitive).copied().flatten();
            let way = here.zip(there).map(|(here, there)| widened(here.union(&there)));
            let can_be_met = |i: &usize| match (way, boxes[*i]) {
                (Some(way), Some(bounds)) => overlap(&way, &bounds),
                _ => true,
            };
            here = there;
            NominalEvent { primitive, candidates: (0..boxes.len()).filter(can_be_met).collect() }
        });
        Some(NominalPath { events: events.collect() })
    }
}

/// Whether the path can go on from a primitive.
fn passes(ir: &SceneIr, primitive: usize) -> bool {
    ir.surfaces.get(primitive).is_some_and(|surface| surface.scatter.is_none())
}

/// Whether the path can end on a primitive: an absorbing surface shows itself when rays end there.
fn ends(ir: &SceneIr, primitive: usize) -> bool {
    match primitive.checked_sub(ir.surfaces.len()) {
        None => passes(ir, primitive),
        Some(sensor) => ir
            .sensors
            .get(sensor)
            .is_some_and(|sensor| sensor.absorb && !matches!(sensor.kind, SensorKind::RayDatabase { .. })),
    }
}

/// The boxes of all primitives; none for those without an end.
fn boxes(scene: &Scene, options: &ProgramOptions) -> Vec<Option<Aabb>> {
    let touch = tree::touch(scene.ir, scene.centre, options.precision);
    let primitives = lowered::primitives(scene.ir).into_iter().enumerate();
    primitives
        .map(|(i, (frame, shape))| {
            let touches = scene.contacts.get(i).is_some_and(|contact| contact.group != 0);
            let frame = Frame { origin: frame.origin - scene.centre, ..frame };
            tree::bounds(&frame, &shape, &scene.ir.meshes, if touches { touch } else { 0.0 })
        })
        .collect()
}

/// The box of where rays are born.
fn emitters_box(scene: &Scene) -> Option<Aabb> {
    let of = |emitter: &Emitter| {
        let frame = Frame { origin: emitter.frame.origin - scene.centre, ..emitter.frame };
        let outline = match emitter.kind {
            EmitterKind::Point { .. } => Outline::Disk { radius: 0.0 },
            EmitterKind::CollimatedTophat { aperture_radius }
            | EmitterKind::CollimatedGaussian { aperture_radius, .. } => {
                Outline::Disk { radius: aperture_radius }
            }
            EmitterKind::Extended { area, .. } => area,
        };
        tree::bounds(&frame, &Shape::Plane(outline), &[], 0.0)
    };
    let boxes: Option<Vec<Aabb>> = scene.ir.emitters.iter().map(of).collect();
    boxes?.into_iter().reduce(|a, b| a.union(&b))
}

/// With room for the roundings of a ray's position, as the tree's shader has it.
fn widened(bounds: Aabb) -> Aabb {
    let largest = bounds.min.abs().max(bounds.max.abs()).max_element();
    let room = glam::Vec3A::splat(tree::SLACK as f32 * largest);
    Aabb::new(bounds.min - room, bounds.max + room)
}

fn overlap(a: &Aabb, b: &Aabb) -> bool {
    a.min.cmple(b.max).all() && b.min.cmple(a.max).all()
}
