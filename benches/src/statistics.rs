//! Statistics of a few runs.

use serde::{Deserialize, Serialize};

/// Median, least and greatest of some runs.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Summary {
    /// The middle value; for an even number of values, the mean of the middle two.
    pub median: f64,
    /// The least.
    pub min: f64,
    /// The greatest.
    pub max: f64,
}

impl Summary {
    /// The summary of `values`; `None` if there are none.
    pub fn of(values: &[f64]) -> Option<Self> {
        let mut sorted = values.to_vec();
        sorted.sort_by(f64::total_cmp);
        let (min, max) = (*sorted.first()?, *sorted.last()?);
        let (below, above) = (sorted[(sorted.len() - 1) / 2], sorted[sorted.len() / 2]);
        Some(Summary { median: 0.5 * (below + above), min, max })
    }

    /// The median of `values`; no number if there are none.
    pub fn median_of(values: &[f64]) -> f64 {
        Self::of(values).map_or(f64::NAN, |summary| summary.median)
    }

    /// The summary of rates \[1/s\]: `things` done in each of these times.
    pub fn of_rates(things: f64, seconds: &[f64]) -> Option<Self> {
        let rates: Vec<f64> = seconds.iter().map(|seconds| things / seconds.max(SHORTEST)).collect();
        Summary::of(&rates)
    }

    /// The summary with every value times `factor`.
    pub fn times(self, factor: f64) -> Self {
        Summary { median: factor * self.median, min: factor * self.min, max: factor * self.max }
    }

    /// This median over the other's.
    pub fn ratio_to(self, other: Summary) -> f64 {
        self.median / other.median
    }
}

/// The shortest time that any clock resolves \[s\].
const SHORTEST: f64 = 1e-9;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_middle_is_the_median() {
        assert_eq!(Summary::of(&[3.0, 1.0, 2.0]), Some(Summary { median: 2.0, min: 1.0, max: 3.0 }));
        assert_eq!(Summary::of(&[4.0, 1.0]), Some(Summary { median: 2.5, min: 1.0, max: 4.0 }));
        assert_eq!(Summary::of(&[]), None);
    }

    #[test]
    fn rates_are_things_by_time() {
        let rates = Summary::of_rates(100.0, &[0.5, 0.25, 1.0]).unwrap();
        assert_eq!(rates, Summary { median: 200.0, min: 100.0, max: 400.0 });
        let twice = rates.times(2.0);
        assert_eq!(twice, Summary { median: 400.0, min: 200.0, max: 800.0 });
        assert_eq!(twice.ratio_to(rates), 2.0);
    }
}
