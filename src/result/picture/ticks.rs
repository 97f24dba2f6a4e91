//! Round numbers along an axis, with their labels.

use crate::format::significant;

/// A value and its label.
pub type Tick = (f64, String);

/// At most `count` round values within a range, a step of 1, 2 or 5 times a power of ten apart, with their labels.
pub fn ticks((low, high): (f64, f64), count: usize) -> Vec<Tick> {
    let span = high - low;
    let power = 10f64.powf((span / count as f64).log10().floor());
    let steps = [1.0, 2.0, 5.0, 10.0, 20.0].map(|factor| factor * power);
    let indices = |step: f64| ((low / step - 1e-9).ceil() as i64)..=((high / step + 1e-9).floor() as i64);
    let fits = |step: &&f64| indices(**step).count() <= count;
    let step = steps.iter().find(fits).copied().unwrap_or(20.0 * power);
    indices(step).map(|index| tick(index as f64 * step, step)).collect()
}

/// The most ticks, up to `count`, whose labels stand side by side: `fits` gets the ticks.
pub fn ticks_that_fit(range: (f64, f64), count: usize, fits: impl Fn(&[Tick]) -> bool) -> Option<Vec<Tick>> {
    (2..=count).rev().map(|count| ticks(range, count)).find(|ticks| fits(ticks))
}

/// A tick with its label. Labels have a true minus sign, and the decimals that a step needs, so that all labels of an
/// axis have as many.
pub fn tick(value: f64, step: f64) -> Tick {
    const MOST_DECIMALS: f64 = 6.0;
    let decimals = (-(step.log10() + 1e-9).floor()).max(0.0);
    let label = if value.abs() < 1e-6 * step {
        "0".into()
    } else if decimals <= MOST_DECIMALS && value.abs() < 1e7 {
        format!("{value:.*}", decimals as usize)
    } else {
        significant(value, 6)
    };
    (value, with_minus(&label))
}

/// A label with a true minus sign.
pub fn with_minus(label: &str) -> String {
    label.replace('-', "−")
}

/// Powers of ten between two logarithms: about `count` of them, if need be every second or third. Over few decades,
/// twice and five times each power come as well.
pub fn decades((low, high): (f64, f64), count: usize) -> impl Iterator<Item = f64> {
    const ROUNDING: f64 = 1e-9;
    let is_short = 3.0 * (high - low) + 1.0 < count as f64;
    let factors: &[f64] = if is_short { &[1.0, 2.0, 5.0] } else { &[1.0] };
    let every = 1 + (high - low) as i32 / count.max(1) as i32;
    let powers = (low.floor() as i32..=high.ceil() as i32).filter(move |power| power % every == 0);
    let values = powers.flat_map(move |power| factors.iter().map(move |factor| factor * 10f64.powi(power)));
    values.filter(move |value| (low - ROUNDING..=high + ROUNDING).contains(&value.log10()))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn labels(range: (f64, f64), count: usize) -> Vec<String> {
        ticks(range, count).into_iter().map(|(_, label)| label).collect()
    }

    #[test]
    fn ticks_stand_at_round_numbers() {
        assert_eq!(labels((-5.0, 5.0), 5), ["−4", "−2", "0", "2", "4"]);
        assert_eq!(labels((0.0, 0.36), 4), ["0", "0.1", "0.2", "0.3"]);
        assert_eq!(labels((-5e-4, 5e-4), 6), ["−0.0004", "−0.0002", "0", "0.0002", "0.0004"]);
        assert_eq!(labels((0.0, 1e4), 3), ["0", "5000", "10000"]);
        assert_eq!(labels((1.0, 1.02), 5), ["1.000", "1.005", "1.010", "1.015", "1.020"]);
        assert_eq!(labels((-5e-9, 5e-9), 3), ["−5e−9", "0", "5e−9"]);
    }

    #[test]
    fn no_range_has_too_many_ticks() {
        for exponent in -12..12 {
            for factor in [1.0, 1.3, 2.7, 4.9, 9.99] {
                let half = factor * 10f64.powi(exponent);
                for count in 2..=9 {
                    let ticks = ticks((-half, half), count);
                    assert!((1..=count).contains(&ticks.len()), "{half} {count}: {ticks:?}");
                }
            }
        }
    }

    #[test]
    fn decades_are_as_many_as_there_is_room_for() {
        let of = |range, count| decades(range, count).map(|value| significant(value, 2)).collect::<Vec<_>>();
        assert_eq!(of((-3.0, 0.0), 7), ["0.001", "0.01", "0.1", "1"]);
        assert_eq!(of((-1.0, 0.5), 7), ["0.1", "0.2", "0.5", "1", "2"]);
        assert_eq!(of((-1.0, 0.5), 5), ["0.1", "1"]);
        assert_eq!(of((-6.0, 0.0), 4), ["1e-6", "0.0001", "0.01", "1"]);
    }
}
