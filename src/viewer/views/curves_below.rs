//! The curves below a detector: values along the line, the spectrum, and the encircled energy.

use crate::format::si_prefix;
use crate::result::figures::field::Field;
use crate::result::figures::region::EncircledEnergy;
use crate::viewer::line_profile::{Line, Sample, profile};
use crate::viewer::model::Picture;
use crate::viewer::plot::{Colors, Plot, PlotFrame, View};
use crate::viewer::spots::Spots;
use crate::viewer::state::App;
use crate::viewer::two_results::Scores;
use crate::viewer::views::detector_plot::default_line;
use eframe::egui::{self, Align2, Color32, FontId, Painter, Rect, Sense, Stroke, Ui, pos2};

/// Two plots side by side.
pub fn show(app: &mut App, ui: &mut Ui) {
    let (rect, _) = ui.allocate_exact_size(ui.available_size(), Sense::hover());
    let (left, right) = rect.split_left_right_at_fraction(0.56);
    let Ok(picture) = app.model.picture() else {
        return;
    };
    match picture.as_ref() {
        Picture::Map { field, other, scale, .. } => {
            let line = app.model.marks().line.unwrap_or_else(|| default_line(field));
            let log = scale.is_log();
            let prefix = scale.prefix(field.labels.value.1);
            let lines = Lines { field, other: other.as_deref(), line, log, prefix };
            lines.show(ui, left);
        }
        Picture::Spots(spots) => wavelengths(ui, left, spots),
    }
    match (picture.as_ref(), Spectrum::of(app)) {
        (Picture::Map { scores: Some(scores), .. }, _) => significance(ui, right, scores),
        (_, Some(spectrum)) => spectrum.show(app, ui, right),
        _ => energy(app, ui, right, &picture),
    }
}

fn plot<'a>(name: &'a str, home: View, x: (&'a str, &'a str), y: (&'a str, &'a str)) -> Plot<'a> {
    Plot { name, home, equal: false, x, y, log_y: false, grid: true, pans: false, moves: false }
}

/// Bounds with room above the highest value, and none below zero.
fn headroom(values: impl Iterator<Item = f64>) -> (f64, f64) {
    let (low, high) = values
        .filter(|value| value.is_finite())
        .fold((0f64, 0f64), |(low, high), value| (low.min(value), high.max(value)));
    if high <= low {
        (0.0, 1.0)
    } else {
        (if low < 0.0 { 1.1 * low } else { 0.0 }, high + 0.08 * (high - low))
    }
}

/// Profiles of one map or of two.
struct Lines<'a> {
    field: &'a Field,
    other: Option<&'a Field>,
    line: Line,
    log: bool,
    /// The colour bar's prefix, with its factor.
    prefix: (f64, &'static str),
}

impl Lines<'_> {
    fn show(&self, ui: &mut Ui, rect: Rect) {
        let samples = profile(self.field, self.line);
        let others = self.other.map(|other| profile(other, self.line)).unwrap_or_default();
        let all = || samples.iter().chain(&others);
        let (_, unit) = self.field.labels.value;
        let (factor, prefix) = self.prefix;
        let top =
            all().map(|sample| sample.value.abs()).filter(|value| value.is_finite()).fold(0.0, f64::max)
                / factor;
        let with_error = |sample: &Sample| sample.value + sample.sigma.max(0.0).min(sample.value.abs());
        let y = if self.log {
            let lit = all().map(|sample| sample.value / factor).filter(|value| *value > 0.0);
            let low = lit.fold(f64::INFINITY, f64::min);
            if low < top {
                (low.log10() - 0.1, top.log10() + 0.2)
            } else {
                (top.max(1e-300).log10() - 1.0, top.max(1e-300).log10() + 0.2)
            }
        } else {
            headroom(
                all().map(with_error).chain(all().map(|sample| sample.value)).map(|value| value / factor),
            )
        };
        let (x, start) = self.along();
        let home = View::new((start, start + self.length()), y);
        let unit = format!("{prefix}{unit}");
        let plot = Plot { log_y: self.log, ..plot("Profile", home, x, (self.field.labels.value.0, &unit)) };
        let colors = Colors::of(ui);
        plot.show(ui, rect, &mut None, |_, painter, frame| {
            let place = |value: f64| {
                let value = value / factor;
                if self.log { value.max(1e-300).log10() } else { value }
            };
            for (samples, color) in [(&others, colors.second), (&samples, colors.curve)] {
                staircase(painter, frame, start, samples, color, place);
            }
            if self.other.is_some() {
                legend(painter, frame, &[("shown", colors.curve), ("other", colors.second)]);
            }
        });
    }

    fn length(&self) -> f64 {
        let [a, b] = self.line;
        (b.0 - a.0).hypot(b.1 - a.1).max(f64::MIN_POSITIVE)
    }

    /// The label and offset of the distance along the line. Along an axis, the axis' coordinate says more than the
    /// distance.
    fn along(&self) -> ((&'static str, &'static str), f64) {
        let [a, b] = self.line;
        let labels = self.field.labels;
        let flat = 1e-3 * self.length();
        if (b.1 - a.1).abs() < flat && b.0 > a.0 {
            (labels.x, a.0)
        } else if (b.0 - a.0).abs() < flat && b.1 > a.1 {
            (labels.y, a.1)
        } else {
            (("along the line", labels.x.1), 0.0)
        }
    }
}

fn staircase(
    painter: &Painter,
    frame: &PlotFrame,
    start: f64,
    samples: &[Sample],
    color: Color32,
    place: impl Fn(f64) -> f64,
) {
    let stroke = Stroke::new(1.5, color);
    let mut points = Vec::with_capacity(2 * samples.len());
    for sample in samples {
        let at = |along: f64, value: f64| frame.place((start + along, place(value)));
        let (from, to) = (at(sample.span.0, sample.value), at(sample.span.1, sample.value));
        if !sample.value.is_finite() {
            // Where the value is unknown, the curve has a gap.
            painter.add(egui::Shape::line(std::mem::take(&mut points), stroke));
            continue;
        }
        // Where cells are finer than the screen, thousands of error bands would merge into one.
        if sample.sigma > 0.0 && to.x - from.x >= 0.5 {
            let (low, high) = (sample.value - sample.sigma, sample.value + sample.sigma);
            let band = Rect::from_two_pos(at(sample.span.0, low), at(sample.span.1, high));
            painter.rect_filled(band, 0.0, color.gamma_multiply(0.22));
            if to.x - from.x > 7.0 {
                let middle = 0.5 * (from.x + to.x);
                painter.vline(middle, band.top()..=band.bottom(), Stroke::new(1.0, color));
            }
        }
        points.extend([from, to]);
    }
    painter.add(egui::Shape::line(points, stroke));
}

fn legend(painter: &Painter, frame: &PlotFrame, entries: &[(&str, Color32)]) {
    for (index, (name, color)) in entries.iter().enumerate() {
        let place = pos2(frame.rect.right() - 8.0, frame.rect.top() + 8.0 + 15.0 * index as f32);
        painter.text(place, Align2::RIGHT_TOP, *name, FontId::proportional(12.0), *color);
    }
}

fn note(painter: &Painter, frame: &PlotFrame, text: &str, color: Color32) {
    let place = frame.rect.right_top() + egui::vec2(-8.0, 6.0);
    painter.text(place, Align2::RIGHT_TOP, text, FontId::proportional(12.0), color);
}

/// Flux per wavelength bin, of the pixel under the cursor or of the whole detector.
struct Spectrum {
    values: Vec<f64>,
    edges: Vec<f64>,
    unit: &'static str,
    of: String,
}

impl Spectrum {
    fn of(app: &App) -> Option<Self> {
        let map = app.model.spectral()?;
        let cell = app.cursor().and_then(|cursor| cursor.cell);
        let cell = cell
            .filter(|(row, column)| *row < map.pixels.y_coords.len() && *column < map.pixels.x_coords.len());
        let edges = map.wavelength_edges.to_vec();
        Some(match cell {
            Some((row, column)) => Spectrum {
                values: (0..map.wavelengths.len())
                    .map(|bin| map.pixels.irradiance[(row, column, bin)])
                    .collect(),
                edges,
                unit: "W/mm²",
                of: format!(
                    "pixel at {:.3}, {:.3} mm",
                    map.pixels.x_coords[column], map.pixels.y_coords[row]
                ),
            },
            None => Spectrum { values: map.spectrum.to_vec(), edges, unit: "W", of: "whole detector".into() },
        })
    }

    /// A click picks a bin.
    fn show(&self, app: &mut App, ui: &mut Ui, rect: Rect) {
        let Spectrum { values, edges, unit, of } = self;
        let top = values.iter().copied().fold(0.0, f64::max);
        let (factor, prefix) = si_prefix(top);
        let x = (edges[0], edges[edges.len() - 1]);
        let (low, high) = headroom(values.iter().map(|value| value / factor));
        // The note is written above the bars.
        let home = View::new(x, (low, 1.15 * high));
        let unit = format!("{prefix}{unit}");
        let plot = plot("Spectrum", home, ("wavelength", "µm"), ("per bin", &unit));
        let colors = Colors::of(ui);
        let bin = app.model.bin;
        let shown = plot.show(ui, rect, &mut None, |_, painter, frame| {
            for (index, value) in values.iter().enumerate() {
                let corner = |at: f64, value: f64| frame.place((at, value / factor));
                let bar = Rect::from_two_pos(corner(edges[index], 0.0), corner(edges[index + 1], *value));
                let chosen = bin.is_none_or(|bin| bin == index);
                let color = if chosen { colors.curve } else { colors.curve.gamma_multiply(0.35) };
                painter.rect_filled(bar.shrink2(egui::vec2(0.5f32.min(bar.width() / 4.0), 0.0)), 0.0, color);
            }
            note(painter, frame, of, colors.text);
        });
        if shown.response.clicked()
            && let Some(place) = shown.response.interact_pointer_pos()
        {
            let (wavelength, _) = shown.frame.point(place);
            let clicked = edges.iter().skip(1).position(|edge| wavelength < *edge);
            app.model.bin = if clicked == bin { None } else { clicked };
        }
    }
}

/// Flux per wavelength of the rays of a database.
fn wavelengths(ui: &mut Ui, rect: Rect, spots: &Spots) {
    const BINS: usize = 60;
    let (low, high) = spots.wavelengths;
    let pad = if high > low { 0.03 * (high - low) } else { 0.05 };
    let range = if spots.spots.is_empty() { (0.0, 1.0) } else { (low - pad, high + pad) };
    let mut flux = vec![0.0; BINS];
    for spot in &spots.spots {
        let part = (spot.wavelength - range.0) / (range.1 - range.0);
        flux[((part * BINS as f64) as usize).min(BINS - 1)] += spot.flux;
    }
    let top = flux.iter().copied().fold(0.0, f64::max);
    let (factor, prefix) = si_prefix(top);
    let home = View::new(range, headroom(flux.iter().map(|flux| flux / factor)));
    let unit = format!("{prefix}{}", spots.labels.flux);
    let colors = Colors::of(ui);
    let plot = plot("Flux over wavelength", home, ("wavelength", "µm"), ("flux", &unit));
    plot.show(ui, rect, &mut None, |_, painter, frame| {
        let edge = |bin: usize| range.0 + (range.1 - range.0) * bin as f64 / BINS as f64;
        for (bin, flux) in flux.iter().enumerate().filter(|(_, flux)| **flux > 0.0) {
            let bar = Rect::from_two_pos(
                frame.place((edge(bin), 0.0)),
                frame.place((edge(bin + 1), flux / factor)),
            );
            painter.rect_filled(bar.shrink2(egui::vec2(0.5, 0.0)), 0.0, colors.curve);
        }
    });
}

/// The distribution of (A - B) / sigma, over the normal distribution of chance alone.
fn significance(ui: &mut Ui, rect: Rect, scores: &Scores) {
    let (reach, width) = (Scores::REACH, Scores::WIDTH);
    let density = |count: u64| count as f64 / (scores.num_cells.max(1) as f64 * width);
    let normal = |score: f64| (-0.5 * score * score).exp() / std::f64::consts::TAU.sqrt();
    let top = scores.counts.iter().map(|count| density(*count)).fold(normal(0.0), f64::max);
    let home = View::new((-reach, reach), (0.0, 1.25 * top));
    let colors = Colors::of(ui);
    let plot = plot("Significance of the difference", home, ("(A − B) / σ", ""), ("density of cells", ""));
    plot.show(ui, rect, &mut None, |_, painter, frame| {
        for (bin, count) in scores.counts.iter().enumerate() {
            let left = -reach + width * bin as f64;
            let bar =
                Rect::from_two_pos(frame.place((left, 0.0)), frame.place((left + width, density(*count))));
            painter.rect_filled(bar.shrink2(egui::vec2(0.5, 0.0)), 0.0, colors.curve.gamma_multiply(0.7));
        }
        let curve = (0..=200).map(|step| {
            let score = -reach + 2.0 * reach * f64::from(step) / 200.0;
            frame.place((score, normal(score)))
        });
        painter.add(egui::Shape::line(curve.collect(), Stroke::new(1.5, colors.second)));
        let text = format!("χ² per cell {:.3}", scores.mean_square);
        note(painter, frame, &text, colors.text);
    });
}

/// The fraction of the flux within a radius.
fn energy(app: &mut App, ui: &mut Ui, rect: Rect, picture: &Picture) {
    let unit = match picture {
        Picture::Map { field, .. } => field.labels.x.1,
        Picture::Spots(spots) => spots.labels.x.1,
    };
    let curve = app.region_figures().and_then(|(_, curve)| curve);
    let largest =
        curve.as_ref().and_then(|curve| curve.radius.last().copied()).filter(|radius| *radius > 0.0);
    let home = View::new((0.0, largest.unwrap_or(1.0)), (0.0, 104.0));
    let unit = if unit == "1" { "" } else { unit };
    let plot = plot("Encircled energy", home, ("radius about the centroid", unit), ("flux within", "%"));
    let colors = Colors::of(ui);
    plot.show(ui, rect, &mut None, |_, painter, frame| {
        if let Some(curve) = &curve {
            draw_energy(painter, frame, curve, &colors);
        }
    });
}

fn draw_energy(painter: &Painter, frame: &PlotFrame, curve: &EncircledEnergy, colors: &Colors) {
    let mut points = vec![frame.place((0.0, 0.0))];
    let rings = curve.radius.iter().zip(&curve.fraction);
    points.extend(rings.map(|(radius, fraction)| frame.place((*radius, 100.0 * fraction))));
    painter.add(egui::Shape::line(points, Stroke::new(1.5, colors.curve)));
    for fraction in [0.5, 0.9] {
        let place = frame.place((curve.radius_of(fraction), 100.0 * fraction));
        painter.circle_filled(place, 3.5, colors.second);
        let text = format!("{:.0} %", 100.0 * fraction);
        painter.text(
            place + egui::vec2(7.0, 4.0),
            Align2::LEFT_TOP,
            text,
            FontId::proportional(12.0),
            colors.second,
        );
    }
}
