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

use crate::result::picture::Rgb;
use crate::result::picture::raster::Raster;
use crate::result::picture::scale::{Palette, Scale, Shade};
use crate::result::picture::ticks::{Tick, tick, ticks, ticks_that_fit};

/// Only writing the file can fail; the message is the reason.
pub(crate) type Drawn = Result<(), String>;

const FONT: &str = "nsq-gpu";
const INK: RGBColor = RGBColor(34, 34, 34);
const SOFT: RGBColor = RGBColor(110, 110, 110);
const GRID: RGBColor = RGBColor(228, 228, 228);

/// A rectangle of the picture \[pixels\].
#[derive(Debug, Clone, Copy)]
pub(super) struct Area {
    pub left: i32,
    pub top: i32,
    pub width: i32,
    pub height: i32,
}

/// An axis: its label, the values at its ends, and its ticks.
pub(super) struct Axis {
    pub label: String,
    pub range: (f64, f64),
    pub ticks: Vec<Tick>,
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

impl Area {
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
        let fits = |ticks: &[Tick]| {
            let widest = ticks.iter().map(|(_, label)| text_width(label, text)).max().unwrap_or(0);
            f64::from(widest) * 1.7 * ticks.len() as f64 <= f64::from(length)
        };
        let ticks = ticks_that_fit(range, 9, fits).filter(|ticks| !ticks.is_empty());
        let ends = || vec![tick(0.5 * (range.0 + range.1), range.1 - range.0)];
        Axis { label: label.into(), range, ticks: ticks.unwrap_or_else(ends) }
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

/// Paeth's filter alone makes as small a file as a search for the best filter row by row, in a sixth of the time. It
/// predicts both repeated rows and steps along a row.
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
        // The box of a line has no room for descenders, so that the middle of the digits lies lower than its own.
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
    pub fn note(&self, place: Area, text: &str) -> Drawn {
        let middle = (place.left + place.width / 2, place.top + place.height / 2);
        self.text(text, middle, (self.text, RGBColor(140, 140, 140)), (HPos::Center, VPos::Center))
    }

    /// Says that a map has no colour but the one of zero, if that is so.
    pub fn note_if_dark(&self, place: Area, bar: &ColorBar) -> Drawn {
        let text = if bar.scale.diverging { "no difference" } else { "no rays" };
        if bar.scale.high == 0.0 { self.note(place, text) } else { Ok(()) }
    }

    /// Words beside a point.
    pub fn label(&self, text: &str, at: (i32, i32), horizontal: HPos, vertical: VPos) -> Drawn {
        self.text(text, at, (self.text, INK), (horizontal, vertical))
    }

    /// Pixels of data, their top left corner at the corner of the place.
    pub fn raster(&self, place: Area, raster: Raster) -> Drawn {
        let size = (raster.width as u32, raster.height as u32);
        let element = BitMapElement::with_owned_buffer((place.left, place.top), size, raster.rgb);
        let element: BitMapElement<'_, (i32, i32)> = element.ok_or("a picture of the wrong size")?;
        self.root.draw(&element).map_err(reason)
    }

    /// A thin frame, just outside the pixels of the place.
    pub fn frame(&self, place: Area) -> Drawn {
        let corners = [(place.left - 1, place.top - 1), (place.right(), place.bottom())];
        self.root.draw(&Rectangle::new(corners, INK)).map_err(reason)
    }

    /// Light lines at the ticks.
    pub fn grid(&self, place: Area, x: &Axis, y: &Axis) -> Drawn {
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
    pub fn base_line(&self, place: Area) -> Drawn {
        self.line((place.left, place.bottom()), (place.right(), place.bottom()), INK, 1.0)
    }

    /// Ticks, labels and name below a place.
    pub fn x_axis(&self, place: Area, axis: &Axis) -> Drawn {
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
    pub fn y_axis(&self, place: Area, axis: &Axis) -> Drawn {
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

    /// The colours of a scale, with ticks in a unit whose prefix fits.
    pub fn color_bar(&self, place: Area, bar: &ColorBar) -> Drawn {
        let colors = bar.palette.lookup();
        let mut raster = Raster::filled(place.width as usize, place.height as usize, [0; 3]);
        for (row, pixels) in raster.rgb.chunks_exact_mut(3 * place.width as usize).enumerate() {
            let part = row as f64 / f64::from(place.height - 1).max(1.0);
            let color = colors(Shade::Part(1.0 - part));
            pixels.chunks_exact_mut(3).for_each(|pixel| pixel.copy_from_slice(&color));
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

    /// A curve through points, in a colour.
    pub fn curve(&self, points: Vec<(i32, i32)>, [r, g, b]: Rgb) -> Drawn {
        let style =
            ShapeStyle::from(&RGBColor(r, g, b)).stroke_width((0.14 * self.text).round().max(2.0) as u32);
        // Line by line: a whole path would have spikes where it turns sharply.
        for ends in points.windows(2) {
            self.root.draw(&PathElement::new(ends.to_vec(), style)).map_err(reason)?;
        }
        points.iter().try_for_each(|&at| {
            self.root.draw(&Circle::new(at, style.stroke_width as i32 / 2, style.filled())).map_err(reason)
        })
    }

    /// A light line of a grid through points.
    pub fn grid_line(&self, points: Vec<(i32, i32)>) -> Drawn {
        let style = ShapeStyle::from(&GRID).stroke_width((0.05 * self.text).round().max(1.0) as u32);
        self.root.draw(&PathElement::new(points, style)).map_err(reason)
    }

    /// A filled staircase: `edges` has one value more than `heights`.
    pub fn staircase(&self, place: Area, (x, y): (&Axis, &Axis), edges: &[f64], heights: &[f64]) -> Drawn {
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
    pub fn dot(&self, at: (i32, i32), color: Rgb) -> Drawn {
        let [r, g, b] = color;
        self.root.draw(&Circle::new(at, 0.3 * self.text, RGBColor(r, g, b).filled())).map_err(reason)
    }
}

/// A colour bar in the making.
pub(super) struct ColorBar {
    /// The unit of its labels: how many units of the values it is, and its name.
    pub unit: (f64, String),
    axis: Axis,
    scale: Scale,
    palette: Palette,
}

impl ColorBar {
    /// The bar of a quantity, along `length` pixels.
    pub fn new(
        quantity: &str,
        unit: (f64, String),
        (scale, palette): (Scale, Palette),
        length: i32,
        text: f64,
    ) -> Self {
        const DECADES: usize = 7;
        let label = with_unit(quantity, &unit.1);
        let range = (scale.low / unit.0, scale.high / unit.0);
        let axis = if scale.high <= 0.0 {
            // Without any flux there is one colour, the one of zero, and one honest tick.
            let low = if scale.diverging { -1.0 } else { 0.0 };
            Axis { label, range: (low, 1.0), ticks: vec![(0.0, "0".into())] }
        } else if scale.is_log() {
            let ticks = scale.ticks(unit.0, DECADES).into_iter();
            let ticks = ticks.map(|(value, label)| (value.log10(), label)).collect();
            Axis { label, range: (range.0.log10(), range.1.log10()), ticks }
        } else {
            Axis::vertical(&label, range, length, text)
        };
        ColorBar { unit, axis, scale, palette }
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
    use crate::result::picture::scale::ScaleKind;
    use ndarray::array;

    #[test]
    fn a_map_without_light_has_an_axis_on_any_scale() {
        let dark = array![[0.0]];
        let fit = |kind| Scale::fit(kind, 100.0, [&dark]).in_whole_decades();
        let difference = Scale::fit_difference(ScaleKind::Linear, 100.0, &dark);
        for (scale, low) in [(fit(ScaleKind::Linear), 0.0), (fit(ScaleKind::Log), 0.0), (difference, -1.0)] {
            let bar =
                ColorBar::new("irradiance", (1.0, "W".into()), (scale, Palette::of_files(&scale)), 400, 20.0);
            assert_eq!((bar.axis.range, bar.axis.ticks), ((low, 1.0), vec![(0.0, "0".into())]));
        }
    }
}
