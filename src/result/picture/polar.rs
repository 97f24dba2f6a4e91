//! A far field as a disc of directions: the polar angle grows from the middle, the azimuth turns counter-clockwise from
//! the right.

use crate::result::picture::Rgb;
use crate::result::picture::raster::Raster;
use ndarray::{Array2, ArrayView1, s};
use rayon::prelude::*;
use std::ops::Range;

/// A disc of directions.
pub struct Disc<'a> {
    /// Colours of the bins, by polar angle and azimuth.
    pub colors: &'a Array2<Rgb>,
    /// The polar angle at the rim \[deg\].
    pub limit: f64,
    /// The polar angle where the bins end \[deg\]: 90 or 180.
    pub reach: f64,
    /// The colour beside the disc.
    pub outside: Rgb,
}

/// Into how many groups of neighbours the cells of each ring go, by the solid angles of the rings' cells. A group has on average at
/// least the solid angle of the largest cell.
fn groups(solid_angles: &[f64], columns: usize) -> Vec<usize> {
    let largest = solid_angles.iter().copied().fold(0.0, f64::max);
    // Rounding must not double a cell of the full size.
    let of_ring = |size: &f64| ((columns as f64 * size / largest * (1.0 + 1e-9)) as usize).clamp(1, columns);
    solid_angles.iter().map(of_ring).collect()
}

/// A far field whose cells have the number that `of` gives of their group. The sizes of a ring's groups differ by one at most.
pub(crate) fn by_groups(
    values: &Array2<f64>,
    solid_angles: &[f64],
    of: impl Fn(ArrayView1<'_, f64>) -> f64,
) -> Array2<f64> {
    let mut shared = values.clone();
    for (mut row, num_groups) in shared.outer_iter_mut().zip(groups(solid_angles, values.ncols())) {
        let first = |group: usize| group * values.ncols() / num_groups;
        for group in 0..num_groups {
            let mut cells = row.slice_mut(s![first(group)..first(group + 1)]);
            let shared = of(cells.view());
            cells.fill(shared);
        }
    }
    shared
}

/// Half of the width of the sector of azimuths that stands for a half plane \[deg\].
const SECTOR: f64 = 5.0;

/// The columns of azimuths that stand for a half plane at this azimuth \[deg\]. All within 5 degrees count, but at
/// least the one or two beside it.
pub(crate) fn sector(columns: usize, azimuth: f64) -> Vec<usize> {
    let half = SECTOR.max(180.0 / columns as f64) + 1e-9;
    let at = |column: usize| -180.0 + 360.0 * (column as f64 + 0.5) / columns as f64;
    let off = |column: usize| ((at(column) - azimuth + 540.0).rem_euclid(360.0) - 180.0).abs();
    (0..columns).filter(|&column| off(column) <= half).collect()
}

/// A far field in cells of about equal solid angle, shown in its own cells: neighbours share their mean. So the light of the pole
/// is not judged by cells that a single ray fills.
pub(crate) fn in_equal_solid_angles(values: &Array2<f64>, solid_angles: &[f64]) -> Array2<f64> {
    by_groups(values, solid_angles, |group| group.sum() / group.len() as f64)
}

/// The part of a disc that a picture shows, in radii: from left to right, and from bottom to top.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Window {
    /// From left to right.
    pub x: (f64, f64),
    /// From bottom to top.
    pub y: (f64, f64),
}

impl Window {
    /// The whole disc.
    pub const WHOLE: Window = Window { x: (-1.0, 1.0), y: (-1.0, 1.0) };
}

impl Disc<'_> {
    /// Draws the part of the disc in a window; edges are smoothed.
    pub fn draw(&self, window: Window, [width, height]: [usize; 2]) -> Raster {
        let mut raster = Raster::filled(width, height, self.outside);
        let directions = Directions::new(self.colors.dim(), self.limit / self.reach);
        raster.rgb.par_chunks_mut(3 * width * Band::HEIGHT).enumerate().for_each(|(number, rgb)| {
            let first = number * Band::HEIGHT;
            let rows = first..(first + Band::HEIGHT).min(height);
            let directions = directions.clone();
            Band { disc: self, directions, window, size: [width, height], first, rgb }.draw(0..width, rows);
        });
        raster
    }
}

/// Some rows of a disc in the making.
struct Band<'a> {
    disc: &'a Disc<'a>,
    directions: Directions,
    window: Window,
    /// Width and height of the whole picture.
    size: [usize; 2],
    /// The first row.
    first: usize,
    rgb: &'a mut [u8],
}

impl Band<'_> {
    /// Rows of all bands but the last.
    const HEIGHT: usize = 64;
    /// Samples of a pixel along each axis.
    const SAMPLES: usize = 3;

    /// How far a pixel's sample lies along an axis, in 0..=1.
    fn part(pixel: usize, sample: usize, pixels: usize) -> f64 {
        (pixel as f64 + (sample as f64 + 0.5) / Self::SAMPLES as f64) / pixels as f64
    }

    fn x(&self, column: usize, sample: usize) -> f64 {
        let (left, right) = self.window.x;
        left + (right - left) * Self::part(column, sample, self.size[0])
    }

    fn y(&self, row: usize, sample: usize) -> f64 {
        let (bottom, top) = self.window.y;
        top - (top - bottom) * Self::part(row, sample, self.size[1])
    }

    fn color(&mut self, x: f64, y: f64) -> Rgb {
        self.directions.bin_at(x, y).map_or(self.disc.outside, |bin| self.disc.colors[bin])
    }

    fn set(&mut self, column: usize, row: usize, color: Rgb) {
        let at = 3 * ((row - self.first) * self.size[0] + column);
        self.rgb[at..at + 3].copy_from_slice(&color);
    }

    /// Draws a part of the picture: in one colour, or its halves, down to single pixels.
    fn draw(&mut self, columns: Range<usize>, rows: Range<usize>) {
        if let Some(color) = self.only_color(&columns, &rows) {
            rows.for_each(|row| columns.clone().for_each(|column| self.set(column, row, color)));
        } else if columns.len().max(rows.len()) <= 1 {
            let color = self.mean_color(columns.start, rows.start);
            self.set(columns.start, rows.start, color);
        } else if columns.len() >= rows.len() {
            let middle = columns.start + columns.len() / 2;
            self.draw(columns.start..middle, rows.clone());
            self.draw(middle..columns.end, rows);
        } else {
            let middle = rows.start + rows.len() / 2;
            self.draw(columns.clone(), rows.start..middle);
            self.draw(columns, middle..rows.end);
        }
    }

    /// The colour of every sample in a part, if the corners of the part decide it. Within a quadrant, radius and
    /// azimuth are greatest and least at corners.
    fn only_color(&mut self, columns: &Range<usize>, rows: &Range<usize>) -> Option<Rgb> {
        let nearer_first = |a: f64, b: f64| {
            let ends = if a.abs() < b.abs() { (a, b) } else { (b, a) };
            (a.signum() == b.signum()).then_some(ends)
        };
        let last = Self::SAMPLES - 1;
        let (near_x, far_x) = nearer_first(self.x(columns.start, 0), self.x(columns.end - 1, last))?;
        let (near_y, far_y) = nearer_first(self.y(rows.start, 0), self.y(rows.end - 1, last))?;
        let corners = [(near_x, near_y), (far_x, far_y), (near_x, far_y), (far_x, near_y)];
        let [near, far, side, other_side] = corners.map(|(x, y)| self.directions.bin_at(x, y));
        match near {
            None => Some(self.disc.outside),
            Some(bin) => (far == near && side == near && other_side == near).then(|| self.disc.colors[bin]),
        }
    }

    fn mean_color(&mut self, column: usize, row: usize) -> Rgb {
        let mut sum = [0; 3];
        for sample in 0..Self::SAMPLES * Self::SAMPLES {
            let at = (sample % Self::SAMPLES, sample / Self::SAMPLES);
            let color = self.color(self.x(column, at.0), self.y(row, at.1));
            sum.iter_mut().zip(color).for_each(|(sum, part)| *sum += u32::from(part));
        }
        let count = (Self::SAMPLES * Self::SAMPLES) as u32;
        sum.map(|part| ((part + count / 2) / count) as u8)
    }
}

/// Finds the bins of a far field for points of its disc. Neighbouring points mostly lie in the same bin, so that
/// comparisons take the place of millions of angles.
#[derive(Clone)]
struct Directions {
    /// Squared radii where rows begin, and where the last ends.
    radii: Vec<f64>,
    /// Where columns begin, and where the last ends, as what [`around`] gives.
    azimuths: Vec<f64>,
    bin: [usize; 2],
}

impl Directions {
    /// `shown` is the share of the polar angles that the disc shows.
    fn new((rows, columns): (usize, usize), shown: f64) -> Self {
        let radius = |row: usize| row as f64 / rows as f64 / shown;
        let azimuth = |column: usize| {
            let (y, x) = (std::f64::consts::TAU * column as f64 / columns as f64).sin_cos();
            around(-x, -y)
        };
        let mut azimuths: Vec<f64> = (0..=columns).map(azimuth).collect();
        azimuths[0] = -2.0;
        azimuths[columns] = 2.0;
        Directions { radii: (0..=rows).map(|row| radius(row).powi(2)).collect(), azimuths, bin: [0; 2] }
    }

    /// (row, column) at a point; none outside the disc.
    fn bin_at(&mut self, x: f64, y: f64) -> Option<[usize; 2]> {
        let square = x * x + y * y;
        if square > 1.0 {
            return None;
        }
        let [row, column] = self.bin;
        self.bin = [interval(row, square, &self.radii), interval(column, around(x, y), &self.azimuths)];
        Some(self.bin)
    }
}

/// Grows with the azimuth, from -2 to 2 at -180 and 180 degrees.
fn around(x: f64, y: f64) -> f64 {
    let across = y / (x.abs() + y.abs()).max(f64::MIN_POSITIVE);
    if x >= 0.0 { across } else { 2.0_f64.copysign(y) - across }
}

/// The interval between `edges` that holds `value`, looked for at `guess` and beside it first. The first and the last
/// interval also hold what lies beyond them.
fn interval(guess: usize, value: f64, edges: &[f64]) -> usize {
    let holds = |at: &usize| edges[*at] <= value && edges.get(at + 1).is_some_and(|&next| value < next);
    let near = [guess, guess + 1, guess.saturating_sub(1)].into_iter().find(holds);
    near.unwrap_or_else(|| edges.partition_point(|&edge| edge <= value).clamp(1, edges.len() - 1) - 1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::array;

    #[test]
    fn azimuth_turns_from_right_to_up() {
        // One ring of four sectors: -180 to -90, -90 to 0, 0 to 90, 90 to 180 degrees.
        let colors = array![[0, 1, 2, 3]].mapv(|sector: u8| [sector; 3]);
        let disc = Disc { colors: &colors, limit: 90.0, reach: 90.0, outside: [255; 3] };
        let whole = disc.draw(Window::WHOLE, [100, 100]);
        let at = |raster: &Raster, x: usize, y: usize| raster.rgb[3 * (raster.width * y + x)];
        assert_eq!(at(&whole, 65, 35), 2, "the upper right");
        assert_eq!([at(&whole, 35, 35), at(&whole, 35, 65), at(&whole, 65, 65)], [3, 0, 1]);
        assert_eq!(at(&whole, 2, 2), 255, "outside the disc");
        let corner = disc.draw(Window { x: (0.5, 1.5), y: (0.0, 0.5) }, [40, 20]);
        assert_eq!([at(&corner, 2, 17), at(&corner, 39, 17)], [2, 255]);
    }

    #[test]
    fn neighbours_near_the_pole_share_their_light() {
        let sizes: Vec<f64> =
            (0..9).map(|row| ((f64::from(row) + 0.5) * 10.0_f64).to_radians().sin()).collect();
        assert_eq!(groups(&sizes, 36), [3, 9, 15, 20, 25, 29, 32, 34, 36]);
        // A prime number of azimuths has groups, too: a lamp that shines to one side is no lamp of revolution.
        assert_eq!(groups(&sizes, 37), [3, 9, 15, 21, 26, 30, 33, 35, 37]);
        let values = Array2::from_shape_fn((9, 36), |(row, column)| (row * 36 + column) as f64);
        let shared = in_equal_solid_angles(&values, &sizes);
        assert_eq!(shared.row(8), values.row(8));
        assert_eq!([shared[(0, 0)], shared[(0, 11)], shared[(0, 12)]], [5.5, 5.5, 17.5]);
        let sums = |values: &Array2<f64>| values.outer_iter().map(|row| row.sum()).collect::<Vec<_>>();
        assert_eq!(sums(&shared), sums(&values), "light is kept");
    }

    #[test]
    fn intervals_are_those_of_a_search_in_turn() {
        let edges = [-2.0, -1.0, 0.0, 0.0, 0.5, 2.0];
        let in_turn = |value: f64| (1..5).rev().find(|&at| edges[at] <= value).unwrap_or(0);
        for value in [-3.0, -2.0, -1.5, -1.0, -0.1, 0.0, 0.2, 0.5, 1.0, 2.0, 3.0] {
            for guess in 0..5 {
                assert_eq!(interval(guess, value, &edges), in_turn(value), "{value} from {guess}");
            }
        }
        assert_eq!(interval(0, 7.0, &[0.0, 1.0]), 0);
    }

    #[test]
    fn bins_are_those_of_the_angles() {
        let (rows, columns, shown) = (7, 10, 2.0 / 3.0);
        let mut directions = Directions::new((rows, columns), shown);
        // A spiral that jumps; its points keep clear of edges.
        for i in 0..5_000 {
            let (radius, azimuth) = ((f64::from(i) * 0.618_033).fract(), f64::from(i) * 2.399_963);
            let (y, x) = azimuth.sin_cos();
            let row = radius * shown * rows as f64;
            let column =
                ((y.atan2(x).to_degrees() + 180.0) / 360.0 * columns as f64).min(columns as f64 - 0.1);
            let bin = directions.bin_at(radius * x, radius * y);
            assert_eq!(bin, Some([row as usize, column as usize]), "{radius} {azimuth}");
        }
        assert_eq!(directions.bin_at(0.8, 0.8), None);
    }
}
