//! Point source transmittance: how much of the light of a far point comes to a detector, by the angle off the axis.
//!
//! PST is the mean irradiance on the detector over the irradiance of the beam on a plane across it. Source: Fest, Stray
//! Light Analysis and Control (SPIE 2013), section 2.2. The beam is turned about a pivot, angle by angle, and one
//! compiled shader serves all angles. Standard errors come from the scatter between rounds of rays. Single rays may
//! weigh less than squares can be summed for.

use crate::error::{Error, Result};
use crate::format::shown;
use crate::model::key_path::did_you_mean;
use crate::model::shapes::Outline;
use crate::model::sources::collimated::Collimated;
use crate::model::{DetectorKind, End, Frame, SceneIr, SourceKind, Step, StepKind};
use crate::result::Tally;
use crate::run::rounds::{Rounds, in_rounds};
use crate::run::{Collect, Next, Run, Session, Status, TraceOptions};
use crate::scene::Scene;
use glam::{DMat3, DVec3};
use std::collections::BTreeMap;
use std::f64::consts::PI;
use std::time::Duration;

/// What is asked for.
pub struct Pst<'a> {
    /// The scene.
    pub scene: &'a Scene,
    /// What [`Scene::lower`] made of it, which may have been changed since.
    pub model: &'a SceneIr,
    /// How a direction is traced, of which `num_rays` is the largest number of rays.
    pub options: TraceOptions,
    /// The directions of the source.
    pub directions: Vec<Direction>,
    /// The detector.
    pub detector: String,
    /// The source that is turned; none: a beam that overfills the scene, along the axis of the first source.
    pub source: Option<String>,
    /// The point about which the source is turned \[mm\]; none: the middle of the scene.
    pub pivot: Option<DVec3>,
    /// Each direction is traced until its relative error is this; none: all rays are.
    pub target_error: Option<f64>,
    /// Most rows of the table of paths of a round.
    pub path_rows: u32,
}

/// Where the source is, seen from the scene: an angle off the axis, and an azimuth from the source's x towards its y \[deg\].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Direction {
    /// Off the axis.
    pub angle: f64,
    /// About the axis.
    pub azimuth: f64,
}

/// A part of a point source transmittance, with its standard error.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Part {
    /// The transmittance.
    pub pst: f64,
    /// Its standard error.
    pub standard_error: f64,
}

/// What one direction has.
#[derive(Debug, Clone)]
pub struct PstPoint {
    /// The direction.
    pub direction: Direction,
    /// All light.
    pub all: Part,
    /// Rays that were traced.
    pub num_rays: u64,
    /// Deposits on the detector.
    pub num_hits: u64,
    /// True if the error that was asked for was reached.
    pub is_reached: bool,
    /// By the number of scatterings: none, one, and so on; the last entry is of all that scattered more often.
    pub by_order: Vec<Part>,
    /// By the surface that scattered first, most light first.
    pub by_first_scatterer: Vec<(String, Part)>,
    /// Light whose path had no place in the table.
    pub unknown: Part,
}

/// What was found.
#[derive(Debug)]
pub struct Transmittances {
    /// Directions that were asked for.
    pub num_directions: usize,
    /// Those that were traced.
    pub points: Vec<PstPoint>,
    /// Warnings of the traces, each once.
    pub warnings: Vec<String>,
    /// Why not all were.
    pub failure: Option<Error>,
}

/// Numbers of scatterings that are listed apart.
const ORDERS: usize = 4;
/// An error is believed from so many rounds on.
const FEWEST_ROUNDS: usize = 16;
/// An error is believed where so many rays came.
const FEWEST_HITS: u64 = 100;

impl Transmittances {
    /// True if a stop or an error left some directions out.
    pub fn is_partial(&self) -> bool {
        self.points.len() < self.num_directions
    }
}

impl Pst<'_> {
    /// Traces every direction. `ask` gets each run, and may ask for more. `next` gets how far a round has come, and says how to
    /// go on.
    ///
    /// # Errors
    /// [`Error::Usage`] for a detector or a source that does not do. Errors of a direction end the others, and stand beside what was
    /// found before.
    pub fn go(
        &self,
        session: &mut Session,
        mut ask: impl for<'r> FnMut(Run<'r>) -> Result<Run<'r>>,
        mut next: impl FnMut(&Status) -> Next,
    ) -> Result<Transmittances> {
        let beam = Beam::of(self.model, &self.detector, self.source.as_deref(), self.pivot)?;
        let num_directions = self.directions.len();
        let mut found =
            Transmittances { num_directions, points: Vec::new(), warnings: Vec::new(), failure: None };
        for direction in &self.directions {
            match self.point(&beam, *direction, session, &mut ask, &mut next, &mut found.warnings) {
                Ok(point) => found.points.push(point),
                Err(error) => {
                    found.failure = Some(error);
                    break;
                }
            }
        }
        Ok(found)
    }

    fn point(
        &self,
        beam: &Beam<'_>,
        direction: Direction,
        session: &mut Session,
        ask: &mut impl for<'r> FnMut(Run<'r>) -> Result<Run<'r>>,
        next: &mut impl FnMut(&Status) -> Next,
        warnings: &mut Vec<String>,
    ) -> Result<PstPoint> {
        let (model, pst_per_share) = beam.towards(direction);
        let options = in_rounds(TraceOptions {
            collect: Collect::Paths { rows: self.path_rows, ends: false },
            may_end_early: true,
            ..self.options.clone()
        });
        let run = session.run(ask(Run::of(self.scene, &model).options(options))?, Some(true))?;
        let mut received = Received::default();
        let outcome = run.pass_time(Duration::ZERO).go_with(|pass| {
            // Half a round would count as one.
            if next(&pass.status) != Next::GoOn {
                return Ok(Next::Cancel);
            }
            received.add(pass.tally()?, beam.detector);
            Ok(if self.target_error.is_some_and(|target| received.is_reached(target)) {
                Next::Stop
            } else {
                Next::GoOn
            })
        })?;
        let result = &outcome.result;
        // What warnings say of detectors is said of their maps; here errors are those between rounds.
        let grave = result.diagnostics.grave.iter().filter(|warning| !warning.contains("detector"));
        for warning in result.run.scene_warnings.iter().chain(grave) {
            if !warnings.contains(warning) {
                warnings.push(warning.clone());
            }
        }
        let is_reached = self.target_error.is_none_or(|target| received.is_reached(target));
        Ok(received.point(direction, &model, pst_per_share, is_reached))
    }
}

/// The scene with its source in a direction, and no other source: as [`Pst`] traces it.
///
/// # Errors
/// [`Error::Usage`] for a detector or a source that does not do.
pub fn turned(
    model: &SceneIr,
    detector: &str,
    (source, pivot): (Option<&str>, Option<DVec3>),
    direction: Direction,
) -> Result<SceneIr> {
    Ok(Beam::of(model, detector, source, pivot)?.towards(direction).0)
}

/// The source that is turned.
struct Beam<'a> {
    model: &'a SceneIr,
    source: usize,
    detector: usize,
    /// Area of the detector \[mm^2\].
    area: f64,
    pivot: DVec3,
    /// True if the beam has the size of the scene.
    overfills: bool,
    corners: Vec<DVec3>,
}

impl<'a> Beam<'a> {
    fn of(model: &'a SceneIr, detector: &str, source: Option<&str>, pivot: Option<DVec3>) -> Result<Self> {
        let overfills = source.is_none();
        let names = || model.detectors.iter().map(|detector| detector.name.as_str());
        let named = detector;
        let detector = names().position(|name| name == named).ok_or_else(|| {
            let advice = did_you_mean(named, names());
            Error::Usage(format!("`{}` is no detector; {advice}", shown(named)))
        })?;
        let area = match model.detectors[detector].outline() {
            Outline::Rectangle { width, height } => width * height,
            Outline::Disk { radius } if !is_far_field(&model.detectors[detector].kind) => {
                PI * radius * radius
            }
            Outline::Disk { .. } | Outline::Infinite => {
                let name = shown(named);
                return Err(Error::Usage(format!(
                    "the detector `{name}` has no area, and so no irradiance; name one of type irradiance"
                )));
            }
        };
        let names = || model.sources.iter().map(|source| source.name.as_str());
        let source = match source {
            None => 0,
            Some(wanted) => names().position(|name| name == wanted).ok_or_else(|| {
                let advice = did_you_mean(wanted, names());
                Error::Usage(format!("`{}` is no source; {advice}", shown(wanted)))
            })?,
        };
        if !overfills && uniform_beam(&model.sources[source].kind).is_none() {
            return Err(Error::Usage(format!(
                "the source `{}` is no beam of the same irradiance everywhere; name a collimated one with the profile tophat, or none: \
                 then a beam overfills the scene",
                shown(&model.sources[source].name)
            )));
        }
        let corners = corners(model);
        let middle = corners.iter().sum::<DVec3>() / corners.len().max(1) as f64;
        Ok(Beam { model, source, detector, area, pivot: pivot.unwrap_or(middle), overfills, corners })
    }

    /// The scene with the source in a direction alone, and the transmittance that it would have if all light came to the
    /// detector.
    fn towards(&self, direction: Direction) -> (SceneIr, f64) {
        let (angle, azimuth) = (direction.angle.to_radians(), direction.azimuth.to_radians());
        let mut model = self.model.clone();
        let mut source = model.sources.swap_remove(self.source);
        // The source lies towards (cos, sin) of the azimuth, so its light goes the other way.
        let axis = DVec3::new(azimuth.sin(), -azimuth.cos(), 0.0);
        let base = source.frame.rotation;
        let rotation = if angle == 0.0 { base } else { base * DMat3::from_axis_angle(axis, angle) };
        let turn = rotation * base.transpose();
        source.frame = Frame { rotation, origin: self.pivot + turn * (source.frame.origin - self.pivot) };
        if self.overfills {
            let (light, middle) = (rotation.z_axis, self.pivot);
            let across = |corner: &DVec3| (*corner - middle - light * light.dot(*corner - middle)).length();
            let along = |corner: &DVec3| light.dot(*corner - middle);
            let radius = self.corners.iter().map(across).fold(0.0, f64::max).max(f64::MIN_POSITIVE);
            let back = self.corners.iter().map(along).fold(0.0, f64::min);
            source.frame.origin = middle + light * (back - 0.01 * radius);
            source.kind = SourceKind::Collimated(Collimated { aperture_radius: radius, sigma: None });
            source.medium = SceneIr::VACUUM;
        }
        let radius = uniform_beam(&source.kind).unwrap_or(1.0);
        model.sources = vec![source];
        // A far field around the scene would take the beam before it is in.
        for (number, detector) in model.detectors.iter_mut().enumerate() {
            detector.absorb &= number == self.detector || !is_far_field(&detector.kind);
        }
        (model, PI * radius * radius / self.area)
    }
}

/// The radius of a beam of the same irradiance everywhere.
fn uniform_beam(kind: &SourceKind) -> Option<f64> {
    if let SourceKind::Collimated(Collimated { aperture_radius, sigma: None }) = kind {
        return Some(*aperture_radius);
    }
    None
}

/// True of a far field, whose outline is a disk of a kilometre: it has no irradiance.
pub(super) fn is_far_field(kind: &DetectorKind) -> bool {
    match kind {
        DetectorKind::FarField(_) => true,
        DetectorKind::Apart(apart) => is_far_field(&apart.of),
        DetectorKind::Irradiance(_) | DetectorKind::Spectral(_) | DetectorKind::RayDatabase(_) => false,
    }
}

/// The corners of a box that holds all surfaces and detectors that have an edge.
fn corners(model: &SceneIr) -> Vec<DVec3> {
    let (mut low, mut high) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
    let far_field = |number: usize| {
        let detector =
            number.checked_sub(model.surfaces.len()).and_then(|number| model.detectors.get(number));
        detector.is_some_and(|detector| is_far_field(&detector.kind))
    };
    let primitives = crate::model::primitives::primitives(model);
    for (_, (frame, shape)) in primitives.into_iter().enumerate().filter(|(number, _)| !far_field(*number)) {
        let Some(extent) = shape.extent(&model.meshes) else { continue };
        let (middle, reach) =
            (frame.origin + frame.rotation * extent.middle, extent.reach_along(&frame.rotation));
        (low, high) = (low.min(middle - reach), high.max(middle + reach));
    }
    if !(low.is_finite() && high.is_finite()) {
        return vec![DVec3::ZERO];
    }
    let pick =
        |bits: u8| DVec3::select(glam::BVec3::new(bits & 1 > 0, bits & 2 > 0, bits & 4 > 0), high, low);
    (0..8).map(pick).collect()
}

/// The parts into which light is divided.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Key {
    All,
    Order(usize),
    FirstScatterer(u32),
    Unknown,
}

/// What rounds brought to the detector.
#[derive(Debug, Default)]
struct Received {
    rounds: Rounds<Key>,
    num_hits: u64,
}

impl Received {
    /// Adds a round, after which the sums are these.
    fn add(&mut self, tally: &Tally, detector: usize) {
        let mut light: BTreeMap<Key, f64> = BTreeMap::new();
        self.num_hits = 0;
        if let Some(sums) = &tally.path_sums {
            let on_detector = |end: &End| end.detector() == Some(detector);
            for (sequence, sum) in sums.rows.iter().filter(|(sequence, _)| on_detector(&sequence.end)) {
                let order = sequence.scatterings().min(ORDERS - 1);
                let scatters =
                    |step: &&Step| matches!(step.kind, StepKind::ScatteredThrough | StepKind::ScatteredBack);
                let first =
                    sequence.steps.iter().find(scatters).map(|step| Key::FirstScatterer(step.surface));
                for key in [Some(Key::All), Some(Key::Order(order)), first].into_iter().flatten() {
                    *light.entry(key).or_default() += sum.quanta as f64;
                }
                self.num_hits += sum.count;
            }
            for (_, sum) in sums.other.iter().filter(|(end, _)| on_detector(end)) {
                for key in [Key::All, Key::Unknown] {
                    *light.entry(key).or_default() += sum.quanta as f64;
                }
                self.num_hits += sum.count;
            }
        }
        self.rounds.add(tally, light);
    }

    fn is_reached(&self, target: f64) -> bool {
        let [share, error] = self.rounds.share(&Key::All);
        self.rounds.len() >= FEWEST_ROUNDS && self.num_hits >= FEWEST_HITS && error <= target * share
    }

    fn point(&self, direction: Direction, model: &SceneIr, pst_per_share: f64, is_reached: bool) -> PstPoint {
        let part = |key| {
            let [pst, standard_error] = self.rounds.share(&key).map(|share| share * pst_per_share);
            Part { pst, standard_error }
        };
        let of_surface = |key: &Key| match *key {
            Key::FirstScatterer(surface) => Some((model.surface_name(surface as usize), part(*key))),
            Key::All | Key::Order(_) | Key::Unknown => None,
        };
        let mut by_first_scatterer: Vec<(String, Part)> = self.rounds.keys().filter_map(of_surface).collect();
        by_first_scatterer.sort_by(|one, other| other.1.pst.total_cmp(&one.1.pst));
        PstPoint {
            direction,
            all: part(Key::All),
            num_rays: self.rounds.num_rays,
            num_hits: self.num_hits,
            is_reached,
            by_order: (0..ORDERS).map(|order| part(Key::Order(order))).collect(),
            by_first_scatterer,
            unknown: part(Key::Unknown),
        }
    }
}
