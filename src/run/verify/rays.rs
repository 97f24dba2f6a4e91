//! Whether other rays of the scene agree with a result, by standard errors.
//!
//! The rays have a seed that follows from the hash of the result, so that nobody who writes a result can choose them.
//! The errors of the ledger's lines come from the scatter of [`NUM_RANGES`] blocks of these rays. The errors of
//! detectors come from the moments that traces sum up.
//!
//! A right result fails less than once in a million. All its numbers together are as rarely beyond their limits as a
//! single one is beyond 5 standard errors. The lines of a ledger have limits by Student's t.

use crate::error::Result;
use crate::format::significant;
use crate::gpu::{AdapterChoice, Gpu};
use crate::model::{Precision, SceneIr};
use crate::result::comparison::{self, Flux, ResultComparison, compare, limit_of_largest};
use crate::result::difference::Spread;
use crate::result::output::REPORT;
use crate::result::{FluxUnit, Ledger, LedgerEntry, RunInfo, TraceResult};
use crate::run::blocks::Blocks;
use crate::run::precision::WantedPrecision;
use crate::run::proof::NUM_RANGES;
use crate::run::verify::finding::Finding;
use crate::run::verify::like::{options_like, word_of};
use crate::run::{Run, StandardError, TraceOptions, Tracer};
use crate::scene::Scene;
use serde::Serialize;
use serde_json::Value;

/// Standard errors that chance is held to explain, for a single number.
const LIMIT: f64 = 5.0;
/// The least number of rays, so that small results are compared by more than a few hits.
const LEAST_RAYS: u64 = 1 << 16;

/// How other rays agree with a result.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct OtherRays {
    /// How many.
    pub num_rays: u64,
    /// Their seed.
    pub seed: u64,
    /// Their precision.
    pub precision: String,
    /// What traced them.
    pub adapter: String,
    /// Lines of the ledger.
    pub ledger: Vec<Quantity>,
    /// Most standard errors that chance is held to explain, for a line of the ledger.
    pub limit: f64,
    /// Detectors: their flux, and their maps cell by cell. A is the result, and B are the other rays.
    pub detectors: ResultComparison,
}

/// A number of a result, beside the same number by other rays.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Quantity {
    /// What it is.
    pub name: String,
    /// In the result \[W\].
    pub result: f64,
    /// By other rays \[W\].
    pub other: f64,
    /// Standard error of the difference \[W\]; null where so few events are expected that there is none.
    pub sigma: Option<f64>,
    /// The difference in standard errors; null where that is not known, or infinite.
    pub score: Option<f64>,
    /// True if chance explains the difference.
    pub agrees: bool,
}

/// Why a result cannot be compared with other rays, if it cannot.
pub(super) fn why_not(stored: &TraceResult, report: &Value) -> Option<String> {
    let is_of = |what: &str| {
        Some(format!("the result is one of {what}, whose files were compared with their hashes alone"))
    };
    if !stored.gradients.is_empty() || report.get("gradients_file").is_some() {
        return is_of("`trace --gradient`");
    }
    if stored.detectors.iter().any(|detector| detector.title.is_some()) {
        return is_of("`paths`");
    }
    (stored.num_rays_total == 0).then(|| "the result has no ray".into())
}

/// Traces other rays, and compares.
pub(super) fn trace(
    stored: &TraceResult,
    scene: &Scene,
    ir: &SceneIr,
    sha256: &str,
    sample: u32,
    adapter: &AdapterChoice,
) -> Result<OtherRays> {
    let gpu = Gpu::open(adapter)?;
    let run = run_of(stored, scene, ir, sha256, sample, &gpu)?;
    let settled = run.settle(&gpu)?;
    let mut tracer = Tracer::new(&gpu, ir, &settled.options)?;
    let mut blocks = Blocks::new(&tracer, NUM_RANGES);
    let mut spread = Spread::default();
    let unit = FluxUnit::of_scene(ir, tracer.num_rays());
    for _ in 0..NUM_RANGES {
        let end = blocks.next_end(&tracer);
        let traced = blocks.trace_to(&mut tracer, end, |_| true)?;
        let block = blocks.add(traced.tally);
        let lines = all_lines(&Ledger::new(ir, &block, unit));
        let fluxes: Vec<f64> = lines.iter().map(|(_, entry)| entry.flux).collect();
        spread.add(block.launched.count, &fluxes);
        blocks.end_block();
    }
    let info = RunInfo { num_rays: tracer.num_rays(), ..settled.info };
    let other = TraceResult::new(ir, &info, &blocks.sums)?;
    let num_lines = all_lines(&other.ledger).len() + 2 * other.detectors.len();
    let limit = limit_of_largest(LIMIT, num_lines as u64);
    let (ledger, limit_of_ledger) = lines(stored, &other, &spread, limit);
    Ok(OtherRays {
        num_rays: other.num_rays_total,
        seed: settled.options.seed,
        precision: info.precision,
        adapter: format!("{}, {}", info.adapter, info.driver),
        ledger,
        limit: limit_of_ledger,
        detectors: compare(stored, &other, limit),
    })
}

/// A trace like the result's, of other rays.
fn run_of<'a>(
    stored: &TraceResult,
    scene: &'a Scene,
    ir: &'a SceneIr,
    sha256: &str,
    sample: u32,
    gpu: &'a Gpu,
) -> Result<Run<'a>> {
    let told = &stored.run;
    let share = stored.num_rays_total / NUM_RANGES * u64::from(sample);
    let options = TraceOptions {
        num_rays: share.max(LEAST_RAYS),
        seed: seed_of(sha256, told.seed),
        standard_error: StandardError::On,
        ..options_like(told, ir)?
    };
    // Whatever the tier, it is right within the standard errors.
    let precision = match told.precision.as_str() {
        "f64" if gpu.f64 => WantedPrecision::Exactly(Precision::F64),
        "f32" => WantedPrecision::Exactly(Precision::F32),
        _ => WantedPrecision::Auto,
    };
    Ok(Run::of(scene, ir).options(options).max_depth(told.max_depth).precision(precision).on(gpu))
}

/// A seed that follows from the hash of the result, and differs from the seed of its trace.
fn seed_of(sha256: &str, traced: u64) -> u64 {
    let seed = word_of(&format!("other rays of {sha256}"), 4);
    seed + u64::from(seed == traced)
}

fn all_lines(ledger: &Ledger) -> Vec<(&'static str, LedgerEntry)> {
    [&ledger.sources()[1..], &ledger.destinations()[..]].concat()
}

/// The lines of the ledger, except what was launched, and their limit. The limit follows from `limit`, which is for
/// numbers with a known error.
fn lines(stored: &TraceResult, other: &TraceResult, spread: &Spread, limit: f64) -> (Vec<Quantity>, f64) {
    let errors = spread.errors().unwrap_or_default();
    let (ours, others) = (all_lines(&stored.ledger), all_lines(&other.ledger));
    let limit = limit_of_blocks(limit, spread.num_blocks());
    let ray = |result: &TraceResult| result.total_flux_in / result.num_rays_total.max(1) as f64;
    let line = |index: usize| {
        let (name, ours) = ours[index];
        let (_, others) = others[index];
        let error = errors.get(index).copied().unwrap_or(f64::NAN);
        let few = other.num_rays_total as f64 / stored.num_rays_total.max(1) as f64;
        let flux = |entry: LedgerEntry, error: f64, ray: f64| Flux {
            flux: entry.flux,
            error,
            count: entry.count,
            ray,
        };
        let sides = [flux(ours, error * few.sqrt(), ray(stored)), flux(others, error, ray(other))];
        let difference = comparison::difference(sides);
        let score = difference.and_then(|difference| difference.score);
        Quantity {
            name: name.into(),
            result: ours.flux,
            other: others.flux,
            sigma: difference.map(|difference| difference.sigma),
            score,
            agrees: difference.is_none() || score.is_some_and(|score| score.abs() <= limit),
        }
    };
    ((0..ours.len()).map(line).collect(), limit)
}

/// What a score by an error from so many blocks exceeds as seldom as a normal variable exceeds `limit`: Student's t
/// (Abramowitz and Stegun, 26.7.5).
fn limit_of_blocks(limit: f64, num_blocks: u32) -> f64 {
    let freedom = f64::from(num_blocks.saturating_sub(1).max(1));
    let z = limit;
    let terms = [
        (z.powi(3) + z) / 4.0,
        (5.0 * z.powi(5) + 16.0 * z.powi(3) + 3.0 * z) / 96.0,
        (3.0 * z.powi(7) + 19.0 * z.powi(5) + 17.0 * z.powi(3) - 15.0 * z) / 384.0,
    ];
    terms.iter().rev().fold(0.0, |sum, term| (sum + term) / freedom) + z
}

impl OtherRays {
    /// What chance does not explain.
    pub(super) fn findings(&self) -> Vec<Finding> {
        let line = |quantity: &Quantity| {
            let Quantity { result, other, score, .. } = quantity;
            let problem = apart(*result, *other, *score, self.limit);
            Finding::at(REPORT, &format!("ledger: {}", quantity.name), &problem)
        };
        let lines = self.ledger.iter().filter(|quantity| !quantity.agrees).map(line);
        let detector = |detector: &comparison::DetectorComparison| {
            let [result, other] = detector.total_flux.map(Option::unwrap_or_default);
            let of_total = detector
                .total
                .filter(|total| total.score.is_none_or(|score| score.abs() > self.detectors.limit));
            let map = detector.map.as_ref();
            let problem = match (&detector.problem, of_total, map) {
                (Some(problem), ..) => problem.clone(),
                (None, Some(total), _) => apart(result, other, total.score, self.detectors.limit),
                (None, None, Some(map)) => format!(
                    "its map is {} standard errors from the map of other rays at {:?}; chance explains {:.1}",
                    map.largest_score.map_or("infinitely many".into(), |score| format!("{score:.1}")),
                    map.largest_at,
                    map.limit
                ),
                (None, None, None) => "is not what other rays give".into(),
            };
            Finding::at(REPORT, &format!("detectors.{}", detector.name), &problem)
        };
        lines.chain(self.detectors.detectors.iter().filter(|found| !found.agree).map(detector)).collect()
    }
}

fn apart(result: f64, other: f64, score: Option<f64>, limit: f64) -> String {
    format!(
        "is {} W; other rays give {} W, {} standard errors apart; chance explains {limit:.1}",
        significant(result, 6),
        significant(other, 6),
        score.map_or("infinitely many".into(), |score| format!("{score:.1}")),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn limits_by_few_blocks_are_those_of_students_t() {
        // Two-sided quantiles of t with 63 degrees of freedom, by SciPy: t.isf(norm.sf(z), 63).
        for (z, t) in [(1.0, 1.008_0), (3.0, 3.123_5), (5.0, 5.565_4), (5.6, 6.405_7)] {
            assert!((limit_of_blocks(z, 64) - t).abs() < 0.01, "{z}: {}", limit_of_blocks(z, 64));
        }
    }

    #[test]
    fn a_seed_follows_from_the_result_and_is_another_one() {
        let seed = seed_of("abc", 0);
        assert_eq!(seed, seed_of("abc", 1));
        assert_ne!(seed, seed_of("abd", 0));
        assert_ne!(seed_of("abc", seed), seed);
    }
}
