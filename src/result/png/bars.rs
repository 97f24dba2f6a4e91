//! Bars on a logarithmic axis: values over decades, with the range that each was seen in.

use std::path::Path;

use plotters::style::text_anchor::{HPos, VPos};

use crate::error::{Error, Result};
use crate::format::si_prefix;
use crate::result::png::canvas::{self, Axis, Canvas, Drawn, Place, picture, text_width, with_unit};

/// Groups of bars.
#[derive(Debug, Clone, PartialEq)]
pub struct Bars {
    /// The title.
    pub title: String,
    /// A line below it.
    pub numbers: String,
    /// What the bars measure.
    pub quantity: String,
    /// Its unit.
    pub unit: String,
    /// Names of the bars of a group; one colour each, which come again beyond as many as [`COLORS`].
    pub series: Vec<String>,
    /// The groups, from the top.
    pub groups: Vec<Group>,
}

/// One bar for each series that has one.
#[derive(Debug, Clone, PartialEq)]
pub struct Group {
    /// What stands beside it.
    pub label: String,
    /// True if a gap parts it from the group above.
    pub first_of_section: bool,
    /// The bars, in the order of the series.
    pub bars: Vec<Option<Bar>>,
}

/// A positive value and the range that it was seen in.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Bar {
    /// The length of the bar.
    pub value: f64,
    /// The least.
    pub low: f64,
    /// The greatest.
    pub high: f64,
}

/// Told apart in grey and by the colour-blind.
const COLORS: [[u8; 3]; 7] = [
    [87, 16, 110],
    [227, 89, 51],
    [120, 120, 120],
    [64, 150, 190],
    [150, 190, 90],
    [235, 180, 50],
    [60, 60, 60],
];

/// Sizes \[pixels\].
const TEXT: f64 = 22.0;
const BAR: i32 = 15;
const GROUP_GAP: i32 = 11;
const SECTION_GAP: i32 = 20;
const WIDTH: i32 = 1000;
const HEAD: i32 = 150;
const FOOT: i32 = 90;
const PAD: i32 = 24;

/// Draws the bars to `path`, a `.png` file.
///
/// # Errors
/// [`Error::File`] if the file cannot be written.
pub fn write_bars(path: &Path, bars: &Bars) -> Result<()> {
    canvas::register_fonts();
    draw(path, bars).map_err(|error| Error::file(path, error))
}

fn draw(path: &Path, bars: &Bars) -> Drawn {
    let labels = bars.groups.iter().map(|group| text_width(&group.label, TEXT)).max().unwrap_or(0);
    let height = bars.groups.iter().map(group_height).sum::<i32>() + GROUP_GAP;
    let place = Place { left: PAD + labels + 14, top: HEAD, width: WIDTH, height };
    picture(path, (place.right() + 2 * PAD, place.bottom() + FOOT), TEXT, |canvas| {
        let axis = decades(bars);
        canvas.title((PAD, PAD), &bars.title, &bars.numbers)?;
        key(canvas, (PAD, HEAD - 30), &bars.series)?;
        canvas.grid(place, &axis, &Axis { label: String::new(), range: (0.0, 1.0), ticks: Vec::new() })?;
        let mut top = place.top;
        for group in &bars.groups {
            draw_group(canvas, place, &axis, group, top)?;
            top += group_height(group);
        }
        canvas.x_axis(place, &axis)?;
        canvas.frame(place)
    })
}

fn num_bars(group: &Group) -> i32 {
    group.bars.iter().flatten().count() as i32
}

/// Height of a group and of the gap above it.
fn group_height(group: &Group) -> i32 {
    gap(group) + BAR * num_bars(group)
}

fn gap(group: &Group) -> i32 {
    if group.first_of_section { GROUP_GAP + SECTION_GAP } else { GROUP_GAP }
}

/// An axis of the logarithms, from a power of ten to a power of ten, with a tick at each.
fn decades(bars: &Bars) -> Axis {
    let all = || bars.groups.iter().flat_map(|group| group.bars.iter().flatten());
    let low = all().map(|bar| bar.low).fold(f64::INFINITY, f64::min).log10().floor();
    let high = all().map(|bar| bar.high).fold(0.0, f64::max).log10().ceil();
    let range = if low < high { (low, high) } else { (0.0, 1.0) };
    let tick = |power: i32| {
        let (factor, prefix) = si_prefix(10f64.powi(power));
        (f64::from(power), format!("{} {prefix}", (10f64.powi(power) / factor).round()).trim().to_string())
    };
    Axis {
        label: with_unit(&bars.quantity, &bars.unit),
        range,
        ticks: (range.0 as i32..=range.1 as i32).map(tick).collect(),
    }
}

fn key(canvas: &Canvas, (left, middle): (i32, i32), series: &[String]) -> Drawn {
    let mut left = left;
    for (name, color) in series.iter().zip(COLORS.into_iter().cycle()) {
        let place = Place { left, top: middle - BAR / 2, width: 2 * BAR, height: BAR };
        canvas.fill(place, color)?;
        canvas.label(name, (place.right() + 10, middle), HPos::Left, VPos::Center)?;
        left = place.right() + 10 + text_width(name, TEXT) + 2 * PAD;
    }
    Ok(())
}

fn draw_group(canvas: &Canvas, place: Place, axis: &Axis, group: &Group, top: i32) -> Drawn {
    let mut top = top + gap(group);
    let middle = top + BAR * num_bars(group) / 2;
    canvas.label(&group.label, (place.left - 14, middle), HPos::Right, VPos::Center)?;
    for (bar, color) in group.bars.iter().zip(COLORS.into_iter().cycle()) {
        let Some(bar) = bar else { continue };
        let end = |value: f64| place.x(value.log10(), axis.range);
        canvas.fill(
            Place { left: place.left, top, width: end(bar.value) - place.left, height: BAR - 2 },
            color,
        )?;
        canvas.whisker((end(bar.low), end(bar.high)), top + (BAR - 2) / 2)?;
        top += BAR;
    }
    Ok(())
}
