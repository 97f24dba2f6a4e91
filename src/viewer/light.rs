//! The panel of paths without the panel: the table of the detector that is shown, what is ticked, and what is shown of it.

use crate::error::{Error, Result};
use crate::model::path_filter::MOST_PATTERNS;
use crate::result::{Detector, Grouping, LightPath};
use crate::viewer::following::{
    Followed, LightRays, Listing, Watch, Work, find_rays, follow, list, list_with_maps,
};
use crate::viewer::tracing::{Device, LoadedScene, Notify, RunOptions};
use std::sync::Arc;

/// Most searches for rays. Rays of further ticked rows are not drawn.
const MOST_SEARCHES: usize = 5;

/// What the plot of a detector shows.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ShownLight {
    /// All light.
    Whole,
    /// The light of the row of this index.
    Row(usize),
    /// The light of the ticked rows.
    Ticked,
}

/// What background work needs.
#[derive(Clone)]
pub struct Context {
    /// The device.
    pub device: Device,
    /// The scene.
    pub scene: Arc<LoadedScene>,
    /// The options of the trace.
    pub run: RunOptions,
    /// Called when there is something new to show.
    pub notify: Notify,
}

/// The rays of the side view, if the user asked for the rays of some paths.
pub enum RaysOfPaths {
    /// They are being looked for.
    Searching,
    /// They are here.
    Found(Arc<LightRays>),
    /// There are none, and why.
    Missing(String),
}

enum RaysState {
    Searching(Work<LightRays>),
    Found(Arc<LightRays>),
    Missing(String),
}

/// How far the table is.
#[derive(Debug, Clone, PartialEq)]
pub enum TableStage {
    /// Nothing was asked for.
    None,
    /// Light is being summed up by its path; the number of rays done.
    Following(u64),
    /// Rows are made of the sums.
    Listing,
    /// There is a table, and the maps of its rows are being traced.
    Mapping,
    /// There is a table, and nothing further comes.
    Listed,
    /// There is none, and why.
    Failed(String),
}

/// A detector's number, and which sequences make a row.
type TableRequest = (usize, Grouping);

/// A table that is being made.
struct Making {
    wanted: TableRequest,
    /// True while maps are traced for a table that is shown already.
    is_of_maps: bool,
    work: Work<Listing>,
}

/// Light by its path, and what the user does with it.
pub struct Light {
    /// True if the panel is shown.
    pub is_open: bool,
    group: Grouping,
    following: Option<Work<Followed>>,
    followed: Option<Arc<Followed>>,
    making: Option<Making>,
    listed: Option<(TableRequest, Arc<Listing>)>,
    failed: Option<(Option<TableRequest>, String)>,
    /// The rank of a row that is shown as soon as there is a table.
    asked: Option<u32>,
    shown: ShownLight,
    ticked: Vec<bool>,
    rest_is_ticked: bool,
    /// What the plot shows in the place of the detector.
    detector: Option<Arc<Detector>>,
    /// Grows whenever `detector` changes.
    revision: u64,
    /// The rays of a detector's light, by the expressions that keep it.
    rays: Option<((usize, Vec<String>), RaysState)>,
}

impl Default for Light {
    fn default() -> Self {
        Light {
            is_open: false,
            // A ghost is then one row.
            group: Grouping::Faces,
            following: None,
            followed: None,
            making: None,
            listed: None,
            failed: None,
            asked: None,
            shown: ShownLight::Whole,
            ticked: Vec::new(),
            rest_is_ticked: false,
            detector: None,
            revision: 0,
            rays: None,
        }
    }
}

impl Light {
    /// Begins to trace, for the table.
    pub fn follow(&mut self, context: &Context) {
        self.forget();
        let work = context.clone();
        self.following = Some(Work::start(
            move |watch| follow(&work.device, &work.scene, &work.run, watch, &work.notify),
            context.notify.clone(),
        ));
    }

    /// Shows the row of this rank as soon as there is a table.
    pub fn ask_for(&mut self, rank: u32) {
        self.asked = Some(rank);
    }

    /// Forgets the table: another trace has begun.
    pub fn forget(&mut self) {
        (self.following, self.followed, self.making, self.failed) = (None, None, None, None);
        self.rays = None;
        self.unlist();
    }

    fn unlist(&mut self) {
        self.listed = None;
        (self.shown, self.ticked, self.rest_is_ticked) = (ShownLight::Whole, Vec::new(), false);
        self.refresh();
    }

    /// Ends the work that goes on, with what there is.
    pub fn stop(&self) {
        self.following.iter().for_each(Work::stop);
        self.making.iter().for_each(|making| making.work.stop());
    }

    /// Takes what the background has finished, and begins what the table of the detector of this number lacks.
    pub fn poll(&mut self, context: &Context, detector: Option<usize>) {
        match self.following.as_ref().and_then(Work::take) {
            Some(Ok(followed)) => (self.following, self.followed) = (None, Some(Arc::new(followed))),
            Some(Err(error)) => (self.following, self.failed) = (None, Some((None, error.to_string()))),
            None => {}
        }
        self.take_table(context);
        if let Some((_, state)) = &mut self.rays
            && let RaysState::Searching(work) = state
            && let Some(outcome) = work.take()
        {
            *state = match outcome {
                Ok(rays) => RaysState::Found(Arc::new(rays)),
                Err(error) => RaysState::Missing(error.to_string()),
            };
        }
        let (Some(followed), Some(detector)) = (self.followed.clone(), detector) else { return };
        let wanted = (detector, self.group);
        if self.listed.as_ref().is_some_and(|(listed, _)| *listed != wanted) {
            self.unlist();
        }
        let is_under_way = self.making.as_ref().is_some_and(|making| making.wanted == wanted);
        let has_failed = self.failed.as_ref().is_some_and(|(failed, _)| failed.is_none_or(|of| of == wanted));
        if self.listed.is_none() && !is_under_way && !has_failed {
            let work = Work::start(move |_| Ok(list(&followed, detector, wanted.1)), context.notify.clone());
            self.making = Some(Making { wanted, is_of_maps: false, work });
        }
    }

    /// Takes the table that is made. Maps are traced for it while it is shown.
    fn take_table(&mut self, context: &Context) {
        let Some(making) = self.making.take() else { return };
        let wanted = making.wanted;
        match making.work.take() {
            None => self.making = Some(making),
            Some(Err(error)) => self.failed = Some((Some(wanted), error.to_string())),
            Some(Ok(listing)) => {
                let followed = listing.followed.clone();
                self.set(wanted, listing);
                if !making.is_of_maps {
                    let device = context.device.clone();
                    let trace =
                        move |watch: &Watch| list_with_maps(&device, &followed, wanted.0, wanted.1, watch);
                    let work = Work::start(trace, context.notify.clone());
                    self.making = Some(Making { wanted, is_of_maps: true, work });
                }
            }
        }
    }

    fn set(&mut self, wanted: TableRequest, listing: Listing) {
        let num_rows = listing.table.paths.len();
        let is_shown = self.listed.as_ref().is_some_and(|(listed, _)| *listed == wanted);
        self.listed = Some((wanted, Arc::new(listing)));
        if is_shown {
            // The maps have come. What the user chose in the meantime stays.
            self.refresh();
            return;
        }
        (self.shown, self.ticked, self.rest_is_ticked) = (ShownLight::Whole, vec![false; num_rows], false);
        if let Some(rank) = self.asked.take() {
            let row = (rank as usize).wrapping_sub(1);
            if row < num_rows {
                self.shown = ShownLight::Row(row);
            } else {
                let problem = format!("there is no path of rank {rank}; the table has ranks 1 to {num_rows}");
                self.failed = Some((Some(wanted), problem));
            }
        }
        self.refresh();
    }

    /// How far the table is.
    pub fn stage(&self) -> TableStage {
        if let Some(work) = &self.following {
            return TableStage::Following(work.done());
        }
        match (&self.listed, &self.making, &self.failed) {
            (Some(_), Some(making), _) if making.is_of_maps => TableStage::Mapping,
            (_, Some(_), _) => TableStage::Listing,
            (Some(_), None, _) => TableStage::Listed,
            (None, None, Some((_, problem))) => TableStage::Failed(problem.clone()),
            (None, None, None) if self.followed.is_some() => TableStage::Listing,
            (None, None, None) => TableStage::None,
        }
    }

    /// What went wrong last.
    pub fn problem(&self) -> Option<&str> {
        self.failed.as_ref().map(|(_, problem)| problem.as_str())
    }

    /// True while nothing further comes by itself.
    pub fn is_idle(&self) -> bool {
        let is_searching = matches!(self.rays, Some((_, RaysState::Searching(_))));
        self.following.is_none() && self.making.is_none() && !is_searching
    }

    /// The table and its maps.
    pub fn listing(&self) -> Option<&Arc<Listing>> {
        self.listed.as_ref().map(|(_, listing)| listing)
    }

    /// The rows of the table.
    pub fn rows(&self) -> &[LightPath] {
        self.listing().map_or(&[], |listing| &listing.table.paths)
    }

    /// Which sequences make a row.
    pub fn group(&self) -> Grouping {
        self.group
    }

    /// Groups the table anew.
    pub fn set_group(&mut self, group: Grouping) {
        if group != self.group {
            (self.group, self.failed) = (group, None);
        }
    }

    /// What the plot shows.
    pub fn shown(&self) -> ShownLight {
        self.shown
    }

    /// True if the row of this index is ticked.
    pub fn is_ticked(&self, row: usize) -> bool {
        self.ticked.get(row).copied().unwrap_or(false)
    }

    /// True if the light without maps is ticked.
    pub fn rest_is_ticked(&self) -> bool {
        self.rest_is_ticked
    }

    /// Shows the row of this index alone; all light again, if that row is shown.
    pub fn click(&mut self, row: usize) {
        if row < self.rows().len() {
            self.shown =
                if self.shown == ShownLight::Row(row) { ShownLight::Whole } else { ShownLight::Row(row) };
            self.refresh();
        }
    }

    /// Shows all light again.
    pub fn show_whole(&mut self) {
        self.shown = ShownLight::Whole;
        self.refresh();
    }

    /// Ticks the row of this index, or takes its tick away. Only rows with maps can be ticked.
    pub fn tick(&mut self, row: usize, is_ticked: bool) {
        let has_map = self.listing().is_some_and(|listing| listing.has_map(row));
        if let Some(tick) = self.ticked.get_mut(row) {
            *tick = is_ticked && has_map;
        }
        self.after_ticks();
    }

    /// Ticks the light without maps, or takes its tick away.
    pub fn tick_rest(&mut self, is_ticked: bool) {
        self.rest_is_ticked = is_ticked && self.has_rest();
        self.after_ticks();
    }

    /// Ticks all light.
    pub fn tick_all(&mut self) {
        self.tick_where(|_| true, true);
    }

    /// Takes all ticks away.
    pub fn tick_none(&mut self) {
        self.tick_where(|_| false, false);
    }

    /// Ticks all light that was reflected or scattered. Of light without maps it must be known.
    pub fn tick_all_but_direct(&mut self) {
        let rest = self.listing().and_then(|listing| listing.rest());
        let takes_rest = rest.is_some_and(|rest| !rest.may_be_direct);
        self.tick_where(|row| row.reflections + row.scatterings > 0, takes_rest);
    }

    fn tick_where(&mut self, is_ticked: impl Fn(&LightPath) -> bool, rest: bool) {
        let Some(listing) = self.listing().cloned() else { return };
        let rows = listing.table.paths.iter().enumerate();
        self.ticked = rows.map(|(index, row)| listing.has_map(index) && is_ticked(row)).collect();
        self.rest_is_ticked = rest && self.has_rest();
        self.after_ticks();
    }

    /// True if there is light without maps, and its map is known.
    fn has_rest(&self) -> bool {
        self.listing().is_some_and(|listing| listing.has_maps() && listing.rest().is_some())
    }

    fn after_ticks(&mut self) {
        let has_ticks = self.rest_is_ticked || self.ticked.contains(&true);
        self.shown = if has_ticks { ShownLight::Ticked } else { ShownLight::Whole };
        self.refresh();
    }

    /// Sums up what is shown.
    fn refresh(&mut self) {
        self.revision += 1;
        let listing = self.listing().cloned();
        let detector = listing.and_then(|listing| self.sum_up(&listing).transpose());
        self.detector = match detector.transpose() {
            Ok(detector) => detector.map(Arc::new),
            Err(error) => {
                let wanted = self.listed.as_ref().map(|(wanted, _)| *wanted);
                self.failed = Some((wanted, error.to_string()));
                None
            }
        };
    }

    fn sum_up(&self, listing: &Listing) -> Result<Option<Detector>> {
        let sums = match self.shown {
            ShownLight::Row(row) if listing.has_map(row) => listing.sums(|index| index == row, false),
            ShownLight::Ticked => listing.sums(|index| self.is_ticked(index), self.rest_is_ticked),
            ShownLight::Row(_) | ShownLight::Whole => return Ok(None),
        };
        let Followed { scene, tally, .. } = listing.followed.as_ref();
        let detector = scene.ir.detectors.get(listing.detector);
        let detector = detector.ok_or_else(|| Error::Internal("a table is of no detector".into()))?;
        Detector::of_part(&scene.ir, tally, listing.followed.unit(), detector, &sums).map(Some)
    }

    /// What the plot shows in the place of the detector of this number, if it does.
    pub fn detector(&self, number: Option<usize>) -> Option<&Arc<Detector>> {
        let listing = self.listing()?;
        self.detector.as_ref().filter(|_| number == Some(listing.detector))
    }

    /// Grows whenever something else is shown.
    pub fn revision(&self) -> u64 {
        self.revision
    }

    /// What is shown, for people; none for all light.
    pub fn caption(&self) -> Option<String> {
        let listing = self.listing()?;
        match self.shown {
            ShownLight::Whole => None,
            ShownLight::Row(row) => {
                let row = listing.table.paths.get(row)?;
                Some(format!("Path {}: {}", row.rank, row.sequence))
            }
            ShownLight::Ticked => {
                let num_ticked = self.ticked.iter().filter(|tick| **tick).count();
                let rest = if self.rest_is_ticked { " and the rest" } else { "" };
                let paths = if num_ticked == 1 { "path" } else { "paths" };
                Some(format!("{num_ticked} ticked {paths}{rest}"))
            }
        }
    }

    /// What is shown, as a part of a file's name; none for all light.
    pub fn stem(&self) -> Option<String> {
        match self.shown {
            ShownLight::Whole => None,
            ShownLight::Row(row) => Some(format!("path_{}", self.rows().get(row)?.rank)),
            ShownLight::Ticked => Some("paths".into()),
        }
    }

    /// Expressions of which each keeps a part of the light that is shown. An expression has room for a few sequences.
    fn filters(&self) -> Option<std::result::Result<Vec<String>, String>> {
        let listing = self.listing()?;
        let of_trace = listing.followed.options.path_filter.as_ref();
        let room = MOST_PATTERNS.saturating_sub(of_trace.map_or(0, |filter| filter.patterns.len())).max(1);
        let kept = match self.shown {
            ShownLight::Whole => return None,
            ShownLight::Row(row) => vec![listing.table.paths.get(row)?.filter.clone()?],
            ShownLight::Ticked => {
                let of_rows = |is_ticked: bool| {
                    let rows = listing.table.paths.iter().enumerate();
                    let rows = rows
                        .filter(|(index, _)| listing.has_map(*index) && self.is_ticked(*index) == is_ticked);
                    let filters = rows.filter_map(|(_, row)| row.filter.as_ref());
                    filters.map(|filter| format!("({filter})")).collect::<Vec<_>>()
                };
                let (ticked, others) = (of_rows(true), of_rows(false));
                // The rest is known only as what the rows without a tick leave.
                let is_by_others = self.rest_is_ticked || (listing.rest().is_none() && others.len() <= room);
                match (is_by_others, others.len()) {
                    (true, 0) => vec!["events >= 0".into()],
                    (true, len) if len > room => {
                        return Some(Err(format!(
                            "rays of the rest are found where at most {room} rows have no tick"
                        )));
                    }
                    (true, _) => vec![format!("not ({})", others.join(" or "))],
                    (false, _) => {
                        let parts = ticked.chunks(room).take(MOST_SEARCHES);
                        parts.map(|part| part.join(" or ")).collect()
                    }
                }
            }
        };
        let with_trace = |kept: String| match of_trace {
            Some(filter) => format!("({}) and ({kept})", filter.text),
            None => kept,
        };
        Some(Ok(kept.into_iter().map(with_trace).collect()))
    }

    /// Rays of the light that is shown, which are looked for when they are first asked for; none for all light.
    pub fn rays(&mut self, context: &Context) -> Option<RaysOfPaths> {
        let filters = match self.filters()? {
            Ok(filters) => filters,
            Err(problem) => return Some(RaysOfPaths::Missing(problem)),
        };
        let listing = self.listing()?.clone();
        let key = (listing.detector, filters);
        if self.rays.as_ref().is_none_or(|(of, _)| *of != key) {
            let (device, filters) = (context.device.clone(), key.1.clone());
            let work = Work::start(
                move |watch| find_rays(&device, &listing.followed, listing.detector, &filters, watch),
                context.notify.clone(),
            );
            self.rays = Some((key, RaysState::Searching(work)));
        }
        let (_, state) = self.rays.as_ref()?;
        Some(match state {
            RaysState::Searching(_) => RaysOfPaths::Searching,
            RaysState::Found(rays) => RaysOfPaths::Found(rays.clone()),
            RaysState::Missing(problem) => RaysOfPaths::Missing(problem.clone()),
        })
    }

    /// Ends all work, and waits for its end.
    pub fn finish(&mut self) {
        if let Some(work) = self.following.take() {
            work.finish();
        }
        if let Some(making) = self.making.take() {
            making.work.finish();
        }
        if let Some((_, RaysState::Searching(work))) = self.rays.take() {
            work.finish();
        }
    }
}
