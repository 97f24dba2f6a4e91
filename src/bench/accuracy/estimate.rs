//! The estimate that a trace makes of one detector, and its distance from another answer.

use crate::model::SceneIr;
use crate::result::uncertainty::Uncertainty;
use crate::result::{FluxUnit, QUANTA_PER_WEIGHT, Tally};

/// A detector's cells and their sum, as shares of the launched flux.
#[derive(Debug, Clone, PartialEq)]
pub struct Estimate {
    /// The shares of the pixels or bins.
    pub cells: Vec<f64>,
    /// The sum over the cells.
    pub total: f64,
}

/// The error of a map, and the error of a detector's flux.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Errors {
    /// Root mean square over the cells, in units of their mean.
    pub cells: f64,
    /// The error of the sum, in units of the sum.
    pub total: f64,
}

/// Squared deviations, in shares of the launched flux.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Deviations {
    /// The mean over the cells of the square of a deviation times the number of cells.
    pub cells: f64,
    /// The square of the deviation of the cells' sum.
    pub total: f64,
}

impl Errors {
    /// The root mean square of the errors of independent traces.
    pub fn root_mean_square(errors: &[Errors]) -> Self {
        let count = errors.len().max(1) as f64;
        let root =
            |of: fn(&Errors) -> f64| (errors.iter().map(|e| of(e).powi(2)).sum::<f64>() / count).sqrt();
        Errors { cells: root(|e| e.cells), total: root(|e| e.total) }
    }
}

impl Estimate {
    /// The estimate of a detector in a tally.
    pub fn of(tally: &Tally, detector: usize) -> Self {
        let launched = tally.launched.quanta as f64;
        let detector = &tally.detectors[detector];
        let cells = detector.quanta.iter().map(|&quanta| quanta as f64 / launched).collect();
        Estimate { cells, total: detector.total().quanta as f64 / launched }
    }

    /// The mean of some estimates of one detector.
    pub fn mean(estimates: &[Estimate]) -> Self {
        let count = estimates.len() as f64;
        let num_cells = estimates.first().map_or(0, |first| first.cells.len());
        let cell = |i: usize| estimates.iter().map(|estimate| estimate.cells[i]).sum::<f64>() / count;
        Estimate {
            cells: (0..num_cells).map(cell).collect(),
            total: estimates.iter().map(|estimate| estimate.total).sum::<f64>() / count,
        }
    }

    /// Variance of the flux, for random rays, from their second moments; `None` if these were not summed.
    pub fn flux_variance(ir: &SceneIr, tally: &Tally, detector: usize) -> Option<f64> {
        let quanta = FluxUnit::new(QUANTA_PER_WEIGHT, 1);
        let error = Uncertainty::new(ir, tally, quanta).of_total(&tally.detectors[detector])?;
        Some((error / tally.launched.quanta as f64).powi(2))
    }

    /// Squared deviations from `answer`.
    pub fn squares(&self, answer: &Estimate) -> Deviations {
        let squares: f64 = self.cells.iter().zip(&answer.cells).map(|(a, b)| (a - b).powi(2)).sum();
        Deviations { cells: squares * answer.cells.len() as f64, total: (self.total - answer.total).powi(2) }
    }

    /// The errors of this estimate, compared with `answer`.
    pub fn errors(&self, answer: &Estimate) -> Errors {
        let squares = self.squares(answer);
        Errors { cells: squares.cells.sqrt() / answer.total, total: squares.total.sqrt() / answer.total }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bench::accuracy::CLAIMS;
    use crate::result::{DetectorTally, FluxSum, Moments};

    #[test]
    fn the_variance_of_a_flux_is_that_of_its_rays() {
        let ir = CLAIMS.iter().map(|claim| claim.ir().unwrap()).find(|ir| ir.sources.len() == 1).unwrap();
        let quanta = |weight: f64| (weight * QUANTA_PER_WEIGHT) as u128;
        // Five rays of weight 1, of which three leave 1, 1.5 and 1: sample variance 0.45 of each.
        let totals = vec![Moments { quanta: quanta(3.5), squares: quanta(4.25) }];
        let detectors = vec![DetectorTally { quanta: vec![quanta(3.5)], totals, ..Default::default() }];
        let launched = FluxSum { count: 5, quanta: quanta(5.0) };
        let mut tally = Tally { detectors, launched, ..Default::default() };
        let variance = Estimate::flux_variance(&ir, &tally, 0).unwrap();
        approx::assert_relative_eq!(variance, 0.45 / 5.0, max_relative = 1e-14);
        tally.detectors[0].totals.clear();
        assert_eq!(Estimate::flux_variance(&ir, &tally, 0), None);
    }
}
