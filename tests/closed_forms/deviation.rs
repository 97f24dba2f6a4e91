//! How far a measured number is from its closed form, in units of what is tolerated.

/// Standard deviations within which a statistical form must lie.
const SIGMAS: f64 = 4.0;

/// A distance from a closed form: 1 is the edge of what is accepted.
#[must_use]
pub struct Deviation {
    form: String,
    in_tolerances: f64,
}

impl Deviation {
    fn new(form: &str, in_tolerances: f64) -> Self {
        eprintln!("{in_tolerances:10.3e} of the tolerance: {form}");
        Deviation { form: form.to_owned(), in_tolerances }
    }

    /// Fails unless the form holds; so does anything that is not a number.
    pub fn accepted(self) {
        assert!(self.in_tolerances <= 1.0, "{}: {} times the tolerance", self.form, self.in_tolerances);
    }

    /// Fails if the form holds: guards against comparisons that accept anything.
    pub fn rejected(self) {
        assert!(self.in_tolerances > 1.0, "{}: a wrong expectation was accepted", self.form);
    }
}

/// The largest distance of pairs (measured, expected), over a tolerance.
pub fn exact(form: &str, pairs: impl IntoIterator<Item = (f64, f64)>, tolerance: f64) -> Deviation {
    let mut largest = f64::NEG_INFINITY;
    for (measured, expected) in pairs {
        let distance = (measured - expected).abs() / tolerance;
        // A distance that is not a number sticks; no pairs at all are no proof.
        largest = if distance.is_nan() || largest.is_nan() { f64::NAN } else { largest.max(distance) };
    }
    Deviation::new(form, if largest == f64::NEG_INFINITY { f64::NAN } else { largest })
}

/// `hits` of `trials` independent rays, each a hit with probability p: the variance is trials p (1 - p).
pub fn binomial(form: &str, hits: u64, trials: u64, p: f64) -> Deviation {
    let trials = trials as f64;
    let z = (hits as f64 - trials * p) / (trials * p * (1.0 - p)).sqrt();
    Deviation::new(form, z.abs() / SIGMAS)
}

/// The mean of independent samples against its expectation, with the samples' own variance.
pub fn mean(form: &str, samples: &[f64], expected: f64) -> Deviation {
    let (mean, variance) = mean_and_variance(samples);
    Deviation::new(form, (mean - expected).abs() / (variance / samples.len() as f64).sqrt() / SIGMAS)
}

/// Sample mean and unbiased sample variance.
pub fn mean_and_variance(samples: &[f64]) -> (f64, f64) {
    let count = samples.len() as f64;
    let mean = samples.iter().sum::<f64>() / count;
    let variance = samples.iter().map(|x| (x - mean) * (x - mean)).sum::<f64>() / (count - 1.0);
    (mean, variance)
}

/// Pearson's chi-square of counts against probabilities; what the bins leave of `trials` is a bin of its own. The
/// statistic is brought to a standard normal by its cube root (Wilson and Hilferty 1931).
pub fn chi_square(form: &str, counts: &[u64], probabilities: &[f64], trials: u64) -> Deviation {
    assert_eq!(counts.len(), probabilities.len(), "{form}: one probability a bin");
    let rest = trials - counts.iter().sum::<u64>();
    let p_rest = 1.0 - probabilities.iter().sum::<f64>();
    let mut bins: Vec<(f64, f64)> =
        counts.iter().map(|&n| n as f64).zip(probabilities.iter().copied()).collect();
    if p_rest > 1e-12 {
        bins.push((rest as f64, p_rest));
    } else {
        assert_eq!(rest, 0, "{form}: rays outside of bins that hold them all");
    }
    let term = |&(count, p): &(f64, f64)| (count - trials as f64 * p).powi(2) / (trials as f64 * p);
    let chi_square: f64 = bins.iter().map(term).sum();
    let width = 2.0 / (9.0 * (bins.len() - 1) as f64);
    let z = ((chi_square / (bins.len() - 1) as f64).cbrt() - (1.0 - width)) / width.sqrt();
    Deviation::new(form, z.abs() / SIGMAS)
}

/// Simpson's rule over 2000 intervals.
pub fn integral(from: f64, to: f64, f: impl Fn(f64) -> f64) -> f64 {
    const INTERVALS: u32 = 2000;
    let step = (to - from) / f64::from(INTERVALS);
    let weight = |i: u32| match i {
        0 | INTERVALS => 1.0,
        _ if i % 2 == 1 => 4.0,
        _ => 2.0,
    };
    (0..=INTERVALS).map(|i| weight(i) * f(from + f64::from(i) * step)).sum::<f64>() * step / 3.0
}
