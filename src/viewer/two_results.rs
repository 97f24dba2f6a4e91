//! Two results of one detector: A, B, their difference, and how significant it is.

use crate::result::figures::field::{Field, Labels};
use ndarray::Array2;
use serde::{Deserialize, Serialize};

/// What is shown of two results.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum ComparisonMode {
    /// The result that was opened or is being traced.
    #[default]
    A,
    /// The result for comparison.
    B,
    /// A - B.
    Difference,
    /// (A - B) / sigma.
    Significance,
}

impl ComparisonMode {
    /// All choices, in the order of the menu.
    pub const ALL: [(ComparisonMode, &'static str); 4] = [
        (ComparisonMode::A, "A"),
        (ComparisonMode::B, "B"),
        (ComparisonMode::Difference, "A − B"),
        (ComparisonMode::Significance, "(A − B) / σ"),
    ];

    /// True for quantities that lie around zero.
    pub fn is_difference(self) -> bool {
        matches!(self, ComparisonMode::Difference | ComparisonMode::Significance)
    }
}

/// A - B, or A - B over its standard error.
///
/// # Errors
/// Why the two cannot be compared cell by cell.
pub fn difference(comparison: ComparisonMode, a: &Field, b: &Field) -> Result<Field, String> {
    let same = a.geometry == b.geometry && a.labels == b.labels && a.dim() == b.dim();
    if !same {
        let [(rows_a, columns_a), (rows_b, columns_b)] = [a.dim(), b.dim()];
        return Err(format!(
            "A has {columns_a} × {rows_a} cells, B {columns_b} × {rows_b}: the two cannot be subtracted"
        ));
    }
    if (a.x_range, a.y_range) != (b.x_range, b.y_range) {
        return Err("A and B do not cover the same area: the two cannot be subtracted".into());
    }
    let values = &a.values - &b.values;
    let sigma = zip(&a.sigma, &b.sigma, |a, b| match (a.is_nan(), b.is_nan()) {
        (true, true) => f64::NAN,
        // A cell without hits has no known error. The error of the other cell is the least that the difference has.
        (true, false) => b,
        (false, true) => a,
        (false, false) => a.hypot(b),
    });
    let mut field = Field { values, sigma, hits: &a.hits + &b.hits, ..a.clone() };
    field.labels.value.0 = "A − B";
    if comparison == ComparisonMode::Significance {
        field.values =
            zip(
                &field.values,
                &field.sigma,
                |difference, sigma| {
                    if sigma > 0.0 { difference / sigma } else { f64::NAN }
                },
            );
        // A score has no error of its own.
        field.sigma.fill(f64::NAN);
        field.labels = Labels { value: ("(A − B) / σ", "σ"), ..field.labels };
    }
    Ok(field)
}

/// The distribution of (A - B) / sigma. For two results that differ by chance alone, it is normal with mean 0 and
/// variance 1.
#[derive(Debug, Clone, PartialEq)]
pub struct Scores {
    /// Cells whose error is known.
    pub num_cells: u64,
    /// Cells per bin of [`Scores::WIDTH`], from -[`Scores::REACH`] to [`Scores::REACH`]. The end bins hold all beyond.
    pub counts: Vec<u64>,
    /// The mean of (A - B) / sigma.
    pub mean: f64,
    /// The mean square of (A - B) / sigma: chi squared per cell.
    pub mean_square: f64,
}

impl Scores {
    /// Where the bins end.
    pub const REACH: f64 = 5.0;
    /// Width of a bin.
    pub const WIDTH: f64 = 0.25;

    /// The scores of a difference or of a significance.
    pub fn of(field: &Field) -> Self {
        let bins = (2.0 * Self::REACH / Self::WIDTH) as usize;
        let mut scores = Scores { num_cells: 0, counts: vec![0; bins], mean: 0.0, mean_square: 0.0 };
        let is_score = field.labels.value.1 == "σ";
        for (value, sigma) in field.values.iter().zip(&field.sigma) {
            let score = if is_score { *value } else { value / sigma };
            if !score.is_finite() {
                continue;
            }
            let bin = ((score + Self::REACH) / Self::WIDTH).max(0.0) as usize;
            scores.counts[bin.min(bins - 1)] += 1;
            scores.num_cells += 1;
            scores.mean += score;
            scores.mean_square += score * score;
        }
        scores.mean /= scores.num_cells as f64;
        scores.mean_square /= scores.num_cells as f64;
        scores
    }
}

fn zip(a: &Array2<f64>, b: &Array2<f64>, of: impl Fn(f64, f64) -> f64) -> Array2<f64> {
    let mut result = a.clone();
    result.zip_mut_with(b, |a, b| *a = of(*a, *b));
    result
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::result::IrradianceMap;
    use ndarray::{Array1, array};

    fn field(irradiance: Array2<f64>, hits: Array2<u64>) -> Field {
        let (rows, columns) = irradiance.dim();
        Field::of_result(&IrradianceMap {
            x_coords: Array1::zeros(columns),
            y_coords: Array1::zeros(rows),
            width: 2.0,
            height: 1.0,
            irradiance,
            hits,
            standard_error: None,
        })
    }

    #[test]
    fn errors_add_in_squares() {
        let a = field(array![[8.0, 3.0, 0.0]], array![[4, 9, 0]]);
        let b = field(array![[5.0, 0.0, 0.0]], array![[1, 0, 0]]);
        let difference_of = |comparison| difference(comparison, &a, &b).unwrap();
        let difference = difference_of(ComparisonMode::Difference);
        assert_eq!(difference.values, array![[3.0, 3.0, 0.0]]);
        // 8 / sqrt(4) = 4 and 5 / sqrt(1) = 5; then only A's 3 / sqrt(9) = 1 is known.
        assert_eq!(difference.sigma[(0, 0)], 4f64.hypot(5.0));
        assert_eq!(difference.sigma[(0, 1)], 1.0);
        let significance = difference_of(ComparisonMode::Significance);
        assert_eq!(significance.values[(0, 0)], 3.0 / 4f64.hypot(5.0));
        assert_eq!(significance.values[(0, 1)], 3.0);
        assert!(significance.values[(0, 2)].is_nan(), "nothing is known of a cell that no ray hit");
        let scores = Scores::of(&significance);
        assert_eq!((scores.num_cells, scores.counts.iter().sum::<u64>()), (2, 2));
        let first = 3.0 / 4f64.hypot(5.0);
        assert_eq!((scores.mean, scores.mean_square), ((first + 3.0) / 2.0, (first * first + 9.0) / 2.0));
        assert_eq!(Scores::of(&difference), scores);
    }

    #[test]
    fn other_cells_are_not_subtracted() {
        let a = field(array![[1.0, 2.0]], array![[1, 1]]);
        let b = field(array![[1.0]], array![[1]]);
        assert!(difference(ComparisonMode::Difference, &a, &b).unwrap_err().contains("2 × 1"));
    }
}
