//! Where a profile falls below a part of its peak.

/// A profile: values at ascending places, with their standard errors.
#[derive(Debug, Clone, Default)]
pub(super) struct Profile {
    pub(super) places: Vec<f64>,
    pub(super) values: Vec<f64>,
    pub(super) errors: Vec<f64>,
}

impl Profile {
    /// A value that is known to this relative error may be the peak.
    const KNOWN: f64 = 0.01;
    /// Where none is known to this relative error, there is no peak.
    const UNKNOWN: f64 = 0.1;

    /// The index of the largest value that is known to 1 %, or half as well as the value known best. Other values do
    /// not count, because cells of a far field at its pole have a few rays each. Where errors are unknown, the largest
    /// of all.
    pub(super) fn peak(&self) -> Option<usize> {
        let error = |index: usize| self.errors[index] / self.values[index];
        let lit = || (0..self.values.len()).filter(|index| self.values[*index] > 0.0);
        let least = lit().map(error).min_by(f64::total_cmp).filter(|least| *least <= Profile::UNKNOWN)?;
        let enough = (2.0 * least).max(Profile::KNOWN);
        lit()
            .filter(|index| error(*index) <= enough)
            .max_by(|a, b| self.values[*a].total_cmp(&self.values[*b]))
    }

    /// The place beyond which values stay below `level`; none if the last one does not.
    pub(super) fn outermost(&self, level: f64) -> Option<f64> {
        let last = (0..self.values.len()).rev().find(|index| self.values[*index] >= level)?;
        self.between(last, last + 1, level)
    }

    /// The width of the peak at `part` of its height: from the first values below it on both sides. None if one side has none.
    pub(super) fn width(&self, part: f64) -> Option<f64> {
        let peak = self.peak()?;
        let level = part * self.values[peak];
        let is_below = |index: &usize| self.values[*index] < level;
        let after = (peak..self.values.len()).find(is_below)?;
        let before = (0..peak).rev().find(is_below)?;
        Some(self.between(after - 1, after, level)? - self.between(before + 1, before, level)?)
    }

    /// The place of a level between two neighbours, linear between them.
    fn between(&self, above: usize, below: usize, level: f64) -> Option<f64> {
        let (&high, &low) = (self.values.get(above)?, self.values.get(below)?);
        let (from, to) = (self.places[above], self.places[below]);
        Some(from + (to - from) * (high - level) / (high - low))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;

    fn profile(value: impl Fn(f64) -> f64) -> Profile {
        let places: Vec<f64> = (-200..=200).map(|index| f64::from(index) * 0.05).collect();
        Profile {
            values: places.iter().map(|&place| value(place)).collect(),
            errors: vec![0.0; places.len()],
            places,
        }
    }

    #[test]
    fn a_gaussian_has_its_full_width_at_half_maximum() {
        let width = profile(|x| (-0.5 * (x / 1.5_f64).powi(2)).exp()).width(0.5).unwrap();
        assert_relative_eq!(width, 1.5 * (8.0 * 2.0_f64.ln()).sqrt(), max_relative = 1e-3);
    }

    #[test]
    fn a_profile_that_does_not_fall_has_no_width() {
        assert_eq!(profile(|_| 1.0).width(0.5), None);
        assert_eq!(profile(|x| 1.0 + 0.01 * x).width(0.5), None);
        assert_eq!(profile(|_| 1.0).outermost(0.5), None);
        assert_eq!(profile(|_| 0.0).width(0.5), None);
    }

    #[test]
    fn the_outermost_place_is_behind_the_last_hill() {
        let two_hills = profile(|x| if x.abs() < 1.0 || (x - 5.0).abs() < 1.0 { 1.0 } else { 0.0 });
        assert_relative_eq!(two_hills.outermost(0.5).unwrap(), 5.975, epsilon = 0.03);
    }

    #[test]
    fn a_value_of_a_few_rays_is_no_peak() {
        let mut profile = profile(|x| (-x * x).exp());
        profile.values[0] = 50.0;
        profile.errors[0] = 30.0;
        assert_eq!(profile.peak(), Some(200));
        profile.errors.fill(100.0);
        assert_eq!(profile.peak(), None, "nothing is known");
    }
}
