//! Standard errors, from the first and second moments over primary rays.
//!
//! The rays of a source are independent draws of one distribution; so the variance of a sum over n of them is estimated
//! without bias by n/(n-1) (Q - S^2/n), where S is the sum of the rays' contributions and Q that of their squares. A
//! contribution is all that one primary ray leaves in the cell, however often it comes by.
//!
//! Sobol's points are no independent draws. Their error is that between R independent scrambles of them, each with its share
//! of every source's rays: sums S_r over n_r rays, of S over n, estimate the variance of S as
//! R/(R-1) sum (S_r - n_r/n S)^2, with R - 1 degrees of freedom. It is without bias where all n_r are equal; else it is too
//! large by about the square of one ray of each source, and never too small by more.

use crate::ir::SceneIr;
use crate::ir::ray_id::NUM_REPLICATES;
use crate::result::{FluxUnit, Moments, QUANTA_PER_WEIGHT, SensorTally, Tally};

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

/// Standard error of a sum from those of its independent replicates, in quanta: `sums` over `num_rays` rays each; NaN where a
/// replicate has no ray.
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
    rays_of_emitters: Vec<u64>,
    rays_of_replicates: Vec<u64>,
    unit: FluxUnit,
    overflowed: bool,
}

impl Uncertainty {
    pub(crate) fn new(ir: &SceneIr, tally: &Tally, unit: FluxUnit) -> Self {
        let rays_of_emitters = match ir.emitters.len() {
            1 => vec![tally.launched.count],
            emitters => (0..emitters).map(|emitter| tally.rays.count_of(emitter)).collect(),
        };
        let overflowed = tally.moments_overflowed;
        let rays_of_replicates = tally.rays.counts_by_remainder(u64::from(NUM_REPLICATES));
        let num_rays = tally.launched.count;
        Uncertainty { num_rays, rays_of_emitters, rays_of_replicates, unit, overflowed }
    }

    /// Standard error of the flux in each cell \[W\]; none where second moments were not summed. The sources are pooled:
    /// where they light a cell unequally, the error is too large, by a factor of at most 1/sqrt(1 - p) where p is the
    /// largest share of a source's rays that comes by the cell; it is never too small.
    ///
    /// Each is divided by the size of its cell: area, or solid angle.
    pub(crate) fn of_cells(&self, sums: &SensorTally, size: impl Fn(usize) -> f64) -> Option<Vec<f64>> {
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

    /// Mean of the relative standard errors of the cells that are not dark; none where all are, or second moments were not
    /// summed.
    fn mean_relative_of_cells(&self, sums: &SensorTally) -> Option<f64> {
        if !Uncertainty::knows_cells(sums) {
            return None;
        }
        let lit = sums.quanta.iter().enumerate().filter(|(_, quanta)| **quanta > 0);
        mean(lit.map(|(cell, &quanta)| self.of_cell(sums, cell) / self.unit.watts(quanta)))
    }

    /// True if the tally tells errors of the cells.
    fn knows_cells(sums: &SensorTally) -> bool {
        let has_squares = sums.squares.len() == sums.quanta.len() && !sums.totals.is_empty();
        has_squares || !sums.replicates.is_empty()
    }

    /// Standard error of the flux in a cell \[W\].
    fn of_cell(&self, sums: &SensorTally, cell: usize) -> f64 {
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

    /// Standard error of a detector's flux \[W\]; none where second moments were not summed. Each source has a fixed
    /// number of rays, so that the variances of the sources add up.
    pub(crate) fn of_total(&self, sums: &SensorTally) -> Option<f64> {
        if !sums.replicates.is_empty() {
            let of_replicate = sums.replicates.chunks(sums.quanta.len().max(1));
            return Some(self.of_replicates(of_replicate.map(|cells| cells.iter().sum())));
        }
        if sums.totals.len() != self.rays_of_emitters.len() {
            return None;
        }
        let strata = sums.totals.iter().zip(&self.rays_of_emitters);
        let variance: f64 = strata.map(|(&moments, &num_rays)| variance(num_rays, moments)).sum();
        Some(self.watts(variance.sqrt()))
    }

    fn watts(&self, weight: f64) -> f64 {
        if self.overflowed { f64::NAN } else { self.unit.watts_of_weight(weight) }
    }
}

/// Mean of the cells' standard errors relative to their values, over the cells that are not dark; none if all are.
pub(crate) fn mean_relative<'a>(
    values: impl IntoIterator<Item = &'a f64>,
    errors: impl IntoIterator<Item = &'a f64>,
) -> Option<f64> {
    let lit = values.into_iter().zip(errors).filter(|(value, _)| **value > 0.0);
    mean(lit.map(|(value, error)| error / value))
}

/// None of nothing.
fn mean(numbers: impl Iterator<Item = f64>) -> Option<f64> {
    let (count, sum) = numbers.fold((0_u64, 0.0), |(count, sum), number| (count + 1, sum + number));
    (count > 0).then(|| sum / count as f64)
}

/// The largest of all detectors' errors: for each, the mean of the relative standard errors of its lit cells, and the
/// relative standard error of its flux. None where no detector was hit; NaN where an error is not known.
pub fn worst_relative_error(ir: &SceneIr, tally: &Tally) -> Option<f64> {
    let uncertainty = Uncertainty::new(ir, tally, FluxUnit::new(QUANTA_PER_WEIGHT, 1));
    let watts = |quanta: u128| quanta as f64;
    let errors = tally.sensors.iter().flat_map(|sensor| {
        let cells = uncertainty.mean_relative_of_cells(sensor);
        let total = Some(watts(sensor.total().quanta)).filter(|total| *total > 0.0);
        let total = total.map(|total| uncertainty.of_total(sensor).map_or(f64::NAN, |error| error / total));
        [cells, total].into_iter().flatten()
    });
    // NaN is the largest of all.
    errors.max_by(f64::total_cmp)
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
    fn the_relative_error_is_that_of_lit_cells() {
        assert_eq!(mean_relative(&[0.0, 2.0, 4.0], &[0.0, 1.0, 1.0]), Some(0.375));
        assert_eq!(mean_relative(&[0.0], &[0.0]), None);
    }
}
