//! When it pays to follow the hot path.

/// The stage pays where this share of the rays keeps to the path. The stage takes 0.3 (f64) to 0.45 (f32) of the time
/// of the plain stages. Rays that fail its guards are traced again, in nearly the time that they took without it.
pub(super) const LEAST_SHARE: f64 = 0.45;
/// So many rays show whether the profile was right.
const TELLING_RAYS: u64 = 1 << 16;
/// Shorter traces are over before the profile has paid.
const LEAST_RAYS: u64 = 1 << 22;

/// Whether a trace of so many rays looks for a hot path.
pub fn is_long_enough(num_rays: u64) -> bool {
    num_rays >= LEAST_RAYS
}

/// Whether it still pays to follow a path, as far as these rays show: a profile may be wrong.
pub fn pays([num_followed, num_failed]: [u64; 2]) -> bool {
    num_followed < TELLING_RAYS || num_failed as f64 <= (1.0 - LEAST_SHARE) * num_followed as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_path_that_fails_most_rays_does_not_pay() {
        let num = TELLING_RAYS;
        assert!(pays([0, 0]) && pays([num - 1, num - 1]), "too few to judge");
        assert!(pays([num, 0]) && pays([num, num / 2]));
        assert!(!pays([num, num / 8 * 5]) && !pays([num, num]));
    }
}
