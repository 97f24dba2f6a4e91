//! Weights and positions of logged ends in the precision of the trace, in the very operations of the shaders.

use crate::engine::sums::QUANTA_PER_UNIT;

// How a position is written (ends.logged.wgsl), by columns and by rows alike. A position lies between two pixels. Where
// the ray hit the second one, the position is multiplied by HIT_NEXT. At the edge of the map both pixels are the same
// one, marked or not. Beyond the edge, where roundings may lead far from the scene's centre, both are that pixel, too.
// A position of 0, which HIT_NEXT cannot mark, is the middle of the first pixel, which was hit.
/// `HIT_NEXT` in ends.logged.wgsl.
pub const HIT_NEXT: f64 = 79228162514264337593543950336.0;
/// Positions between two pixels are smaller, and larger times [`HIT_NEXT`].
pub const LAST_POSITION: f64 = (1 << 30) as f64;
/// `OFF_DETECTORS` in ends.logged.wgsl: the column of an entry that is no position. A true position so far beyond the
/// map would be marked.
pub const OFF_DETECTORS: f64 = -1.25;

/// The taps of a position along one axis.
#[derive(Debug, Clone, Copy)]
pub struct AxisTaps<T> {
    /// The pixel before the position.
    pub first: u32,
    /// The pixel behind the position: the same one at the edges and beyond.
    pub next: u32,
    /// The pixel that was hit.
    pub hit: u32,
    /// The corner between them: 0 before the first pixel of all, their number behind the last.
    pub corner: u32,
    /// How far the position is from the first pixel to the next, in 0..=1.
    pub fraction: T,
    /// The position is not NaN.
    pub is_number: bool,
}

/// The pixels before and behind a corner ([`AxisTaps::corner`]).
pub fn pixels_at(corner: u32, num_pixels: u32) -> [u32; 2] {
    [corner.saturating_sub(1), corner.min(num_pixels - 1)]
}

/// The arithmetic of weights and positions, in the precision of the trace.
pub trait Real: Copy + Into<f64> {
    /// Quanta of weights below it fit 63 bits.
    const LIMIT: f64 = 2048.0;

    /// A number as the device has it.
    fn nearest(value: f64) -> Self;

    /// Whether it lies in 0..=1: a fraction, or a weight whose quanta an f64 holds exactly.
    fn is_at_most_one(self) -> bool;

    /// What the first three taps take of a weight of 1 (`first_shares` in splat.wgsl, in its very operations).
    fn parts(fractions: [Self; 2]) -> [Self; 3];

    /// The same of any weight.
    fn first_shares(weight: Self, parts: [Self; 3]) -> [Self; 3];

    /// Quanta of the taps of an end whose first taps take these parts, in 0..=1. The flag beside these quanta is true
    /// where they hold: the weight is below [`Real::LIMIT`]. The last tap takes what the others left (`deposit_taps` in
    /// splat.wgsl). `AT_MOST_ONE`: the weight is at most 1.
    fn quanta<const AT_MOST_ONE: bool>(weight: Self, parts: [Self; 3]) -> ([u64; 4], bool);

    /// The whole part of a number in 0..2^63.
    fn to_whole(self) -> i64;

    /// Between which of so many pixels a logged position lies (`bilinear_taps` in splat.wgsl, `marked_position` in
    /// ends.logged.wgsl).
    fn tap(self, num_pixels: u32) -> AxisTaps<Self>;

    /// True if an entry with this in place of a column is no position.
    fn is_off_detectors(self) -> bool;
}

/// The whole part of a number in 0..=2^52. Numbers as large as 2^52 are whole. So the sum is rounded to a whole number,
/// and its last bits are the bits of an integer. Few processors convert vectors to 64-bit integers.
#[inline(always)]
fn whole_part(number: f64) -> i64 {
    const LARGE: f64 = (1_u64 << 52) as f64;
    let sum = number + LARGE;
    let nearest = sum.to_bits().wrapping_sub(LARGE.to_bits()) as i64;
    nearest - i64::from(sum - LARGE > number)
}

macro_rules! real {
    ($real:ty) => {
        impl Real for $real {
            #[inline]
            fn nearest(value: f64) -> $real {
                value as $real
            }

            #[inline(always)]
            fn is_at_most_one(self) -> bool {
                const ONE: $real = 1.0;
                // Positive numbers are in the order of their bits; what is negative, or no number, lies above.
                self.to_bits() <= ONE.to_bits()
            }

            #[inline(always)]
            fn parts([x, y]: [$real; 2]) -> [$real; 3] {
                [(1.0 - x) * (1.0 - y), x * (1.0 - y), (1.0 - x) * y]
            }

            #[inline(always)]
            fn first_shares(weight: $real, parts: [$real; 3]) -> [$real; 3] {
                parts.map(|part| weight * part)
            }

            #[inline(always)]
            fn quanta<const AT_MOST_ONE: bool>(weight: $real, parts: [$real; 3]) -> ([u64; 4], bool) {
                const LIMIT: $real = <$real as Real>::LIMIT as $real;
                let is_small = weight.to_bits() < LIMIT.to_bits();
                // A power of two: shares of the scaled weight are the scaled shares, but for those far below a quantum.
                let scaled = if is_small { weight * QUANTA_PER_UNIT as $real } else { 0.0 };
                let quanta = |share: $real| match AT_MOST_ONE {
                    true => whole_part(share.into()),
                    false => share.to_whole(),
                };
                // In signed integers, of whose minimum more processors have an instruction.
                let mut rest = quanta(scaled);
                let [a, b, c] = <$real>::first_shares(scaled, parts).map(|share| {
                    let taken = quanta(share).min(rest);
                    rest -= taken;
                    taken
                });
                ([a, b, c, rest].map(|quanta| quanta as u64), is_small)
            }

            #[inline(always)]
            fn to_whole(self) -> i64 {
                const LARGE: $real = (1_u64 << 63) as $real;
                let number = if self.to_bits() < LARGE.to_bits() { self } else { 0.0 };
                // SAFETY: it lies in 0..2^63.
                #[allow(unsafe_code)]
                unsafe {
                    number.to_int_unchecked::<i64>()
                }
            }

            #[inline(always)]
            fn tap(self, num_pixels: u32) -> AxisTaps<$real> {
                const FARTHEST: $real = LAST_POSITION as $real;
                let hits_next = self.abs() >= FARTHEST;
                let place = if hits_next { self / HIT_NEXT as $real } else { self };
                // In selections, each an instruction of vectors; one that is no number is the least.
                let above = if place > -FARTHEST { place } else { -FARTHEST };
                let position = if above < FARTHEST { above } else { FARTHEST };
                let corner = position.floor();
                let last = (num_pixels - 1) as $real;
                let between = |number: $real, last: $real| {
                    let number = if number > 0.0 { number } else { 0.0 };
                    if number < last { number } else { last }
                };
                let (first, next) = (between(corner, last), between(corner + 1.0, last));
                // SAFETY: from 0 to the farthest and one.
                #[allow(unsafe_code)]
                let whole = |pixel: $real| unsafe { pixel.to_int_unchecked::<i32>() as u32 };
                AxisTaps {
                    first: whole(first),
                    next: whole(next),
                    hit: whole(if hits_next { next } else { first }),
                    corner: whole(between(corner + 1.0, last + 1.0)),
                    fraction: position - corner,
                    is_number: !self.is_nan(),
                }
            }

            #[inline(always)]
            fn is_off_detectors(self) -> bool {
                self == OFF_DETECTORS as $real
            }
        }
    };
}

real!(f32);
real!(f64);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn whole_parts_are_those_of_conversions() {
        let half = f64::from(1_u32 << 31).powi(2) / 2048.0;
        for number in [
            0.0,
            -0.0,
            5e-324,
            0.5,
            1.0_f64.next_down(),
            1.0,
            1.5,
            half - 0.5,
            half + 0.5,
            2.0 * half - 0.5,
            (2.0 * half).next_down(),
            2.0 * half,
        ] {
            assert_eq!(whole_part(number), number as i64, "{number}");
        }
    }

    #[test]
    fn a_position_where_what_is_none_would_lie_is_marked_by_its_fraction() {
        assert!(OFF_DETECTORS - OFF_DETECTORS.floor() >= 0.5 && OFF_DETECTORS < -0.5);
        assert!((OFF_DETECTORS * HIT_NEXT).tap(7).hit == 0 && !(OFF_DETECTORS * HIT_NEXT).is_off_detectors());
        assert!((OFF_DETECTORS as f32).is_off_detectors());
    }

    #[test]
    fn taps_are_those_of_whole_numbers() {
        for num_pixels in [1, 7] {
            let last = i64::from(num_pixels) - 1;
            for position in (-1000..=1000).map(|i| f64::from(i) / 64.0).chain([-0.0]) {
                let corner = position.floor();
                let [first, next] = [0, 1].map(|to| (corner as i64 + to).clamp(0, last) as u32);
                let marked = if position == 0.0 { first } else { next };
                for (logged, hit) in [(position, first), (position * HIT_NEXT, marked)] {
                    for taps in [logged.tap(num_pixels), widened((logged as f32).tap(num_pixels))] {
                        assert_eq!((taps.first, taps.next, taps.hit), (first, next, hit), "{logged}");
                        assert_eq!(pixels_at(taps.corner, num_pixels), [first, next], "{logged}");
                        assert!(taps.is_number && taps.fraction == position - corner, "{logged}");
                    }
                }
            }
        }
        for [least, most] in [
            [f64::NEG_INFINITY, f64::INFINITY].map(|at| at.tap(7)),
            [f32::NEG_INFINITY, f32::INFINITY].map(|at| widened(at.tap(7))),
        ] {
            assert_eq!(
                [least.first, least.next, least.hit, most.first, most.next, most.hit],
                [0, 0, 0, 6, 6, 6]
            );
            assert_eq!([least.fraction, most.fraction], [0.0; 2]);
        }
        assert!(!f64::NAN.tap(7).is_number && !f32::NAN.tap(7).is_number);
    }

    fn widened(taps: AxisTaps<f32>) -> AxisTaps<f64> {
        let AxisTaps { first, next, hit, corner, fraction, is_number } = taps;
        AxisTaps { first, next, hit, corner, fraction: fraction.into(), is_number }
    }

    #[test]
    fn quanta_of_small_weights_are_found_either_way() {
        for i in 0..10_000 {
            let at = |factor: f64| (f64::from(i) * factor).fract();
            let (weight, fractions) = (at(0.618_033_988), [at(0.754_877_666), at(0.569_840_290)]);
            let parts = f64::parts(fractions);
            assert_eq!(f64::quanta::<true>(weight, parts), f64::quanta::<false>(weight, parts));
            let parts = f32::parts(fractions.map(|fraction| fraction as f32));
            let weight = weight as f32;
            assert_eq!(f32::quanta::<true>(weight, parts), f32::quanta::<false>(weight, parts));
        }
        assert!(f64::quanta::<false>(3.0, [0.25; 3]).1 && !f64::quanta::<false>(2048.0, [0.25; 3]).1);
    }
}
