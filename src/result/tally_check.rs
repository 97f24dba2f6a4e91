//! Checks that sums belong to a scene. A file with the right checksum may hold anything.

use std::fmt::Display;

use crate::model::sequence::{End, Sequence};
use crate::model::{SceneIr, ray_id};
use crate::result::{DetectorTally, PathEventKind, RaySpan, Tally};

/// Most that all counts of a tally may come to. What is made of two such tallies then overflows nowhere, and no trace comes
/// near it.
const MOST_COUNTS: u128 = 1 << 62;
/// The same of all quanta, and of all squares.
const MOST_QUANTA: u128 = 1 << 126;

type Checked = std::result::Result<(), String>;

fn refuse(problem: impl Into<String>) -> Checked {
    Err(problem.into())
}

/// Refuses a number that is no place in a list.
fn place(number: impl TryInto<usize> + Display + Copy, length: usize, what: &str) -> Checked {
    match number.try_into() {
        Ok(place) if place < length => Ok(()),
        _ => refuse(format!("names {what} {number}; the scene has {length}")),
    }
}

impl Tally {
    /// Refuses sums that no trace of the scene gives, or that would overflow where they are added to others. Sums that come
    /// from a file must be checked before anything is made of them.
    ///
    /// # Errors
    /// What is wrong, as the end of a sentence about the file.
    pub fn check(&self, ir: &SceneIr) -> Checked {
        self.check_lengths(ir)?;
        self.check_rays(ir)?;
        self.check_rows(ir)?;
        self.check_paths(ir)?;
        self.check_sums()
    }

    fn check_lengths(&self, ir: &SceneIr) -> Checked {
        let of_surfaces = ("surfaces", self.surfaces.len(), ir.surfaces.len());
        for (what, found, expected) in [("detectors", self.detectors.len(), ir.detectors.len()), of_surfaces]
        {
            if found != expected {
                return refuse(format!("holds sums of {found} {what}; the scene has {expected}"));
            }
        }
        for (number, (detector, sums)) in ir.detectors.iter().zip(&self.detectors).enumerate() {
            let cells = detector.num_cells();
            let DetectorTally { quanta, hits, squares, totals, replicates, .. } = sums;
            let copies = ray_id::NUM_REPLICATES as usize * cells.max(1);
            let fits = [quanta.len(), hits.len()] == [cells; 2]
                && [0, cells].contains(&squares.len())
                && [0, 1, ir.sources.len()].contains(&totals.len())
                && [0, copies].contains(&replicates.len());
            if !fits {
                return refuse(format!(
                    "holds sums of detector {number} that do not fit its {cells} pixels or bins"
                ));
            }
        }
        Ok(())
    }

    /// Spans of rays ascend, do not overlap, and are the rays that were launched.
    fn check_rays(&self, ir: &SceneIr) -> Checked {
        let (mut next, mut launched) = (0, 0);
        for &RaySpan { first, count, source } in self.rays.spans() {
            place(source, ir.sources.len(), "source")?;
            let Some(end) = first.checked_add(count).filter(|_| count > 0 && first >= next) else {
                return refuse(format!(
                    "holds {count} rays from ray {first} on, which overlap others or are none"
                ));
            };
            (next, launched) = (end, launched + count);
        }
        match self.launched.count == launched {
            true => Ok(()),
            false => refuse(format!("launched {} rays, and names {launched}", self.launched.count)),
        }
    }

    fn check_rows(&self, ir: &SceneIr) -> Checked {
        for (number, (detector, sums)) in ir.detectors.iter().zip(&self.detectors).enumerate() {
            if !sums.rows.is_empty() && !detector.kind.stores_rays() {
                return refuse(format!("holds rays of detector {number}, which stores none"));
            }
        }
        let of_databases = self.detectors.iter().flat_map(|detector| &detector.rows);
        for row in of_databases.chain(self.paths.iter().map(|event| &event.ray)) {
            place(row.wavelength, ir.wavelengths.len(), "wavelength")?;
        }
        self.paths.iter().try_for_each(|event| match event.kind {
            PathEventKind::Birth(source) => place(source, ir.sources.len(), "source"),
            PathEventKind::Surface(surface) => place(surface, ir.surfaces.len(), "surface"),
            PathEventKind::Detector(detector) => place(detector, ir.detectors.len(), "detector"),
            PathEventKind::Escaped | PathEventKind::DepthKilled | PathEventKind::FluxKilled => Ok(()),
        })
    }

    fn check_paths(&self, ir: &SceneIr) -> Checked {
        let Some(sums) = &self.path_sums else { return Ok(()) };
        let end = |end: &End| match *end {
            End::Detector(detector) => place(detector, ir.detectors.len(), "detector"),
            End::Absorbed(surface) => place(surface, ir.surfaces.len(), "surface"),
            End::Missed | End::DepthLimit | End::Roulette => Ok(()),
        };
        let sequence = |sequence: &Sequence| {
            place(sequence.source, ir.sources.len(), "source")?;
            end(&sequence.end)?;
            sequence.steps.iter().try_for_each(|step| place(step.surface, ir.surfaces.len(), "surface"))
        };
        sums.rows.keys().try_for_each(sequence)?;
        sums.other.keys().try_for_each(end)?;
        let chosen = sums.chosen.as_deref().unwrap_or_default();
        chosen.iter().try_for_each(sequence)?;
        let is_sorted = chosen.is_sorted_by(|one, next| one < next);
        if !is_sorted || chosen.len() > sums.most_rows as usize || sums.is_closed && sums.chosen.is_none() {
            return refuse("holds a table of paths whose rows were not chosen as this program does it");
        }
        Ok(())
    }

    /// Refuses sums that would overflow where they are added to others.
    ///
    /// # Errors
    /// As [`Tally::check`].
    pub fn check_sums(&self) -> Checked {
        let mut counts = Sum(0);
        let mut quanta = Sum(0);
        let mut squares = Sum(0);
        let surfaces = self.surfaces.iter().map(|surface| surface.absorbed);
        let recorded = self.detectors.iter().map(|detector| detector.recorded);
        let alone = [
            self.launched,
            self.escaped,
            self.depth_killed,
            self.roulette_loss,
            self.roulette_gain,
            self.bulk,
            self.importance_loss,
            self.importance_gain,
            self.coating,
            self.bsdf_loss,
            self.bsdf_gain,
            self.filtered_out,
        ];
        for sum in alone.into_iter().chain(surfaces).chain(recorded) {
            counts.add([sum.count.into()]);
            quanta.add([sum.quanta]);
        }
        counts.add([self.medium_stack_underflows, self.invalid_deposits].map(u128::from));
        let on_surfaces =
            self.surfaces.iter().flat_map(|surface| [surface.entered_twice, surface.ended_inside]);
        let on_detectors = self.detectors.iter().map(|detector| detector.ended_inside);
        counts.add(on_surfaces.chain(on_detectors).map(u128::from));
        for detector in &self.detectors {
            counts.add(detector.hits.iter().map(|&hits| hits.into()));
            quanta.add(detector.quanta.iter().chain(&detector.replicates).copied());
            quanta.add(detector.totals.iter().map(|moments| moments.quanta));
            squares.add(detector.squares.iter().copied());
            squares.add(detector.totals.iter().map(|moments| moments.squares));
        }
        let paths = self.path_sums.iter().flat_map(|sums| sums.rows.values().chain(sums.other.values()));
        for path in paths {
            counts.add([path.count.into()]);
            quanta.add([path.quanta]);
            squares.add([path.squares]);
        }
        match counts.0 <= MOST_COUNTS && quanta.0 <= MOST_QUANTA && squares.0 <= MOST_QUANTA {
            true => Ok(()),
            false => refuse("holds sums that are larger than any trace's"),
        }
    }
}

/// A sum that ends at the largest number.
struct Sum(u128);

impl Sum {
    fn add(&mut self, parts: impl IntoIterator<Item = u128>) {
        self.0 = parts.into_iter().fold(self.0, u128::saturating_add);
    }
}
