//! Pixels, top row first: maps as means of their cells, and the discs and circles of figures.

use crate::result::picture::Rgb;
use crate::result::picture::pyramid::Level;
use ndarray::{Array2, s};
use std::ops::Range;

/// RGB pixels.
#[derive(Debug, Clone, PartialEq)]
pub struct Raster {
    /// Pixels of a row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Three bytes a pixel.
    pub rgb: Vec<u8>,
}

impl Raster {
    /// Pixels in one colour.
    pub fn filled(width: usize, height: usize, color: Rgb) -> Self {
        Raster { width, height, rgb: color.repeat(width * height) }
    }

    fn blend(&mut self, pixel: usize, color: Rgb, alpha: f64) {
        for (part, ink) in self.rgb[3 * pixel..3 * pixel + 3].iter_mut().zip(color) {
            *part = (f64::from(*part) * (1.0 - alpha) + f64::from(ink) * alpha).round() as u8;
        }
    }

    /// Light lines at columns and rows, such as a grid; beside the pixels there is none.
    pub fn lines(&mut self, columns: impl Iterator<Item = i32>, rows: impl Iterator<Item = i32>) {
        const LIGHT: Rgb = [228; 3];
        let (width, height) = (self.width, self.height);
        let within = |at: i32, end: usize| usize::try_from(at).ok().filter(|at| *at < end);
        for x in columns.filter_map(|x| within(x, width)) {
            (0..height).for_each(|y| self.blend(y * width + x, LIGHT, 1.0));
        }
        for y in rows.filter_map(|y| within(y, height)) {
            (0..width).for_each(|x| self.blend(y * width + x, LIGHT, 1.0));
        }
    }

    /// A disc around a point, its rim smoothed.
    pub fn disc(&mut self, at: (f64, f64), radius: f64, color: Rgb, alpha: f64) {
        for (pixel, cover) in disc([self.width, self.height], at, radius) {
            self.blend(pixel, color, alpha * cover);
        }
    }

    /// A circle around the middle, one thin smoothed line.
    pub fn circle(&mut self, radius: f64, thickness: f64, color: Rgb, alpha: f64) {
        let middle = (self.width as f64 / 2.0, self.height as f64 / 2.0);
        let reach = thickness / 2.0 + 0.5;
        for y in 0..self.height {
            let above = y as f64 + 0.5 - middle.1;
            // How far from the middle of the row the ring begins, and ends.
            let [inner, outer] = [radius - reach, radius + reach]
                .map(|edge| (edge.max(0.0).powi(2) - above * above).max(0.0).sqrt());
            let pixel = |x: f64| (middle.0 + x).clamp(0.0, self.width as f64) as usize;
            let left = pixel(-outer - 1.0)..pixel(-inner + 1.0);
            let right = pixel(inner - 1.0).max(left.end)..pixel(outer + 1.0);
            for x in left.chain(right) {
                let distance = (x as f64 + 0.5 - middle.0).hypot(above);
                let cover = (reach - (distance - radius).abs()).clamp(0.0, 1.0);
                if cover > 0.0 {
                    self.blend(y * self.width + x, color, alpha * cover);
                }
            }
        }
    }
}

/// The pixels that a disc covers, and the part of each, in 0..=1.
pub fn disc(
    [width, height]: [usize; 2],
    (x, y): (f64, f64),
    radius: f64,
) -> impl Iterator<Item = (usize, f64)> {
    let reach = |at: f64, end: usize| {
        let [low, high] = [(at - radius - 1.0).floor(), (at + radius + 2.0).ceil()];
        low.clamp(0.0, end as f64) as usize..high.clamp(0.0, end as f64) as usize
    };
    let columns = reach(x, width);
    let pixels = reach(y, height).flat_map(move |row| columns.clone().map(move |column| (row, column)));
    let covers = pixels.map(move |(row, column)| {
        let distance = (column as f64 + 0.5 - x).hypot(row as f64 + 0.5 - y);
        (row * width + column, (radius + 0.5 - distance).clamp(0.0, 1.0))
    });
    covers.filter(|(_, cover)| *cover > 0.0)
}

/// The blocks of cells that pixels along an axis show, with how many pixels side by side show the same ones.
pub type Runs = Vec<(Range<usize>, usize)>;

/// The blocks, of `blocks` along an axis, that each of `pixels` shows between two places, which are counted in blocks.
///
/// A pixel shows the blocks that begin in it, so that no block is left out. A pixel smaller than a block shows the
/// block at the pixel's middle. A pixel beside the map shows none.
pub fn runs((low, high): (f64, f64), blocks: usize, pixels: usize) -> Runs {
    let at = |pixel: f64| low + (high - low) * pixel / pixels as f64;
    let block = |at: f64| at.clamp(0.0, blocks as f64);
    let shown = |pixel: usize| {
        let (start, middle, end) = (at(pixel as f64), at(pixel as f64 + 0.5), at(pixel as f64 + 1.0));
        if end - start >= 1.0 {
            return block(start).ceil() as usize..block(end).ceil() as usize;
        }
        if middle < 0.0 || middle >= blocks as f64 { 0..0 } else { middle as usize..middle as usize + 1 }
    };
    let mut runs = Runs::new();
    for shown in (0..pixels).map(shown) {
        match runs.last_mut() {
            Some((last, count)) if *last == shown => *count += 1,
            _ => runs.push((shown, 1)),
        }
    }
    runs
}

/// What the pixels of a map show, each value once for a rectangle of pixels that show the same.
///
/// A pixel that covers several cells shows their mean, so that the flux per area stays true. It is zero only if all its
/// cells are zero, and NaN where no cell has a value.
#[derive(Debug, Clone, PartialEq)]
pub struct Means {
    /// The values, first row at the bottom.
    pub values: Array2<f64>,
    heights: Vec<usize>,
    widths: Vec<usize>,
}

impl Means {
    /// What pixels show of a map, with the blocks of its rows and columns that they cover.
    pub fn new(level: &Level, rows: &Runs, columns: &Runs) -> Self {
        let mut values = Array2::zeros((rows.len(), columns.len()));
        let mut sums = vec![0.0; level.sums.ncols()];
        for ((rows, _), mut means) in rows.iter().zip(values.outer_iter_mut()) {
            column_sums(level, rows, &mut sums);
            means.iter_mut().zip(columns).for_each(|(value, (columns, _))| {
                *value = mean(level, rows, columns, &sums);
            });
        }
        let counts = |runs: &Runs| runs.iter().map(|(_, count)| *count).collect();
        Means { values, heights: counts(rows), widths: counts(columns) }
    }

    /// The pixels, in the colours of their values.
    pub fn paint(&self, color: impl Fn(f64) -> Rgb) -> Raster {
        self.paint_cells(|cell| color(self.values[cell]))
    }

    /// The pixels, in colours by the row and the column of their values.
    pub fn paint_cells(&self, color: impl Fn((usize, usize)) -> Rgb) -> Raster {
        let [width, height] = [&self.widths, &self.heights].map(|counts| counts.iter().sum::<usize>());
        let mut rgb = Vec::with_capacity(3 * width * height);
        for (y, height) in self.heights.iter().enumerate().rev() {
            let colors = self.widths.iter().enumerate();
            let row: Vec<u8> = colors.flat_map(|(x, width)| color((y, x)).repeat(*width)).collect();
            (0..*height).for_each(|_| rgb.extend_from_slice(&row));
        }
        Raster { width, height, rgb }
    }
}

/// Sums the columns over some rows. In this order, a large map is read as fast as memory allows.
fn column_sums(level: &Level, rows: &Range<usize>, sums: &mut [f64]) {
    sums.fill(0.0);
    for row in level.sums.slice(s![rows.clone(), ..]).outer_iter() {
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
    let cells = level.sums.slice(s![rows.clone(), columns.clone()]);
    let known = cells.iter().filter(|value| !value.is_nan());
    let (sum, count) = known.fold((0.0, 0u32), |(sum, count), value| (sum + value, count + 1));
    if count == 0 { f64::NAN } else { sum / f64::from(count) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::result::picture::pyramid::Pyramid;
    use ndarray::array;

    #[test]
    fn a_pixel_over_many_cells_shows_their_mean() {
        let values = array![[1.0, 3.0, 0.0, f64::NAN], [2.0, 2.0, 0.0, 4.0]];
        let pyramid = Pyramid::default();
        let level = pyramid.level(&values, 1.0);
        let means = Means::new(&level, &runs((0.0, 2.0), 2, 1), &runs((0.0, 6.0), 4, 3));
        assert_eq!(means.values.slice(s![.., ..2]), array![[2.0, 4.0 / 3.0]]);
        assert!(means.values[(0, 2)].is_nan(), "beside the map");
        // Pixels in the colour of one value stand side by side, the first row at the bottom.
        let means = Means::new(&level, &runs((0.0, 2.0), 2, 2), &runs((0.0, 1.0), 4, 2));
        assert_eq!(means.values, array![[1.0], [2.0]]);
        let raster = means.paint(|value| [value as u8; 3]);
        assert_eq!((raster.width, raster.height), (2, 2));
        assert_eq!(raster.rgb, [[2; 6], [1; 6]].concat());
    }

    #[test]
    fn every_cell_is_covered_once() {
        for (cells, pixels) in [(7, 3), (3000, 2400), (5, 5), (1200, 801)] {
            let runs = runs((0.0, cells as f64), cells, pixels);
            let covered: Vec<usize> = runs.iter().flat_map(|(cells, _)| cells.clone()).collect();
            assert_eq!(covered, (0..cells).collect::<Vec<_>>(), "{cells} cells on {pixels} pixels");
            assert_eq!(runs.iter().map(|(_, count)| count).sum::<usize>(), pixels);
        }
        assert_eq!(runs((0.0, 2.0), 2, 6), [(0..1, 3), (1..2, 3)]);
        assert_eq!(runs((-1.0, 2.0), 1, 3), [(0..0, 1), (0..1, 1), (1..1, 1)], "beside the map");
    }

    /// Rings within the picture, cut by its border, and so small that they are discs.
    #[test]
    fn a_circle_covers_the_pixels_of_its_ring() {
        for (size, radius, thickness) in [(40, 15.0, 2.0), (41, 20.0, 1.5), (30, 18.0, 3.0), (9, 0.4, 2.0)] {
            let mut raster = Raster::filled(size, size, [255; 3]);
            raster.circle(radius, thickness, [0; 3], 1.0);
            let middle = size as f64 / 2.0;
            for (i, pixel) in raster.rgb.chunks(3).enumerate() {
                let [x, y] = [i % size, i / size].map(|at| at as f64 + 0.5 - middle);
                let cover = (thickness / 2.0 + 0.5 - (x.hypot(y) - radius).abs()).clamp(0.0, 1.0);
                assert_eq!(pixel[0], (255.0 * (1.0 - cover)).round() as u8, "pixel {i} of {size}^2");
            }
        }
    }
}
