//! Two results of one scene, detector by detector: whether chance alone explains how far they are apart.

use crate::result::{Detector, DetectorData, TraceResult};
use ndarray::ArrayViewD;
use serde::Serialize;

/// How far two results, A and B, are apart.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ResultComparison {
    /// Largest difference that chance is held to explain, in standard errors, for a single number.
    pub limit: f64,
    /// Per detector of either result, A's first.
    pub detectors: Vec<DetectorComparison>,
    /// True if some standard error was not known, and value / sqrt(hits) was taken.
    pub errors_from_hits: bool,
    /// True if the traces share draws: then they are less far apart than chance has it.
    pub same_draws: bool,
    /// True if no difference exceeds its limit, and both have the same detectors.
    pub agree: bool,
}

/// How far a detector of A is from that of the same name of B.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct DetectorComparison {
    /// The name.
    pub name: String,
    /// The kind in A, or in B where A has none.
    pub kind: &'static str,
    /// A's flux and B's \[W\]; none where it has no such detector.
    pub total_flux: [Option<f64>; 2],
    /// The flux's difference; none where one side is missing.
    pub total: Option<Difference>,
    /// The map's differences; none for a ray database, or where the two have no map of the same cells.
    pub map: Option<MapComparison>,
    /// Why there is no comparison where there could be one.
    pub problem: Option<String>,
    /// True if chance explains all differences.
    pub agree: bool,
}

/// A difference and its standard error, in the unit of what is compared.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Difference {
    /// A - B.
    pub difference: f64,
    /// Standard error of the difference.
    pub sigma: f64,
    /// Their quotient; 0 where both are 0, null where chance cannot explain a difference at all.
    pub score: Option<f64>,
}

/// Differences of cells that got enough rays to have an error.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct MapComparison {
    /// Cells that are compared.
    pub num_cells: u64,
    /// Root mean square of (A - B) / sigma: 1 for results that differ by chance alone.
    pub rms_score: f64,
    /// The score furthest from zero; null where no cell is compared.
    pub largest_score: Option<f64>,
    /// Its cell, in the order of the array's indices.
    pub largest_at: Vec<usize>,
    /// The largest score that chance is held to explain among so many cells.
    pub limit: f64,
}

/// Fewer rays of both sides together have no normal distribution yet, and so no error to speak of.
const LEAST_HITS: u64 = 25;

/// Compares results; a single number may be up to `limit` standard errors apart, the largest of many accordingly more.
pub fn compare(a: &TraceResult, b: &TraceResult, limit: f64) -> ResultComparison {
    let only_in_b = b.detectors.iter().filter(|theirs| a.detector(&theirs.name).is_none());
    let of_a = a.detectors.iter().map(|ours| pair(Some(ours), b.detector(&ours.name), limit));
    let detectors: Vec<DetectorComparison> =
        of_a.chain(only_in_b.map(|theirs| pair(None, Some(theirs), limit))).collect();
    let lacks_errors = |result: &TraceResult| {
        result.detectors.iter().any(|detector| detector.total_flux_standard_error.is_none())
    };
    ResultComparison {
        limit,
        errors_from_hits: lacks_errors(a) || lacks_errors(b),
        same_draws: (a.run.seed, &a.run.sampler, a.run.first_ray)
            == (b.run.seed, &b.run.sampler, b.run.first_ray),
        agree: detectors.iter().all(|detector| detector.agree),
        detectors,
    }
}

fn pair(a: Option<&Detector>, b: Option<&Detector>, limit: f64) -> DetectorComparison {
    let either = a.or(b);
    let mut found = DetectorComparison {
        name: either.map_or(String::new(), |detector| detector.name.clone()),
        kind: either.map_or("", |detector| detector.data.kind()),
        total_flux: [a, b].map(|detector| detector.map(|detector| detector.total_flux)),
        total: None,
        map: None,
        problem: None,
        agree: false,
    };
    let (Some(a), Some(b)) = (a, b) else {
        found.problem = Some(format!("only {} has it", if a.is_some() { "A" } else { "B" }));
        return found;
    };
    let total = Difference::new(a.total_flux - b.total_flux, error_of_total(a).hypot(error_of_total(b)));
    found.total = Some(total);
    match maps(a, b, limit) {
        Ok(map) => found.map = map,
        Err(problem) => found.problem = Some(problem),
    }
    let within = |score: Option<f64>, limit: f64| score.is_some_and(|score| score.abs() <= limit);
    found.agree = found.problem.is_none()
        && within(total.score, limit)
        && found.map.as_ref().is_none_or(|map| map.num_cells == 0 || within(map.largest_score, map.limit));
    found
}

impl Difference {
    fn new(difference: f64, sigma: f64) -> Self {
        let score = match (difference == 0.0, sigma > 0.0) {
            (true, _) => Some(0.0),
            (false, true) => Some(difference / sigma),
            (false, false) => None,
        };
        Difference { difference, sigma, score }
    }
}

/// Of the result; where it has none, that of rays of equal weight.
fn error_of_total(detector: &Detector) -> f64 {
    let from_hits = || detector.total_flux / (detector.num_rays_hit.max(1) as f64).sqrt();
    detector.total_flux_standard_error.filter(|error| error.is_finite()).unwrap_or_else(from_hits)
}

/// Values, their errors and hits, cell by cell.
struct Cells<'a> {
    values: ArrayViewD<'a, f64>,
    errors: Option<ArrayViewD<'a, f64>>,
    hits: ArrayViewD<'a, u64>,
}

impl<'a> Cells<'a> {
    fn of(detector: &'a Detector) -> Option<Self> {
        Some(match &detector.data {
            DetectorData::Irradiance(map) => Cells {
                values: map.irradiance.view().into_dyn(),
                errors: map.standard_error.as_ref().map(|errors| errors.view().into_dyn()),
                hits: map.hits.view().into_dyn(),
            },
            DetectorData::Spectral(map) => Cells {
                values: map.irradiance.view().into_dyn(),
                errors: map.standard_error.as_ref().map(|errors| errors.view().into_dyn()),
                hits: map.hits.view().into_dyn(),
            },
            DetectorData::FarField(pattern) => Cells {
                values: pattern.intensity.view().into_dyn(),
                errors: pattern.standard_error.as_ref().map(|errors| errors.view().into_dyn()),
                hits: pattern.hits.view().into_dyn(),
            },
            DetectorData::RayDatabase(_) => return None,
        })
    }

    /// Value, error and hits of every cell, in the order of the indices.
    fn iter(&self) -> impl Iterator<Item = (f64, f64, u64)> + '_ {
        let mut errors = self.errors.iter().flat_map(|errors| errors.iter());
        self.values.iter().zip(&self.hits).map(move |(&value, &hits)| {
            let error = errors.next().copied().unwrap_or_else(|| value / (hits.max(1) as f64).sqrt());
            (value, error, hits)
        })
    }
}

fn maps(a: &Detector, b: &Detector, limit: f64) -> Result<Option<MapComparison>, String> {
    if a.data.kind() != b.data.kind() {
        return Err(format!("it is {} in A, {} in B", a.data.kind(), b.data.kind()));
    }
    let (Some(a), Some(b)) = (Cells::of(a), Cells::of(b)) else {
        return Ok(None);
    };
    if a.values.shape() != b.values.shape() {
        return Err(format!("its cells are {:?} in A, {:?} in B", a.values.shape(), b.values.shape()));
    }
    let (mut num_cells, mut squares, mut largest) = (0, 0.0, None::<(f64, usize)>);
    for (index, ((value_a, error_a, hits_a), (value_b, error_b, hits_b))) in
        a.iter().zip(b.iter()).enumerate()
    {
        if hits_a + hits_b < LEAST_HITS {
            continue;
        }
        let score = Difference::new(value_a - value_b, error_a.hypot(error_b)).score;
        let score = score.unwrap_or(f64::INFINITY);
        num_cells += 1;
        squares += score * score;
        if largest.is_none_or(|(found, _): (f64, usize)| score.abs() > found.abs()) {
            largest = Some((score, index));
        }
    }
    Ok(Some(MapComparison {
        num_cells,
        rms_score: (squares / num_cells.max(1) as f64).sqrt(),
        largest_score: largest.map(|(score, _)| score).filter(|score| score.is_finite()),
        largest_at: largest.map_or(Vec::new(), |(_, index)| indices(index, a.values.shape())),
        limit: limit_of_largest(limit, num_cells),
    }))
}

fn indices(index: usize, shape: &[usize]) -> Vec<usize> {
    let mut rest = index;
    let mut indices: Vec<usize> = shape
        .iter()
        .rev()
        .map(|&length| {
            let at = rest % length;
            rest /= length;
            at
        })
        .collect();
    indices.reverse();
    indices
}

/// What the largest of `num` normal variables exceeds as seldom as one of them exceeds `limit`.
fn limit_of_largest(limit: f64, num: u64) -> f64 {
    let wanted = log_tail(limit) - (num.max(1) as f64).ln();
    let (mut low, mut high) = (limit, limit + 40.0);
    for _ in 0..60 {
        let middle = 0.5 * (low + high);
        if log_tail(middle) > wanted { low = middle } else { high = middle }
    }
    0.5 * (low + high)
}

/// ln of the probability that a normal variable is beyond `z` of either sign, to 6 % of the probability: the bound of
/// Abramowitz and Stegun, 7.1.13.
fn log_tail(z: f64) -> f64 {
    let x = z / 2f64.sqrt();
    (2.0 / std::f64::consts::PI.sqrt()).ln() - x * x - (x + (x * x + 4.0 / std::f64::consts::PI).sqrt()).ln()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_limit_grows_with_the_number_of_cells() {
        assert!((limit_of_largest(5.0, 1) - 5.0).abs() < 1e-9);
        // p(5) = 5.733e-7; p(7.2067) is a millionth of that.
        assert!((limit_of_largest(5.0, 1_000_000) - 7.2067).abs() < 0.003);
        for (z, p) in [(1.0, 0.31731), (2.0, 0.0455003), (5.0, 5.733e-7), (7.0, 2.5596e-12)] {
            assert!((log_tail(z).exp() / p - 1.0).abs() < 0.06, "{z}");
        }
    }

    #[test]
    fn chance_explains_no_difference_without_an_error() {
        assert_eq!(Difference::new(0.0, 0.0).score, Some(0.0));
        assert_eq!(Difference::new(1.0, 0.5).score, Some(2.0));
        assert_eq!(Difference::new(1.0, 0.0).score, None);
    }

    #[test]
    fn a_cell_is_named_by_its_indices() {
        assert_eq!(indices(0, &[3, 4, 5]), [0, 0, 0]);
        assert_eq!(indices(59, &[3, 4, 5]), [2, 3, 4]);
        assert_eq!(indices(27, &[3, 4, 5]), [1, 1, 2]);
    }
}
