//! Standard errors, from the first and second moments over primary rays.
//!
//! The rays of a source are independent draws of one distribution. The variance of a sum over n rays is estimated
//! without bias by n/(n-1) (Q - S^2/n). S is the sum of the rays' contributions, and Q the sum of their squares. A
//! contribution is all that one primary ray leaves in the cell, however often it comes by.
//!
//! Sobol's points are no independent draws. Their error is the spread between R independent scrambles, each with its
//! share of every source's rays. Scramble r has the sum S_r over n_r rays, and all rays have S over n. The variance
//! of S is estimated as R/(R-1) sum (S_r - n_r/n S)^2, with R - 1 degrees of freedom. It is without bias if all n_r
//! are equal. Otherwise it is too large by about the square of one ray of each source, and never too small by more.
//!
//! The error of a map is the sum of its cells' standard errors over the sum of their values. It is the mean of the
//! cells' relative errors, weighted by the light in each cell. So a cell counts for what it holds, and neither stray
//! light nor the outer taps of a splat rule the figure. A cell without a ray has an estimated error of 0. The root of
//! few hits is on average smaller than the root of the hits expected. The difference is 23 % at one hit a cell, and 3 %
//! at five. So the error of a map is at most about 100 %, and too small where most of its light falls on cells of few
//! hits.

use crate::model::SceneIr;
use crate::model::ray_id::NUM_REPLICATES;
use crate::result::few_rays::{Brought, FewRays};
use crate::result::wavelengths_apart::added_up;
use crate::result::{DetectorTally, FluxUnit, Moments, QUANTA_PER_WEIGHT, Tally};

/// Standard error of a sum over `num_rays` rays, in units of weight; NaN for a single ray, which says nothing.
pub fn standard_error(num_rays: u64, moments: Moments) -> f64 {
    variance(num_rays, moments).sqrt()
}

fn variance(num_rays: u64, moments: Moments) -> f64 {
    let n = num_rays as f64;
    let sum = moments.quanta as f64 / QUANTA_PER_WEIGHT;
    let squares = moments.squares as f64 / QUANTA_PER_WEIGHT;
    if num_rays < 2 {
        return f64::NAN;
    }
    // Q >= S^2/n but for rounding.
    (squares - sum * (sum / n)).max(0.0) * (n / (n - 1.0))
}

/// Standard error of a sum by the spread of its independent replicates, in quanta: `sums` over `num_rays` rays each. NaN if
/// a replicate has no ray.
fn replicates_error(sums: impl Iterator<Item = u128> + Clone, num_rays: &[u64]) -> f64 {
    let sum: u128 = sums.clone().sum();
    let all = num_rays.iter().copied().map(u128::from).sum::<u128>();
    if num_rays.contains(&0) || num_rays.len() < 2 {
        return f64::NAN;
    }
    // The expected share, exact to a quantum: what is left over all rays is shared apart, so that nothing overflows.
    let expected = |rays: u128| sum / all * rays + sum % all * rays / all;
    let deviations =
        sums.zip(num_rays).map(|(found, &rays)| found.abs_diff(expected(u128::from(rays))) as f64);
    let squares: f64 = deviations.map(|deviation| deviation * deviation).sum();
    let num = num_rays.len() as f64;
    (squares * num / (num - 1.0)).sqrt()
}

/// What standard errors are computed from, for one tally.
#[derive(Debug, Clone)]
pub(crate) struct Uncertainty {
    num_rays: u64,
    rays_of_sources: Vec<u64>,
    rays_of_replicates: Vec<u64>,
    /// The mean weight of a new ray.
    birth_weight: f64,
    /// What the sources launch \[W\].
    launched_flux: f64,
    unit: FluxUnit,
    overflowed: bool,
}

impl Uncertainty {
    pub(crate) fn new(ir: &SceneIr, tally: &Tally, unit: FluxUnit) -> Self {
        let rays_of_sources = match ir.sources.len() {
            1 => vec![tally.launched.count],
            sources => tally.rays.counts(sources),
        };
        let overflowed = tally.moments_overflowed;
        let rays_of_replicates = tally.rays.counts_by_remainder(u64::from(NUM_REPLICATES));
        let num_rays = tally.launched.count;
        let birth_weight = tally.launched.mean_weight();
        let launched_flux = unit.watts(tally.launched.quanta);
        Uncertainty {
            num_rays,
            rays_of_sources,
            rays_of_replicates,
            birth_weight,
            launched_flux,
            unit,
            overflowed,
        }
    }

    /// Standard error of each cell \[W\], divided by the cell's size: area, or solid angle. `None` if second moments were
    /// not summed.
    ///
    /// The sources are pooled. Let p be the largest share of a source's rays that comes by the cell. Where sources
    /// light a cell unequally, the error is too large by a factor of at most 1/sqrt(1 - p). The error is never too
    /// small.
    pub(crate) fn of_cells(&self, sums: &DetectorTally, size: impl Fn(usize) -> f64) -> Option<Vec<f64>> {
        if !Uncertainty::knows_cells(sums) {
            return None;
        }
        let is_dark = |cell: usize| sums.quanta[cell] == 0 && sums.squares.get(cell).is_none_or(|&s| s == 0);
        let num_cells = sums.quanta.len();
        // Dark cells are alike, and mostly zero: then they take no memory.
        let of_dark = (0..num_cells).find(|&cell| is_dark(cell)).map_or(0.0, |cell| self.of_cell(sums, cell));
        let mut errors = vec![of_dark; num_cells];
        let lit = errors.iter_mut().enumerate().filter(|(cell, _)| !is_dark(*cell));
        lit.for_each(|(cell, error)| *error = self.of_cell(sums, cell) / size(cell));
        Some(errors)
    }

    /// The error of a detector's map. `None` for a dark map, for a ray database, and where errors of cells are unknown.
    pub(crate) fn of_map(&self, sums: &DetectorTally) -> Option<MapError> {
        Uncertainty::knows_cells(sums)
            .then(|| MapError::new(sums, self.unit, |cell| self.of_cell(sums, cell)))?
    }

    /// The same by the hits alone: each cell's error is its value over the root of its hits. It is right where all rays
    /// weigh the same and each comes to one cell.
    pub(crate) fn of_map_by_hits(&self, sums: &DetectorTally) -> Option<MapError> {
        let error = |cell: usize| {
            let hits = sums.hits.get(cell).map_or(1, |&hits| hits.max(1));
            self.unit.watts(sums.quanta[cell]) / (hits as f64).sqrt()
        };
        MapError::new(sums, self.unit, error)
    }

    /// True if the tally has what errors of cells follow from.
    fn knows_cells(sums: &DetectorTally) -> bool {
        let has_squares = sums.squares.len() == sums.quanta.len() && !sums.totals.is_empty();
        has_squares || !sums.replicates.is_empty()
    }

    /// Standard error of the flux in a cell \[W\].
    fn of_cell(&self, sums: &DetectorTally, cell: usize) -> f64 {
        if sums.replicates.is_empty() {
            return self.of_moments(Moments { quanta: sums.quanta[cell], squares: sums.squares[cell] });
        }
        self.of_replicates(sums.replicates.iter().skip(cell).step_by(sums.quanta.len()).copied())
    }

    /// Standard error of a sum over pooled sources \[W\].
    fn of_moments(&self, moments: Moments) -> f64 {
        self.watts(standard_error(self.num_rays, moments))
    }

    /// Standard error of a sum from its replicates \[W\].
    fn of_replicates(&self, sums: impl Iterator<Item = u128> + Clone) -> f64 {
        self.watts(replicates_error(sums, &self.rays_of_replicates) / QUANTA_PER_WEIGHT)
    }

    /// Standard error of a detector's flux \[W\]. `None` if second moments were not summed. Each source has a fixed
    /// number of rays, so that the variances of the sources add up.
    pub(crate) fn of_total(&self, sums: &DetectorTally) -> Option<f64> {
        if !sums.replicates.is_empty() {
            let of_replicate = sums.replicates.chunks(sums.quanta.len().max(1));
            return Some(self.of_replicates(of_replicate.map(|cells| cells.iter().sum())));
        }
        if sums.totals.len() != self.rays_of_sources.len() {
            return None;
        }
        let strata = sums.totals.iter().zip(&self.rays_of_sources);
        let variance: f64 = strata.map(|(&moments, &num_rays)| variance(num_rays, moments)).sum();
        Some(self.watts(variance.sqrt()))
    }

    /// What is known of the flux of a detector, which may absorb, where it rests on few rays.
    pub(crate) fn few_rays(&self, sums: &DetectorTally, absorbs: bool) -> Option<FewRays> {
        let brought = sums.brought();
        let squares = brought.squares.filter(|_| !self.overflowed);
        let few = Brought { squares, ..brought }.few_rays(self.birth_weight, self.unit)?;
        Some(if absorbs { few.at_most(self.launched_flux) } else { few })
    }

    fn watts(&self, weight: f64) -> f64 {
        if self.overflowed { f64::NAN } else { self.unit.watts_of_weight(weight) }
    }
}

/// The error of a detector's map, and what more rays would make of it.
///
/// Where cells have many hits, their standard errors grow with the root of the rays, and the map's error falls with it.
/// Where they have few, more rays find more cells: the error hardly falls until most cells are found. Their
/// number follows from the numbers of cells that were hit once and twice (Chao's estimate).
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct MapError {
    /// Sum over cells of their values.
    value: f64,
    /// Sum of the standard errors of the cells of many hits.
    of_many: f64,
    /// Sum of the standard errors of the others.
    of_few: f64,
    /// Hits expected in one of these, those included that were not hit yet.
    expected_hits: f64,
}

impl MapError {
    /// The root of fewer hits is a poor estimate of the root of the hits that are expected.
    const MANY_HITS: u64 = 8;

    fn new(sums: &DetectorTally, unit: FluxUnit, error: impl Fn(usize) -> f64) -> Option<Self> {
        let mut map = MapError { value: 0.0, of_many: 0.0, of_few: 0.0, expected_hits: 1.0 };
        for (cell, &quanta) in sums.quanta.iter().enumerate().filter(|(_, quanta)| **quanta > 0) {
            map.value += unit.watts(quanta);
            let has_many = sums.hits.get(cell).is_some_and(|&hits| hits >= MapError::MANY_HITS);
            *(if has_many { &mut map.of_many } else { &mut map.of_few }) += error(cell);
        }
        // Cells by their number of hits; the last are of many.
        let mut cells = [0.0_f64; MapError::MANY_HITS as usize + 1];
        sums.hits.iter().for_each(|&hits| cells[hits.min(MapError::MANY_HITS) as usize] += 1.0);
        let [dark, once, twice, ..] = cells;
        let unseen = (once * (once - 1.0) / (2.0 * (twice + 1.0))).clamp(0.0, dark);
        let few = (1..).zip(&cells[1..MapError::MANY_HITS as usize]);
        let (hits, seen) =
            few.fold((0.0, 0.0), |(hits, seen), (each, &num)| (hits + f64::from(each) * num, seen + num));
        if hits > 0.0 {
            map.expected_hits = hits / (seen + unseen);
        }
        (map.value > 0.0).then_some(map)
    }

    /// Relative error of the map.
    pub(crate) fn relative(&self) -> f64 {
        (self.of_many + self.of_few) / self.value
    }

    /// The relative error after `factor` times as many rays.
    fn relative_after(&self, factor: f64) -> f64 {
        let of_few = mean_root(factor * self.expected_hits) / mean_root(self.expected_hits);
        (self.of_many * factor.sqrt() + self.of_few * of_few) / (self.value * factor)
    }

    /// By what factor the number of rays must grow to bring the error to `target`; 1 if it is there, `None` if that is unknown.
    pub(crate) fn factor_to(&self, target: f64) -> Option<f64> {
        const MOST_DOUBLINGS: f64 = 64.0;
        const BISECTIONS: u32 = 50;
        let is_enough = |doublings: f64| self.relative_after(doublings.exp2()) <= target;
        if self.relative() <= target {
            return Some(1.0);
        }
        let (mut low, mut high) = (0.0, MOST_DOUBLINGS);
        for _ in 0..BISECTIONS {
            let middle = 0.5 * (low + high);
            *(if is_enough(middle) { &mut high } else { &mut low }) = middle;
        }
        is_enough(high).then(|| high.exp2())
    }
}

/// The mean of the root of a Poisson variable of this mean, to 0.7 %.
fn mean_root(mean: f64) -> f64 {
    mean / (mean + 0.25 + 0.75 * (-mean / 1.6).exp()).sqrt()
}

/// The relative errors of one detector that was hit.
#[derive(Debug, Clone, Copy, PartialEq)]
struct DetectorError {
    /// It rests on few rays: nothing is promised of more.
    is_of_few: bool,
    map: Option<MapError>,
    /// The relative error of its flux. NaN if it is not known.
    flux: f64,
}

/// The relative errors of all detectors that were hit.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Errors(Vec<DetectorError>);

impl Errors {
    pub(crate) fn of(ir: &SceneIr, tally: &Tally) -> Self {
        let (ir, tally) = added_up(ir, tally);
        let (ir, tally) = (&*ir, &*tally);
        let uncertainty = Uncertainty::new(ir, tally, FluxUnit::new(QUANTA_PER_WEIGHT, 1));
        let lit = tally.detectors.iter().map(|detector| (detector, detector.total().quanta as f64));
        let errors = lit.filter(|(_, total)| *total > 0.0).map(|(detector, total)| DetectorError {
            is_of_few: detector.brought().is_of_few(),
            map: uncertainty.of_map(detector),
            flux: uncertainty.of_total(detector).map_or(f64::NAN, |error| error / total),
        });
        Errors(errors.collect())
    }

    /// The largest relative error of any detector's map or flux. `None` if no detector was hit; NaN if an error is not known.
    pub(crate) fn worst(&self) -> Option<f64> {
        let all = self.0.iter().flat_map(|error| [error.map.map(|map| map.relative()), Some(error.flux)]);
        // NaN is the largest of all.
        all.flatten().max_by(f64::total_cmp)
    }

    /// By what factor the number of rays must grow to bring all errors to `target`; `None` if that is unknown, as from few rays.
    pub(crate) fn factor_to(&self, target: f64) -> Option<f64> {
        if self.0.iter().any(|error| error.is_of_few) {
            return None;
        }
        let factors = self.0.iter().flat_map(|error| {
            let of_flux = Some((error.flux / target).powi(2)).filter(|factor| factor.is_finite());
            [error.map.map_or(Some(1.0), |map| map.factor_to(target)), of_flux]
        });
        // The largest, if all are known.
        factors.reduce(|a, b| Some(f64::max(a?, b?)))?.map(|factor| factor.max(1.0))
    }
}

/// The largest relative error of any detector's map or flux. The error of a map is the sum of its cells' standard errors
/// over the sum of their values. `None` if no detector was hit; NaN if an error is not known.
pub fn worst_relative_error(ir: &SceneIr, tally: &Tally) -> Option<f64> {
    Errors::of(ir, tally).worst()
}

/// Sum of the cells' standard errors over the sum of their values, by the size of each cell; none of a dark map.
pub(crate) fn relative_error_of_map<'a>(
    values: impl IntoIterator<Item = &'a f64>,
    errors: impl IntoIterator<Item = &'a f64>,
    sizes: impl IntoIterator<Item = f64>,
) -> Option<f64> {
    let cells = values.into_iter().zip(errors).zip(sizes).filter(|((value, _), _)| **value > 0.0);
    let (value, error) = cells.fold((0.0, 0.0), |(values, errors), ((value, error), size)| {
        (values + value * size, errors + error * size)
    });
    (value > 0.0).then(|| error / value)
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;

    fn moments(weights: &[f64]) -> Moments {
        let sum =
            |value: fn(f64) -> f64| weights.iter().map(|w| (value(*w) * QUANTA_PER_WEIGHT) as u128).sum();
        Moments { quanta: sum(|w| w), squares: sum(|w| w * w) }
    }

    #[test]
    fn the_error_is_that_of_the_sample_variance() {
        // Five rays, of which two miss: mean 0.7, sample variance (0.49 * 2 + 0.3^2 + 0.8^2 + 0.3^2) / 4 = 0.45.
        let found = standard_error(5, moments(&[1.0, 1.5, 1.0]));
        assert_relative_eq!(found, (5.0_f64 * 0.45).sqrt(), max_relative = 1e-14);
    }

    #[test]
    fn replicates_tell_the_error_by_how_far_they_lie_apart() {
        let sums = [100, 104, 96, 100_u128];
        // Deviations 0, 4, -4, 0 from the mean: 4/3 * 32.
        assert_relative_eq!(replicates_error(sums.into_iter(), &[10; 4]), (128.0_f64 / 3.0).sqrt());
        // A replicate of one ray more is expected to have its share more, to the quantum.
        let large = 1 << 100;
        let shares = [large * 3, large * 3, large * 4, large * 3_u128];
        assert_eq!(replicates_error(shares.into_iter(), &[3, 3, 4, 3]), 0.0);
        assert!(replicates_error([5, 0_u128].into_iter(), &[1, 0]).is_nan());
    }

    #[test]
    fn rays_that_all_do_the_same_leave_no_doubt_and_one_ray_leaves_all() {
        assert_eq!(standard_error(3, moments(&[0.5, 0.5, 0.5])), 0.0);
        assert_eq!(standard_error(1 << 40, Moments::default()), 0.0);
        assert!(standard_error(1, moments(&[1.0])).is_nan());
    }

    #[test]
    fn the_error_of_a_map_is_weighted_by_its_light() {
        let error = |values: &[f64], errors: &[f64], sizes: &[f64]| {
            relative_error_of_map(values, errors, sizes.iter().copied())
        };
        assert_eq!(error(&[0.0, 2.0, 4.0], &[0.0, 1.0, 2.0], &[1.0; 3]), Some(0.5));
        assert_eq!(error(&[1.0, 3.0], &[1.0, 1.0], &[2.0, 1.0]), Some(0.6));
        // A tap of 1e-20 of the peak, whose error is a million times its value, is nothing.
        assert_eq!(error(&[1.0, 1e-20], &[0.01, 1e-14], &[1.0; 2]), Some(0.01 + 1e-14));
        // A dark cell has no error, and the error of a cell without weight does not count.
        assert_eq!(error(&[0.0], &[1.0], &[1.0]), None);
    }

    /// A map of cells of so many hits, all of weight 1.
    fn map_of(hits: Vec<u64>) -> MapError {
        let quanta = hits.iter().map(|&hits| u128::from(hits) << 52).collect();
        let sums = DetectorTally { quanta, hits, ..DetectorTally::default() };
        let uncertainty = Uncertainty {
            num_rays: 1,
            rays_of_sources: Vec::new(),
            rays_of_replicates: Vec::new(),
            birth_weight: 1.0,
            launched_flux: 1.0,
            unit: FluxUnit::new(1.0, 1),
            overflowed: false,
        };
        uncertainty.of_map_by_hits(&sums).unwrap()
    }

    #[test]
    fn a_map_of_few_hits_says_so_and_knows_what_it_takes() {
        let many = map_of(vec![0, 100, 100, 400]);
        assert_relative_eq!(many.relative(), 40.0 / 600.0, max_relative = 1e-12);
        assert_relative_eq!(many.factor_to(40.0 / 6000.0).unwrap(), 100.0, max_relative = 1e-9);
        assert_eq!(many.factor_to(0.5), Some(1.0));
        // 1 of 100 cells is hit each time, by chance: of 10,000 cells at 0.1 hits, 905 have one, 45 two, 2 three.
        let mut hits = vec![1; 905];
        hits.extend(vec![2; 45]);
        hits.extend(vec![3; 2]);
        hits.extend(vec![0; 10_000 - 952]);
        let few = map_of(hits);
        // The root of one hit is one hit, so that the error is close to 100 %, and would be for ten times the rays.
        assert!((0.95..1.0).contains(&few.relative()), "{}", few.relative());
        // 5 % are 400 hits a cell, 4,000 times as many.
        assert_relative_eq!(few.factor_to(0.05).unwrap(), 4000.0, max_relative = 0.1);
        let (factor, error) = (few.factor_to(0.5).unwrap(), few.relative_after(few.factor_to(0.5).unwrap()));
        assert!((30.0..45.0).contains(&factor) && (0.49..=0.5).contains(&error), "{factor}: {error}");
    }

    #[test]
    fn the_mean_of_the_root_is_close_to_the_series() {
        for mean in [0.01, 0.1, 0.5, 1.0, 2.0, 4.0, 8.0, 30.0] {
            let (mut sum, mut share) = (0.0, f64::exp(-mean));
            for hits in 1..200 {
                share *= mean / f64::from(hits);
                sum += share * f64::from(hits).sqrt();
            }
            assert_relative_eq!(mean_root(mean), sum, max_relative = 7e-3);
        }
    }
}
