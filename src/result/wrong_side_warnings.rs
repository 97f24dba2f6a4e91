//! Rays that took the inside of a solid for its outside, by face, and which face is likely turned.

use std::collections::BTreeMap;

use crate::format::{listed, shown, thousands};
use crate::model::SceneIr;
use crate::model::sides::wrong_sides;
use crate::result::{Tally, WrongSides};
use crate::scene::notes;

/// What the search for turned faces says at most.
const MOST_NOTES: usize = 4;
/// What that search may cost for each result: some ms. `check` searches longer ([`crate::model::sides::MOST_WORK`]).
const MOST_WORK: usize = 1 << 16;

/// What the counters say, if they say anything.
pub(super) fn of(ir: &SceneIr, tally: &Tally) -> Option<WrongSides> {
    let surfaces = || tally.surfaces.iter().enumerate();
    let entered = surfaces().map(|(i, sums)| (ir.surface_name(i), sums.entered_twice));
    let behind = surfaces().map(|(i, sums)| (ir.surface_name(i), sums.ended_inside));
    let on = ir
        .detectors
        .iter()
        .zip(&tally.detectors)
        .map(|(detector, sums)| (detector.name.clone(), sums.ended_inside));
    let entered_twice = counted(entered);
    let ended_inside = counted(behind.chain(on));
    if entered_twice.is_empty() && ended_inside.is_empty() {
        return None;
    }
    let mut warnings = Vec::new();
    if !entered_twice.is_empty() {
        warnings.push(format!(
            "{} time(s) a ray passed a face from another medium than the face has on that side: {}. Such a face has its media on \
             the wrong sides, the solid in front of that face is open, two solids overlap, or a source stands in a solid \
             without the solid's `medium`",
            total(&entered_twice),
            with_counts(&entered_twice)
        ));
    }
    if !ended_inside.is_empty() {
        warnings.push(format!(
            "{} ray(s) ended in a medium in which they were not born, on or behind {}. This is right where a detector stands in \
             a solid. Elsewhere a solid is open, or one of its faces has its media on the wrong sides",
            total(&ended_inside),
            with_counts(&ended_inside)
        ));
    }
    let found = wrong_sides(ir, MOST_WORK);
    warnings.extend(notes::of_sides(ir, &found).into_iter().take(MOST_NOTES));
    Some(WrongSides { entered_twice, ended_inside, warnings, has_turned: !found.turned.is_empty() })
}

fn counted(counts: impl Iterator<Item = (String, u64)>) -> BTreeMap<String, u64> {
    let mut by_name = BTreeMap::new();
    counts
        .filter(|(_, count)| *count > 0)
        .for_each(|(name, count)| *by_name.entry(name).or_default() += count);
    by_name
}

fn total(counts: &BTreeMap<String, u64>) -> String {
    thousands(counts.values().sum())
}

/// The names with their counts, the most frequent first.
fn with_counts(counts: &BTreeMap<String, u64>) -> String {
    let mut counts: Vec<(&String, &u64)> = counts.iter().collect();
    counts.sort_by_key(|(name, count)| (std::cmp::Reverse(**count), *name));
    listed(counts.iter().map(|(name, count)| format!("`{}` ({})", shown(name), thousands(**count))))
}
