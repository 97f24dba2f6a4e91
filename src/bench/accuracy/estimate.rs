//! What a trace says of one detector, and how far that is from another answer.

use crate::result::Tally;

/// A detector's cells and their sum, as shares of the launched flux.
#[derive(Debug, Clone, PartialEq)]
pub struct Estimate {
    /// Per pixel or bin.
    pub cells: Vec<f64>,
    /// Their sum.
    pub total: f64,
}

/// An error of a map in units of the mean of its cells, and one of the detector's flux in units of itself.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Errors {
    /// Root of the mean of the squares over the cells, in units of their mean.
    pub cells: f64,
    /// Of the sum, in units of the sum.
    pub total: f64,
}

impl Errors {
    /// Of errors of independent traces.
    pub fn root_mean_square(errors: &[Errors]) -> Self {
        let count = errors.len().max(1) as f64;
        let root =
            |of: fn(&Errors) -> f64| (errors.iter().map(|e| of(e).powi(2)).sum::<f64>() / count).sqrt();
        Errors { cells: root(|e| e.cells), total: root(|e| e.total) }
    }
}

impl Estimate {
    /// What a tally holds of a detector.
    pub fn of(tally: &Tally, sensor: usize) -> Self {
        let launched = tally.launched.quanta as f64;
        let sensor = &tally.sensors[sensor];
        let cells = sensor.quanta.iter().map(|&quanta| quanta as f64 / launched).collect();
        Estimate { cells, total: sensor.total().quanta as f64 / launched }
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

    /// How far this is from `answer`.
    pub fn errors(&self, answer: &Estimate) -> Errors {
        let squares: f64 = self.cells.iter().zip(&answer.cells).map(|(a, b)| (a - b).powi(2)).sum();
        let num_cells = answer.cells.len() as f64;
        let mean = answer.total / num_cells;
        Errors {
            cells: (squares / num_cells).sqrt() / mean,
            total: (self.total - answer.total).abs() / answer.total,
        }
    }
}
