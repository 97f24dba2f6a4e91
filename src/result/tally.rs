//! Exact, additive sums of a trace: the value that the fold over passes accumulates.

use crate::error::{Error, Result};
use std::borrow::Cow;
use std::ops::AddAssign;

use serde::{Deserialize, Serialize};

use crate::model::{Detector, SceneIr};
use crate::result::few_rays::Brought;
use crate::result::{PathTally, QUANTA_PER_WEIGHT, RaySpans};

/// Number of events and the quanta that they took.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct FluxSum {
    /// Number of events.
    pub count: u64,
    /// Sum of weight before minus weight after \[quanta\].
    pub quanta: u128,
}

impl FluxSum {
    /// The mean weight of an event; where there is none, the weight of one new ray.
    pub(crate) fn mean_weight(&self) -> f64 {
        if self.count == 0 { 1.0 } else { self.quanta as f64 / QUANTA_PER_WEIGHT / self.count as f64 }
    }
}

/// The sums of a range of rays. Adding the tallies of two disjoint ranges gives the tally of both, bit for bit, however
/// the ranges were cut.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Tally {
    /// Rays launched, and the weight they were born with.
    pub launched: FluxSum,
    /// Which rays they are.
    pub rays: RaySpans,
    /// Per detector, in scene order.
    pub detectors: Vec<DetectorTally>,
    /// Per surface, in scene order.
    pub surfaces: Vec<SurfaceTally>,
    /// Rays that met nothing any more.
    pub escaped: FluxSum,
    /// Rays that reached the largest number of events.
    pub depth_killed: FluxSum,
    /// Rays ended by Russian roulette.
    pub roulette_loss: FluxSum,
    /// Weight gained by the survivors of roulette.
    pub roulette_gain: FluxSum,
    /// Weight taken by absorbing media (events are segments with a loss).
    pub bulk: FluxSum,
    /// Weight lost where a branch was drawn more often than its share.
    pub importance_loss: FluxSum,
    /// Weight gained where a branch was drawn less often than its share.
    pub importance_gain: FluxSum,
    /// Weight absorbed by coatings.
    pub coating: FluxSum,
    /// Weight lost where rays were scattered, or drawn not to be more often than their share.
    pub bsdf_loss: FluxSum,
    /// Weight gained there.
    pub bsdf_gain: FluxSum,
    /// Rays that left a solid which they had never entered.
    pub medium_stack_underflows: u64,
    /// True if splitting wanted more rays of some launched ray than its budget.
    pub split_budget_saturated: bool,
    /// Deposits that no sum can hold: not a number, infinite, or over 2^43 units of weight. Never 0 in silence.
    pub invalid_deposits: u64,
    /// True if some second moment may have grown beyond its sum: no standard error can then be given.
    pub moments_overflowed: bool,
    /// Events of the recorded paths.
    pub paths: Vec<PathEvent>,
    /// Rays that ended on detectors, and were kept from maps by a filter.
    pub filtered_out: FluxSum,
    /// Light by its path, where it was summed up so.
    pub path_sums: Option<PathTally>,
}

/// The sums of one detector.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct DetectorTally {
    /// Quanta per cell; the order of [`crate::model::Detector::num_cells`]. Empty for a ray database.
    pub quanta: Vec<u128>,
    /// Rays per cell: the cell that was hit, whatever the splat.
    pub hits: Vec<u64>,
    /// Ray database: rays recorded and their weight.
    pub recorded: FluxSum,
    /// Ray database: the rows.
    pub rows: Vec<RayRow>,
    /// Per cell, the sum over primary rays of the square of the weight that the ray left there, in units of 2^-52,
    /// rounded up. Empty where second moments were not summed, and for a ray database.
    pub squares: Vec<u128>,
    /// Per source, the moments of what its rays left on the detector in all. Empty where they were not summed.
    pub totals: Vec<Moments>,
    /// Where points were scrambled in several independent ways: the quanta per cell of each, one after the other; of a ray
    /// database in all. The ray whose id has the remainder r by their number is of the scramble r.
    pub replicates: Vec<u128>,
    /// Sums of the derivatives of what rays left in each cell, in quanta, one parameter after the other. Empty where there
    /// are none.
    #[serde(skip)]
    pub tangents: Vec<i128>,
    /// Derivatives of deposits that no sum can hold.
    #[serde(skip)]
    pub lost_tangents: u64,
    /// Rays that ended there in a medium in which they were not born.
    pub ended_inside: u64,
}

/// First and second moment over primary rays.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Moments {
    /// Sum of the weights \[quanta\].
    pub quanta: u128,
    /// Sum of the squares of the weights, in units of 2^-52.
    pub squares: u128,
}

/// The sums of one surface.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct SurfaceTally {
    /// True if some ray hit the surface.
    pub reached: bool,
    /// Rays that ended there (absorbing surfaces), or events with a loss (mirrors), and what they left there.
    pub absorbed: FluxSum,
    /// Times that a ray passed the surface from another medium than the surface has on that side.
    pub entered_twice: u64,
    /// Rays that left the surface last, and escaped in a medium in which they were not born.
    pub ended_inside: u64,
}

/// One row of a ray database, in global coordinates.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct RayRow {
    /// The ray.
    pub ray_id: u64,
    /// Its number of events before this one.
    pub bounce: u32,
    /// Index into the scene's wavelengths.
    pub wavelength: u32,
    /// Where it crossed the detector \[mm\].
    pub position: [f64; 3],
    /// Its direction.
    pub direction: [f64; 3],
    /// Its weight.
    pub weight: f64,
}

/// One event of a recorded path: the state before the event, at the place of the event.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct PathEvent {
    /// The state of the ray.
    pub ray: RayRow,
    /// What happened.
    pub kind: PathEventKind,
}

/// Kinds of path events.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum PathEventKind {
    /// Born at this source.
    Birth(usize),
    /// Hit this surface.
    Surface(usize),
    /// Crossed this detector.
    Detector(usize),
    /// Met nothing any more.
    Escaped,
    /// Reached the largest number of events.
    DepthKilled,
    /// Ended by Russian roulette.
    FluxKilled,
}

impl AddAssign for FluxSum {
    fn add_assign(&mut self, other: Self) {
        self.count += other.count;
        self.quanta += other.quanta;
    }
}

impl AddAssign<&DetectorTally> for DetectorTally {
    fn add_assign(&mut self, other: &DetectorTally) {
        add_cells(&mut self.quanta, &other.quanta);
        add_cells(&mut self.hits, &other.hits);
        self.recorded += other.recorded;
        self.rows.extend_from_slice(&other.rows);
        add_cells(&mut self.squares, &other.squares);
        add_each(&mut self.totals, &other.totals, |sum, moments| *sum += *moments);
        add_cells(&mut self.replicates, &other.replicates);
        add_cells(&mut self.tangents, &other.tangents);
        self.lost_tangents += other.lost_tangents;
        self.ended_inside += other.ended_inside;
    }
}

impl AddAssign for Moments {
    fn add_assign(&mut self, other: Self) {
        self.quanta += other.quanta;
        self.squares += other.squares;
    }
}

impl AddAssign for SurfaceTally {
    fn add_assign(&mut self, other: Self) {
        self.reached |= other.reached;
        self.absorbed += other.absorbed;
        self.entered_twice += other.entered_twice;
        self.ended_inside += other.ended_inside;
    }
}

impl AddAssign<&Tally> for Tally {
    fn add_assign(&mut self, other: &Tally) {
        self.launched += other.launched;
        self.rays += &other.rays;
        add_each(&mut self.detectors, &other.detectors, |sum, detector| *sum += detector);
        add_each(&mut self.surfaces, &other.surfaces, |sum, surface| *sum += *surface);
        self.escaped += other.escaped;
        self.depth_killed += other.depth_killed;
        self.roulette_loss += other.roulette_loss;
        self.roulette_gain += other.roulette_gain;
        self.bulk += other.bulk;
        self.importance_loss += other.importance_loss;
        self.importance_gain += other.importance_gain;
        self.coating += other.coating;
        self.bsdf_loss += other.bsdf_loss;
        self.bsdf_gain += other.bsdf_gain;
        self.medium_stack_underflows += other.medium_stack_underflows;
        self.split_budget_saturated |= other.split_budget_saturated;
        self.invalid_deposits += other.invalid_deposits;
        self.moments_overflowed |= other.moments_overflowed;
        self.paths.extend_from_slice(&other.paths);
        self.filtered_out += other.filtered_out;
        if let Some(others) = &other.path_sums {
            *self.path_sums.get_or_insert_default() += others;
        }
    }
}

/// Adds one by one. A shorter sum grows first, so that nothing is dropped and the default is a zero of the addition.
fn add_each<T: Clone + Default>(sums: &mut Vec<T>, others: &[T], add: impl Fn(&mut T, &T)) {
    sums.resize(sums.len().max(others.len()), T::default());
    sums.iter_mut().zip(others).for_each(|(sum, other)| add(sum, other));
}

/// Adds sums of cells, of which many may be dark. Only cells that gain something are written to. So a large map that is
/// mostly dark takes little memory.
fn add_cells<T: Copy + Default + PartialEq + AddAssign>(sums: &mut Vec<T>, others: &[T]) {
    if sums.is_empty() {
        *sums = map_lit(others, |_, other| other);
        return;
    }
    sums.resize(sums.len().max(others.len()), T::default());
    let lit = sums.iter_mut().zip(others).filter(|(_, other)| **other != T::default());
    lit.for_each(|(sum, other)| *sum += *other);
}

/// What `value` makes of each cell, by its number and contents; zero becomes zero, in memory that is not written to.
pub(crate) fn map_lit<T: Copy + Default + PartialEq, V: Clone + Default>(
    cells: &[T],
    value: impl Fn(usize, T) -> V,
) -> Vec<V> {
    let mut values = vec![V::default(); cells.len()];
    let lit = values.iter_mut().zip(cells).enumerate().filter(|(_, (_, cell))| **cell != T::default());
    lit.for_each(|(number, (to, cell))| *to = value(number, *cell));
    values
}

impl Tally {
    /// The tally of no rays, with a cell for everything in the scene.
    pub fn zeros(ir: &SceneIr) -> Self {
        let detector = |detector: &Detector| DetectorTally {
            quanta: vec![0; detector.num_cells()],
            hits: vec![0; detector.num_cells()],
            ..DetectorTally::default()
        };
        Tally {
            detectors: ir.detectors.iter().map(detector).collect(),
            surfaces: vec![SurfaceTally::default(); ir.surfaces.len()],
            ..Tally::default()
        }
    }
}

impl Tally {
    /// Puts the rows and paths of a scene in the order in which files hold them.
    pub fn sort_rows(&mut self, ir: &SceneIr) {
        let splits = crate::model::surface_optics::splits(ir);
        self.detectors.iter_mut().for_each(|detector| detector.rows.sort_by_key(|row| row.order(splits)));
        self.paths.sort_by_key(|event| event.ray.order(splits));
    }
}

impl DetectorTally {
    /// Rays recorded, and their weight: the sum over cells, or over the rays of a database.
    pub fn total(&self) -> FluxSum {
        FluxSum {
            count: self.recorded.count + self.hits.iter().sum::<u64>(),
            quanta: self.recorded.quanta + self.quanta.iter().sum::<u128>(),
        }
    }

    /// What the rays brought.
    pub(crate) fn brought(&self) -> Brought {
        let FluxSum { count, quanta } = self.total();
        let squares: u128 = self.totals.iter().map(|moments| moments.squares).sum();
        Brought { count, quanta, squares: (squares > 0).then_some(squares) }
    }

    /// The quanta of each cell; of a detector without cells, the quanta of all that it recorded.
    pub(crate) fn quanta_of_cells(&self) -> Cow<'_, [u128]> {
        if self.quanta.is_empty() {
            Cow::Owned(vec![self.total().quanta])
        } else {
            Cow::Borrowed(&self.quanta)
        }
    }

    /// The sums of tangents by the parameter of this number, in the order of [`DetectorTally::quanta_of_cells`].
    pub(crate) fn tangents_by(&self, number: usize) -> &[i128] {
        let num_cells = self.quanta.len().max(1);
        self.tangents.get(number * num_cells..(number + 1) * num_cells).unwrap_or_default()
    }
}

/// Refuses sums that are not of this scene.
pub(crate) fn check_shape(ir: &SceneIr, tally: &Tally) -> Result<()> {
    let detectors_fit = ir.detectors.len() == tally.detectors.len()
        && ir.detectors.iter().zip(&tally.detectors).all(|(detector, sums)| {
            sums.quanta.len() == detector.num_cells() && sums.hits.len() == detector.num_cells()
        });
    if detectors_fit && ir.surfaces.len() == tally.surfaces.len() {
        Ok(())
    } else {
        Err(Error::Internal("the sums of the trace do not have the shape of the scene".into()))
    }
}
