//! Side paths: what most rays do that are rejected by the main path at one of its events, such as those that a lens reflects back.
//! Each has a stage of its own, which traces them from their birth as `trace_main_path` does the others; one that is rejected by
//! its side path, too, follows the next one from the same event, or is traced by `trace_new`.

use crate::cpu::path::main_path::{MainPath, PilotPath};
use crate::cpu::path::path_log::{LoggedScene, PathLog, media_absorb_weakly};
use crate::program::geometry::contact::Contacts;
use glam::DVec3;

/// More would make the shaders' text long, each of whose paths is another one to read.
pub const MOST_SIDE_PATHS: usize = 12;

/// One of them.
#[derive(Debug, Clone, PartialEq)]
pub struct SidePath {
    /// The event of the main path, by its number, at which its rays were rejected.
    pub rejected_at: usize,
    /// The way from their birth on.
    pub path: MainPath,
    /// What they log; none where they log entries, as those of the main path then do.
    pub log: Option<PathLog>,
    /// Of all rays, as far as a pilot tells.
    pub share: f64,
    /// See [`media_absorb_weakly`].
    pub media_absorb_weakly: bool,
}

/// The stage of a side path, by its number. Writers of WGSL change names that end in digits.
pub fn entry_point(number: usize) -> String {
    format!("trace_side_{}", char::from(b'a' + number as u8))
}

impl SidePath {
    /// Those of a pilot, the most frequent first, which log as the main path does: places, or entries.
    pub fn of(
        scene: &LoggedScene,
        centre: DVec3,
        contacts: &Contacts,
        main_path: &MainPath,
        main_log: Option<&PathLog>,
        pilots: &[PilotPath],
    ) -> Vec<SidePath> {
        let side_path = |pilot: &PilotPath| {
            let path = MainPath::of(scene.ir, centre, contacts, scene.options, pilot)?;
            let log = match main_log {
                Some(main_log) => Some(PathLog::beside(main_log, scene, &path, pilot)?),
                None => None,
            };
            Some(SidePath {
                rejected_at: rejected_at(main_path, &path),
                path,
                log,
                share: pilot.share,
                media_absorb_weakly: media_absorb_weakly(pilot),
            })
        };
        pilots.iter().filter_map(side_path).take(MOST_SIDE_PATHS).collect()
    }
}

/// The event at which rays of a side path are rejected by the main path: where they meet something else, or the one before, if
/// they go on from it to another side. It may be another one where a pilot's rays did not tell how they go on; then these
/// are rejected by the side path, too.
fn rejected_at(main_path: &MainPath, side: &MainPath) -> usize {
    let pairs = || main_path.events.iter().zip(&side.events);
    let num_alike = pairs().take_while(|(event, own)| event.primitive == own.primitive).count();
    let turned = pairs().take(num_alike).position(|(event, own)| event.crossing != own.crossing);
    turned.unwrap_or(num_alike)
}
