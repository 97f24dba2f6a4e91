//! Curves on logarithmic axes, in panels that share one key.

use std::path::Path;

use plotters::style::text_anchor::{HPos, VPos};

use crate::error::{Error, Result};
use crate::format::{si_prefix, significant};
use crate::result::png::canvas::{self, Axis, Canvas, Drawn, Place, decades, picture, text_width};

/// Panels of curves.
#[derive(Debug, Clone, PartialEq)]
pub struct Curves {
    /// The title.
    pub title: String,
    /// A line below it.
    pub numbers: String,
    /// What runs along x.
    pub x: Quantity,
    /// Names of the curves, the same in every panel; at most as many as [`COLORS`].
    pub series: Vec<String>,
    /// The panels, row by row.
    pub panels: Vec<Panel>,
}

/// What an axis shows.
#[derive(Debug, Clone, PartialEq)]
pub struct Quantity {
    /// Its name.
    pub name: String,
    /// Its unit, which takes SI prefixes: with `%` values are fractions, without a unit they are powers of ten.
    pub unit: &'static str,
}

/// Curves over one pair of axes.
#[derive(Debug, Clone, PartialEq)]
pub struct Panel {
    /// What stands above it.
    pub title: String,
    /// What runs along y.
    pub y: Quantity,
    /// Points (x, y), both positive, by series; those that have none here are empty.
    pub curves: Vec<Vec<(f64, f64)>>,
    /// A dashed line: nothing below it can be told.
    pub floor: Option<f64>,
}

/// Told apart by most of the colour-blind where curves cross; the key names them in their order.
pub const COLORS: [[u8; 3]; 12] = [
    [227, 89, 51],
    [40, 40, 40],
    [64, 150, 190],
    [150, 190, 90],
    [230, 160, 30],
    [87, 16, 110],
    [200, 120, 170],
    [130, 100, 70],
    [0, 130, 110],
    [170, 170, 170],
    [110, 110, 220],
    [190, 30, 90],
];

/// Sizes \[pixels\].
const TEXT: f64 = 21.0;
const PANEL: (i32, i32) = (480, 400);
const COLUMNS: usize = 3;
const GAP: (i32, i32) = (150, 150);
const PAD: i32 = 28;
const HEAD: i32 = 110;
const KEY_ROW: i32 = 34;
const LINE: f64 = 3.0;

/// Draws the panels to `path`, a `.png` file.
///
/// # Errors
/// [`Error::File`] if the file cannot be written.
pub fn write_curves(path: &Path, curves: &Curves) -> Result<()> {
    canvas::register_fonts();
    draw(path, curves).map_err(|error| Error::file(path, error))
}

fn draw(path: &Path, curves: &Curves) -> Drawn {
    let columns = COLUMNS.min(curves.panels.len().max(1)) as i32;
    let rows = curves.panels.len().div_ceil(COLUMNS).max(1) as i32;
    let width = 2 * PAD + columns * (GAP.0 + PANEL.0);
    let key = key_places(&curves.series, width);
    let key_rows = key.last().map_or(0, |(_, row)| row + 1);
    let top = HEAD + KEY_ROW * key_rows;
    let height = top + rows * (GAP.1 + PANEL.1) + PAD;
    picture(path, (width, height), TEXT, |canvas| {
        canvas.title((PAD, PAD), &curves.title, &curves.numbers)?;
        for ((name, color), (left, row)) in curves.series.iter().zip(COLORS).zip(&key) {
            let middle = HEAD + KEY_ROW * row + KEY_ROW / 2;
            let place = Place { left: *left, top: middle - 2, width: 34, height: 4 };
            canvas.fill(place, color)?;
            canvas.dot((left + 17, middle), color)?;
            canvas.label(name, (place.right() + 10, middle), HPos::Left, VPos::Center)?;
        }
        for (i, panel) in (0..).zip(&curves.panels) {
            let (column, row) = (i % columns, i / columns);
            let place = Place {
                left: PAD + GAP.0 - 40 + column * (GAP.0 + PANEL.0),
                top: top + 60 + row * (GAP.1 + PANEL.1),
                width: PANEL.0,
                height: PANEL.1,
            };
            draw_panel(canvas, place, curves, panel)?;
        }
        Ok(())
    })
}

/// Left ends and rows of the key's entries.
fn key_places(series: &[String], width: i32) -> Vec<(i32, i32)> {
    let (mut left, mut row) = (PAD, 0);
    let place = |name: &String| {
        let length = 34 + 10 + text_width(name, TEXT) + 2 * PAD;
        if left + length > width && left > PAD {
            (left, row) = (PAD, row + 1);
        }
        let here = (left, row);
        left += length;
        here
    };
    series.iter().map(place).collect()
}

fn draw_panel(canvas: &Canvas, place: Place, curves: &Curves, panel: &Panel) -> Drawn {
    let points = || panel.curves.iter().flatten();
    let x = axis(&curves.x, points().map(|point| point.0));
    let y = axis(&panel.y, points().map(|point| point.1));
    canvas.grid(place, &x, &y)?;
    if let Some(floor) = panel.floor.map(f64::log10).filter(|floor| *floor > y.range.0) {
        canvas.dashes(place, place.y(floor.min(y.range.1), y.range))?;
    }
    for (curve, color) in panel.curves.iter().zip(COLORS) {
        let at = |(a, b): &(f64, f64)| (place.x(a.log10(), x.range), place.y(b.log10(), y.range));
        let corners: Vec<(i32, i32)> = curve.iter().map(at).collect();
        canvas.curve(&corners, color, LINE)?;
    }
    canvas.x_axis(place, &x)?;
    canvas.y_axis(place, &y)?;
    canvas.frame(place)?;
    let middle = place.left + place.width / 2;
    canvas.label(&panel.title, (middle, place.top - 14), HPos::Center, VPos::Bottom)
}

/// An axis of the logarithms, of a width that holds every point.
fn axis(quantity: &Quantity, values: impl Iterator<Item = f64>) -> Axis {
    const MARGIN: f64 = 0.08;
    let (low, high) = values
        .filter(|value| *value > 0.0)
        .map(f64::log10)
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), value| (low.min(value), high.max(value)));
    let (low, high) = if low <= high { (low, high) } else { (0.0, 1.0) };
    let margin = MARGIN * (high - low).max(1.0);
    let range = (low - margin, high + margin);
    Axis { label: quantity.name.clone(), range, ticks: ticks(range, quantity.unit) }
}

/// Those of [`decades`], with a unit.
fn ticks(range: (f64, f64), unit: &str) -> Vec<(f64, String)> {
    decades(range).map(|value| (value.log10(), tick(value, unit))).collect()
}

fn tick(value: f64, unit: &str) -> String {
    if unit.is_empty() {
        return format!("{value:.0e}").replace('-', "−");
    }
    if unit == "%" {
        return format!("{} %", significant(100.0 * value, 3)).replace('-', "−");
    }
    let (factor, prefix) = si_prefix(value);
    format!("{} {prefix}{unit}", significant(value / factor, 3)).replace('-', "−")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_powers_of_ten_in_their_unit() {
        let seconds = Quantity { name: "time".into(), unit: "s" };
        let labels = |axis: Axis| axis.ticks.into_iter().map(|tick| tick.1).collect::<Vec<_>>();
        assert_eq!(labels(axis(&seconds, [5e-4, 2.0].into_iter())), ["1 ms", "10 ms", "100 ms", "1 s"]);
        let share = Quantity { name: "error".into(), unit: "%" };
        assert_eq!(labels(axis(&share, [5e-4, 0.2].into_iter())), ["0.1 %", "1 %", "10 %"]);
    }

    #[test]
    fn no_points_make_an_axis_all_the_same() {
        let share = Quantity { name: "error".into(), unit: "%" };
        let axis = axis(&share, [].into_iter());
        assert!(axis.range.0 < axis.range.1);
    }

    #[test]
    fn the_key_breaks_into_rows() {
        let series: Vec<String> = (0..12).map(|i| format!("a method of some name {i}")).collect();
        let places = key_places(&series, 900);
        assert!(places.windows(2).all(|pair| pair[0].1 <= pair[1].1));
        assert!(places.last().unwrap().1 > 0);
    }
}
