//! Pictures of values and rays at the resolution of the screen: their cost depends on the window, not on the detector.

use crate::viewer::field::{Field, Geometry};
use crate::viewer::plot::View;
use crate::viewer::pyramid::{Level, Pyramid};
use crate::viewer::scale::{Scale, Shade};
use crate::viewer::spots::Spots;
use eframe::egui::{Color32, ColorImage};
use std::ops::Range;

/// Draws a map as pixels, top row first. A pixel that covers several cells shows their mean, so that the flux per area
/// stays true. The pixel is drawn as zero only if all its cells are zero.
///
/// A large map is drawn from blocks of cells, which are no larger than a pixel. A block counts for the one pixel in
/// which it begins, so that no cell is left out.
pub fn map(
    field: &Field,
    pyramid: &Pyramid,
    scale: &Scale,
    colors: &Colors,
    view: &View,
    size: [usize; 2],
) -> ColorImage {
    let color = |value: f64| match scale.shade(value) {
        Shade::Missing => colors.missing,
        Shade::Zero => colors.zero,
        Shade::Part(part) => colors.table[(part * 255.0).round() as usize],
    };
    let pixels = match field.geometry {
        Geometry::Rectangles => {
            let (along_x, along_y) = cells_per_pixel(field, view, size);
            let level = pyramid.level(&field.values, along_x.min(along_y) / BLOCKS);
            let (rows, columns) = level.sums.dim();
            let spanned = |(low, high): (f64, f64), cells: usize, blocks: usize| {
                (low, low + (high - low) * (blocks * level.side) as f64 / cells as f64)
            };
            let cells = field.dim();
            let x = covered(view.x, spanned(field.x_range, cells.1, columns), columns, size[0]);
            let y = covered(view.y, spanned(field.y_range, cells.0, rows), rows, size[1]);
            let mut pixels = Vec::with_capacity(size[0] * size[1]);
            let mut sums = vec![0.0; columns];
            for y in y.iter().rev() {
                column_sums(&level, y, &mut sums);
                pixels.extend(x.iter().map(|x| color(mean(&level, y, x, &sums))));
            }
            pixels
        }
        Geometry::Polar => {
            let along = |index: usize, (low, high): (f64, f64), count: usize| {
                low + (high - low) * (index as f64 + 0.5) / count as f64
            };
            let value = |x: usize, y: usize| {
                let at = (along(x, view.x, size[0]), along(size[1] - 1 - y, view.y, size[1]));
                field.cell_at(at.0, at.1).map_or(f64::NAN, |cell| field.values[cell])
            };
            (0..size[1]).flat_map(|y| (0..size[0]).map(move |x| color(value(x, y)))).collect()
        }
    };
    ColorImage::new(size, pixels)
}

/// The least number of blocks in a pixel, along each axis. With fewer, the numbers of cells in neighbouring pixels
/// could differ by half.
const BLOCKS: f64 = 1.5;

/// Cells along the sides of a pixel, x and y.
pub fn cells_per_pixel(field: &Field, view: &View, size: [usize; 2]) -> (f64, f64) {
    let (rows, columns) = field.dim();
    let along = |(low, high): (f64, f64), pixels: usize, range: (f64, f64), cells: usize| {
        (high - low) / pixels as f64 * cells as f64 / (range.1 - range.0)
    };
    (along(view.x, size[0], field.x_range, columns), along(view.y, size[1], field.y_range, rows))
}

/// The colours of a map.
#[derive(Debug, Clone, PartialEq)]
pub struct Colors {
    /// 256 colours, from the low end of the scale to the high end.
    pub table: Vec<Color32>,
    /// The colour of exactly zero.
    pub zero: Color32,
    /// The colour of a missing value.
    pub missing: Color32,
}

/// The blocks that each pixel of an axis shows: those that begin in the pixel. A pixel smaller than a block shows the
/// block at the pixel's middle. A pixel outside the map shows none.
fn covered(
    (view_low, view_high): (f64, f64),
    (low, high): (f64, f64),
    blocks: usize,
    pixels: usize,
) -> Vec<Range<usize>> {
    let at = |pixel: f64| {
        let place = view_low + (view_high - view_low) * pixel / pixels as f64;
        (place - low) / (high - low) * blocks as f64
    };
    let block = |at: f64| at.clamp(0.0, blocks as f64);
    let range = |pixel: usize| {
        let (start, middle, end) = (at(pixel as f64), at(pixel as f64 + 0.5), at(pixel as f64 + 1.0));
        if end - start >= 1.0 {
            return block(start).ceil() as usize..block(end).ceil() as usize;
        }
        if middle < 0.0 || middle >= blocks as f64 { 0..0 } else { middle as usize..middle as usize + 1 }
    };
    (0..pixels).map(range).collect()
}

/// Sums the columns over some rows. In this order, a large map is read as fast as memory allows.
fn column_sums(level: &Level, rows: &Range<usize>, sums: &mut [f64]) {
    sums.fill(0.0);
    for row in level.sums.slice(ndarray::s![rows.clone(), ..]).outer_iter() {
        sums.iter_mut().zip(row).for_each(|(sum, value)| *sum += value);
    }
}

/// The mean of the cells of a pixel that have a value.
fn mean(level: &Level, rows: &Range<usize>, columns: &Range<usize>, sums: &[f64]) -> f64 {
    let sum: f64 = sums[columns.clone()].iter().sum();
    if !sum.is_nan() {
        let count = level.count(rows, columns);
        return if count == 0 { f64::NAN } else { sum / count as f64 };
    }
    let cells = level.sums.slice(ndarray::s![rows.clone(), columns.clone()]);
    let known = cells.iter().filter(|value| !value.is_nan());
    let (sum, count) = known.fold((0.0, 0u32), |(sum, count), value| (sum + value, count + 1));
    if count == 0 { f64::NAN } else { sum / f64::from(count) }
}

/// Draws rays as dots of `radius` pixels, in the colours of their wavelengths. Where many overlap, their colours mix,
/// in the same way for any order of the rays. The density still shows.
pub fn spots(
    spots: &Spots,
    color: impl Fn(f64) -> Color32,
    ground: Color32,
    view: &View,
    size: [usize; 2],
    radius: f64,
) -> ColorImage {
    let mut canvas = Canvas { size, sums: vec![[0.0; 4]; size[0] * size[1]] };
    let place = |at: f64, (low, high): (f64, f64), count: usize| (at - low) / (high - low) * count as f64;
    for spot in &spots.spots {
        let x = place(spot.at.0, view.x, size[0]);
        let y = size[1] as f64 - place(spot.at.1, view.y, size[1]);
        canvas.dot((x, y), radius, color(spot.wavelength));
    }
    let opacity = canvas.opacity();
    let pixels = canvas.sums.iter().map(|[r, g, b, cover]| {
        let mean = [r, g, b].map(|sum| (sum / cover.max(1e-6)).round() as u8);
        let ink = Color32::from_rgb(mean[0], mean[1], mean[2]);
        ground.lerp_to_gamma(ink, 1.0 - (-opacity * cover).exp())
    });
    ColorImage::new(size, pixels.collect())
}

/// Sums of colours and of coverage.
struct Canvas {
    size: [usize; 2],
    sums: Vec<[f32; 4]>,
}

impl Canvas {
    fn dot(&mut self, (x, y): (f64, f64), radius: f64, color: Color32) {
        let [width, height] = self.size;
        let reach = |at: f64, limit: usize| {
            let low = (at - radius - 1.0).floor().clamp(0.0, limit as f64) as usize;
            low..(at + radius + 1.0).ceil().clamp(0.0, limit as f64) as usize
        };
        for row in reach(y, height) {
            for column in reach(x, width) {
                let distance = (column as f64 + 0.5 - x).hypot(row as f64 + 0.5 - y);
                let cover = (radius + 0.5 - distance).clamp(0.0, 1.0) as f32;
                let ink = [color.r(), color.g(), color.b()].map(|part| cover * f32::from(part));
                let sum = &mut self.sums[row * width + column];
                sum.iter_mut().zip(ink.into_iter().chain([cover])).for_each(|(sum, part)| *sum += part);
            }
        }
    }

    /// The opacity of one dot: a single dot shows well, and the densest places still differ.
    fn opacity(&self) -> f32 {
        const SINGLE: f32 = 1.4;
        const DENSE: f32 = 2.2;
        const FAINTEST: f32 = 0.15;
        let mut covers: Vec<f32> = self.sums.iter().map(|sum| sum[3]).filter(|cover| *cover > 0.0).collect();
        let Some(last) = covers.len().checked_sub(1) else {
            return SINGLE;
        };
        let (_, dense, _) = covers.select_nth_unstable_by(last * 98 / 100, f32::total_cmp);
        // A single ray beside a bright spot is what a hunter of stray light looks for, so it never vanishes.
        SINGLE.min(DENSE / *dense).max(FAINTEST)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::result::IrradianceMap;
    use crate::viewer::scale::ScaleKind;
    use ndarray::{Array1, Array2};

    fn field(values: Array2<f64>) -> Field {
        let (rows, columns) = values.dim();
        Field::of_irradiance(&IrradianceMap {
            hits: Array2::zeros((rows, columns)),
            x_coords: Array1::zeros(columns),
            y_coords: Array1::zeros(rows),
            width: columns as f64,
            height: rows as f64,
            irradiance: values,
            standard_error: None,
        })
    }

    fn colors() -> Colors {
        let table = (0..=255).map(Color32::from_gray).collect();
        Colors { table, zero: Color32::RED, missing: Color32::BLUE }
    }

    fn picture(field: &Field, view: View, size: [usize; 2]) -> Vec<Color32> {
        let scale = Scale::fit(ScaleKind::Linear, 99.0, [&field.values]);
        map(field, &Pyramid::of(&field.values), &scale, &colors(), &view, size).pixels
    }

    #[test]
    fn the_first_row_stands_at_the_bottom() {
        let field = field(ndarray::array![[1.0, 2.0], [4.0, 0.0]]);
        let pixels = picture(&field, View::new((-1.0, 1.0), (-1.0, 1.0)), [2, 2]);
        let grey = |part: f64| Color32::from_gray((part * 255.0).round() as u8);
        assert_eq!(pixels, [grey(1.0), Color32::RED, grey(0.25), grey(0.5)]);
    }

    #[test]
    fn a_pixel_over_many_cells_shows_their_mean() {
        let mut values = Array2::zeros((512, 512));
        values[(0, 0)] = 4.0;
        values[(511, 511)] = 8.0;
        let field = field(values);
        let pixels = picture(&field, View::new((-256.0, 256.0), (-256.0, 256.0)), [256, 256]);
        // Means of four cells against a scale that ends at the largest cell.
        assert_eq!(pixels[255], Color32::from_gray(64));
        assert_eq!(pixels[255 * 256], Color32::from_gray(32));
        assert_eq!(pixels.iter().filter(|pixel| **pixel == Color32::RED).count(), 256 * 256 - 2);
    }

    /// Some pixel shows a single bright cell, wherever the cell lies, and however large the map is on the screen.
    #[test]
    fn no_cell_is_passed_over() {
        for (cells, pixels) in [(100, 69), (100, 99), (100, 31), (1200, 801), (1200, 377)] {
            for bright in [0, 1, cells / 3, cells / 2 + 1, cells - 1] {
                let mut values = Array2::zeros((cells, cells));
                values[(bright, cells - 1 - bright)] = 1.0;
                let half = cells as f64 / 2.0;
                let view = View::new((-half, half), (-half, half));
                let shown = picture(&field(values), view, [pixels, pixels]);
                let lit = shown.iter().filter(|pixel| **pixel != Color32::RED).count();
                assert_eq!(lit, 1, "cell {bright} of {cells} on {pixels} pixels");
            }
        }
    }

    #[test]
    fn beside_the_map_there_is_nothing() {
        let pixels = picture(&field(ndarray::array![[1.0]]), View::new((-1.5, 1.5), (-0.5, 0.5)), [3, 1]);
        assert_eq!(pixels, [Color32::BLUE, Color32::WHITE, Color32::BLUE]);
    }
}
