//! Turns values into colours: linear, logarithmic, or linear up to a percentile.
//!
//! Colours are perceptually even, and their brightness rises with the value. The colours of differences diverge from a
//! neutral middle. In the window a zero is a finding of its own, with a colour that no other value has.

use crate::format::{si_prefix, significant};
use crate::result::picture::Rgb;
use crate::result::picture::srgb;
use crate::result::picture::ticks::{Tick, decades, ticks, with_minus};
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
    /// For differences: red where A is larger.
    RedBlue,
    /// The colours of the light itself; of what has no colour, white light.
    TrueColor,
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

/// The colours of the shades.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Palette {
    colors: ColorMap,
    /// The part at the beginning of the colours that only zero may have.
    reserved: f64,
    /// The colour of exactly zero.
    pub zero: Rgb,
    /// The colour where there is no value.
    pub missing: Rgb,
}

/// Most decades of a logarithmic scale.
const DECADES: f64 = 6.0;
/// The part of a colour map that faint light leaves to zero.
const RESERVED: f64 = 0.1;

impl ScaleKind {
    /// All, in the order in which they are offered.
    pub const ALL: [(ScaleKind, &'static str); 3] =
        [(ScaleKind::Linear, "Linear"), (ScaleKind::Log, "Log"), (ScaleKind::Percentile, "Percentile")];
}

impl ColorMap {
    /// All that are offered, in this order.
    pub const ALL: [(ColorMap, &'static str); 6] = [
        (ColorMap::Inferno, "Inferno"),
        (ColorMap::Magma, "Magma"),
        (ColorMap::Viridis, "Viridis"),
        (ColorMap::Cividis, "Cividis"),
        (ColorMap::Grey, "Grey"),
        (ColorMap::TrueColor, "True colour"),
    ];

    fn color(self, position: f64) -> Rgb {
        let (gradient, position) = match self {
            ColorMap::TrueColor => return srgb::white(position),
            ColorMap::Inferno => (colorous::INFERNO, position),
            ColorMap::Magma => (colorous::MAGMA, position),
            ColorMap::Viridis => (colorous::VIRIDIS, position),
            ColorMap::Cividis => (colorous::CIVIDIS, position),
            // These gradients of colorous run the other way.
            ColorMap::Grey => (colorous::GREYS, 1.0 - position),
            ColorMap::RedBlue => (colorous::RED_BLUE, 1.0 - position),
        };
        gradient.eval_continuous(position).into_array()
    }
}

impl Palette {
    /// The colours of `.png` files: zero is black, and a linear scale begins with it. Faint light has another colour than
    /// none on a logarithmic scale.
    pub fn of_files(scale: &Scale) -> Self {
        let reserved = if scale.is_log() { RESERVED } else { 0.0 };
        let colors = if scale.diverging { ColorMap::RedBlue } else { ColorMap::Inferno };
        Palette { colors, reserved, zero: ColorMap::Inferno.color(0.0), missing: [255; 3] }
    }

    /// True colours: black where there is no light. On a logarithmic scale, faint light is brighter than black.
    pub fn of_true_colors(scale: &Scale, missing: Rgb) -> Self {
        let reserved = if scale.is_log() { RESERVED } else { 0.0 };
        Palette { colors: ColorMap::TrueColor, reserved, zero: [0; 3], missing }
    }

    /// The colours of the window, with `missing` where there is no value.
    pub fn of_window(map: ColorMap, scale: &Scale, missing: Rgb) -> Self {
        let (colors, reserved) = match (scale.diverging, map) {
            (true, _) => (ColorMap::RedBlue, 0.0),
            (false, ColorMap::TrueColor) => return Palette::of_true_colors(scale, missing),
            (false, map) => (map, RESERVED),
        };
        Palette { colors, reserved, zero: [12, 13, 17], missing }
    }

    /// The colour at a position along the colours, in 0..=1.
    pub fn at(&self, part: f64) -> Rgb {
        self.colors.color(self.position(part))
    }

    pub(crate) fn position(&self, part: f64) -> f64 {
        self.reserved + (1.0 - self.reserved) * part
    }

    /// Looks up the colours of many shades.
    pub fn lookup(self) -> impl Fn(Shade) -> Rgb {
        /// Finer than the 8 bits of a colour; a picture has more pixels than that.
        const LEVELS: usize = 1 << 12;
        let color = |level: usize| self.colors.color(level as f64 / LEVELS as f64);
        let table: Vec<Rgb> = (0..=LEVELS).map(color).collect();
        move |shade| match shade {
            Shade::Missing => self.missing,
            Shade::Zero => self.zero,
            Shade::Part(part) => table[(self.position(part) * LEVELS as f64).round() as usize],
        }
    }
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

    /// True if equal ratios look equally far apart.
    pub fn is_log(&self) -> bool {
        self.kind == ScaleKind::Log && !self.diverging
    }

    /// The scale over whole decades, if it is logarithmic.
    pub fn in_whole_decades(self) -> Scale {
        if !self.is_log() || self.high <= self.low {
            return self;
        }
        let decades = (self.high / self.low).log10().ceil().clamp(1.0, DECADES);
        Scale { low: 10f64.powf(-decades) * self.high, ..self }
    }

    /// Round values along the scale, in a unit that is so many of the scale's.
    pub fn ticks(&self, unit: f64, count: usize) -> Vec<Tick> {
        let (low, high) = (self.low / unit, self.high / unit);
        if self.is_log() {
            let label = |value| (value, with_minus(&significant(value, 3)));
            return decades((low.log10(), high.log10()), count).map(label).collect();
        }
        ticks((low, high), count)
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
        if self.is_log() {
            (value / self.low).max(f64::MIN_POSITIVE).ln() / (self.high / self.low).ln()
        } else {
            (value - self.low) / (self.high - self.low)
        }
    }

    /// The value at a position along the colours.
    pub fn value(&self, part: f64) -> f64 {
        if self.is_log() {
            self.low * (self.high / self.low).powf(part)
        } else {
            self.low + part * (self.high - self.low)
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
        let scale = Scale::fit(ScaleKind::Log, 99.0, [&values]);
        let palettes = ColorMap::ALL.map(|(map, _)| Palette::of_window(map, &scale, [255; 3]));
        for palette in palettes.into_iter().chain([Palette::of_files(&scale)]) {
            let mut colors = (0..=255).map(|level| palette.at(f64::from(level) / 255.0));
            assert!(colors.all(|color| color != palette.zero), "{palette:?}");
            assert_eq!(palette.lookup()(Shade::Zero), palette.zero);
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
    fn logarithmic_pictures_have_whole_decades() {
        let fit = |values: &Array2<f64>| Scale::fit(ScaleKind::Log, 99.0, [values]).in_whole_decades();
        let scale = fit(&array![[0.0, 1e-9, 1e-4, 1e-2, 1.0]]);
        let part = |value: f64| {
            let Shade::Part(part) = scale.shade(value) else { panic!("{value} has no colour of its own") };
            part
        };
        assert_eq!(part(1e-9), 0.0, "below all decades, yet a colour");
        for (value, expected) in [(1e-4, 1.0 / 3.0), (1e-2, 2.0 / 3.0), (1.0, 1.0)] {
            assert!((part(value) - expected).abs() < 1e-12, "{value}");
        }
        let scale = fit(&array![[0.5, 0.2, 1.0]]);
        assert!((scale.low - 0.1).abs() < 1e-15);
        assert_eq!(scale.ticks(1e-3, 7).last().map(|tick| tick.1.as_str()), Some("1000"));
        assert_eq!(fit(&array![[0.0]]).high, 0.0);
    }

    #[test]
    fn a_difference_is_red_above_zero_blue_below_and_white_between() {
        let scale = Scale::fit_difference(ScaleKind::Linear, 100.0, &array![[-2.0, 0.0, 1.0]]);
        assert_eq!(scale.high, 2.0);
        let palette = Palette::of_files(&scale).lookup();
        let [[b0, _, b2], white, [r0, _, r2]] = [-2.0, 0.0, 1.0].map(|value| palette(scale.shade(value)));
        assert!(b2 > b0 + 50 && r0 > r2 + 50, "{b0} {b2} {r0} {r2}");
        assert!(white.iter().all(|part| *part > 235), "{white:?}");
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
