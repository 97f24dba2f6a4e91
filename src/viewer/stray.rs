//! Which surfaces are to blame for the stray light of a detector: what colours the side view.

use crate::run::surfaces::{Blame, blame};
use crate::run::{Next, Session, StandardError, TraceOptions};
use crate::viewer::following::{Watch, Work};
use crate::viewer::light::Context;
use std::collections::HashMap;

/// Most rays of the list.
const MOST_RAYS: u64 = 1_000_000;
/// Rows of its table of paths.
const PATH_ROWS: u32 = 1 << 18;

/// What a surface has to do with stray light.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Part {
    /// Sources light it, and the detector sees it.
    LitAndSeen,
    /// Sources light it.
    Lit,
    /// The detector sees it.
    Seen,
}

impl Part {
    fn of(Blame { receives, seen, .. }: &Blame) -> Option<Self> {
        match (*receives > 0.0, *seen > 0.0) {
            (true, true) => Some(Part::LitAndSeen),
            (true, false) => Some(Part::Lit),
            (false, true) => Some(Part::Seen),
            (false, false) => None,
        }
    }
}

/// The list that was asked for last.
#[derive(Default)]
pub struct Stray {
    /// The detector that is chosen.
    pub detector: Option<String>,
    work: Option<Work<Vec<Blame>>>,
    found: Option<std::result::Result<Vec<Blame>, String>>,
    /// By the names of surfaces.
    parts: HashMap<String, Part>,
}

impl Stray {
    /// Begins the list of a detector.
    pub fn ask(&mut self, context: &Context, detector: &str) {
        let Context { device, scene, run, notify } = context.clone();
        let (choice, wanted) = (device.choice(), detector.to_owned());
        let options = TraceOptions {
            num_rays: run.num_rays.min(MOST_RAYS),
            seed: run.seed,
            max_depth: run.max_depth,
            standard_error: StandardError::Off,
            ..TraceOptions::default()
        };
        let work = move |watch: &Watch| {
            let next = |_: &_| if watch.is_stopped() { Next::Cancel } else { Next::GoOn };
            let mut session = Session::new(choice);
            blame(
                (&scene.scene, &scene.ir),
                &wanted,
                &mut session,
                (&options, PATH_ROWS),
                |run| Ok(run),
                next,
            )
        };
        self.detector = Some(detector.to_owned());
        self.clear();
        self.work = Some(Work::start(work, notify));
    }

    /// Takes the list if it is ready.
    pub fn poll(&mut self) {
        if let Some(found) = self.work.as_ref().and_then(Work::take) {
            let of = |blame: &Blame| Some((blame.name.clone(), Part::of(blame)?));
            self.parts = found.iter().flatten().filter_map(of).collect();
            (self.found, self.work) = (Some(found.map_err(|error| error.to_string())), None);
        }
    }

    /// True while the list is made.
    pub fn is_asked(&self) -> bool {
        self.work.is_some()
    }

    /// The list, the worst surface first, or why there is none.
    pub fn found(&self) -> Option<std::result::Result<&[Blame], &str>> {
        self.found.as_ref().map(|found| found.as_deref().map_err(String::as_str))
    }

    /// Forgets the list.
    pub fn clear(&mut self) {
        (self.found, self.work) = (None, None);
        self.parts.clear();
    }

    /// Ends the work, and waits for its end.
    pub fn finish(&mut self) {
        if let Some(work) = self.work.take() {
            work.finish();
        }
    }

    /// What the surface of a name has to do with stray light, if that is known.
    pub fn part(&self, surface: &str) -> Option<Part> {
        self.parts.get(surface).copied()
    }
}
