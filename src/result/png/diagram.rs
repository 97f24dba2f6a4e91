//! Far fields, as a disc or as the polar diagram of a luminaire: intensity over the polar angle gamma, in the planes C0-C180 and
//! C90-C270.

use crate::format;
use crate::result::picture::Rgb;
use crate::result::picture::polar::{in_equal_solid_angles, sector};
use crate::result::picture::ticks::ticks;
use crate::result::png::canvas::{Drawn, picture, text_width};
use crate::result::png::charts::{self, EQUAL_CELLS, Head, numbers_of};
use ndarray::Array2;
use plotters::style::text_anchor::{HPos, VPos};
use std::path::Path;

/// Radius of the diagram \[pixels\].
const RADIUS: f64 = 550.0;
/// Size of the text \[pixels\].
const TEXT: f64 = 29.0;
/// Planes, the azimuths of their halves, of which the first is drawn to the right \[deg\], and their colours. Plane C lies at the
/// azimuth 360 - C, as in a lamp's file.
pub(crate) const PLANES: [(&str, [f64; 2], Rgb); 2] =
    [("C0–C180", [0.0, 180.0], [200, 60, 30]), ("C90–C270", [-90.0, 90.0], [30, 90, 180])];

/// Draws intensities by polar angle and azimuth, with the solid angles of the rings' cells: as a disc, or as a polar diagram. Polar
/// angles go to `reach` \[deg\]. Cells of equal solid angle are drawn.
pub(crate) fn far_field(
    path: &Path,
    head: &Head,
    intensity: &Array2<f64>,
    (reach, solid_angles): (f64, &[f64]),
) -> Drawn {
    let intensity = in_equal_solid_angles(intensity, solid_angles);
    let colors = head.colors.map(|colors| colors.changed(|map| in_equal_solid_angles(map, solid_angles)));
    let head = Head { colors: colors.as_ref(), ..*head };
    // A diagram has curves, and no cells that could have a colour.
    let draw = if head.style.is_polar && colors.is_none() { polar_diagram } else { charts::directions };
    draw(path, &head, &intensity, reach)
}

/// The diagram, in which the polar angle 0 points down.
fn polar_diagram(path: &Path, head: &Head, intensity: &Array2<f64>, reach: f64) -> Drawn {
    let curves = curves(intensity, reach);
    let top = top(&curves);
    let unit = head.style.unit_of(head.quantity.1, top);
    let steps = ticks((0.0, if top > 0.0 { top / unit.0 } else { 1.0 }), 5);
    let outermost =
        (1.05 * top / unit.0).max(steps.last().map_or(1.0, |(value, _)| *value)).max(f64::MIN_POSITIVE);

    let px = |times: f64| (times * TEXT).round() as i32;
    let radius = RADIUS as i32;
    let middle = (px(4.0) + radius, px(7.5) + if reach > 90.0 { radius + px(1.5) } else { 0 });
    let numbers = format!("{} · {EQUAL_CELLS}", numbers_of(head, Some((top, &unit))));
    let title = format::shown(head.name);
    let width =
        (2 * middle.0).max(px(2.0) + text_width(&numbers, 0.95 * TEXT).max(text_width(&title, 1.45 * TEXT)));
    let size = (width, middle.1 + radius + px(3.0));
    let at = |angle: f64, part: f64| {
        let (sin, cos) = angle.to_radians().sin_cos();
        (middle.0 + (RADIUS * part * sin).round() as i32, middle.1 + (RADIUS * part * cos).round() as i32)
    };
    picture(path, size, TEXT, |canvas| {
        canvas.title((px(1.0), px(1.0)), &title, &numbers)?;
        for (value, _) in steps.iter().filter(|(value, _)| *value > 0.0) {
            let circle = (-180..=180).map(|step| at(reach / 180.0 * f64::from(step), value / outermost));
            canvas.grid_line(circle.collect())?;
        }
        for step in -6_i32..=6 {
            let angle = 30.0 * f64::from(step);
            if angle.abs() <= reach && step != -6 {
                canvas.grid_line(vec![middle, at(angle, 1.0)])?;
                let place = at(angle, 1.0 + 1.1 * TEXT / RADIUS);
                canvas.label(&format!("{}°", angle.abs()), place, HPos::Center, VPos::Center)?;
            }
        }
        for curve in curves {
            let line = curve.points.iter().map(|(angle, value)| at(*angle, value / unit.0 / outermost));
            canvas.curve(line.collect(), curve.color)?;
        }
        for (value, label) in steps.iter().filter(|(value, _)| *value > 0.0) {
            let place = at(0.0, value / outermost);
            canvas.label(label, (place.0 + px(0.2), place.1), HPos::Left, VPos::Bottom)?;
        }
        let unit_text = format!("{} [{}]", head.quantity.0, unit.1);
        let mut left = px(1.0);
        for (name, _, color) in PLANES {
            canvas.dot((left + px(0.4), px(5.3)), color)?;
            canvas.label(name, (left + px(1.0), px(5.3)), HPos::Left, VPos::Center)?;
            left += px(2.5) + text_width(name, TEXT);
        }
        canvas.label(&unit_text, (left, px(5.3)), HPos::Left, VPos::Center)
    })
}

/// The intensity in a plane through the axis.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Curve {
    /// The plane.
    pub name: &'static str,
    /// The curve's colour.
    pub color: Rgb,
    /// Polar angles \[deg\], rising and negative in the half to the left, with their intensities.
    pub points: Vec<(f64, f64)>,
}

impl Curve {
    /// The curve of two halves, by their polar angles \[deg\].
    pub fn of_halves(name: &'static str, color: Rgb, [right, left]: [Vec<(f64, f64)>; 2]) -> Self {
        let left = left.into_iter().rev().map(|(angle, value)| (-angle, value));
        Curve { name, color, points: left.chain(right).collect() }
    }
}

/// The largest intensity of curves.
pub(crate) fn top(curves: &[Curve]) -> f64 {
    curves.iter().flat_map(|curve| &curve.points).map(|(_, value)| *value).fold(0.0, f64::max)
}

/// The curves of a far field: of intensities by polar angle and azimuth. Polar angles go to `reach` \[deg\].
pub(crate) fn curves(intensity: &Array2<f64>, reach: f64) -> [Curve; 2] {
    let (rows, columns) = intensity.dim();
    let half = |azimuth: f64| {
        let angles = (0..rows).map(|row| reach * (row as f64 + 0.5) / rows as f64);
        angles.zip(profile(intensity, &sector(columns, azimuth))).collect()
    };
    PLANES.map(|(name, halves, color)| Curve::of_halves(name, color, halves.map(half)))
}

/// The mean over some columns, by row.
fn profile(intensity: &Array2<f64>, columns: &[usize]) -> Vec<f64> {
    let mean = |row: usize| {
        columns.iter().map(|&column| intensity[(row, column)]).sum::<f64>() / columns.len() as f64
    };
    (0..intensity.nrows()).map(mean).collect()
}
