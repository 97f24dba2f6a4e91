//! What a change does: two scenes by the same draws, their difference, and its own standard errors.
//!
//! Both scenes trace the same rays by the same random numbers. So what the change does not touch cancels to the bit, and
//! the error of the difference is far below the error of either scene.
//!
//! ```text
//! tallies of blocks -> Figures of A less Figures of B -> Spread -> SceneDifference -> table, report.json, .npz, .png
//! ```

mod files;
mod spread;
mod table;

pub use crate::result::difference::files::{file_names, write};
pub use crate::result::difference::spread::Spread;

use crate::error::{Error, Result};
use crate::format::{shown, sigmas};
use crate::model::SceneIr;
use crate::model::detectors::grid::PixelGrid;
use crate::model::key_path::did_you_mean;
use crate::result::{Detector, DetectorTally, FewRays, FluxUnit, Ledger, RunInfo, Tally};
use ndarray::{ArrayD, Dimension};
use serde::Serialize;

/// A number of both scenes, and its difference \[W\].
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FluxDifference {
    /// What it is of: a detector, a surface, or a line of the ledger.
    #[serde(skip)]
    pub name: String,
    /// A's flux.
    pub a: f64,
    /// B's flux.
    pub b: f64,
    /// A - B.
    pub difference: f64,
    /// Standard error of the difference; `None` if it is not known.
    pub standard_error: Option<f64>,
    /// What is known of a difference that rests on few rays, which go other ways in A than in B. The bound is one of the
    /// difference's size.
    #[serde(flatten)]
    pub few_rays: Option<FewRays>,
}

impl FluxDifference {
    /// The difference in standard errors; 0 if it is rounding alone. `None` if the error is not known or 0, or if the
    /// difference rests on few rays.
    pub fn score(&self) -> Option<f64> {
        if self.few_rays.is_some() {
            return None;
        }
        sigmas(self.difference, self.standard_error, self.largest()).filter(|sigmas| sigmas.is_finite())
    }

    /// The larger flux of the two.
    pub(crate) fn largest(&self) -> f64 {
        self.a.abs().max(self.b.abs())
    }
}

/// A detector that both scenes have.
#[derive(Debug, Clone, PartialEq)]
pub struct DetectorDifference {
    /// Its flux, under its name.
    pub flux: FluxDifference,
    /// Optiland's name of the kind in A.
    pub kind: &'static str,
    /// Rays of A, and of B, that it recorded.
    pub num_rays_hit: [u64; 2],
    /// Its map; none of a ray database, and where the scenes have no map of the same cells.
    pub map: Option<MapDifference>,
    /// What should be known of the map.
    pub note: Option<String>,
}

/// Cell by cell, in the unit of the detector's map, shape and order of its array.
#[derive(Debug, Clone, PartialEq)]
pub struct MapDifference {
    /// The results of A and of B.
    pub sides: [Detector; 2],
    /// A - B.
    pub values: ArrayD<f64>,
    /// Standard errors of `values`; `None` if they are not known.
    pub errors: Option<ArrayD<f64>>,
}

/// What a change does: A - B.
#[derive(Debug, Clone, PartialEq)]
pub struct SceneDifference {
    /// How both scenes were traced.
    pub run: RunInfo,
    /// What users call A and B.
    pub names: [String; 2],
    /// Rays of each scene.
    pub num_rays: u64,
    /// Independent blocks of rays, or scrambles of points, which the errors come from.
    pub num_blocks: u32,
    /// Detectors that both have, in A's order.
    pub detectors: Vec<DetectorDifference>,
    /// Lines of the ledger in which light is.
    pub totals: Vec<FluxDifference>,
    /// Surfaces that took light, in A's order, then surfaces of B alone.
    pub surfaces: Vec<FluxDifference>,
    /// Detectors and surfaces that one scene alone has.
    pub notes: Vec<String>,
}

/// Two scenes, and what of one belongs to what of the other.
#[derive(Debug)]
pub struct Pairing<'a> {
    /// A and B.
    pub scenes: [&'a SceneIr; 2],
    detectors: Vec<[usize; 2]>,
    surfaces: Vec<(String, [Option<usize>; 2])>,
    notes: Vec<String>,
}

/// The numbers that are compared, of one scene: fluxes \[W\], and cells in the units of their maps.
pub(crate) struct Figures {
    /// Lines of the ledger, then surfaces.
    pub(crate) lines: Vec<f64>,
    /// Fluxes of detectors, then the cells of those whose maps are compared.
    pub(crate) detected: Vec<f64>,
}

impl<'a> Pairing<'a> {
    /// Pairs detectors and surfaces by their names.
    ///
    /// # Errors
    /// [`Error::Usage`] if no detector of A has the name of one of B.
    pub fn new(scenes: [&'a SceneIr; 2]) -> Result<Self> {
        let [a, b] = scenes;
        let names =
            scenes.map(|ir| ir.detectors.iter().map(|detector| detector.name.as_str()).collect::<Vec<_>>());
        let pairs = by_name(&names[0], &names[1]);
        let detectors: Vec<[usize; 2]> = pairs.iter().filter_map(|&[a, b]| Some([a?, b?])).collect();
        if detectors.is_empty() && !names[0].is_empty() {
            let advice = did_you_mean(names[0][0], names[1].iter().copied());
            return Err(Error::Usage(format!(
                "A and B have no detector of the same name; B has none called `{}`: {advice}",
                shown(names[0][0])
            )));
        }
        let lone = pairs.iter().filter_map(|pair| match pair {
            [Some(a), None] => Some(format!("only A has the detector `{}`", shown(names[0][*a]))),
            [None, Some(b)] => Some(format!("only B has the detector `{}`", shown(names[1][*b]))),
            _ => None,
        });
        let notes = lone.collect();
        let surfaces =
            [a, b].map(|ir| ir.surfaces.iter().map(|surface| surface.name.as_str()).collect::<Vec<_>>());
        let of_surfaces = by_name(&surfaces[0], &surfaces[1]).into_iter().map(|pair| {
            let name = pair[0].map(|i| surfaces[0][i]).or(pair[1].map(|i| surfaces[1][i]));
            (name.unwrap_or_default().to_string(), pair)
        });
        Ok(Pairing { scenes, detectors, surfaces: of_surfaces.collect(), notes })
    }

    /// The numbers of one scene, 0 for A and 1 for B.
    pub(crate) fn figures(&self, side: usize, tally: &Tally, unit: FluxUnit) -> Result<Figures> {
        let ledger = Ledger::new(self.scenes[side], tally, unit);
        let surfaces = self.surfaces.iter().map(|(_, pair)| {
            pair[side].map_or(0.0, |number| unit.watts(tally.surfaces[number].absorbed.quanta))
        });
        Ok(Figures {
            lines: lines(&ledger).map(|(_, flux)| flux).chain(surfaces).collect(),
            detected: self.detected(side, tally, unit, |number| Ok(tally.detectors[number].clone()))?,
        })
    }

    /// The numbers of detectors, whose sums `sums` gives.
    pub(crate) fn detected(
        &self,
        side: usize,
        tally: &Tally,
        unit: FluxUnit,
        sums: impl Fn(usize) -> Result<DetectorTally>,
    ) -> Result<Vec<f64>> {
        let (mut fluxes, mut cells) = (Vec::new(), Vec::new());
        for pair in &self.detectors {
            let sums = sums(pair[side])?;
            fluxes.push(unit.watts(sums.total().quanta));
            if self.has_map(pair) {
                let found = self.detector(side, pair[side], tally, unit, &sums)?;
                cells.extend(found.data.result().map().iter().flat_map(|map| map.values.iter().copied()));
            }
        }
        fluxes.extend(cells);
        Ok(fluxes)
    }

    fn detector(
        &self,
        side: usize,
        number: usize,
        tally: &Tally,
        unit: FluxUnit,
        sums: &DetectorTally,
    ) -> Result<Detector> {
        let ir = self.scenes[side];
        // The errors of a difference do not follow from the errors of its sides.
        let sums =
            DetectorTally { squares: Vec::new(), totals: Vec::new(), replicates: Vec::new(), ..sums.clone() };
        Detector::of_part(ir, tally, unit, &ir.detectors[number], &sums)
    }

    fn has_map(&self, pair: &[usize; 2]) -> bool {
        let [a, b] = [0, 1].map(|side| &self.scenes[side].detectors[pair[side]]);
        let pixels = |grid: &PixelGrid| (grid.num_pixels_x, grid.num_pixels_y);
        let is_alike = match (a.kind.grid(), b.kind.grid()) {
            (Some(ours), Some(theirs)) => pixels(ours) == pixels(theirs),
            _ => a.kind == b.kind,
        };
        is_alike
            && a.num_cells() > 0
            && a.num_cells() == b.num_cells()
            && a.kind.function() == b.kind.function()
    }

    /// The difference of two traces. The difference follows from their sums, the largest weight of a new ray, what a
    /// weight of each is worth, and the spread of blocks. Lines of the ledger and detectors have spreads. A spread
    /// times `scale` is an error.
    ///
    /// # Errors
    /// [`Error::Internal`] if the sums are not of these scenes.
    pub(crate) fn difference(
        &self,
        tallies: [&Tally; 2],
        largest_births: [f64; 2],
        units: [FluxUnit; 2],
        spreads: [&Spread; 2],
        scale: f64,
    ) -> Result<SceneDifference> {
        let [a, b] = [0, 1].map(|side| self.figures(side, tallies[side], units[side]));
        let (a, b) = (a?, b?);
        let names: Vec<&str> = lines(&Ledger::default()).map(|(name, _)| name).collect();
        let errors = spreads.map(|spread| {
            spread.errors().map(|errors| errors.iter().map(|error| error * scale).collect::<Vec<_>>())
        });
        // No ray brings one scene more than the other by more than it was born with.
        let births = [0, 1].map(|side| units[side].watts_of_weight(largest_births[side]));
        let number = |name: &str, [a, b]: [f64; 2], kind: usize, at: usize| FluxDifference {
            name: name.into(),
            a,
            b,
            difference: a - b,
            standard_error: errors[kind].as_ref().and_then(|errors| errors.get(at).copied()),
            few_rays: FewRays::of_difference(spreads[kind].rests_on(at), a - b, births),
        };
        let line = |(at, name): (usize, &str)| {
            let line = number(name, [a.lines[at], b.lines[at]], 0, at);
            // What sources launch is no estimate, and lines that no ray changes are many.
            let few_rays = line.few_rays.filter(|few| few.rests_on > 0 && name != "launched");
            let standard_error =
                line.standard_error.map(|error| if name == "launched" { 0.0 } else { error });
            FluxDifference { standard_error, few_rays, ..line }
        };
        let has_light = |line: &FluxDifference| line.a != 0.0 || line.b != 0.0;
        let surfaces = self.surfaces.iter().map(|(name, _)| name.as_str());
        let num_totals = names.len();
        let mut found = SceneDifference {
            run: RunInfo::default(),
            names: ["A".into(), "B".into()],
            num_rays: tallies[0].launched.count,
            num_blocks: spreads[1].num_blocks(),
            detectors: Vec::new(),
            totals: names.iter().copied().enumerate().map(line).filter(has_light).collect(),
            surfaces: (num_totals..).zip(surfaces).map(line).filter(has_light).collect(),
            notes: self.notes.clone(),
        };
        let mut cell = self.detectors.len();
        for (at, pair) in self.detectors.iter().enumerate() {
            let [of_a, of_b] = [0, 1].map(|side| &self.scenes[side].detectors[pair[side]]);
            let sums = [0, 1].map(|side| &tallies[side].detectors[pair[side]]);
            let mut map = None;
            if self.has_map(pair) {
                let side = |side| self.detector(side, pair[side], tallies[side], units[side], sums[side]);
                let sides = [side(0)?, side(1)?];
                let shape = sides[0].data.result().map().map(|map| map.values.raw_dim()).unwrap_or_default();
                let end = cell + shape.slice().iter().product::<usize>();
                let array = |values: Vec<f64>| {
                    ArrayD::from_shape_vec(shape.clone(), values)
                        .map_err(|error| Error::Internal(error.to_string()))
                };
                let values = a.detected[cell..end].iter().zip(&b.detected[cell..end]).map(|(a, b)| a - b);
                let values = array(values.collect())?;
                let errors =
                    errors[1].as_ref().map(|errors| array(errors[cell..end].to_vec())).transpose()?;
                map = Some(MapDifference { sides, values, errors });
                cell = end;
            }
            let note = match &map {
                None if of_a.num_cells() > 0 || of_b.num_cells() > 0 => {
                    Some("A and B have no map of the same cells".into())
                }
                Some(_) if of_a.kind != of_b.kind => {
                    Some("A and B do not cover the same area: cells are paired by their indices".into())
                }
                _ => None,
            };
            found.detectors.push(DetectorDifference {
                flux: number(&of_a.name, [a.detected[at], b.detected[at]], 1, at),
                kind: of_a.kind.function().name(),
                num_rays_hit: sums.map(|sums| sums.total().count),
                map,
                note,
            });
        }
        Ok(found)
    }
}

/// The lines of a ledger in which light can be.
fn lines(ledger: &Ledger) -> impl Iterator<Item = (&'static str, f64)> {
    let all = ledger.sources().into_iter().chain(ledger.destinations()).chain([("tapped", ledger.tapped)]);
    all.map(|(name, entry)| (name, entry.flux))
}

/// Pairs of things of the same name by their numbers, in the order of A; then the things of B alone. Among several of one
/// name, the first of A belongs to the first of B.
fn by_name(a: &[&str], b: &[&str]) -> Vec<[Option<usize>; 2]> {
    let mut taken = vec![false; b.len()];
    let mut pairs: Vec<[Option<usize>; 2]> = Vec::new();
    for (i, name) in a.iter().enumerate() {
        let other = (0..b.len()).find(|&j| !taken[j] && b[j] == *name);
        other.into_iter().for_each(|j| taken[j] = true);
        pairs.push([Some(i), other]);
    }
    pairs.extend((0..b.len()).filter(|&j| !taken[j]).map(|j| [None, Some(j)]));
    pairs
}

/// B with its sources in the order of A's, so that each has the rays of its own name.
///
/// # Errors
/// [`Error::Usage`] if the two have no sources of the same names.
pub fn with_sources_of(a: &SceneIr, b: SceneIr) -> Result<SceneIr> {
    let names = [a, &b].map(|ir| ir.sources.iter().map(|source| source.name.as_str()).collect::<Vec<_>>());
    let mut order = Vec::new();
    for pair in by_name(&names[0], &names[1]) {
        let lacking = match pair {
            [Some(_), Some(j)] => {
                order.push(j);
                continue;
            }
            [Some(i), None] => format!("B has no source called `{}`", shown(names[0][i])),
            [_, j] => format!("A has no source called `{}`", shown(names[1][j.unwrap_or_default()])),
        };
        return Err(Error::Usage(format!(
            "{lacking}; both need the same sources, by their names, to launch the same rays"
        )));
    }
    let sources = order.iter().map(|&j| b.sources[j].clone()).collect();
    Ok(SceneIr { sources, ..b })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn things_are_paired_by_their_names() {
        assert_eq!(
            by_name(&["a", "b", "a"], &["c", "a", "a"]),
            [[Some(0), Some(1)], [Some(1), None], [Some(2), Some(2)], [None, Some(0)]]
        );
    }

    #[test]
    fn a_difference_without_an_error_has_no_score() {
        let number = |difference, standard_error| FluxDifference {
            name: "screen".into(),
            a: difference,
            b: 0.0,
            difference,
            standard_error,
            few_rays: None,
        };
        assert_eq!(number(3.0, Some(1.5)).score(), Some(2.0));
        assert_eq!(number(3.0, Some(0.0)).score(), None);
        assert_eq!(number(3.0, None).score(), None);
        assert_eq!(number(0.0, None).score(), Some(0.0));
    }
}
