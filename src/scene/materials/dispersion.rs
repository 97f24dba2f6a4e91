//! Refractive index and extinction as functions of the wavelength, in the package's order of operations.

use std::sync::Arc;

/// A quantity measured at some wavelengths.
#[derive(Debug, Clone, PartialEq)]
pub struct Table {
    wavelengths: Arc<[f64]>,
    values: Vec<f64>,
}

impl Table {
    /// A table over ascending `wavelengths` \[um\]; `None` unless each has one value and there is at least one.
    pub(in crate::scene) fn new(wavelengths: Arc<[f64]>, values: Vec<f64>) -> Option<Self> {
        (!values.is_empty() && wavelengths.len() == values.len()).then_some(Self { wavelengths, values })
    }

    /// The wavelengths \[um\], ascending.
    pub fn wavelengths(&self) -> &Arc<[f64]> {
        &self.wavelengths
    }

    /// First and last wavelength \[um\].
    pub fn range(&self) -> (f64, f64) {
        (self.wavelengths[0], self.wavelengths[self.wavelengths.len() - 1])
    }

    /// Linear between the samples, constant beyond the ends; `wavelength` in um.
    pub fn at(&self, wavelength: f64) -> f64 {
        let above = self.wavelengths.partition_point(|&sample| sample <= wavelength);
        if above == 0 {
            return self.values[0];
        }
        let below = above - 1;
        if above == self.values.len() {
            return self.values[below];
        }
        let slope =
            (self.values[above] - self.values[below]) / (self.wavelengths[above] - self.wavelengths[below]);
        slope * (wavelength - self.wavelengths[below]) + self.values[below]
    }
}

/// How the refractive index depends on the wavelength.
#[derive(Debug, Clone, PartialEq)]
pub enum Dispersion {
    /// Measured samples.
    Table(Table),
    /// A dispersion formula of refractiveindex.info.
    Formula {
        /// Its number there, 1 to 9.
        number: u8,
        /// Its coefficients, for wavelengths in um.
        coefficients: Vec<f64>,
        /// Where it was fitted \[um\].
        range: (f64, f64),
    },
}

impl Dispersion {
    /// Refractive index at `wavelength` \[um\]. A table is constant beyond its ends; a formula is evaluated
    /// anywhere, and is NaN where it has no real value.
    pub fn n(&self, wavelength: f64) -> f64 {
        match self {
            Dispersion::Table(table) => table.at(wavelength),
            Dispersion::Formula { number, coefficients, .. } => formula(*number, coefficients, wavelength),
        }
    }

    /// Wavelengths that the data covers \[um\].
    pub fn range(&self) -> (f64, f64) {
        match self {
            Dispersion::Table(table) => table.range(),
            Dispersion::Formula { range, .. } => *range,
        }
    }
}

/// Formula `number` of refractiveindex.info at wavelength `w` \[um\]. The operations stand in the order in which the
/// package carries them out, so that both round alike. NaN if the coefficients do not fit the formula.
fn formula(number: u8, coefficients: &[f64], w: f64) -> f64 {
    match (number, coefficients) {
        (1, [c0, terms @ ..]) => sellmeier(*c0, terms, w, |c| c * c).sqrt(),
        (2, [c0, terms @ ..]) => sellmeier(*c0, terms, w, |c| c).sqrt(),
        (3, [c0, terms @ ..]) => powers(*c0, terms, w).sqrt(),
        (4, [c0, a0, a1, a2, a3, b0, b1, b2, b3, terms @ ..]) => {
            let first = a0 * w.powf(*a1) / (w * w - a2.powf(*a3));
            let second = b0 * w.powf(*b1) / (w * w - b2.powf(*b3));
            powers(c0 + first + second, terms, w).sqrt()
        }
        (5, [c0, terms @ ..]) => powers(*c0, terms, w),
        (6, [c0, terms @ ..]) => pairs(terms).fold(1.0 + c0, |n, (a, b)| n + a / (b - w.powf(-2.0))),
        (7, [c0, c1, c2, terms @ ..]) => herzberger([*c0, *c1, *c2], terms, w),
        (8, [c0, c1, c2, c3]) => {
            let value = c0 + c1 * (w * w) / (w * w - c2) + c3 * (w * w);
            ((1.0 + 2.0 * value) / (1.0 - value)).sqrt()
        }
        (9, [c0, c1, c2, c3, c4, c5]) => {
            let shifted = w - c4;
            (c0 + c1 / (w * w - c2) + c3 * shifted / (shifted * shifted + c5)).sqrt()
        }
        _ => f64::NAN,
    }
}

fn pairs(terms: &[f64]) -> impl Iterator<Item = (f64, f64)> {
    terms.chunks_exact(2).map(|pair| (pair[0], pair[1]))
}

fn sellmeier(c0: f64, terms: &[f64], w: f64, resonance: impl Fn(f64) -> f64) -> f64 {
    pairs(terms).fold(1.0 + c0, |sum, (a, b)| sum + a * (w * w) / (w * w - resonance(b)))
}

fn powers(c0: f64, terms: &[f64], w: f64) -> f64 {
    pairs(terms).fold(c0, |sum, (factor, exponent)| sum + factor * w.powf(exponent))
}

fn herzberger([c0, c1, c2]: [f64; 3], terms: &[f64], w: f64) -> f64 {
    let resonance = 1.0 / (w * w - 0.028);
    let start = c0 + c1 * resonance + c2 * (resonance * resonance);
    let exponents = (1..).map(|half| 2.0 * f64::from(half));
    terms.iter().zip(exponents).fold(start, |n, (factor, exponent)| n + factor * w.powf(exponent))
}
