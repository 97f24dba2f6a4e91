//! The parts that every figure is made of: text, frame, axes, colour bar.

use std::fs::File;
use std::io::BufWriter;
use std::path::Path;
use std::sync::Once;

use plotters::coord::Shift;
use plotters::element::BitMapElement;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};
use plotters::style::{FontStyle, FontTransform, register_font};

use crate::format::significant;
use crate::result::png::raster::{Colors, Raster};

/// Only writing the file can fail; the message is the reason.
pub(crate) type Drawn = Result<(), String>;

const FONT: &str = "nsq-gpu";
const INK: RGBColor = RGBColor(34, 34, 34);
const SOFT: RGBColor = RGBColor(110, 110, 110);
const GRID: RGBColor = RGBColor(228, 228, 228);

/// A rectangle of the picture \[pixels\].
#[derive(Debug, Clone, Copy)]
pub(super) struct Place {
    pub left: i32,
    pub top: i32,
    pub width: i32,
    pub height: i32,
}

/// An axis: its label, the values at its ends, and its ticks.
pub(super) struct Axis {
    pub label: String,
    pub range: (f64, f64),
    pub ticks: Vec<(f64, String)>,
}

/// A picture in the making. Every size is a multiple of `text`, the size of the tick labels \[pixels\].
pub(super) struct Canvas<'a> {
    root: DrawingArea<BitMapBackend<'a>, Shift>,
    text: f64,
}

/// Text is drawn with a font that the program carries: there may be none on the machine.
pub(super) fn register_fonts() {
    static ONCE: Once = Once::new();
    ONCE.call_once(|| {
        let _ = register_font(FONT, FontStyle::Normal, epaint_default_fonts::UBUNTU_LIGHT);
    });
}

/// Width of a line of text \[pixels\].
pub(super) fn text_width(text: &str, size: f64) -> i32 {
    (FONT, size).into_font().box_size(&spaced(text)).map_or(0, |(width, _)| width as i32)
}

/// Glyphs are drawn without the white on their left, which narrows the space before a word: two make up for it.
fn spaced(text: &str) -> String {
    text.replace(' ', "  ")
}

impl Place {
    pub fn right(self) -> i32 {
        self.left + self.width
    }

    pub fn bottom(self) -> i32 {
        self.top + self.height
    }

    /// The horizontal position of a value.
    pub fn x(self, value: f64, (low, high): (f64, f64)) -> i32 {
        self.left + ((value - low) / (high - low) * f64::from(self.width)).round() as i32
    }

    /// The vertical position of a value; values grow upwards.
    pub fn y(self, value: f64, (low, high): (f64, f64)) -> i32 {
        self.bottom() - ((value - low) / (high - low) * f64::from(self.height)).round() as i32
    }
}

impl Axis {
    /// An axis along `length` pixels whose labels stand side by side.
    pub fn horizontal(label: &str, range: (f64, f64), length: i32, text: f64) -> Self {
        let fits = |ticks: &Vec<(f64, String)>| {
            let widest = ticks.iter().map(|(_, label)| text_width(label, text)).max().unwrap_or(0);
            f64::from(widest) * 1.7 * ticks.len() as f64 <= f64::from(length)
        };
        let ticks = (2..=9).rev().map(|count| ticks(range, count)).find(fits);
        let ends = || vec![tick(0.5 * (range.0 + range.1), range.1 - range.0)];
        Axis {
            label: label.into(),
            range,
            ticks: ticks.filter(|ticks| !ticks.is_empty()).unwrap_or_else(ends),
        }
    }

    /// An axis along `length` pixels whose labels stand one above the other.
    pub fn vertical(label: &str, range: (f64, f64), length: i32, text: f64) -> Self {
        let count = (f64::from(length) / (2.2 * text)).clamp(2.0, 9.0) as usize;
        Axis { label: label.into(), range, ticks: ticks(range, count) }
    }

    /// Width of the widest label \[pixels\].
    pub fn label_width(&self, text: f64) -> i32 {
        self.ticks.iter().map(|(_, label)| text_width(label, text)).max().unwrap_or(0)
    }
}

/// At most `count` round values within a range, a step of 1, 2 or 5 times a power of ten apart, with their labels.
pub(crate) fn ticks((low, high): (f64, f64), count: usize) -> Vec<(f64, String)> {
    let span = high - low;
    let power = 10f64.powf((span / count as f64).log10().floor());
    let steps = [1.0, 2.0, 5.0, 10.0, 20.0].map(|factor| factor * power);
    let indices = |step: f64| ((low / step - 1e-9).ceil() as i64)..=((high / step + 1e-9).floor() as i64);
    let fits = |step: &&f64| indices(**step).count() <= count;
    let step = steps.iter().find(fits).copied().unwrap_or(20.0 * power);
    indices(step).map(|index| tick(index as f64 * step, step)).collect()
}

/// A tick labelled with the decimals that a step needs, so that all labels of an axis have the same, and with a true
/// minus sign.
fn tick(value: f64, step: f64) -> (f64, String) {
    const MOST_DECIMALS: f64 = 6.0;
    let decimals = (-(step.log10() + 1e-9).floor()).max(0.0);
    let label = if value.abs() < 1e-6 * step {
        "0".into()
    } else if decimals <= MOST_DECIMALS && value.abs() < 1e7 {
        format!("{value:.*}", decimals as usize)
    } else {
        significant(value, 6)
    };
    (value, label.replace('-', "−"))
}

/// Powers of ten between two of their logarithms, all or every second and so on; over less than two of them also twice and
/// five times a power.
pub(super) fn decades((low, high): (f64, f64)) -> impl Iterator<Item = f64> {
    const ROUNDING: f64 = 1e-9;
    let factors: &[f64] = if high - low < 2.0 { &[1.0, 2.0, 5.0] } else { &[1.0] };
    let every = 1 + (high - low) as i32 / 7;
    let powers = (low.floor() as i32..=high.ceil() as i32).filter(move |power| power % every == 0);
    let values = powers.flat_map(move |power| factors.iter().map(move |factor| factor * 10f64.powi(power)));
    values.filter(move |value| (low - ROUNDING..=high + ROUNDING).contains(&value.log10()))
}

/// The name of an axis with its unit.
pub(super) fn with_unit(name: &str, unit: &str) -> String {
    format!("{name} [{unit}]")
}

/// Draws on a white picture, and writes it to `path`.
pub(super) fn picture(
    path: &Path,
    (width, height): (i32, i32),
    text: f64,
    draw: impl FnOnce(&Canvas) -> Drawn,
) -> Drawn {
    let size = (width as u32, height as u32);
    let mut rgb = vec![255; 3 * width as usize * height as usize];
    let root = BitMapBackend::with_buffer(&mut rgb, size).into_drawing_area();
    draw(&Canvas { root, text })?;
    write(path, size, &rgb).map_err(reason)
}

/// Of all filters, Paeth's alone makes as small a file as a search for the best one row by row, in a sixth of the time: it
/// sees both rows like the ones before and steps along a row.
fn write(path: &Path, (width, height): (u32, u32), rgb: &[u8]) -> Result<(), png::EncodingError> {
    let mut encoder = png::Encoder::new(BufWriter::new(File::create(path)?), width, height);
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_depth(png::BitDepth::Eight);
    encoder.set_compression(png::Compression::Fast);
    encoder.set_filter(png::FilterType::Paeth);
    let mut writer = encoder.write_header()?;
    writer.write_image_data(rgb)?;
    writer.finish()
}

impl Canvas<'_> {
    fn line(&self, from: (i32, i32), to: (i32, i32), color: RGBColor, width: f64) -> Drawn {
        let style = ShapeStyle::from(&color).stroke_width(width.round().max(1.0) as u32);
        self.root.draw(&PathElement::new(vec![from, to], style)).map_err(reason)
    }

    fn text(
        &self,
        text: &str,
        at: (i32, i32),
        (size, color): (f64, RGBColor),
        (h, v): (HPos, VPos),
    ) -> Drawn {
        // The box of a line has no room for descenders, so that its middle is not that of the digits.
        let lower = if matches!(v, VPos::Center) { (0.13 * size).round() as i32 } else { 0 };
        let style = (FONT, size).into_font().color(&color).pos(Pos::new(h, v));
        self.root.draw_text(&spaced(text), &style, (at.0, at.1 + lower)).map_err(reason)
    }

    fn upright_text(&self, text: &str, at: (i32, i32)) -> Drawn {
        let font = (FONT, self.text).into_font().transform(FontTransform::Rotate270);
        let style = font.color(&INK).pos(Pos::new(HPos::Center, VPos::Center));
        self.root.draw_text(&spaced(text), &style, at).map_err(reason)
    }

    /// A title, and below it a line with the numbers.
    pub fn title(&self, (left, top): (i32, i32), title: &str, numbers: &str) -> Drawn {
        self.text(title, (left, top), (1.45 * self.text, INK), (HPos::Left, VPos::Top))?;
        let below = top + (1.75 * self.text) as i32;
        self.text(numbers, (left, below), (0.95 * self.text, SOFT), (HPos::Left, VPos::Top))
    }

    /// Words in the middle of a place, readable on black and on white.
    pub fn note(&self, place: Place, text: &str) -> Drawn {
        let middle = (place.left + place.width / 2, place.top + place.height / 2);
        self.text(text, middle, (self.text, RGBColor(140, 140, 140)), (HPos::Center, VPos::Center))
    }

    /// Words beside a point.
    pub fn label(&self, text: &str, at: (i32, i32), horizontal: HPos, vertical: VPos) -> Drawn {
        self.text(text, at, (self.text, INK), (horizontal, vertical))
    }

    /// Pixels of data, their top left corner at the corner of the place.
    pub fn raster(&self, place: Place, raster: Raster) -> Drawn {
        let size = (raster.width as u32, raster.height as u32);
        let element = BitMapElement::with_owned_buffer((place.left, place.top), size, raster.rgb);
        let element: BitMapElement<'_, (i32, i32)> = element.ok_or("a picture of the wrong size")?;
        self.root.draw(&element).map_err(reason)
    }

    /// A thin frame, just outside the pixels of the place.
    pub fn frame(&self, place: Place) -> Drawn {
        let corners = [(place.left - 1, place.top - 1), (place.right(), place.bottom())];
        self.root.draw(&Rectangle::new(corners, INK)).map_err(reason)
    }

    /// Light lines at the ticks.
    pub fn grid(&self, place: Place, x: &Axis, y: &Axis) -> Drawn {
        for (value, _) in &x.ticks {
            let at = place.x(*value, x.range);
            self.line((at, place.top), (at, place.bottom()), GRID, 0.05 * self.text)?;
        }
        for (value, _) in &y.ticks {
            let at = place.y(*value, y.range);
            self.line((place.left, at), (place.right(), at), GRID, 0.05 * self.text)?;
        }
        Ok(())
    }

    /// A thin line along the lower edge of a place.
    pub fn base_line(&self, place: Place) -> Drawn {
        self.line((place.left, place.bottom()), (place.right(), place.bottom()), INK, 1.0)
    }

    /// Ticks, labels and name below a place.
    pub fn x_axis(&self, place: Place, axis: &Axis) -> Drawn {
        let (reach, width) = ((0.3 * self.text) as i32, 0.045 * self.text);
        for (value, label) in &axis.ticks {
            let at = place.x(*value, axis.range);
            self.line((at, place.bottom()), (at, place.bottom() + reach), INK, width)?;
            let below = (at, place.bottom() + reach + (0.25 * self.text) as i32);
            self.text(label, below, (self.text, INK), (HPos::Center, VPos::Top))?;
        }
        let middle = (place.left + place.width / 2, place.bottom() + (1.9 * self.text) as i32);
        self.text(&axis.label, middle, (self.text, INK), (HPos::Center, VPos::Top))
    }

    /// Ticks, labels and name to the left of a place.
    pub fn y_axis(&self, place: Place, axis: &Axis) -> Drawn {
        let (reach, width) = ((0.3 * self.text) as i32, 0.045 * self.text);
        let edge = place.left - reach - (0.3 * self.text) as i32;
        for (value, label) in &axis.ticks {
            let at = place.y(*value, axis.range);
            self.line((place.left - 1 - reach, at), (place.left - 1, at), INK, width)?;
            self.text(label, (edge, at), (self.text, INK), (HPos::Right, VPos::Center))?;
        }
        let middle = edge - axis.label_width(self.text) - (0.95 * self.text) as i32;
        self.upright_text(&axis.label, (middle, place.top + place.height / 2))
    }

    /// The colours from zero to the top value, with ticks in a unit whose prefix fits.
    pub fn color_bar(&self, place: Place, bar: &ColorBar) -> Drawn {
        let mut raster = Raster::filled(place.width as usize, place.height as usize, [0; 3]);
        for (row, pixels) in raster.rgb.chunks_exact_mut(3 * place.width as usize).enumerate() {
            let part = row as f64 / f64::from(place.height - 1).max(1.0);
            let color = bar.colors.color(bar.colors.fraction(part));
            pixels.chunks_exact_mut(3).for_each(|pixel| pixel.copy_from_slice(&[color.r, color.g, color.b]));
        }
        self.raster(place, raster)?;
        self.frame(place)?;
        let (reach, width) = ((0.3 * self.text) as i32, 0.045 * self.text);
        let edge = place.right() + reach + (0.3 * self.text) as i32;
        for (value, label) in &bar.axis.ticks {
            let at = place.y(*value, bar.axis.range);
            self.line((place.right(), at), (place.right() + reach, at), INK, width)?;
            self.text(label, (edge, at), (self.text, INK), (HPos::Left, VPos::Center))?;
        }
        let middle = edge + bar.axis.label_width(self.text) + (0.95 * self.text) as i32;
        self.upright_text(&bar.axis.label, (middle, place.top + place.height / 2))
    }

    /// A filled staircase: `edges` has one value more than `heights`.
    pub fn staircase(&self, place: Place, (x, y): (&Axis, &Axis), edges: &[f64], heights: &[f64]) -> Drawn {
        let mut line = vec![(place.x(edges[0], x.range), place.bottom())];
        for (edge, height) in edges.windows(2).zip(heights) {
            let level = place.y(*height, y.range);
            line.extend(edge.iter().map(|&edge| (place.x(edge, x.range), level)));
        }
        line.push((place.x(edges[edges.len() - 1], x.range), place.bottom()));
        let (fill, edge) = (RGBColor(221, 213, 232), RGBColor(87, 16, 110));
        self.root.draw(&Polygon::new(line.clone(), fill.filled())).map_err(reason)?;
        let style = ShapeStyle::from(&edge).stroke_width((0.09 * self.text).round().max(1.0) as u32);
        self.root.draw(&PathElement::new(line, style)).map_err(reason)
    }

    /// A dot, as the key to a colour.
    pub fn dot(&self, at: (i32, i32), color: [u8; 3]) -> Drawn {
        let [r, g, b] = color;
        self.root.draw(&Circle::new(at, 0.3 * self.text, RGBColor(r, g, b).filled())).map_err(reason)
    }
}

/// A colour bar in the making.
pub(super) struct ColorBar {
    /// The unit of its labels: how many units of the values it is, and its name.
    pub unit: (f64, String),
    axis: Axis,
    colors: Colors,
}

impl ColorBar {
    /// The bar of a quantity up to `top`, along `length` pixels.
    pub fn new(
        quantity: &str,
        unit: (f64, String),
        (top, colors): (f64, Colors),
        length: i32,
        text: f64,
    ) -> Self {
        let label = with_unit(quantity, &unit.1);
        let range = (colors.fraction(1.0) * top / unit.0, top / unit.0);
        let axis = match colors {
            // Without any flux there is one colour, that of zero, and one honest tick.
            _ if top <= 0.0 => {
                Axis { label, range: (colors.fraction(1.0).min(0.0), 1.0), ticks: vec![(0.0, "0".into())] }
            }
            Colors::Log(_) => {
                let range = (range.0.log10(), range.1.log10());
                let label_of = |value: f64| (value.log10(), significant(value, 3).replace('-', "−"));
                Axis { label, range, ticks: decades(range).map(label_of).collect() }
            }
            Colors::Rising | Colors::Diverging => Axis::vertical(&label, range, length, text),
        };
        ColorBar { unit, axis, colors }
    }

    /// What a map says that has no colour but that of zero.
    pub fn note(&self) -> &'static str {
        match self.colors {
            Colors::Rising | Colors::Log(_) => "no rays",
            Colors::Diverging => "no difference",
        }
    }

    /// Width of ticks, labels and name, right of the colours \[pixels\].
    pub fn margin(&self, text: f64) -> i32 {
        (2.3 * text) as i32 + self.axis.label_width(text)
    }
}

fn reason(error: impl std::fmt::Display) -> String {
    error.to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn labels(range: (f64, f64), count: usize) -> Vec<String> {
        ticks(range, count).into_iter().map(|(_, label)| label).collect()
    }

    #[test]
    fn a_map_without_light_has_an_axis_on_any_scale() {
        for (colors, low) in [(Colors::Rising, 0.0), (Colors::Log(0), 0.0), (Colors::Diverging, -1.0)] {
            let bar = ColorBar::new("irradiance", (1.0, "W".into()), (0.0, colors), 400, 20.0);
            assert_eq!((bar.axis.range, bar.axis.ticks), ((low, 1.0), vec![(0.0, "0".into())]));
        }
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
}
