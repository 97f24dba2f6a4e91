//! The record that a ray writes on the hot path or a side trace. The record holds the ray's positions on detectors and,
//! where weights differ, the weight or the end.
//!
//! Where all rays weigh the same at the same event, the host knows how much they leave, and no weight is logged. Where
//! rays arrive once more at the same place, as between parallel mirrors, the host knows the place, too. Where media
//! alone take something from rays, the last weight shows what media took. The profile only says what may be so: guards
//! of the stage look at each ray. A ray that weighs something else, loses something elsewhere or arrives elsewhere
//! fails a guard.

use crate::cpu::log::format::{DepositLog, EntryFormat, Grid};
use crate::cpu::path::hot_path::{Crossing, HotPath, HotPathEvent, LEAST_ASSUMED, ProfiledPath, SampledPath};
use crate::cpu::path::miss_test::{ProfiledRays, Segment};
use crate::model::{Detector, DetectorKind, Interaction, SceneIr, Splat};
use crate::program::features::Features;
use crate::program::layout::tables::{Cells, LedgerCell};
use crate::program::{Precision, ProgramOptions};

/// The log of a stage that follows a path.
#[derive(Debug, Clone, PartialEq)]
pub struct PathLog {
    /// What each ray logs, in the order of the path: its positions in pixels, and its weights if these are logged. On a
    /// path without places a ray logs one place with its last weight. That place only means that the ray failed no
    /// guard.
    pub places: Vec<Place>,
    /// What it leaves where it ends, unless that is on a detector.
    pub end: Option<LedgerEnd>,
    /// Each place is logged with the weight there ([`Weight::Logged`]). On so many of its legs a ray loses something to
    /// media, from its birth to its end. The end is the last place or, where there is no place, [`PathLog::end`].
    pub attenuating_legs: Option<u32>,
    /// On its way a ray that keeps to the path deposits nothing: what it logs is all that it leaves.
    pub tells_all: bool,
}

/// A place on a detector.
#[derive(Debug, Clone, PartialEq)]
pub struct Place {
    /// The detector's cells.
    pub grid: Grid,
    /// The detector, by its number among detectors.
    pub detector: usize,
    /// When rays arrive there.
    pub arrivals: Vec<Arrival>,
    /// Within this distance of an edge, roundings decide which pixel is hit, by columns and by rows \[pixels\]. `None`
    /// unless nearly all rays are farther.
    pub edge_room: Option<[f64; 2]>,
}

/// One of the times that rays arrive at a place.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Arrival {
    /// The event of the path, by its number.
    pub event: usize,
    /// What they weigh.
    pub weight: Weight,
}

/// Where the whole weight of rays goes that end on no detector.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LedgerEnd {
    /// The cell.
    pub cell: u32,
    /// What they weigh.
    pub weight: Weight,
}

/// What rays of the path weigh at one of its events.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Weight {
    /// What they were born with.
    Born,
    /// This weight.
    Known(f64),
    /// What they log: at most what they were born with.
    Logged,
}

impl Weight {
    /// The most that rays weigh that were born with this weight.
    pub fn most_of_born(self, born: f64) -> f64 {
        match self {
            Weight::Born | Weight::Logged => born,
            Weight::Known(weight) => weight,
        }
    }
}

/// The position alone gives the pixel, if at least this share of the rays is off the edges at all places. The others
/// fail the guard.
const LEAST_OFF_EDGES: f64 = 0.99;

/// [`Place::edge_room`] where the profiled rays arrive on a detector. `pixel_position` in splat.wgsl rounds the sum x +
/// half, the quotient, for which WGSL allows 2.5 ulp (section 15.7.4), and what is left after 0.5. `pixel_of` rounds
/// the product of the pitch and what is left after half. Together these are 12 units of roundoff of the number of
/// pixels, if each may be rounded either way. A factor of 16 leaves some room.
fn edge_room(detector: &Detector, precision: Precision, profile: &mut ProfiledRays) -> Option<[f64; 2]> {
    let grid = detector.kind.grid().filter(|_| detector.kind.is_plain_grid())?;
    let size = [grid.num_pixels_x, grid.num_pixels_y];
    let room = size.map(|num_pixels| 16.0 * f64::from(num_pixels) / precision.significands());
    let from_edge = |at: f64, width: f64, num_pixels: u32| {
        let edge = (at / width + 0.5) * f64::from(num_pixels);
        (edge - edge.round()).abs()
    };
    let is_off = |Segment { to, .. }: &Segment| {
        let by_axis = [from_edge(to.x, grid.width, size[0]), from_edge(to.y, grid.height, size[1])];
        by_axis.iter().zip(room).all(|(from_edge, room)| *from_edge > room)
    };
    profile.takes(&detector.frame, is_off).then_some(room)
}

/// Most bytes of a log. There are two logs.
const MAX_BYTES: u64 = 16 << 20;

impl DepositLog {
    /// Bytes of all that a ray may log, on the hot path (if it has a log of its own) or off it.
    pub fn ray_bytes(&self, path: Option<&PathLog>) -> u64 {
        let entries = u64::from(self.max_passes + 1) * u64::from(self.num_words() * self.word_bytes());
        entries.max(path.map_or(0, |path| path.ray_bytes(self.format)))
    }

    /// Rays of a dispatch, so many at most that the log stays small.
    pub fn max_rays(&self, path: Option<&PathLog>) -> u32 {
        (MAX_BYTES / self.ray_bytes(path)) as u32
    }
}

impl PathLog {
    /// The log of the hot path. `None` where rays arrive on no detector, or where a detector does not keep to bilinear
    /// taps. `None`, too, where weights differ by more than what media took.
    pub fn of(scene: &LoggedScene, path: &HotPath, profile: &ProfiledPath) -> Option<Self> {
        let log = PathLog::with_known_weights(scene, path, profile)
            .or_else(|| PathLog::with_logged_weights(scene, path, profile))?;
        (!log.places.is_empty()).then_some(log)
    }

    /// The log of a side trace, in the format of the hot path's log. A side trace may be without a place.
    pub fn beside(
        hot_path: &PathLog,
        scene: &LoggedScene,
        path: &HotPath,
        profile: &ProfiledPath,
    ) -> Option<Self> {
        let log = match hot_path.attenuating_legs {
            None => PathLog::with_known_weights(scene, path, profile),
            Some(_) => PathLog::with_logged_weights(scene, path, profile),
        };
        log.filter(|log| log.num_rows() <= hot_path.num_rows())
    }

    fn with_known_weights(scene: &LoggedScene, path: &HotPath, profile: &ProfiledPath) -> Option<Self> {
        let weights = KnownWeights::of(profile, scene.options, scene.features);
        let places = places(scene, path, profile, |event| weights.on_arrival(event))?;
        let end = match ledger_end(scene, path, path.events.last()?) {
            Some((cell, event)) => Some(LedgerEnd { cell, weight: weights.on_arrival(event)? }),
            None => None,
        };
        let tells_all = scene.features.keeps_weight && !may_underflow(scene.ir, path);
        Some(PathLog { places, end, attenuating_legs: None, tells_all })
    }

    fn with_logged_weights(scene: &LoggedScene, path: &HotPath, profile: &ProfiledPath) -> Option<Self> {
        let attenuating_legs = Some(attenuating_legs(scene, path, profile)?);
        let places = places(scene, path, profile, |_| Some(Weight::Logged))?;
        let end = ledger_end(scene, path, path.events.last()?)
            .map(|(cell, _)| LedgerEnd { cell, weight: Weight::Logged });
        let arrive_once = places.iter().all(|place| place.arrivals.len() == 1);
        // The last weight that is logged is the one that they end with.
        let ends_on_last = places.is_empty() == end.is_some();
        let tells_all = !may_underflow(scene.ir, path);
        (ends_on_last && arrive_once).then_some(PathLog { places, end, attenuating_legs, tells_all })
    }

    /// Rows of the log, of which each has a place of every ray.
    pub fn num_rows(&self) -> usize {
        self.places.len().max(1)
    }

    /// Bytes of all that a ray logs.
    pub fn ray_bytes(&self, format: EntryFormat) -> u64 {
        let num_reals = if self.attenuating_legs.is_some() { 4 } else { 2 };
        let real_bytes = if format == EntryFormat::Reals { 8 } else { 4 };
        self.num_rows() as u64 * num_reals * real_bytes
    }

    /// How rays arrive at an event: at which place, with its number.
    pub fn arrival(&self, event: usize) -> Option<(usize, &Place, &Arrival)> {
        self.places.iter().enumerate().find_map(|(number, place)| {
            let arrival = place.arrivals.iter().find(|arrival| arrival.event == event)?;
            Some((number, place, arrival))
        })
    }
}

/// What logs of paths are made for.
#[derive(Debug, Clone, Copy)]
pub struct LoggedScene<'a> {
    /// The scene.
    pub ir: &'a SceneIr,
    /// Its cells.
    pub cells: &'a Cells,
    /// The log that other rays write.
    pub log: &'a DepositLog,
    /// How the scene is specialised.
    pub options: &'a ProgramOptions,
    /// What it needs.
    pub features: &'a Features,
}

/// What is known, before a trace, of the weights of a path's rays.
struct KnownWeights<'a> {
    samples: &'a [SampledPath],
    /// Rays keep the weight that they are born with.
    are_kept: bool,
    /// All rays are born with the same weight. Several sources share the rays of a trace otherwise than the profiling
    /// run does.
    are_born_alike: bool,
}

impl<'a> KnownWeights<'a> {
    fn of(profile: &'a ProfiledPath, options: &ProgramOptions, features: &Features) -> Self {
        let born = same(&profile.samples, |sample| sample.weights.first().copied());
        let are_born_alike = born.is_some_and(|born| {
            options.weights.iter().all(|&weight| options.precision.nearest(weight) == born)
        });
        KnownWeights { samples: &profile.samples, are_kept: features.keeps_weight, are_born_alike }
    }

    /// What all rays that arrive at an event weigh, if that is known.
    fn on_arrival(&self, event: usize) -> Option<Weight> {
        if self.are_kept {
            return Some(Weight::Born);
        }
        // Each ray is born before the first event.
        let weight = same(self.samples, |sample| sample.weights.get(event + 1).copied());
        weight.filter(|weight| self.are_born_alike && weight.is_finite()).map(Weight::Known)
    }
}

/// The places of a path, whose rays have such weights at its events. `None` if a weight is not known, or where a
/// detector does not keep to bilinear taps.
fn places(
    scene: &LoggedScene,
    path: &HotPath,
    profile: &ProfiledPath,
    weight: impl Fn(usize) -> Option<Weight>,
) -> Option<Vec<Place>> {
    let &LoggedScene { ir, log, options, .. } = scene;
    if log.format == EntryFormat::Counts {
        return None;
    }
    let samples = &profile.samples;
    let mut places: Vec<Place> = Vec::new();
    let mut off_edges = ProfiledRays::new(samples, LEAST_OFF_EDGES);
    for (number, event) in path.events.iter().enumerate() {
        let Some(detector) = event.primitive.checked_sub(ir.surfaces.len()) else { continue };
        if !is_bilinear(&ir.detectors.get(detector)?.kind) {
            return None;
        }
        let arrival = Arrival { event: number, weight: weight(number)? };
        let is_there = |place: &&mut Place| {
            place.detector == detector && arrive_together(samples, place.arrivals[0].event, number)
        };
        match places.iter_mut().find(is_there) {
            Some(place) => place.arrivals.push(arrival),
            None => {
                let grid = *log.grids.get(detector)?;
                off_edges.step = number;
                let edge_room = edge_room(&ir.detectors[detector], options.precision, &mut off_edges);
                places.push(Place { grid, detector, arrivals: vec![arrival], edge_room });
            }
        }
    }
    Some(places)
}

/// Where the weight of a path's rays goes after its last event, and at which event, unless a detector takes it.
fn ledger_end(scene: &LoggedScene, path: &HotPath, last: &HotPathEvent) -> Option<(u32, usize)> {
    let num_events = path.events.len();
    match (last.ends, last.primitive < scene.ir.surfaces.len()) {
        (true, false) => None,
        (true, true) => Some((scene.cells.surfaces + last.primitive as u32, num_events - 1)),
        (false, _) if path.missed.is_some() => Some((LedgerCell::Escaped as u32, num_events)),
        (false, _) => Some((LedgerCell::DepthKilled as u32, num_events)),
    }
}

/// A medium takes little where it leaves at least this share of a ray's weight: exp(-NEAR_ZERO), which is 0.712
/// (shaders/math/math.f64.wgsl), and some room.
const LEAST_LEFT: f64 = 0.72;

/// Whether media take little, on each leg, from nearly all profiled rays that lose to media alone.
pub fn media_absorb_weakly(ProfiledPath { samples, .. }: &ProfiledPath) -> bool {
    let loses_little = |sample: &&SampledPath| {
        sample.weights.windows(2).all(|weights| weights[1] >= LEAST_LEFT * weights[0])
    };
    samples.iter().filter(loses_little).count() as f64 >= LEAST_ASSUMED * samples.len() as f64
}

/// On how many of its legs each profiled ray lost something. `None` where rays differ in that, or where surfaces or
/// roulette take from the rays of a path, too.
fn attenuating_legs(scene: &LoggedScene, path: &HotPath, profile: &ProfiledPath) -> Option<u32> {
    let (&LoggedScene { ir, options, features, .. }, samples) = (scene, &profile.samples);
    let is_on_path = |i: u32| path.events.iter().any(|event| event.primitive == i as usize);
    let others_take = features.importance
        || features.coated
        || crate::model::surface_optics::lossy_mirrors(ir).any(is_on_path);
    let comes_to_roulette =
        |sample: &SampledPath| sample.weights.iter().any(|&weight| weight < options.roulette_threshold);
    if !features.bulk_absorption || others_take || samples.iter().any(comes_to_roulette) {
        return None;
    }
    let num_losses =
        |sample: &SampledPath| sample.weights.windows(2).filter(|weights| weights[1] < weights[0]).count();
    same(samples, |sample| u32::try_from(num_losses(sample)).ok())
}

/// Whether rays of the path may enter the ambient medium with no solid behind them, which is counted (`track_solids` in
/// shaders/stages/interact.wgsl). Rays may also do so where they come to a refracting surface from different sides.
fn may_underflow(ir: &SceneIr, path: &HotPath) -> bool {
    let mut is_in_solid = false;
    path.events.iter().any(|event| {
        let surface = ir.surfaces.get(event.primitive);
        let refracting = surface.filter(|surface| surface.interaction == Interaction::Refractive);
        match (refracting, event.crossing) {
            (None, _) | (_, Some(Crossing { reflected: true, .. })) => false,
            (Some(_), None) => true,
            (Some(surface), Some(Crossing { entering_back, .. })) => {
                let medium = if entering_back { surface.back } else { surface.front };
                let is_ambient = medium == SceneIr::VACUUM;
                let underflows = is_ambient && !is_in_solid;
                is_in_solid = !is_ambient;
                underflows
            }
        }
    })
}

fn is_bilinear(kind: &DetectorKind) -> bool {
    kind.is_plain_grid() && kind.grid().is_some_and(|grid| grid.splat == Splat::Bilinear)
}

/// What all samples have in common, if they do.
fn same<T: PartialEq>(samples: &[SampledPath], of: impl Fn(&SampledPath) -> Option<T>) -> Option<T> {
    let mut all = samples.iter().map(of);
    let first = all.next()??;
    all.all(|other| other.as_ref() == Some(&first)).then_some(first)
}

/// True if every ray is at an event where it was at one before, as far as its recorded positions show.
fn arrive_together(samples: &[SampledPath], before: usize, event: usize) -> bool {
    let at = |sample: &SampledPath, event: usize| sample.positions.get(event + 1).copied();
    !samples.is_empty()
        && samples
            .iter()
            .all(|sample| at(sample, before).is_some() && at(sample, before) == at(sample, event))
}
