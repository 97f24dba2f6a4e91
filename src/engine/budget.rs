//! How a budget of rays is shared among sources, and which of these rays belong to a trace.

use crate::engine::options::TraceOptions;
use crate::error::{Error, Result};
use crate::format::shown;
use crate::model::SceneIr;
use crate::result::QUANTA_PER_WEIGHT;

/// Rays of one source, numbered from `first`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct SourceRays {
    pub(crate) first: u64,
    pub(crate) count: u64,
    pub(crate) weight: f64,
}

impl SourceRays {
    /// The number of these rays that are done at `position` of `length`.
    pub(crate) fn done(&self, position: u64, length: u64) -> u64 {
        share(self.count, position, length)
    }
}

/// A position's share of `count` things: floor(count * position / length).
fn share(count: u64, position: u64, length: u64) -> u64 {
    (u128::from(count) * u128::from(position) / u128::from(length.max(1))) as u64
}

/// The rays of a budget that are traced here.
pub(crate) fn part(budget_rays: Vec<SourceRays>, options: &TraceOptions) -> Result<Vec<SourceRays>> {
    let Some(of_rays) = options.of_rays else {
        let shift = |rays: SourceRays| SourceRays { first: rays.first + options.first_ray, ..rays };
        return Ok(budget_rays.into_iter().map(shift).collect());
    };
    let end = options.first_ray + options.num_rays;
    let rays = budget_rays.into_iter().map(|rays| {
        let before = rays.done(options.first_ray, of_rays);
        SourceRays { first: rays.first + before, count: rays.done(end, of_rays) - before, ..rays }
    });
    let rays: Vec<SourceRays> = rays.collect();
    if rays.iter().all(|rays| rays.count == 0) {
        return Err(Error::Usage(format!(
            "no source has a ray in so small a part: {} of {of_rays} rays",
            options.num_rays
        )));
    }
    Ok(rays)
}

/// The rays of each source, and the weight by which they share its flux. Optiland's rule: each source gets one ray, and
/// the rest is shared by flux. The largest remainders round up first; of equal remainders the larger flux, then the
/// first source.
///
/// Where `shares` are given \[W\], the rays are shared by these instead of the sources' own fluxes. So two scenes of
/// the same shares launch the same rays.
pub(crate) fn distribute(ir: &SceneIr, num_rays: u64, shares: Option<&[f64]>) -> Result<Vec<SourceRays>> {
    let fluxes: Vec<f64> = ir.sources.iter().map(|e| e.total_flux).collect();
    let total: f64 = fluxes.iter().sum();
    let shares = shares.unwrap_or(&fluxes);
    if shares.len() != fluxes.len() {
        let (given, sources) = (shares.len(), fluxes.len());
        return Err(Error::Usage(format!(
            "{given} shares of the rays were given for {sources} sources; give one each"
        )));
    }
    let counts = distribute_ray_budget(num_rays, shares);
    let mean = total / num_rays as f64;
    let mut first = 0;
    let mut rays = Vec::new();
    for ((&count, &flux), source) in counts.iter().zip(&fluxes).zip(&ir.sources) {
        let weight = if count == 0 || total == 0.0 { 0.0 } else { flux / count as f64 / mean };
        if weight > 0.0 && weight * QUANTA_PER_WEIGHT < SMALLEST_BIRTH_QUANTA {
            return Err(Error::Usage(format!(
                "source `{}` emits {flux:e} W, less than the other sources' sums can resolve (a quantum is {:e} W); \
                 trace it on its own",
                shown(&source.name),
                mean / QUANTA_PER_WEIGHT
            )));
        }
        rays.push(SourceRays { first, count, weight });
        first += count;
    }
    Ok(rays)
}

/// The least weight of a new ray \[quanta\]: rounding to whole quanta then does not matter.
const SMALLEST_BIRTH_QUANTA: f64 = (1u64 << 30) as f64;

fn distribute_ray_budget(num_rays: u64, fluxes: &[f64]) -> Vec<u64> {
    let num_sources = fluxes.len() as u64;
    if num_sources == 1 {
        return vec![num_rays];
    }
    let total: f64 = fluxes.iter().sum();
    if total <= 0.0 {
        let extra = num_rays % num_sources.max(1);
        return (0..num_sources).map(|i| num_rays / num_sources + u64::from(i < extra)).collect();
    }
    let mut counts: Vec<u64> = (0..num_sources).map(|i| u64::from(i < num_rays)).collect();
    let remaining = num_rays.saturating_sub(num_sources);
    if remaining == 0 {
        return counts;
    }
    let shares: Vec<f64> = fluxes.iter().map(|flux| remaining as f64 * (flux / total)).collect();
    counts.iter_mut().zip(&shares).for_each(|(count, share)| *count += *share as u64);
    let leftover = num_rays.saturating_sub(counts.iter().sum());
    let mut order: Vec<usize> = (0..fluxes.len()).collect();
    let key = |i: usize| (shares[i] - shares[i].floor(), fluxes[i]);
    order.sort_by(|&a, &b| key(b).partial_cmp(&key(a)).unwrap_or(std::cmp::Ordering::Equal));
    order.into_iter().take(leftover as usize).for_each(|i| counts[i] += 1);
    counts
}
