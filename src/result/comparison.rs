//! Two results of one scene, detector by detector: whether chance alone explains how far they are apart.

use crate::result::detectors::CellMap;
use crate::result::{Detector, TraceResult};
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

/// How far a detector of A is from the detector of the same name of B.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct DetectorComparison {
    /// The name.
    pub name: String,
    /// The kind in A, or in B where A has none.
    pub kind: &'static str,
    /// A's flux and B's \[W\], of all rows of a ray database; `None` for the side that has no such detector.
    pub total_flux: [Option<f64>; 2],
    /// The flux's difference; `None` if one side is missing.
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

/// Differences of cells where so many rays are expected of either side that it has an error.
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

/// The sum of fewer rays is not normally distributed, and their spread is no estimate of the error.
const LEAST_HITS: u64 = 12;

/// Compares results; a single number may be up to `limit` standard errors apart, the largest of many accordingly more.
pub fn compare(a: &TraceResult, b: &TraceResult, limit: f64) -> ResultComparison {
    let only_in_b = b.detectors.iter().filter(|theirs| a.detector(&theirs.name).is_none());
    let (in_a, in_b) = (
        |detector| Side { detector, ray: flux_of_a_ray(a) },
        |detector| Side { detector, ray: flux_of_a_ray(b) },
    );
    let of_a = a.detectors.iter().map(|ours| pair(Some(in_a(ours)), b.detector(&ours.name).map(in_b), limit));
    let detectors: Vec<DetectorComparison> =
        of_a.chain(only_in_b.map(|theirs| pair(None, Some(in_b(theirs)), limit))).collect();
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

/// A flux of a trace, of a line of its ledger say.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Flux {
    /// \[W\]
    pub flux: f64,
    /// Its standard error \[W\].
    pub error: f64,
    /// Rays or events.
    pub count: u64,
    /// Mean flux of a launched ray \[W\].
    pub ray: f64,
}

/// The difference of two fluxes that chance alone would set apart; `None` where so few events are expected that it has no error.
pub(crate) fn difference(sides: [Flux; 2]) -> Option<Difference> {
    let sides = sides.map(|Flux { flux, error, count, ray }| Estimate {
        flux,
        own_error: error,
        hits: count,
        ray,
        spread: 1.0,
    });
    if sides.iter().all(|side| side.flux == 0.0) {
        return Some(Difference::new(0.0, 0.0));
    }
    let mean = mean(&sides);
    sides.iter().all(|side| side.is_normal(mean)).then(|| Difference::between(&sides))
}

/// A detector, and the mean flux of a launched ray \[W\].
#[derive(Clone, Copy)]
struct Side<'a> {
    detector: &'a Detector,
    ray: f64,
}

fn flux_of_a_ray(result: &TraceResult) -> f64 {
    result.total_flux_in / result.num_rays_total.max(1) as f64
}

fn pair(a: Option<Side>, b: Option<Side>, limit: f64) -> DetectorComparison {
    let either = a.or(b);
    let mut found = DetectorComparison {
        name: either.map_or(String::new(), |side| side.detector.name.clone()),
        kind: either.map_or("", |side| side.detector.data.kind()),
        total_flux: [a, b].map(|side| side.map(|side| total_flux(side.detector))),
        total: None,
        map: None,
        problem: None,
        agree: false,
    };
    let (Some(a), Some(b)) = (a, b) else {
        found.problem = Some(format!("only {} has it", if a.is_some() { "A" } else { "B" }));
        return found;
    };
    let total = Difference::between(&[a, b].map(Estimate::of_total));
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

    /// Of two estimates that chance alone would set apart.
    fn between(sides: &[Estimate; 2]) -> Self {
        let [a, b] = sides;
        let mean = mean(sides);
        let [error_a, error_b] = sides.map(|side| side.error(mean));
        Self::new(a.flux - b.flux, error_a.hypot(error_b))
    }
}

/// The flux of a detector or of one of its cells, by one of the two traces.
#[derive(Debug, Clone, Copy)]
struct Estimate {
    /// \[W\]
    flux: f64,
    /// Its standard error by the trace itself \[W\].
    own_error: f64,
    hits: u64,
    /// Mean flux of a launched ray \[W\].
    ray: f64,
    /// Expected variance over the variance of hits of equal weight, where there are few hits. It is below 1 where a hit
    /// leaves only a part in a cell, or where points are spread evenly.
    spread: f64,
}

impl Estimate {
    fn of_total(Side { detector, ray }: Side) -> Self {
        let (flux, hits) = (total_flux(detector), detector.num_rays_hit);
        let error = detector.total_flux_standard_error.filter(|error| error.is_finite());
        Estimate {
            flux,
            own_error: error.unwrap_or_else(|| error_from_hits(flux, hits)),
            hits,
            ray,
            spread: 1.0,
        }
    }

    fn has_many_hits(&self) -> bool {
        self.hits >= LEAST_HITS
    }

    /// Mean flux of a hit \[W\]; of few hits, no less than the flux of a launched ray.
    fn flux_of_a_hit(&self) -> f64 {
        let mean = self.flux / self.hits.max(1) as f64;
        let flux = if self.has_many_hits() { mean } else { mean.max(self.ray) };
        flux.max(f64::MIN_POSITIVE)
    }

    /// Standard error, if the flux is to be expected to be `mean`. Who has too few hits by chance has too small an error of
    /// its own, and few hits are no measure of theirs.
    fn error(&self, mean: f64) -> f64 {
        if self.has_many_hits() {
            return self.own_error * (mean / self.flux).max(1.0).sqrt();
        }
        self.own_error.max((self.spread * mean * self.flux_of_a_hit()).sqrt())
    }

    /// True if so many hits are to be expected that their number is all but normally distributed.
    fn is_normal(&self, mean: f64) -> bool {
        mean / self.flux_of_a_hit() >= LEAST_HITS as f64
    }
}

/// What both sides estimate, if chance alone sets them apart: weighed by their hits.
fn mean(sides: &[Estimate; 2]) -> f64 {
    let hits = |side: &Estimate| side.flux / side.flux_of_a_hit();
    let hits_per_watt = |side: &Estimate| side.flux_of_a_hit().recip();
    sides.iter().map(hits).sum::<f64>() / sides.iter().map(hits_per_watt).sum::<f64>()
}

/// The flux of a detector; of a ray database, the flux of all rows, because which rows are kept depends on the number of rays.
fn total_flux(detector: &Detector) -> f64 {
    detector.data.result().recorded_flux().unwrap_or(detector.total_flux)
}

/// The standard error of rays of equal weight.
fn error_from_hits(flux: f64, hits: u64) -> f64 {
    flux / (hits.max(1) as f64).sqrt()
}

/// A detector's map.
struct Cells<'a> {
    map: CellMap<'a>,
    /// Mean flux of a launched ray \[W\].
    ray: f64,
}

impl<'a> Cells<'a> {
    fn of(Side { detector, ray }: Side<'a>) -> Option<Self> {
        detector.data.result().map().map(|map| Cells { map, ray })
    }

    /// Every cell, in the order of the indices.
    fn iter(&self) -> impl Iterator<Item = Estimate> + '_ {
        let CellMap { values, errors, hits, sizes, .. } = &self.map;
        let mut errors = errors.iter().flat_map(|errors| errors.iter());
        let cells_per_row = values.len() / sizes.len().max(1);
        values.iter().zip(hits).enumerate().map(move |(index, (&value, &hits))| {
            let size = sizes[index / cells_per_row];
            let flux = value * size;
            let own_error = errors.next().map_or_else(|| error_from_hits(flux, hits), |error| error * size);
            Estimate { flux, own_error, hits, ray: self.ray, spread: 1.0 }
        })
    }

    /// Variance of all cells with many hits over the variance of hits of equal weight; 1 if there are no such cells.
    fn spread(&self) -> f64 {
        let sums = self.iter().filter(Estimate::has_many_hits).fold((0.0, 0.0), |(own, equal), cell| {
            (own + cell.own_error.powi(2), equal + cell.flux * cell.flux_of_a_hit())
        });
        if sums.1 > 0.0 { sums.0 / sums.1 } else { 1.0 }
    }
}

fn maps(a: Side, b: Side, limit: f64) -> Result<Option<MapComparison>, String> {
    let [kind_a, kind_b] = [a, b].map(|side| side.detector.data.kind());
    if kind_a != kind_b {
        return Err(format!("it is {kind_a} in A, {kind_b} in B"));
    }
    let (Some(a), Some(b)) = (Cells::of(a), Cells::of(b)) else {
        return Ok(None);
    };
    let [shape_a, shape_b] = [&a, &b].map(|cells| cells.map.values.shape());
    if shape_a != shape_b {
        return Err(format!("its cells are {shape_a:?} in A, {shape_b:?} in B"));
    }
    let (mut num_cells, mut squares, mut largest) = (0, 0.0, None::<(f64, usize)>);
    let spreads = [a.spread(), b.spread()];
    for (index, (in_a, in_b)) in a.iter().zip(b.iter()).enumerate() {
        let cell = [Estimate { spread: spreads[0], ..in_a }, Estimate { spread: spreads[1], ..in_b }];
        let mean = mean(&cell);
        if !cell.iter().all(|side| side.is_normal(mean)) {
            continue;
        }
        let score = Difference::between(&cell).score;
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
        largest_at: largest.map_or(Vec::new(), |(_, index)| indices(index, shape_a)),
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
pub(crate) fn limit_of_largest(limit: f64, num: u64) -> f64 {
    let wanted = log_tail(limit) - (num.max(1) as f64).ln();
    let (mut low, mut high) = (limit, limit + 40.0);
    for _ in 0..60 {
        let middle = 0.5 * (low + high);
        if log_tail(middle) > wanted { low = middle } else { high = middle }
    }
    0.5 * (low + high)
}

/// ln of the probability that a normal variable is beyond `z` of either sign, to 6 % of the probability (Abramowitz
/// and Stegun, 7.1.13).
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

    fn estimate(hits: u64, flux_of_a_hit: f64, ray: f64) -> Estimate {
        let flux = hits as f64 * flux_of_a_hit;
        Estimate { flux, own_error: error_from_hits(flux, hits), hits, ray, spread: 1.0 }
    }

    fn score_and_is_compared(sides: [Estimate; 2]) -> (f64, bool) {
        let mean = mean(&sides);
        (Difference::between(&sides).score.unwrap(), sides.iter().all(|side| side.is_normal(mean)))
    }

    #[test]
    fn a_side_without_hits_has_the_error_of_those_that_are_expected() {
        // A ray in 33, so that 2 hits are expected. To see none is likely, and too little to compare by.
        let (score, is_compared) = score_and_is_compared([estimate(0, 0.0, 33.0), estimate(66, 1.0, 1.0)]);
        assert!(!is_compared && score.abs() < 2.0, "{score}");
        // As many rays: none is one.
        let (score, is_compared) = score_and_is_compared([estimate(0, 0.0, 1.0), estimate(100, 1.0, 1.0)]);
        assert!(is_compared && score < -7.0, "{score}");
        // Light rays of a split trace, and none of the heavy ones of another.
        let (_, is_compared) = score_and_is_compared([estimate(0, 0.0, 1.0), estimate(1000, 0.002, 1.0)]);
        assert!(!is_compared);
        // Light rays on both sides.
        let (score, is_compared) =
            score_and_is_compared([estimate(900, 0.002, 1.0), estimate(1000, 0.002, 1.0)]);
        // Of 950 or so each.
        assert!(is_compared && (score + 100.0 / 1947_f64.sqrt()).abs() < 0.01, "{score}");
        // Too few by chance have no smaller error for that.
        let (score, _) = score_and_is_compared([estimate(16, 1.0, 1.0), estimate(36_000, 0.001, 0.001)]);
        assert!((score + 20.0 / 6.0).abs() < 0.1, "{score}");
    }

    #[test]
    fn a_cell_is_named_by_its_indices() {
        assert_eq!(indices(0, &[3, 4, 5]), [0, 0, 0]);
        assert_eq!(indices(59, &[3, 4, 5]), [2, 3, 4]);
        assert_eq!(indices(27, &[3, 4, 5]), [1, 1, 2]);
    }
}
