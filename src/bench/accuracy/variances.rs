//! Variances between independent traces, and the ratio of two of them with confidence.
//!
//! The variance of a detector's flux by random numbers needs no repetition. The rays of each trace determine the
//! variance, because their contributions are independent. All other variances are estimated within groups of traces
//! with different seeds. Either way, a group gives an estimate without bias. The spread of the groups gives the error
//! of their mean.

use crate::bench::accuracy::estimate::{Deviations, Estimate};
use crate::error::{Error, Result};
use crate::model::SceneIr;
use crate::run::Tracer;

/// Traces in a group. Each has a seed of its own, so that scrambles are independent.
pub const GROUP: u64 = 8;

/// The quantity whose error is compared.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Quantity {
    /// The map, as RMS over the cells.
    Map,
    /// The detector's flux.
    Flux,
}

/// A ratio with its confidence interval.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ratio {
    /// At least this, with a confidence of 99 %.
    pub low: f64,
    /// The estimate.
    pub value: f64,
    /// At most this, with a confidence of 99 %.
    pub high: f64,
}

/// How the variance of a flux is estimated.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FluxVariance {
    /// From the traces of a group.
    BetweenTraces,
    /// From the rays of each trace, whose second moments are summed.
    BetweenRays,
}

/// Estimates of a variance without bias, by group.
#[derive(Debug, Clone, PartialEq)]
pub struct Variances {
    groups: Vec<Deviations>,
    /// Share of the launched flux that the detector takes.
    flux: f64,
}

/// A mean over groups.
#[derive(Debug, Clone, Copy)]
struct Mean {
    value: f64,
    /// Square of the mean's relative standard error.
    spread: f64,
    /// The number of groups less one: degrees of freedom.
    freedom: f64,
}

/// The least relative error. A smaller one is that of the sums, whose squares are rounded to 2^-52 a ray.
const LEAST_ERROR: f64 = 1e-9;

impl Variances {
    /// Measures the variances of a tracer's scene, with independent seeds.
    ///
    /// # Errors
    /// The errors of the trace; [`Error::Internal`] if the rays' second moments are needed and were not summed.
    pub fn measure(
        tracer: &mut Tracer,
        (ir, detector): (&SceneIr, usize),
        num_groups: u64,
        first_seed: u64,
        flux: FluxVariance,
    ) -> Result<Self> {
        let mut sample = |seed| {
            tracer.set_seed(seed);
            let tally = tracer.trace(|_| true)?;
            let flux_variance = match flux {
                FluxVariance::BetweenTraces => None,
                FluxVariance::BetweenRays => {
                    let missing = || Error::Internal("second moments were not summed".into());
                    Some(Estimate::flux_variance(ir, &tally, detector).ok_or_else(missing)?)
                }
            };
            Ok((Estimate::of(&tally, detector), flux_variance))
        };
        let (mut groups, mut fluxes) = (Vec::new(), Vec::new());
        for group in 0..num_groups {
            let seeds = first_seed + group * GROUP..first_seed + (group + 1) * GROUP;
            let samples: Vec<(Estimate, Option<f64>)> = seeds.map(&mut sample).collect::<Result<_>>()?;
            let (estimates, flux_variances): (Vec<_>, Vec<_>) = samples.into_iter().unzip();
            let mean = Estimate::mean(&estimates);
            groups.push(of_group(&estimates, &mean, flux_variances.into_iter().sum()));
            fluxes.push(mean.total);
        }
        Ok(Variances { groups, flux: fluxes.iter().sum::<f64>() / fluxes.len() as f64 })
    }

    fn mean(&self, quantity: Quantity) -> Mean {
        let of = |deviations: &Deviations| match quantity {
            Quantity::Map => deviations.cells,
            Quantity::Flux => deviations.total,
        };
        let values: Vec<f64> = self.groups.iter().map(of).collect();
        let count = values.len() as f64;
        let freedom = (count - 1.0).max(1.0);
        let value = values.iter().sum::<f64>() / count;
        let squares: f64 = values.iter().map(|one| (one - value).powi(2)).sum();
        Mean { value, spread: squares / freedom / count / (value * value), freedom }
    }

    /// The standard deviation that belongs to the variance, in units of the mean cell or of the flux.
    pub fn relative_error(&self, quantity: Quantity) -> f64 {
        self.mean(quantity).value.sqrt() / self.flux
    }

    /// The ratio of this variance to another; `None` if neither has an error.
    pub fn ratio_to(&self, other: &Variances, quantity: Quantity) -> Option<Ratio> {
        let is_exact = |variances: &Variances| variances.relative_error(quantity) < LEAST_ERROR;
        if is_exact(self) && is_exact(other) {
            return None;
        }
        let (ours, theirs) = (self.mean(quantity), other.mean(quantity));
        let (value, deviate) = (ours.value / theirs.value, deviate(ours, theirs));
        let low = value / f_quantile(deviate, ours.spread, theirs.spread);
        let high = value * f_quantile(deviate, theirs.spread, ours.spread);
        Some(Ratio { low, value, high })
    }
}

/// The quantile of the difference of two means, in standard errors: the difference lies above it with a probability of
/// 1 %. Each mean is of few values. The degrees of freedom are those of the sum of the spreads. Source: Welch, The
/// generalization of Student's problem when several different population variances are involved, Biometrika 34, 1947.
fn deviate(a: Mean, b: Mean) -> f64 {
    let spread = a.spread + b.spread;
    students_t(spread.powi(2) / (a.spread.powi(2) / a.freedom + b.spread.powi(2) / b.freedom))
}

/// Quantile, at a normal deviate, of the ratio of two estimated variances over their true ratio (Abramowitz and Stegun,
/// 26.6.15).
///
/// The quantile is that of the F distribution. The spreads of the estimates give the degrees of freedom n: chi-squared
/// over n has a relative variance of 2/n. Heavier tails have a larger spread, and so a smaller n.
fn f_quantile(deviate: f64, spread: f64, other_spread: f64) -> f64 {
    // 1/(n - 1), for n = 2/spread.
    let [ours, theirs] = [spread, other_spread].map(|spread| spread / (2.0 - spread.min(1.0)));
    let h = 2.0 / (ours + theirs);
    let lambda = (deviate * deviate - 3.0) / 6.0;
    let skew = (ours - theirs) * (lambda + 5.0 / 6.0 - 2.0 / (3.0 * h));
    (2.0 * (deviate * (h + lambda).sqrt() / h - skew)).exp()
}

/// Variances of a group around its mean. The variance of the flux comes from the rays, where it is known from them.
fn of_group(estimates: &[Estimate], mean: &Estimate, by_rays: Option<f64>) -> Deviations {
    let num = estimates.len() as f64;
    let squares = || estimates.iter().map(|estimate| estimate.squares(mean));
    let between = |of: fn(&Deviations) -> f64| squares().map(|one| of(&one)).sum::<f64>() / (num - 1.0);
    Deviations {
        cells: between(|squares| squares.cells),
        total: by_rays.map_or_else(|| between(|squares| squares.total), |sum| sum / num),
    }
}

/// The quantile of a mean of few values, in standard errors: the mean lies above it with a probability of 1 %. The
/// quantile is Student's t, by its expansion around the normal deviate (Abramowitz and Stegun, 26.7.5). From 4 degrees
/// of freedom on, the error is within 2 %.
fn students_t(freedom: f64) -> f64 {
    const Z: f64 = 2.326_347_874;
    let first = (Z.powi(3) + Z) / 4.0;
    let second = (5.0 * Z.powi(5) + 16.0 * Z.powi(3) + 3.0 * Z) / 96.0;
    let third = (3.0 * Z.powi(7) + 19.0 * Z.powi(5) + 17.0 * Z.powi(3) - 15.0 * Z) / 384.0;
    Z + first / freedom + second / freedom.powi(2) + third / freedom.powi(3)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::program::layout::rng::splitmix64;
    use approx::assert_relative_eq;

    fn variances(values: impl IntoIterator<Item = f64>) -> Variances {
        let group = |cells| Deviations { cells, total: 2.0 * cells };
        Variances { groups: values.into_iter().map(group).collect(), flux: 1.0 }
    }

    #[test]
    fn ratios_are_of_means_and_their_intervals_shrink_with_groups() {
        let few = variances([8.0, 12.0]);
        let many = variances([8.0, 12.0].repeat(50));
        let one = variances([1.0; 100]);
        let [few, many] = [few, many].map(|v| v.ratio_to(&one, Quantity::Map).unwrap());
        assert_eq!((few.value, many.value), (10.0, 10.0));
        assert!(few.low < many.low && many.low < 10.0 && many.high < few.high);
        // Standard deviation of a mean of 100: 2 %.
        assert_relative_eq!((many.high / many.low).ln(), 2.0 * 2.365 * 0.0201, max_relative = 1e-2);
    }

    #[test]
    fn what_makes_no_error_has_no_ratio() {
        let (exact, noisy) = (variances([0.0; 8]), variances([1e-4, 2e-4]));
        assert_eq!(exact.ratio_to(&exact, Quantity::Flux), None);
        assert_eq!(exact.ratio_to(&noisy, Quantity::Flux).unwrap().value, 0.0);
    }

    #[test]
    fn quantiles_are_those_of_students_t() {
        for (freedom, t) in [(4.0, 3.747), (7.0, 2.998), (15.0, 2.602), (63.0, 2.387)] {
            assert_relative_eq!(students_t(freedom), t, max_relative = 0.02);
        }
    }

    #[test]
    fn quantiles_are_those_of_f() {
        // Tables of F at 99 %; the formula itself is within 1.1 % of them.
        for (n, m, f) in
            [(10.0, 10.0, 4.849), (10.0, 60.0, 2.632), (60.0, 10.0, 4.082), (120.0, 120.0, 1.533)]
        {
            assert_relative_eq!(f_quantile(2.326_348, 2.0 / n, 2.0 / m), f, max_relative = 0.011);
        }
    }

    #[test]
    fn the_variance_of_a_group_has_no_bias() {
        let estimates = [1.0, 2.0, 3.0].map(|total| Estimate { cells: vec![total, 1.0], total });
        let mean = Estimate::mean(&estimates);
        // The values deviate by 1, 0 and 1 from their mean of 2, so that their variance is 1.
        assert_eq!(of_group(&estimates, &mean, None), Deviations { cells: 2.0, total: 1.0 });
        assert_eq!(of_group(&estimates, &mean, Some(1.5)), Deviations { cells: 2.0, total: 0.5 });
    }

    /// Deviates of one distribution, keyed by their number.
    type Deviates = fn(u64) -> f64;

    fn uniform(key: u64) -> f64 {
        ((splitmix64(key) >> 11) as f64 + 0.5) / (1_u64 << 53) as f64
    }

    fn normal(key: u64) -> f64 {
        let radius = (-2.0 * uniform(2 * key).ln()).sqrt();
        radius * (std::f64::consts::TAU * uniform(2 * key + 1)).cos()
    }

    /// Deviates of the Laplace distribution, whose kurtosis is 6.
    fn laplace(key: u64) -> f64 {
        let u = uniform(key) - 0.5;
        -u.signum() * (1.0 - 2.0 * u.abs()).ln()
    }

    /// Variances of groups of traces whose values are such deviates, from number `first` on.
    fn drawn(of: Deviates, first: u64, num_groups: u64) -> Variances {
        let estimate = |key| Estimate { cells: vec![of(key)], total: of(key) };
        let group = |group: u64| {
            let first = first + group * GROUP;
            let estimates: Vec<Estimate> = (first..first + GROUP).map(estimate).collect();
            of_group(&estimates, &Estimate::mean(&estimates), None)
        };
        Variances { groups: (0..num_groups).map(group).collect(), flux: 1.0 }
    }

    /// Shares of experiments in which the true ratio of 1 is above the lower and below the upper end.
    fn coverage(of: Deviates, [ours, theirs]: [u64; 2]) -> [f64; 2] {
        const EXPERIMENTS: u64 = 4000;
        let experiment = |number: u64| {
            let first = number << 20;
            let ratio =
                drawn(of, first, ours).ratio_to(&drawn(of, first + (1 << 19), theirs), Quantity::Flux);
            let Ratio { low, high, .. } = ratio.unwrap();
            [low <= 1.0, high >= 1.0]
        };
        let covered: Vec<[bool; 2]> = (0..EXPERIMENTS).map(experiment).collect();
        [0, 1].map(|end| covered.iter().filter(|ends| ends[end]).count() as f64 / EXPERIMENTS as f64)
    }

    #[test]
    fn intervals_hold_the_true_ratio() {
        // Three standard errors of the count are 0.5 %.
        for groups in [[5, 5], [16, 16], [64, 64], [64, 256], [256, 16]] {
            for share in coverage(normal, groups) {
                assert!((0.985..0.9955).contains(&share), "{groups:?}: {share}");
            }
        }
        // Fluxes of thousands of rays are not as far from normal as this.
        for groups in [[5, 5], [64, 64], [256, 64]] {
            let shares = coverage(laplace, groups);
            assert!(shares.iter().all(|share| *share > 0.975), "{groups:?}: {shares:?}");
        }
    }
}
