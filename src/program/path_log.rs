//! What rays that keep to the nominal path log: where they arrive on its detectors, and nothing else.
//!
//! Where all of them weigh the same at the same event, the host knows how much they leave. Where they arrive on a detector
//! once more at the place of before, as between parallel mirrors, it knows that, too. The pilot only says what may be so:
//! the stage looks at each ray, and one that weighs something else or arrives elsewhere has strayed.

use super::clearance::{Pilot, Stretch};
use super::end_log::{EndLog, Form, Grid};
use super::lowered::{CELL_DEPTH_KILLED, Cells};
use super::nominal::{NominalPath, Way};
use super::{Precision, ProgramOptions};
use crate::ir::{SceneIr, Sensor, SensorKind, Splat};

/// The log of the stage `trace_nominal`.
#[derive(Debug, Clone, PartialEq)]
pub struct PathLog {
    /// What each ray logs, in the order of the path: its positions in pixels.
    pub places: Vec<Place>,
    /// What it leaves where it ends, unless that is on a detector.
    pub end: Option<LedgerEnd>,
}

/// A place on a detector.
#[derive(Debug, Clone, PartialEq)]
pub struct Place {
    /// The detector's cells.
    pub grid: Grid,
    /// The detector, by its number among detectors.
    pub sensor: usize,
    /// When rays arrive there.
    pub arrivals: Vec<Arrival>,
    /// How near to an edge between pixels roundings decide which one is hit, by columns and by rows \[pixels\], if nearly all
    /// rays are farther.
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

/// What all rays of the path weigh at one of its events.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Weight {
    /// What they were born with.
    Born,
    /// So much.
    Known(f64),
}

impl Weight {
    /// The weight of rays that were born with so much.
    pub fn of_born(self, born: f64) -> f64 {
        match self {
            Weight::Born => born,
            Weight::Known(weight) => weight,
        }
    }
}

/// The position alone tells the pixel as long as this share of the rays is off the edges at all places: the others stray.
const LEAST_OFF_EDGES: f64 = 0.99;

/// [`Place::edge_room`] where a pilot's rays arrive on a detector.
/// `pixel_position` in splat.wgsl rounds the sum x + half, the quotient, for which WGSL allows 2.5 ulp (section 15.7.4), and
/// what is left after 0.5; `pixel_of` the product of the pitch and what is left after half: 12 units of roundoff of as many
/// pixels as there are, if each may be rounded either way, and some room.
fn edge_room(sensor: &Sensor, precision: Precision, pilot: &mut Pilot) -> Option<[f64; 2]> {
    let SensorKind::Irradiance(grid) = &sensor.kind else { return None };
    let size = [grid.num_pixels_x, grid.num_pixels_y];
    let room = size.map(|num_pixels| 16.0 * f64::from(num_pixels) / precision.significands());
    let from_edge = |at: f64, width: f64, num_pixels: u32| {
        let edge = (at / width + 0.5) * f64::from(num_pixels);
        (edge - edge.round()).abs()
    };
    let is_off = |Stretch { to, .. }: &Stretch| {
        let by_axis = [from_edge(to.x, grid.width, size[0]), from_edge(to.y, grid.height, size[1])];
        by_axis.iter().zip(room).all(|(from_edge, room)| *from_edge > room)
    };
    pilot.takes(&sensor.frame, is_off).then_some(room)
}

impl PathLog {
    /// The log of a path; none where rays arrive on no detector, or on one that does not keep to bilinear taps, or with
    /// weights that differ.
    pub fn of(
        ir: &SceneIr,
        cells: &Cells,
        log: &EndLog,
        path: &NominalPath,
        options: &ProgramOptions,
        keeps_weight: bool,
    ) -> Option<Self> {
        let pilot = options.nominal.as_ref()?;
        let num_surfaces = ir.surfaces.len();
        let at = |event: usize| same(&pilot.ways, |way| way.weights.get(event).copied());
        // Several sources share the rays of a trace otherwise than those of its pilot.
        let is_born_alike = at(0).is_some_and(|born| {
            options.weights.iter().all(|&weight| options.precision.nearest(weight) == born)
        });
        // Each ray is born before the first event.
        let weight = |event: usize| match keeps_weight {
            true => Some(Weight::Born),
            false => at(event + 1).filter(|weight| is_born_alike && weight.is_finite()).map(Weight::Known),
        };
        let mut places: Vec<Place> = Vec::new();
        let mut off_edges = Pilot::new(&pilot.ways, LEAST_OFF_EDGES);
        for (number, event) in path.events.iter().enumerate() {
            let Some(sensor) = event.primitive.checked_sub(num_surfaces) else { continue };
            if !is_bilinear(&ir.sensors.get(sensor)?.kind) {
                return None;
            }
            let arrival = Arrival { event: number, weight: weight(number)? };
            let is_there = |place: &&mut Place| {
                place.sensor == sensor && arrive_together(&pilot.ways, place.arrivals[0].event, number)
            };
            match places.iter_mut().find(is_there) {
                Some(place) => place.arrivals.push(arrival),
                None => {
                    let grid = *log.grids.get(sensor)?;
                    off_edges.step = number;
                    let edge_room = edge_room(&ir.sensors[sensor], options.precision, &mut off_edges);
                    places.push(Place { grid, sensor, arrivals: vec![arrival], edge_room });
                }
            }
        }
        let last = path.events.last()?;
        let end = match (last.ends, last.primitive < num_surfaces) {
            (true, false) => None,
            (true, true) => Some((cells.surfaces + last.primitive as u32, path.events.len() - 1)),
            (false, _) => Some((CELL_DEPTH_KILLED, path.events.len())),
        };
        let end = match end {
            Some((cell, event)) => Some(LedgerEnd { cell, weight: weight(event)? }),
            None => None,
        };
        (log.form != Form::Counts && !places.is_empty()).then_some(PathLog { places, end })
    }

    /// How rays arrive at an event: at which place, with its number.
    pub fn arrival(&self, event: usize) -> Option<(usize, &Place, &Arrival)> {
        self.places.iter().enumerate().find_map(|(number, place)| {
            let arrival = place.arrivals.iter().find(|arrival| arrival.event == event)?;
            Some((number, place, arrival))
        })
    }
}

fn is_bilinear(kind: &SensorKind) -> bool {
    matches!(kind, SensorKind::Irradiance(grid) if grid.splat == Splat::Bilinear)
}

/// What all ways have alike, if they do.
fn same<T: PartialEq>(ways: &[Way], of: impl Fn(&Way) -> Option<T>) -> Option<T> {
    let mut all = ways.iter().map(of);
    let first = all.next()??;
    all.all(|other| other.as_ref() == Some(&first)).then_some(first)
}

/// True if every ray is at an event where it was at one before, as far as its recorded positions tell.
fn arrive_together(ways: &[Way], before: usize, event: usize) -> bool {
    let at = |way: &Way, event: usize| way.positions.get(event + 1).copied();
    !ways.is_empty() && ways.iter().all(|way| at(way, before).is_some() && at(way, before) == at(way, event))
}
