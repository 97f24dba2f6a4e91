//! Fluxes that rest on few rays: how many rays they rest on, and an upper bound.
//!
//! Example: of a million rays, one found a ghost, and brought 1.44e-8 W. The estimated standard error is 1.44e-8 W as well. But
//! the next ray of this ghost may bring as much as it was born with, 1e-6 W. So the bound of the ghost is 3.0e-6 W.
//!
//! **How many.** Rays count by what they bring: the square of the sum of weights, over the sum of squares (Kish, Survey
//! Sampling, 1965). Equal rays count one each. Where one ray brings almost all, the flux rests on one ray. Where squares were
//! not summed, each deposit counts.
//!
//! **The bound.** Rays that bring a flux come by a Poisson law. Let each ray bring w at most. A flux F then has the
//! upper limit U = w/2 chi2(0.95; 2 (F/w + 1)) (Garwood, Biometrika 28, 1936). At most one trace in twenty exceeds
//! it. The weight w is what a new ray carries on average, since coatings, media and scattering only take from that.
//! Where sampling made rays heavier than that, what they may carry is not known. Then w is the mean weight of those
//! that were seen, each counted by what it brought. No bound of light that a detector absorbs is above what the
//! sources launch.

use crate::format::{significant, thousands};
use crate::result::{FluxUnit, QUANTA_PER_WEIGHT};
use serde::{Deserialize, Serialize};
use serde_json::Value;
use statrs::function::gamma::checked_gamma_lr;

/// From so many rays on, a standard error says enough.
pub const ENOUGH_RAYS: u64 = 10;
/// The share of traces whose bound is right.
const CONFIDENCE: f64 = 0.95;
/// What tables say below themselves where some row has a bound.
pub const FOOTNOTE: &str = "≤: fewer than 10 rays give no standard error; the true value, or its size, is below this, with 95 % confidence\n";

/// What is known of a flux that rests on fewer than ten rays.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct FewRays {
    /// Rays that the flux rests on.
    pub rests_on: u64,
    /// The flux is below this, with 95 % confidence \[W\].
    pub upper_bound_95: f64,
}

/// What some rays brought.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Brought {
    /// Deposits.
    pub count: u64,
    /// Sum of weights \[quanta\].
    pub quanta: u128,
    /// Sum over rays of the squares of weights, in units of 2^-52, where it is known.
    pub squares: Option<u128>,
}

impl Brought {
    /// How many rays the sum rests on.
    pub(crate) fn rests_on(&self) -> u64 {
        let equal_rays = self.weight() / self.mean_weight();
        let is_known = self.squares.is_some() && equal_rays.is_finite();
        if is_known { (equal_rays.round() as u64).max(1).min(self.count) } else { self.count }
    }

    /// True if the sum rests on fewer than [`ENOUGH_RAYS`].
    pub(crate) fn is_of_few(&self) -> bool {
        self.rests_on() < ENOUGH_RAYS
    }

    /// None from [`ENOUGH_RAYS`] on. `birth_weight` is what a new ray carries.
    pub(crate) fn few_rays(&self, birth_weight: f64, unit: FluxUnit) -> Option<FewRays> {
        let rests_on = Some(self.rests_on()).filter(|rays| *rays < ENOUGH_RAYS)?;
        // The mean of zero rays is NaN, which `max` leaves out.
        let largest = birth_weight.max(self.mean_weight());
        Some(FewRays { rests_on, upper_bound_95: unit.watts_of_weight(upper_bound(self.weight(), largest)) })
    }

    fn weight(&self) -> f64 {
        self.quanta as f64 / QUANTA_PER_WEIGHT
    }

    /// The mean weight of the rays, each counted by what it brought; NaN of none.
    fn mean_weight(&self) -> f64 {
        match self.squares {
            Some(squares) => squares as f64 / self.quanta as f64,
            None => self.weight() / self.count as f64,
        }
    }
}

impl FewRays {
    /// What is known of a difference of two scenes \[W\], in which so many rays differ; a ray of each is born with `births`
    /// \[W\]. The bound is one of the size of the difference.
    pub(crate) fn of_difference(rests_on: Option<u64>, difference: f64, births: [f64; 2]) -> Option<Self> {
        let rests_on = rests_on.filter(|rays| *rays < ENOUGH_RAYS)?;
        let largest = births[0].max(births[1]).max(difference.abs() / rests_on.max(1) as f64);
        Some(FewRays { rests_on, upper_bound_95: upper_bound(rests_on as f64 * largest, largest) })
    }

    /// What is known of the flux times a factor.
    pub(crate) fn scaled(self, factor: f64) -> Self {
        FewRays { upper_bound_95: self.upper_bound_95 * factor, ..self }
    }

    /// With a bound of at most this \[W\]: no light is more than what the sources launch.
    pub(crate) fn at_most(self, launched: f64) -> Self {
        FewRays { upper_bound_95: self.upper_bound_95.min(launched), ..self }
    }

    /// `rests on 3 rays`.
    pub fn text(&self) -> String {
        match self.rests_on {
            0 => "rests on no ray".into(),
            1 => "rests on 1 ray".into(),
            rays => format!("rests on {} rays", thousands(rays)),
        }
    }

    /// `≤ 4.7e-6`.
    pub fn bound(&self) -> String {
        bound(self.upper_bound_95)
    }
}

/// A bound in \[W\] for a table: `≤ 4.7e-6`.
pub(crate) fn bound(upper_bound_95: f64) -> String {
    format!("≤ {}", significant(upper_bound_95, 2))
}

/// Adds to an entry of a report what is known of a flux that rests on few rays: `rests_on` and `upper_bound_95`.
pub(crate) fn add_to(entry: &mut Value, few: Option<FewRays>) {
    if let Some(few) = few {
        entry["rests_on"] = few.rests_on.into();
        entry["upper_bound_95"] = few.upper_bound_95.into();
    }
}

/// An error for a table, \[W\]: the bound where there are few rays, and `-` where nothing is known.
pub(crate) fn error_or_bound(few: Option<FewRays>, error: Option<f64>) -> String {
    let error = error.filter(|error| error.is_finite());
    few.map_or_else(|| error.map_or("-".into(), |error| significant(error, 2)), |few| few.bound())
}

/// The end of a row: `  rests on 3 rays`.
pub(crate) fn remark(few: Option<FewRays>) -> String {
    few.map_or(String::new(), |few| format!("  {}", few.text()))
}

/// The upper limit of a sum of weights, none of which is above `largest`.
pub(crate) fn upper_bound(weight: f64, largest: f64) -> f64 {
    if largest > 0.0 { largest * half_chi_squared(weight / largest + 1.0) } else { 0.0 }
}

/// Half the quantile of chi squared with twice so many degrees of freedom, which is the gamma distribution's of this shape.
fn half_chi_squared(shape: f64) -> f64 {
    // Beyond ten standard deviations, and for any shape above 1.
    let (mut low, mut high) = (0.0, shape + 10.0 * shape.sqrt());
    for _ in 0..60 {
        let middle = 0.5 * (low + high);
        let is_below = checked_gamma_lr(shape, middle).is_ok_and(|share| share < CONFIDENCE);
        *(if is_below { &mut low } else { &mut high }) = middle;
    }
    high
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;

    const UNIT: u128 = 1 << 52;

    /// Rays of these weights.
    fn rays(weights: &[f64]) -> Brought {
        let sum = |value: fn(f64) -> f64| weights.iter().map(|w| (value(*w) * UNIT as f64) as u128).sum();
        Brought { count: weights.len() as u64, quanta: sum(|w| w), squares: Some(sum(|w| w * w)) }
    }

    #[test]
    fn the_bound_is_that_of_poisson_tables() {
        // Garwood's table: upper one-sided 95 % limits of 0, 1, 2, 3, 5 and 9 counts.
        for (count, limit) in
            [(0.0, 2.9957), (1.0, 4.7439), (2.0, 6.2958), (3.0, 7.7537), (5.0, 10.5130), (9.0, 15.7052)]
        {
            assert_relative_eq!(upper_bound(count, 1.0), limit, max_relative = 1e-4);
            assert_relative_eq!(upper_bound(2.5 * count, 2.5), 2.5 * limit, max_relative = 1e-4);
        }
    }

    #[test]
    fn rays_count_by_what_they_bring() {
        assert_eq!(rays(&[0.3; 7]).rests_on(), 7);
        assert_eq!(rays(&[1.0, 1e-3, 1e-3, 1e-3]).rests_on(), 1);
        // Twenty deposits of one split ray are one ray.
        let split = Brought { count: 20, quanta: UNIT, squares: Some(UNIT) };
        assert_eq!(split.rests_on(), 1);
        assert_eq!(Brought { squares: None, ..split }.rests_on(), 20, "nobody knows better");
        assert_eq!(Brought { count: 0, quanta: 0, squares: None }.rests_on(), 0);
        assert!(!rays(&[1.0; 10]).is_of_few() && rays(&[1.0; 9]).is_of_few());
    }

    /// One ray of a ghost that carried little says nothing of one that carries all: the bound allows for the largest.
    #[test]
    fn a_single_faint_ray_leaves_room_for_a_bright_one() {
        let unit = FluxUnit::new(1.0, 1_000_000);
        let few = rays(&[0.0144]).few_rays(1.0, unit).unwrap_or(FewRays { rests_on: 0, upper_bound_95: 0.0 });
        assert_eq!(few.rests_on, 1);
        assert!((2.99e-6..3.1e-6).contains(&few.upper_bound_95), "{few:?}");
        assert_eq!((few.text(), few.bound()), ("rests on 1 ray".into(), "≤ 3e-6".into()));
        // Rays that sampling made heavier than at birth count as those that were seen.
        let heavy = rays(&[8.0]).few_rays(1.0, unit).map(|few| few.upper_bound_95);
        assert_relative_eq!(heavy.unwrap_or(0.0), 8.0 * 4.7439e-6, max_relative = 1e-4);
        assert_eq!(rays(&[1.0; 10]).few_rays(1.0, unit), None);
    }

    /// Of rays of two weights, of which so many are expected, exactly: how often the bound is right.
    fn coverage(means: [f64; 2], weights: [f64; 2]) -> f64 {
        let truth = means[0] * weights[0] + means[1] * weights[1];
        let shares = |mean: f64| {
            (0..60).scan((-mean).exp(), move |share, count| {
                let this = *share;
                *share *= mean / (f64::from(count) + 1.0);
                Some((f64::from(count), this))
            })
        };
        let right = shares(means[0]).flat_map(|(a, share)| {
            shares(means[1]).map(move |(b, other)| {
                let bound = upper_bound(a * weights[0] + b * weights[1], 1.0);
                if bound >= truth { share * other } else { 0.0 }
            })
        });
        right.sum()
    }

    #[test]
    fn the_bound_is_right_in_nineteen_traces_of_twenty_however_weights_are_mixed() {
        for bright in [0.0, 0.3, 1.0, 2.9, 4.7, 6.2, 9.0] {
            for faint in [0.0, 0.5, 3.0, 7.0, 12.0] {
                for weight in [1e-6, 0.01, 0.2, 0.5, 0.9, 1.0] {
                    let share = coverage([bright, faint], [1.0, weight]);
                    assert!(share >= 0.95 - 1e-9, "{share} of {bright} rays of 1, {faint} of {weight}");
                }
            }
        }
        // A symmetric error of one faint ray would be wrong in most of these.
        assert!(coverage([3.0, 0.0], [1.0, 1.0]) < 0.951, "and no wider than it need be");
    }
}
