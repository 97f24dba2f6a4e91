//! Figures: a map, a map above a spectrum, directions, and spots. Kinds of detectors pick one.

use std::path::Path;

use plotters::style::text_anchor::{HPos, VPos};

use crate::format::{self, si_prefix, significant, thousands, with_prefix};
use crate::result::picture::Rgb;
use crate::result::picture::polar::{Disc, Window};
use crate::result::picture::pyramid::Pyramid;
use crate::result::picture::raster::{Means, Raster, runs};
use crate::result::picture::scale::{Palette, Scale, ScaleKind};
use crate::result::picture::true_color::TrueColors;
pub(crate) use crate::result::png::canvas::Drawn;
use crate::result::png::canvas::{Area, Axis, Canvas, ColorBar, picture, text_width, with_unit};
use crate::result::png::style::Style;
use ndarray::Array2;

/// What pictures of far fields say of their cells.
pub(super) const EQUAL_CELLS: &str = "cells of equal solid angle";

/// Sizes in multiples of the text size.
const PAD: f64 = 1.0;
const HEAD: f64 = 4.6;
const FOOT: f64 = 4.2;
const BAR_GAP: f64 = 1.0;
const BAR_WIDTH: f64 = 1.1;
const LEAST_HEIGHT: f64 = 9.0;
const LEAST_WIDTH: f64 = 22.0;

/// Text grows with the data, so that a large picture shrunk to a page still reads.
fn text_size(data: (usize, usize)) -> f64 {
    let (long, short) = (data.0.max(data.1) as f64, data.0.min(data.1) as f64);
    ((0.6 * long + 0.4 * short) / 38.0).clamp(20.0, 60.0).round()
}

/// Where the parts of a figure go: data on the left, a key on the right, a head above, axes around.
struct FigureLayout {
    data: Area,
    /// The place of the colours of a colour bar.
    bar: Area,
    head: (i32, i32),
    size: (i32, i32),
}

/// What a layout has to make room for.
struct Parts<'a> {
    data: (usize, usize),
    text: f64,
    /// Width of the labels of the y axis, and of all right of the colour bar \[pixels\].
    y_labels: i32,
    key: i32,
    /// Height of what comes below the x axis \[pixels\].
    below: i32,
    title: &'a str,
    numbers: &'a str,
}

impl FigureLayout {
    fn new(parts: &Parts) -> Self {
        let px = |times: f64| (times * parts.text).round() as i32;
        let (width, height) = (parts.data.0 as i32, parts.data.1 as i32);
        let room = height.max(px(LEAST_HEIGHT));
        let left = px(PAD) + px(2.1) + parts.y_labels;
        let data = Area { left, top: px(HEAD), width, height };
        let bar =
            Area { left: data.right() + px(BAR_GAP), top: px(HEAD), width: px(BAR_WIDTH), height: room };
        let head_width =
            text_width(parts.title, 1.45 * parts.text).max(text_width(parts.numbers, 0.95 * parts.text));
        let right = (bar.right() + parts.key).max(left + head_width).max(px(LEAST_WIDTH)) + px(PAD);
        let bottom = px(HEAD) + (height + px(FOOT)).max(room + px(PAD)) + parts.below;
        FigureLayout { data, bar, head: (left, px(PAD)), size: (right, bottom) }
    }
}

/// An axis of a map.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Span {
    /// Its name, and its unit.
    pub label: (&'static str, &'static str),
    /// Its ends.
    pub range: (f64, f64),
}

/// What the head of a figure says, whatever the kind of detector.
pub(crate) struct Head<'a> {
    /// The user's name for the detector.
    pub name: &'a str,
    /// Rays recorded.
    pub num_rays_hit: u64,
    /// Flux, and its unit.
    pub flux: (f64, &'static str),
    /// What maps are called, and the unit of their values.
    pub quantity: (&'static str, &'static str),
    /// How values are shown.
    pub style: Style,
    /// The colours of the light, if they are shown.
    pub colors: Option<&'a TrueColors>,
}

/// The line of numbers below a title.
fn numbers(head: &Head, peak: Option<(f64, &ColorBar)>) -> String {
    numbers_of(head, peak.map(|(peak, bar)| (peak, &bar.unit)))
}

/// The same with the unit of the peak: how many of the values' unit it is, and its name.
pub(super) fn numbers_of(head: &Head, peak: Option<(f64, &(f64, String))>) -> String {
    let mut parts =
        vec![format!("{} rays", thousands(head.num_rays_hit)), with_prefix(head.flux.0, head.flux.1)];
    parts.extend(peak.map(|(peak, (factor, unit))| format!("peak {} {unit}", significant(peak / factor, 4))));
    parts.join(" · ")
}

/// Irradiance over x and y, true to scale.
pub(crate) fn map(path: &Path, head: &Head, size: (f64, f64), values: &Array2<f64>) -> Drawn {
    let panel = MapPanel::new(size, values, head);
    let numbers = numbers(head, Some((maximum(values), &panel.bar)));
    panel.write(path, head, &numbers)
}

/// What a map differs by, cell by cell, with zero white. `numbers` stand below the name.
pub(crate) fn difference(
    path: &Path,
    head: &Head,
    numbers: &str,
    spans: [Span; 2],
    (name, unit): (&str, &str),
    values: &Array2<f64>,
) -> Drawn {
    let name = format!("{name}, A − B");
    MapPanel::of_spans(spans, (&name, unit), values, (None, head.style), None).write(path, head, numbers)
}

/// Irradiance over all wavelengths, and below it the spectrum: edges of bins \[um\], and the flux of each \[W\].
pub(crate) fn map_and_spectrum(
    path: &Path,
    head: &Head,
    size: (f64, f64),
    broadband: &Array2<f64>,
    bins: (&[f64], &[f64]),
) -> Drawn {
    let panel = MapPanel::new(size, broadband, head);
    let numbers = numbers(head, Some((maximum(broadband), &panel.bar)));
    let text = panel.text;
    let px = |times: f64| (times * text).round() as i32;
    let layout = panel.layout(head, &numbers, px(9.0 + FOOT));
    picture(path, layout.size, text, |canvas| {
        canvas.title(layout.head, &format::shown(head.name), &numbers)?;
        panel.draw(canvas, &layout)?;
        let width = layout.data.width.max(px(16.0)).min(layout.size.0 - layout.data.left - px(PAD));
        let place = Area { width, height: px(8.0), top: layout.size.1 - px(8.0 + FOOT), ..layout.data };
        spectrum(canvas, place, text, bins)
    })
}

fn spectrum(canvas: &Canvas, place: Area, text: f64, (edges, fluxes): (&[f64], &[f64])) -> Drawn {
    let top = fluxes.iter().copied().fold(0.0, f64::max);
    let (factor, prefix) = si_prefix(top);
    let heights: Vec<f64> = fluxes.iter().map(|flux| flux / factor).collect();
    let x = Axis::horizontal(
        &with_unit("Wavelength", "µm"),
        (edges[0], edges[edges.len() - 1]),
        place.width,
        text,
    );
    let high = if top > 0.0 { 1.08 * top / factor } else { 1.0 };
    let y = Axis::vertical(
        &with_unit("Flux per bin", &format!("{prefix}W")),
        (0.0, high),
        place.height / 2,
        text,
    );
    canvas.grid(place, &x, &y)?;
    canvas.staircase(place, (&x, &y), edges, &heights)?;
    canvas.frame(place)?;
    canvas.x_axis(place, &x)?;
    canvas.y_axis(place, &y)
}

/// A map with its axes and its colour bar.
struct MapPanel {
    raster: Raster,
    text: f64,
    x: Axis,
    y: Axis,
    bar: ColorBar,
}

impl MapPanel {
    fn new((width, height): (f64, f64), values: &Array2<f64>, head: &Head) -> Self {
        let span = |name, size: f64| Span { label: (name, "mm"), range: (-size / 2.0, size / 2.0) };
        let spans = [span("x", width), span("y", height)];
        Self::of_spans(spans, head.quantity, values, (Some(head.style.scale()), head.style), head.colors)
    }

    /// A map in the colours of a kind of scale, of differences, or of the light.
    fn of_spans(
        [x, y]: [Span; 2],
        (name, unit): (&str, &str),
        values: &Array2<f64>,
        (kind, style): (Option<ScaleKind>, Style),
        colors: Option<&TrueColors>,
    ) -> Self {
        let (ny, nx) = values.dim();
        let length = |span: &Span| span.range.1 - span.range.0;
        let size = map_size((length(&x), length(&y)), (nx, ny));
        let text = text_size(size);
        let whole = Pyramid::default();
        let along = |cells: usize, pixels: usize| runs((0.0, cells as f64), cells, pixels);
        let (rows, columns) = (along(ny, size.1), along(nx, size.0));
        let means = Means::new(&whole.level(values, 1.0), &rows, &columns);
        let scale = match kind {
            Some(kind) => fitted(kind, &means.values),
            None => Scale::fit_difference(ScaleKind::Linear, 100.0, &means.values),
        };
        let palette = palette(&scale, colors);
        let raster = match colors {
            Some(colors) => colors.pixels(1.0, (&rows, &columns), (&scale, &palette)),
            None => {
                let color = palette.lookup();
                means.paint(|value| color(scale.shade(value)))
            }
        };
        let bar_length = (size.1 as f64).max(LEAST_HEIGHT * text) as i32;
        let unit = style.unit_of(unit, scale.high);
        MapPanel {
            text,
            x: Axis::horizontal(&with_unit(x.label.0, x.label.1), x.range, size.0 as i32, text),
            y: Axis::vertical(&with_unit(y.label.0, y.label.1), y.range, size.1 as i32, text),
            bar: ColorBar::new(name, unit, (scale, palette), bar_length, text),
            raster,
        }
    }

    fn layout(&self, head: &Head, numbers: &str, below: i32) -> FigureLayout {
        FigureLayout::new(&Parts {
            data: (self.raster.width, self.raster.height),
            text: self.text,
            y_labels: self.y.label_width(self.text),
            key: self.bar.margin(self.text),
            below,
            title: &format::shown(head.name),
            numbers,
        })
    }

    /// A picture of the map alone.
    fn write(self, path: &Path, head: &Head, numbers: &str) -> Drawn {
        let layout = self.layout(head, numbers, 0);
        picture(path, layout.size, self.text, |canvas| {
            canvas.title(layout.head, &format::shown(head.name), numbers)?;
            self.draw(canvas, &layout)
        })
    }

    fn draw(self, canvas: &Canvas, layout: &FigureLayout) -> Drawn {
        canvas.raster(layout.data, self.raster)?;
        canvas.note_if_dark(layout.data, &self.bar)?;
        canvas.frame(layout.data)?;
        canvas.x_axis(layout.data, &self.x)?;
        canvas.y_axis(layout.data, &self.y)?;
        canvas.color_bar(layout.bar, &self.bar)
    }
}

/// The colours of a picture: of values, or of the light.
fn palette(scale: &Scale, colors: Option<&TrueColors>) -> Palette {
    let of_files = Palette::of_files(scale);
    if colors.is_some() { Palette::of_true_colors(scale, of_files.missing) } else { of_files }
}

/// A scale of values that are not negative.
fn fitted(kind: ScaleKind, values: &Array2<f64>) -> Scale {
    Scale::fit(kind, 100.0, [values]).in_whole_decades()
}

/// The largest value; 0 if there is none above.
fn maximum(values: &Array2<f64>) -> f64 {
    values.iter().copied().fold(0.0, f64::max)
}

/// The size in picture pixels of a map of `width` x `height` with `nx` x `ny` pixels. It is true to scale, with a
/// whole number of picture pixels per map pixel if that fits.
fn map_size((width, height): (f64, f64), (nx, ny): (usize, usize)) -> (usize, usize) {
    const USUAL: f64 = 1200.0;
    const LARGE: f64 = 2400.0;
    // Beyond this the narrow side would vanish, and the axes have scales of their own.
    const MAX_ASPECT: f64 = 12.0;
    let aspect = (height / width).clamp(1.0 / MAX_ASPECT, MAX_ASPECT);
    let limit = if nx.max(ny) as f64 > USUAL { LARGE } else { USUAL };
    let whole = (limit / nx as f64).min(limit / (nx as f64 * aspect)).floor();
    let shown = if whole >= 1.0 { whole * nx as f64 } else { limit * (1.0 / aspect).min(1.0) };
    (shown.round().max(1.0) as usize, (shown * aspect).round().max(1.0) as usize)
}

/// Intensity over directions, whose polar angles go to `reach` \[deg\]: a disc seen along the detector's axis, out to the last
/// direction that holds flux.
pub(super) fn directions(path: &Path, head: &Head, intensity: &Array2<f64>, reach: f64) -> Drawn {
    const SIZE: usize = 1100;
    let limit = shown_angle(intensity, reach);
    let text = text_size((SIZE, SIZE));
    let px = |times: f64| (times * text).round() as i32;
    let scale = fitted(head.style.scale(), intensity);
    let palette = palette(&scale, head.colors);
    let colors = match head.colors {
        Some(colors) => colors.of_cells(&scale, &palette),
        None => {
            let color = palette.lookup();
            intensity.mapv(|value| color(scale.shade(value)))
        }
    };
    let disc = Disc { colors: &colors, limit, reach, outside: palette.missing };
    let mut raster = disc.draw(Window::WHOLE, [SIZE; 2]);
    let unit = head.style.unit_of(head.quantity.1, scale.high);
    let bar = ColorBar::new(head.quantity.0, unit, (scale, palette), SIZE as i32, text);
    let numbers = numbers(head, Some((scale.high, &bar))) + " · " + EQUAL_CELLS;
    let axis = polar_axis(limit);
    for (angle, _) in axis.ticks.iter().filter(|(angle, _)| *angle > 0.0 && *angle < limit) {
        let radius = angle / limit * SIZE as f64 / 2.0;
        raster.circle(radius, 1.5, [255; 3], 0.35);
    }
    raster.circle(SIZE as f64 / 2.0 - 1.0, 2.0, [34; 3], 1.0);

    let rim = text_width("−135°", text) + px(0.6);
    let mut layout = FigureLayout::new(&Parts {
        data: (SIZE, SIZE),
        text,
        y_labels: rim,
        key: bar.margin(text) + rim,
        below: px(2.6),
        title: &format::shown(head.name),
        numbers: &numbers,
    });
    layout.data.top += px(1.3);
    layout.bar.top += px(1.3);
    layout.bar.left += rim;
    picture(path, layout.size, text, |canvas| {
        canvas.title(layout.head, &format::shown(head.name), &numbers)?;
        canvas.raster(layout.data, raster)?;
        canvas.note_if_dark(layout.data, &bar)?;
        azimuth_labels(canvas, layout.data, px(0.5))?;
        let below = Area { height: layout.data.height + px(1.5), ..layout.data };
        canvas.base_line(below)?;
        canvas.x_axis(below, &axis)?;
        canvas.color_bar(layout.bar, &bar)
    })
}

/// The polar angle, counted from the middle to either side.
fn polar_axis(limit: f64) -> Axis {
    // Thirds of 90, 60, 45, 30 and 15 degrees are round, halves of the others.
    let parts = if limit % 15.0 == 0.0 { 3 } else { 2 };
    let tick = |part: i32| {
        let angle = limit * f64::from(part) / f64::from(parts);
        (angle, format!("{}°", significant(angle.abs(), 3)))
    };
    Axis {
        label: "polar angle θ".into(),
        range: (-limit, limit),
        ticks: (-parts..=parts).map(tick).collect(),
    }
}

fn azimuth_labels(canvas: &Canvas, disc: Area, gap: i32) -> Drawn {
    let (radius, middle) = (disc.width / 2, (disc.left + disc.width / 2, disc.top + disc.height / 2));
    for angle in [-135, -90, -45, 0, 45, 90, 135, 180] {
        let (sin, cos) = f64::from(angle).to_radians().sin_cos();
        let reach = f64::from(radius + gap);
        let at = (middle.0 + (reach * cos).round() as i32, middle.1 - (reach * sin).round() as i32);
        let horizontal = if cos > 0.1 {
            HPos::Left
        } else if cos < -0.1 {
            HPos::Right
        } else {
            HPos::Center
        };
        let vertical = if sin > 0.9 {
            VPos::Bottom
        } else if sin < -0.9 {
            VPos::Top
        } else {
            VPos::Center
        };
        let label = format!("{angle}°").replace('-', "−");
        canvas.label(&label, at, horizontal, vertical)?;
    }
    Ok(())
}

/// The smallest of a few round angles that leaves no flux out \[deg\].
fn shown_angle(intensity: &Array2<f64>, all: f64) -> f64 {
    let rows = intensity.nrows();
    let last = (0..rows).rev().find(|&row| intensity.row(row).iter().any(|&value| value > 0.0));
    let reach = last.map_or(all, |row| all * (row + 1) as f64 / rows as f64);
    let round = [1.0, 2.0, 5.0, 10.0, 15.0, 20.0, 30.0, 45.0, 60.0, 90.0, 120.0];
    round.into_iter().find(|&angle| angle >= reach - 1e-9).unwrap_or(all)
}

/// What gives, for each of some rays, where it crossed the detector in its own frame \[mm\], and its wavelength \[um\].
type Take<'a> = &'a mut dyn FnMut((f64, f64), f64);

/// Where rays crossed the detector, in its own frame, coloured by wavelength. `each` hands all of them over.
pub(crate) fn spots(
    path: &Path,
    head: &Head,
    num_rays: u64,
    each: impl FnOnce(Take<'_>) -> crate::Result<()>,
) -> Drawn {
    const SIZE: usize = 1100;
    const MOST_SPOTS: usize = 200_000;
    let text = text_size((SIZE, SIZE));
    let SpotSample { points, bounds, wavelengths } = SpotSample::of(num_rays, MOST_SPOTS, each)?;
    let mut numbers = numbers(head, None);
    if (points.len() as u64) < head.num_rays_hit {
        numbers += &format!(" · {} drawn", thousands(points.len() as u64));
    }
    let ((x_low, x_high), (y_low, y_high)) = square_around(bounds);
    let x = Axis::horizontal(&with_unit("x", "mm"), (x_low, x_high), SIZE as i32, text);
    let y = Axis::vertical(&with_unit("y", "mm"), (y_low, y_high), SIZE as i32, text);
    let key = WavelengthKey::new(wavelengths);
    let layout = FigureLayout::new(&Parts {
        data: (SIZE, SIZE),
        text,
        y_labels: y.label_width(text),
        key: key.width(text),
        below: 0,
        title: &format::shown(head.name),
        numbers: &numbers,
    });
    picture(path, layout.size, text, |canvas| {
        canvas.title(layout.head, &format::shown(head.name), &numbers)?;

        let mut raster = Raster::filled(SIZE, SIZE, [255; 3]);
        let inner = Area { left: 0, top: 0, ..layout.data };
        raster.lines(
            x.ticks.iter().map(|tick| inner.x(tick.0, x.range)),
            y.ticks.iter().map(|tick| inner.y(tick.0, y.range)),
        );
        let (radius, alpha) = spot_style(points.len());
        for &((px, py), wavelength) in &points {
            let at = ((px - x_low) / (x_high - x_low), (y_high - py) / (y_high - y_low));
            let color = wavelength_color(wavelength, key.range);
            raster.disc((at.0 * SIZE as f64, at.1 * SIZE as f64), radius, color, alpha);
        }
        canvas.raster(layout.data, raster)?;
        if points.is_empty() {
            canvas.note(layout.data, "no rays")?;
        }
        canvas.frame(layout.data)?;
        canvas.x_axis(layout.data, &x)?;
        canvas.y_axis(layout.data, &y)?;
        key.draw(canvas, layout.bar, text)
    })
}

/// Radius and opacity of a spot: the more there are, the smaller and fainter, so that density shows.
fn spot_style(count: usize) -> (f64, f64) {
    match count {
        0..2_000 => (4.0, 0.8),
        2_000..20_000 => (2.5, 0.55),
        _ => (1.2, 0.35),
    }
}

/// What a picture of a ray database needs of its rows.
struct SpotSample {
    /// Every so many rows, such that they are not too many: where the ray crossed \[mm\], and its wavelength \[um\].
    points: Vec<((f64, f64), f64)>,
    /// Least and greatest x and y of all rows \[mm\].
    bounds: Option<((f64, f64), (f64, f64))>,
    /// All wavelengths of the rows \[um\], ascending.
    wavelengths: Vec<f64>,
}

impl SpotSample {
    fn of(
        num_rays: u64,
        most: usize,
        each: impl FnOnce(Take<'_>) -> crate::Result<()>,
    ) -> Result<Self, String> {
        let stride = (num_rays as usize).div_ceil(most).max(1);
        let (mut points, mut wavelengths) = (Vec::new(), Vec::new());
        let mut bounds = None;
        let mut index = 0;
        each(&mut |(x, y), wavelength| {
            let ((x_low, x_high), (y_low, y_high)) = bounds.unwrap_or(((x, x), (y, y)));
            bounds = Some(((x.min(x_low), x.max(x_high)), (y.min(y_low), y.max(y_high))));
            if index % stride == 0 {
                points.push(((x, y), wavelength));
            }
            index += 1;
            if let Err(place) = wavelengths.binary_search_by(|known: &f64| known.total_cmp(&wavelength)) {
                wavelengths.insert(place, wavelength);
            }
        })
        .map_err(|error| error.to_string())?;
        Ok(SpotSample { points, bounds, wavelengths })
    }
}

/// A square that holds all points, with a margin; one point alone gets a millimetre.
fn square_around(bounds: Option<((f64, f64), (f64, f64))>) -> ((f64, f64), (f64, f64)) {
    let Some((x, y)) = bounds else {
        return ((-0.5, 0.5), (-0.5, 0.5));
    };
    let size = (x.1 - x.0).max(y.1 - y.0);
    let half = if size > 0.0 { 0.55 * size } else { 0.5 };
    let around = |(low, high): (f64, f64)| (0.5 * (low + high) - half, 0.5 * (low + high) + half);
    (around(x), around(y))
}

/// The colour of a wavelength within a range, from short to long; of a range of one wavelength, the first. The bright
/// end of the colours is left out, because it would not show on white.
fn wavelength_color(wavelength: f64, (shortest, longest): (f64, f64)) -> Rgb {
    const SPAN: f64 = 0.85;
    let fraction = if longest > shortest { (wavelength - shortest) / (longest - shortest) } else { 0.0 };
    colorous::PLASMA.eval_continuous(SPAN * fraction).into_array()
}

/// The key to the colours of wavelengths: one dot each while they are few, else the shortest, middle and longest.
struct WavelengthKey {
    wavelengths: Vec<f64>,
    range: (f64, f64),
}

impl WavelengthKey {
    fn new(wavelengths: Vec<f64>) -> Self {
        const FEW: usize = 12;
        let range = (wavelengths.first().copied().unwrap_or(0.0), wavelengths.last().copied().unwrap_or(0.0));
        let step = wavelengths.len().div_ceil(FEW).max(1);
        let last = wavelengths.last().copied();
        let mut wavelengths: Vec<f64> = wavelengths.into_iter().step_by(step).collect();
        if last != wavelengths.last().copied() {
            wavelengths.extend(last);
        }
        WavelengthKey { wavelengths, range }
    }

    fn labels(&self) -> Vec<String> {
        self.wavelengths.iter().map(|wavelength| format!("{} µm", significant(*wavelength, 5))).collect()
    }

    fn width(&self, text: f64) -> i32 {
        self.labels().iter().map(|label| text_width(label, text)).max().unwrap_or(0)
    }

    fn draw(&self, canvas: &Canvas, place: Area, text: f64) -> Drawn {
        for (row, (wavelength, label)) in self.wavelengths.iter().zip(self.labels()).enumerate() {
            let middle = place.top + ((row as f64 * 1.6 + 0.6) * text) as i32;
            canvas
                .dot((place.left + (0.3 * text) as i32, middle), wavelength_color(*wavelength, self.range))?;
            canvas.label(&label, (place.right(), middle), HPos::Left, VPos::Center)?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_map_is_shown_true_to_scale() {
        assert_eq!(map_size((4.0, 2.0), (4, 2)), (1200, 600));
        assert_eq!(map_size((4.0, 2.0), (100, 100)), (1200, 600), "pixels that are not square");
        assert_eq!(map_size((1.0, 1.0), (256, 256)), (1024, 1024), "whole picture pixels per map pixel");
        assert_eq!(map_size((20.0, 3.0), (2000, 300)), (2000, 300));
        assert_eq!(map_size((1.0, 1.0), (9000, 9000)), (2400, 2400));
        assert_eq!(map_size((1.0, 1000.0), (1, 100)), (100, 1200), "a sliver is widened");
    }
}
