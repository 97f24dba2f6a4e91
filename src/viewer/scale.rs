//! Turns values into colours: linear, logarithmic, or linear up to a percentile.
//!
//! A zero is a finding of its own, and has a colour that no other value has. Colours are perceptually even, and their
//! brightness rises with the value. The colours of differences diverge from a neutral middle.

use crate::format::si_prefix;
use colorous::Gradient;
use eframe::egui::Color32;
use ndarray::Array2;
use serde::{Deserialize, Serialize};

/// How values become colours.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum ScaleKind {
    /// From zero to the largest value.
    Linear,
    /// Logarithmic: equal ratios look equally far apart.
    Log,
    /// Linear up to a percentile of the non-zero values; the few brighter cells share the top colour.
    Percentile,
}

/// A colour map.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[allow(missing_docs, reason = "the names of the maps say it")]
pub enum ColorMap {
    Inferno,
    Magma,
    Viridis,
    Cividis,
    Grey,
}

/// A scale fitted to values.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Scale {
    /// How values become colours.
    pub kind: ScaleKind,
    /// The value of the first colour: 0 of a linear scale, or the smallest value that a logarithmic scale resolves.
    pub low: f64,
    /// The value of the last colour.
    pub high: f64,
    /// True for differences: the scale is symmetric around 0.
    pub diverging: bool,
    /// True if some value lies above `high`.
    pub saturated: bool,
    /// True if some value lies below `low`, and is neither zero nor a difference.
    pub cut: bool,
}

/// What a value looks like.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Shade {
    /// There is no value, as outside a disc or where nothing is known.
    Missing,
    /// Exactly zero, of a quantity that cannot be negative.
    Zero,
    /// The position along the colours, in 0..=1.
    Part(f64),
}

/// Most decades of a logarithmic scale.
const DECADES: f64 = 6.0;
/// The part at the beginning of a colour map that is left to zero.
const FIRST_PART: f64 = 0.10;

impl ScaleKind {
    /// All, in the order in which they are offered.
    pub const ALL: [(ScaleKind, &'static str); 3] =
        [(ScaleKind::Linear, "Linear"), (ScaleKind::Log, "Log"), (ScaleKind::Percentile, "Percentile")];
}

impl ColorMap {
    /// All, in the order in which they are offered.
    pub const ALL: [(ColorMap, &'static str); 5] = [
        (ColorMap::Inferno, "Inferno"),
        (ColorMap::Magma, "Magma"),
        (ColorMap::Viridis, "Viridis"),
        (ColorMap::Cividis, "Cividis"),
        (ColorMap::Grey, "Grey"),
    ];

    /// Exactly zero.
    pub const ZERO: Color32 = Color32::from_rgb(12, 13, 17);

    /// The colours, from dark to bright.
    fn color(self, part: f64) -> Color32 {
        let gradient: Gradient = match self {
            ColorMap::Inferno => colorous::INFERNO,
            ColorMap::Magma => colorous::MAGMA,
            ColorMap::Viridis => colorous::VIRIDIS,
            ColorMap::Cividis => colorous::CIVIDIS,
            // The grey scale of colorous runs from white to black.
            ColorMap::Grey => return opaque(colorous::GREYS, 1.0 - (FIRST_PART + (1.0 - FIRST_PART) * part)),
        };
        opaque(gradient, FIRST_PART + (1.0 - FIRST_PART) * part)
    }

    /// 256 colours from the first to the last of a scale.
    pub fn table(self, diverging: bool) -> Vec<Color32> {
        let color = |index: i32| {
            let part = f64::from(index) / 255.0;
            // Red means that A is larger.
            if diverging { opaque(colorous::RED_BLUE, 1.0 - part) } else { self.color(part) }
        };
        (0..256).map(color).collect()
    }
}

fn opaque(gradient: Gradient, part: f64) -> Color32 {
    let color = gradient.eval_continuous(part.clamp(0.0, 1.0));
    Color32::from_rgb(color.r, color.g, color.b)
}

impl Scale {
    /// The prefix of a unit beside the colours, and its factor: the profile has the same.
    pub fn prefix(&self, unit: &str) -> (f64, &'static str) {
        if unit == "σ" { (1.0, "") } else { si_prefix(self.high) }
    }

    /// Fits a scale to values that are not negative; `percentile` is in percent.
    pub fn fit<'a>(
        kind: ScaleKind,
        percentile: f64,
        values: impl IntoIterator<Item = &'a Array2<f64>>,
    ) -> Scale {
        let mut lit: Vec<f64> =
            values.into_iter().flatten().copied().filter(|value| *value > 0.0 && value.is_finite()).collect();
        let largest = lit.iter().copied().fold(0.0, f64::max);
        let smallest = lit.iter().copied().fold(f64::INFINITY, f64::min);
        let mut scale =
            Scale { kind, low: 0.0, high: largest, diverging: false, saturated: false, cut: false };
        match kind {
            _ if largest == 0.0 => {}
            ScaleKind::Linear => {}
            ScaleKind::Log => {
                scale.low = smallest.max(largest * 10f64.powf(-DECADES));
                scale.cut = smallest < scale.low;
                if scale.low >= scale.high {
                    scale.low = scale.high / 10.0;
                }
            }
            ScaleKind::Percentile => {
                let rank = (percentile / 100.0 * lit.len() as f64).ceil() as usize;
                let index = rank.clamp(1, lit.len()) - 1;
                scale.high = *lit.select_nth_unstable_by(index, f64::total_cmp).1;
                scale.saturated = scale.high < largest;
            }
        }
        scale
    }

    /// Fits a scale to differences: symmetric around zero, linear up to the largest one or to the percentile.
    pub fn fit_difference(kind: ScaleKind, percentile: f64, values: &Array2<f64>) -> Scale {
        let magnitude = values.mapv(f64::abs);
        let kind = if kind == ScaleKind::Log { ScaleKind::Linear } else { kind };
        let scale = Scale::fit(kind, percentile, [&magnitude]);
        Scale { low: -scale.high, diverging: true, ..scale }
    }

    /// What a value looks like.
    pub fn shade(&self, value: f64) -> Shade {
        if value.is_nan() {
            return Shade::Missing;
        }
        if value == 0.0 && !self.diverging {
            return Shade::Zero;
        }
        if self.high <= self.low {
            return Shade::Part(0.5);
        }
        Shade::Part(self.part(value).clamp(0.0, 1.0))
    }

    /// The position of a value along the colours; beyond 0..=1 outside the scale.
    pub fn part(&self, value: f64) -> f64 {
        match self.kind {
            ScaleKind::Log if !self.diverging => {
                (value / self.low).max(f64::MIN_POSITIVE).ln() / (self.high / self.low).ln()
            }
            _ => (value - self.low) / (self.high - self.low),
        }
    }

    /// The value at a position along the colours.
    pub fn value(&self, part: f64) -> f64 {
        match self.kind {
            ScaleKind::Log if !self.diverging => self.low * (self.high / self.low).powf(part),
            _ => self.low + part * (self.high - self.low),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::array;

    #[test]
    fn zero_looks_like_no_other_value() {
        let values = array![[0.0, 1e-30], [1.0, 10.0]];
        for (kind, _) in ScaleKind::ALL {
            let scale = Scale::fit(kind, 99.0, [&values]);
            assert_eq!(scale.shade(0.0), Shade::Zero, "{kind:?}");
            assert!(matches!(scale.shade(1e-30), Shade::Part(_)), "{kind:?}");
        }
        for (map, name) in ColorMap::ALL {
            assert!(!map.table(false).contains(&ColorMap::ZERO), "{name}");
        }
    }

    #[test]
    fn linear_spans_from_zero_to_the_largest() {
        let scale = Scale::fit(ScaleKind::Linear, 99.0, [&array![[2.0, 4.0]]]);
        assert_eq!(scale.shade(1.0), Shade::Part(0.25));
        assert_eq!(scale.value(0.25), 1.0);
    }

    #[test]
    fn equal_ratios_are_equally_far_apart() {
        let scale = Scale::fit(ScaleKind::Log, 99.0, [&array![[1.0, 100.0, 0.0]]]);
        assert_eq!((scale.low, scale.high, scale.cut), (1.0, 100.0, false));
        assert!((scale.part(10.0) - 0.5).abs() < 1e-12 && (scale.value(0.5) - 10.0).abs() < 1e-9);
        let scale = Scale::fit(ScaleKind::Log, 99.0, [&array![[1e-12, 1.0]]]);
        assert!(scale.cut && (scale.low / 1e-6 - 1.0).abs() < 1e-12);
        assert_eq!(scale.shade(1e-12), Shade::Part(0.0));
    }

    #[test]
    fn a_percentile_counts_what_is_not_zero() {
        let mut values = Array2::zeros((10, 20));
        (0..100).for_each(|index| values[(index / 20, index % 20)] = (index + 1) as f64);
        let scale = Scale::fit(ScaleKind::Percentile, 90.0, [&values]);
        assert_eq!((scale.high, scale.saturated), (90.0, true));
        assert_eq!(scale.shade(95.0), Shade::Part(1.0));
    }

    #[test]
    fn differences_are_symmetric_and_know_no_zero_colour() {
        let scale = Scale::fit_difference(ScaleKind::Log, 99.0, &array![[-3.0, 1.0, f64::NAN]]);
        assert_eq!((scale.low, scale.high), (-3.0, 3.0));
        assert_eq!(scale.shade(0.0), Shade::Part(0.5));
        assert_eq!(scale.shade(f64::NAN), Shade::Missing);
    }

    #[test]
    fn two_maps_share_one_scale() {
        let scale = Scale::fit(ScaleKind::Linear, 99.0, [&array![[1.0]], &array![[8.0]]]);
        assert_eq!(scale.high, 8.0);
    }

    #[test]
    fn a_map_of_zeros_has_a_scale() {
        let scale = Scale::fit(ScaleKind::Log, 99.0, [&array![[0.0]]]);
        assert_eq!(scale.shade(0.0), Shade::Zero);
    }
}
