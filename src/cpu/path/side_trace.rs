//! Side traces: the paths of most rays that fail a guard of the hot path, such as rays that a lens reflects back. Each
//! side trace has a stage of its own, which traces its rays from their birth, as `trace_hot_path` does. A ray that
//! fails a guard of its side trace, too, follows the next one from the same event, or falls back on `trace_new`.

use crate::cpu::path::hot_path::{HotPath, ProfiledPath};
use crate::cpu::path::path_log::{LoggedScene, PathLog, media_absorb_weakly};
use crate::program::geometry::contact::Contacts;
use glam::DVec3;

/// More side traces would make the shaders' text long, because each path is written out.
pub const MOST_SIDE_TRACES: usize = 12;

/// A side trace.
#[derive(Debug, Clone, PartialEq)]
pub struct SideTrace {
    /// The event of the hot path, by its number, whose guard its rays fail.
    pub fails_at: usize,
    /// The path from their birth on.
    pub path: HotPath,
    /// What they log. `None` where they log entries, as rays on the hot path then do.
    pub log: Option<PathLog>,
    /// The share of all rays that take it, by the profile.
    pub share: f64,
    /// See [`media_absorb_weakly`].
    pub media_absorb_weakly: bool,
}

/// The stage of a side trace, by its number. Writers of WGSL change names that end in digits.
pub fn entry_point(number: usize) -> String {
    format!("trace_side_{}", char::from(b'a' + number as u8))
}

impl SideTrace {
    /// The side traces of a profile, the most frequent first. They log as the hot path does: places, or entries.
    pub fn of(
        scene: &LoggedScene,
        centre: DVec3,
        contacts: &Contacts,
        hot_path: &HotPath,
        main_log: Option<&PathLog>,
        profiled_paths: &[ProfiledPath],
    ) -> Vec<SideTrace> {
        let side_trace = |profile: &ProfiledPath| {
            let path = HotPath::of(scene.ir, centre, contacts, scene.options, profile)?;
            let log = match main_log {
                Some(main_log) => Some(PathLog::beside(main_log, scene, &path, profile)?),
                None => None,
            };
            Some(SideTrace {
                fails_at: fails_at(hot_path, &path),
                path,
                log,
                share: profile.share,
                media_absorb_weakly: media_absorb_weakly(profile),
            })
        };
        profiled_paths.iter().filter_map(side_trace).take(MOST_SIDE_TRACES).collect()
    }
}

/// The event at which rays of a side trace fail a guard of the hot path. Here a ray meets something else than the hot
/// path, or went on from the event before to another side. The event may be another one where profiled rays did not
/// show how they go on. Such rays fail a guard of the side trace, too.
fn fails_at(hot_path: &HotPath, side: &HotPath) -> usize {
    let pairs = || hot_path.events.iter().zip(&side.events);
    let num_alike = pairs().take_while(|(event, own)| event.primitive == own.primitive).count();
    let turned = pairs().take(num_alike).position(|(event, own)| event.crossing != own.crossing);
    turned.unwrap_or(num_alike)
}
