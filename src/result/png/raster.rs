//! Pictures of data: maps, polar patterns and spots as RGB pixels, top row first.

use crate::result::png::style::Style;
use colorous::{Color, Gradient};
use ndarray::Array2;
use rayon::prelude::*;
use std::ops::Range;
use std::sync::LazyLock;

/// Colours of maps: zero is black, and brightness rises with the value.
pub(super) const MAP: Gradient = colorous::INFERNO;
/// Colours of wavelengths, from short to long; the bright end is left out, since it would not show on white.
const SPECTRUM: Gradient = colorous::PLASMA;
const SPECTRUM_SPAN: f64 = 0.85;

/// RGB pixels.
pub(super) struct Raster {
    pub width: usize,
    pub height: usize,
    pub rgb: Vec<u8>,
}

/// A map, or a part of it that is shown, as picture pixels.
pub(super) struct Shown {
    pub raster: Raster,
    /// The value that has the top colour.
    pub top: f64,
    /// What its colours mean.
    pub colors: Colors,
}

impl Raster {
    pub fn filled(width: usize, height: usize, color: [u8; 3]) -> Self {
        Raster { width, height, rgb: color.repeat(width * height) }
    }

    /// Mixes a colour in; outside the raster nothing happens.
    fn blend(&mut self, x: i64, y: i64, color: [u8; 3], alpha: f64) {
        if x < 0 || y < 0 || x >= self.width as i64 || y >= self.height as i64 {
            return;
        }
        let at = 3 * (y as usize * self.width + x as usize);
        for (pixel, ink) in self.rgb[at..at + 3].iter_mut().zip(color) {
            *pixel = (f64::from(*pixel) * (1.0 - alpha) + f64::from(ink) * alpha).round() as u8;
        }
    }

    /// Light lines at columns and rows, such as a grid.
    pub fn lines(&mut self, columns: impl Iterator<Item = i32>, rows: impl Iterator<Item = i32>) {
        const LIGHT: [u8; 3] = [228; 3];
        for x in columns {
            (0..self.height).for_each(|y| self.blend(i64::from(x), y as i64, LIGHT, 1.0));
        }
        for y in rows {
            (0..self.width).for_each(|x| self.blend(x as i64, i64::from(y), LIGHT, 1.0));
        }
    }

    /// A disc about (x, y), its rim smoothed.
    pub fn disc(&mut self, (x, y): (f64, f64), radius: f64, color: [u8; 3], alpha: f64) {
        let reach = |at: f64| ((at - radius - 1.0).floor() as i64, (at + radius + 1.0).ceil() as i64);
        let ((x0, x1), (y0, y1)) = (reach(x), reach(y));
        for row in y0..=y1 {
            for column in x0..=x1 {
                let distance = (column as f64 + 0.5 - x).hypot(row as f64 + 0.5 - y);
                let cover = (radius + 0.5 - distance).clamp(0.0, 1.0);
                if cover > 0.0 {
                    self.blend(column, row, color, alpha * cover);
                }
            }
        }
    }

    /// A circle about the middle, one thin smoothed line.
    pub fn circle(&mut self, radius: f64, thickness: f64, color: [u8; 3], alpha: f64) {
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
                    self.blend(x as i64, y as i64, color, alpha * cover);
                }
            }
        }
    }
}

/// What colours mean.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Colors {
    /// From zero to the top value.
    Rising,
    /// From the top value below zero to that above, with zero white.
    Diverging,
    /// From so many decades below the top value to that, by the logarithm; zero is black.
    Log(u8),
}

impl Colors {
    /// Those of values that are not negative.
    pub fn rising(style: Style) -> Self {
        if style.is_log { Colors::Log(1) } else { Colors::Rising }
    }

    /// With as many decades as the values need.
    fn fitted(self, values: &Array2<f64>, top: f64) -> Self {
        const MOST_DECADES: f64 = 6.0;
        let Colors::Log(_) = self else { return self };
        let least = values.iter().copied().filter(|value| *value > 0.0).fold(top, f64::min);
        Colors::Log((top / least).log10().ceil().clamp(1.0, MOST_DECADES) as u8)
    }

    /// The value of the top colour.
    fn top(self, values: &Array2<f64>) -> f64 {
        match self {
            Colors::Rising | Colors::Log(_) => maximum(values),
            Colors::Diverging => values.iter().fold(0.0, |top, value| value.abs().max(top)),
        }
    }

    /// A value over the top value, by how far its colour lies from the top of a bar to its foot, in 0..=1.
    pub fn fraction(self, part: f64) -> f64 {
        match self {
            Colors::Rising => 1.0 - part,
            Colors::Diverging => 1.0 - 2.0 * part,
            Colors::Log(decades) => 10_f64.powf(-f64::from(decades) * part),
        }
    }

    /// The colour of a fraction of the top value.
    pub fn color(self, fraction: f64) -> Color {
        match self {
            Colors::Rising => map_color(fraction),
            Colors::Log(_) if fraction <= 0.0 => map_color(0.0),
            Colors::Log(decades) => {
                // Faint light has another colour than none.
                const FIRST: f64 = 0.1;
                let part = 1.0 + fraction.log10() / f64::from(decades);
                map_color(FIRST + (1.0 - FIRST) * part.clamp(0.0, 1.0))
            }
            // Red above zero.
            Colors::Diverging => colorous::RED_BLUE.eval_continuous((0.5 - 0.5 * fraction).clamp(0.0, 1.0)),
        }
    }
}

/// The colour of a fraction of the top value.
pub(super) fn map_color(fraction: f64) -> Color {
    /// Finer than the 8 bits of a colour; a picture has more pixels than that.
    const LEVELS: usize = 1 << 12;
    static COLORS: LazyLock<Vec<Color>> = LazyLock::new(|| {
        (0..=LEVELS).map(|level| MAP.eval_continuous(level as f64 / LEVELS as f64)).collect()
    });
    COLORS[(fraction.clamp(0.0, 1.0) * LEVELS as f64).round() as usize]
}

/// The colour of a wavelength within a range; the middle of the colours if the range is one wavelength.
pub(super) fn wavelength_color(wavelength: f64, (shortest, longest): (f64, f64)) -> [u8; 3] {
    let fraction = if longest > shortest { (wavelength - shortest) / (longest - shortest) } else { 0.0 };
    let color = SPECTRUM.eval_continuous(SPECTRUM_SPAN * fraction);
    [color.r, color.g, color.b]
}

/// The size in picture pixels of a map of `width` x `height` with `nx` x `ny` pixels: true to scale, and with a whole
/// number of picture pixels per map pixel where that fits.
pub(super) fn map_size((width, height): (f64, f64), (nx, ny): (usize, usize)) -> (usize, usize) {
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

/// A map with its first row at the bottom. Where it has more pixels than the picture, each picture pixel shows the mean
/// of those it covers, so that the flux per area stays true.
pub(super) fn map(values: &Array2<f64>, (width, height): (usize, usize), colors: Colors) -> Shown {
    let (ny, nx) = values.dim();
    let (rows, columns) = (runs(ny, height), runs(nx, width));
    let mean = |rows: &Range<usize>, columns: &Range<usize>| {
        let cells = rows.clone().flat_map(|row| columns.clone().map(move |column| values[[row, column]]));
        cells.sum::<f64>() / (rows.len() * columns.len()) as f64
    };
    let shown = Array2::from_shape_fn((rows.len(), columns.len()), |(y, x)| mean(&rows[y].0, &columns[x].0));
    let top = colors.top(&shown);
    let colors = colors.fitted(&shown, top);
    let mut rgb = Vec::with_capacity(3 * width * height);
    for ((_, height), means) in rows.iter().zip(shown.rows()).rev() {
        let means = means.iter().map(|mean| colors.color(if top > 0.0 { mean / top } else { 0.0 }));
        let row: Vec<u8> = means
            .zip(&columns)
            .flat_map(|(color, (_, width))| [color.r, color.g, color.b].repeat(*width))
            .collect();
        (0..*height).for_each(|_| rgb.extend_from_slice(&row));
    }
    Shown { raster: Raster { width, height, rgb }, top, colors }
}

/// The cells that pixels along an axis show, with how many pixels side by side show the same.
fn runs(cells: usize, pixels: usize) -> Vec<(Range<usize>, usize)> {
    let mut runs: Vec<(Range<usize>, usize)> = Vec::new();
    for shown in (0..pixels).map(|pixel| covered(pixel, cells, pixels)) {
        match runs.last_mut() {
            Some((last, count)) if *last == shown => *count += 1,
            _ => runs.push((shown, 1)),
        }
    }
    runs
}

/// The cells, of `cells` along an axis, that pixel `index` of `pixels` shows: the one at its middle, or all it covers.
fn covered(index: usize, cells: usize, pixels: usize) -> Range<usize> {
    if cells <= pixels {
        let middle = (2 * index + 1) * cells / (2 * pixels);
        middle..middle + 1
    } else {
        let first = index * cells / pixels;
        first..((index + 1) * cells / pixels).max(first + 1)
    }
}

/// A far-field pattern as a disc of directions out to `limit` \[deg\]: the polar angle grows from the middle, the azimuth
/// turns counter-clockwise from the right. The rim is smoothed on white.
pub(super) fn polar(intensity: &Array2<f64>, limit: f64, size: usize, colors: Colors) -> Shown {
    let top = maximum(intensity);
    let meaning = colors.fitted(intensity, top);
    let colors = intensity.mapv(|value| meaning.color(if top > 0.0 { value / top } else { 0.0 }));
    let directions = Directions::new(intensity.dim(), limit);
    let mut raster = Raster::filled(size, size, [255; 3]);
    raster.rgb.par_chunks_mut(3 * size * Band::HEIGHT).enumerate().for_each(|(number, rgb)| {
        let first = number * Band::HEIGHT;
        let rows = first..(first + Band::HEIGHT).min(size);
        Band { colors: &colors, directions: directions.clone(), size, first, rgb }.draw(0..size, rows);
    });
    Shown { raster, top, colors: meaning }
}

/// Some rows of a disc of directions in the making.
struct Band<'a> {
    colors: &'a Array2<Color>,
    directions: Directions,
    /// Of the whole picture.
    size: usize,
    /// Its first row.
    first: usize,
    rgb: &'a mut [u8],
}

impl Band<'_> {
    /// Rows of all but the last.
    const HEIGHT: usize = 64;
    /// Samples of a pixel along each axis.
    const SAMPLES: usize = 3;
    const OUTSIDE: Color = Color { r: 255, g: 255, b: 255 };

    /// A coordinate of a pixel's sample, from -1 to 1 across the picture.
    fn at(&self, pixel: usize, sample: usize) -> f64 {
        (pixel as f64 + (sample as f64 + 0.5) / Self::SAMPLES as f64) / self.size as f64 * 2.0 - 1.0
    }

    fn color(&mut self, x: f64, y: f64) -> Color {
        self.directions.bin_at(x, y).map_or(Self::OUTSIDE, |bin| self.colors[bin])
    }

    fn set(&mut self, x: usize, y: usize, color: Color) {
        let at = 3 * ((y - self.first) * self.size + x);
        self.rgb[at..at + 3].copy_from_slice(&[color.r, color.g, color.b]);
    }

    /// Draws a part of the picture: in one colour, or its halves, down to single pixels.
    fn draw(&mut self, columns: Range<usize>, rows: Range<usize>) {
        if let Some(color) = self.only_color(&columns, &rows) {
            rows.for_each(|y| columns.clone().for_each(|x| self.set(x, y, color)));
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

    /// The colour of every sample in a part, where one can tell from its corners: within a quadrant the radius is
    /// greatest and least there, and so is the azimuth.
    fn only_color(&mut self, columns: &Range<usize>, rows: &Range<usize>) -> Option<Color> {
        let ends = |range: &Range<usize>| {
            let (a, b) = (self.at(range.start, 0), self.at(range.end - 1, Self::SAMPLES - 1));
            let nearer_first = if a.abs() < b.abs() { (a, b) } else { (b, a) };
            (a.signum() == b.signum()).then_some(nearer_first)
        };
        let ((near_x, far_x), (near_y, far_y)) = (ends(columns)?, ends(rows)?);
        let corners = [(near_x, near_y), (far_x, far_y), (near_x, far_y), (far_x, near_y)];
        let [near, far, side, other_side] = corners.map(|(x, y)| self.directions.bin_at(x, -y));
        match near {
            None => Some(Self::OUTSIDE),
            Some(bin) => (far == near && side == near && other_side == near).then(|| self.colors[bin]),
        }
    }

    fn mean_color(&mut self, x: usize, y: usize) -> Color {
        let mut sum = [0; 3];
        for sample in 0..Self::SAMPLES * Self::SAMPLES {
            let (column, row) = (sample % Self::SAMPLES, sample / Self::SAMPLES);
            let color = self.color(self.at(x, column), -self.at(y, row));
            sum.iter_mut().zip([color.r, color.g, color.b]).for_each(|(sum, part)| *sum += u32::from(part));
        }
        let count = (Self::SAMPLES * Self::SAMPLES) as u32;
        let [r, g, b] = sum.map(|part| ((part + count / 2) / count) as u8);
        Color { r, g, b }
    }
}

/// The bins of a far field, for points of its disc in turn: neighbours mostly lie in the same bin, so that comparisons do
/// for the angles of millions of points.
#[derive(Clone)]
struct Directions {
    /// Squared radii where rows begin, and where the last ends.
    radii: Vec<f64>,
    /// Where columns begin, and where the last ends, as what [`around`] gives.
    azimuths: Vec<f64>,
    bin: [usize; 2],
}

impl Directions {
    fn new((rows, columns): (usize, usize), limit: f64) -> Self {
        let radius = |row: usize| row as f64 / rows as f64 * 90.0 / limit;
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

/// The interval between `edges` that holds `value`, looked for at `guess` and beside it first; the first and the last one
/// hold what lies beyond them too.
fn interval(guess: usize, value: f64, edges: &[f64]) -> usize {
    let holds = |at: &usize| edges[*at] <= value && edges.get(at + 1).is_some_and(|&next| value < next);
    let near = [guess, guess + 1, guess.saturating_sub(1)].into_iter().find(holds);
    near.unwrap_or_else(|| edges.partition_point(|&edge| edge <= value).clamp(1, edges.len() - 1) - 1)
}

/// The largest value; 0 if there is none above.
pub(super) fn maximum(values: &Array2<f64>) -> f64 {
    values.iter().copied().fold(0.0, f64::max)
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::array;

    #[test]
    fn a_map_is_shown_true_to_scale() {
        assert_eq!(map_size((4.0, 2.0), (4, 2)), (1200, 600));
        assert_eq!(map_size((4.0, 2.0), (100, 100)), (1200, 600), "pixels that are not square");
        assert_eq!(map_size((1.0, 1.0), (256, 256)), (1024, 1024), "whole picture pixels per map pixel");
        assert_eq!(map_size((20.0, 3.0), (2000, 300)), (2000, 300));
        assert_eq!(map_size((1.0, 1.0), (9000, 9000)), (2400, 2400));
        assert_eq!(map_size((1.0, 1000.0), (1, 100)), (100, 1200), "a sliver is widened");
    }

    #[test]
    fn a_picture_with_fewer_pixels_shows_means() {
        let shown = map(&array![[1.0, 3.0, 0.0, 0.0], [2.0, 2.0, 0.0, 4.0]], (2, 1), Colors::Rising);
        assert_eq!(shown.top, 2.0);
        let [r, g, b] = [map_color(0.5).r, map_color(0.5).g, map_color(0.5).b];
        assert_eq!(shown.raster.rgb, [252, 255, 164, r, g, b]);
    }

    #[test]
    fn logarithmic_colours_are_as_far_apart_as_ratios() {
        let shown = map(&array![[0.0, 1e-9, 1e-4, 1e-2, 1.0]], (5, 1), Colors::Log(1));
        assert_eq!(shown.colors, Colors::Log(6), "no more, whatever the values");
        let pixel = |at: usize| &shown.raster.rgb[3 * at..3 * at + 3];
        let of_map = |fraction| [map_color(fraction).r, map_color(fraction).g, map_color(fraction).b];
        assert_eq!(pixel(0), of_map(0.0));
        assert_eq!(pixel(1), of_map(0.1), "below all decades, and not none");
        assert_eq!(pixel(2), of_map(0.4));
        assert_eq!(pixel(3), of_map(0.7));
        assert_eq!(pixel(4), of_map(1.0));
        let few = map(&array![[0.5, 0.2, 1.0]], (3, 1), Colors::Log(1));
        assert_eq!(few.colors, Colors::Log(1));
        // A bar has the colours of its values.
        assert!((few.colors.fraction(0.5) - 0.1_f64.sqrt()).abs() < 1e-12);
        assert_eq!([0.0, 0.5, 1.0].map(|part| Colors::Diverging.fraction(part)), [1.0, 0.0, -1.0]);
        assert_eq!(map(&array![[0.0]], (1, 1), Colors::Log(1)).top, 0.0);
    }

    #[test]
    fn a_difference_is_red_above_zero_blue_below_and_white_between() {
        let shown = map(&array![[-2.0, 0.0, 1.0]], (3, 1), Colors::Diverging);
        assert_eq!(shown.top, 2.0);
        let [blue, white, red] = [0, 3, 6].map(|at| [0, 2].map(|channel| shown.raster.rgb[at + channel]));
        assert!(blue[1] > blue[0] + 50 && red[0] > red[1] + 50, "{blue:?} {red:?}");
        assert!(white.iter().all(|channel| *channel > 235), "{white:?}");
    }

    #[test]
    fn every_cell_is_covered_once() {
        for (cells, pixels) in [(7, 3), (3000, 2400), (5, 5)] {
            let covered: Vec<usize> = (0..pixels).flat_map(|pixel| covered(pixel, cells, pixels)).collect();
            assert_eq!(covered, (0..cells).collect::<Vec<_>>(), "{cells} cells on {pixels} pixels");
        }
    }

    #[test]
    fn azimuth_turns_from_right_to_up() {
        // One ring of four sectors: -180 to -90, -90 to 0, 0 to 90, 90 to 180 degrees.
        let shown = polar(&array![[0.0, 0.0, 1.0, 0.0]], 90.0, 100, Colors::Rising);
        let at = |x: usize, y: usize| &shown.raster.rgb[3 * (100 * y + x)..][..3];
        assert_eq!(at(65, 35), [252, 255, 164], "the upper right");
        assert_eq!(at(35, 35), [0, 0, 4]);
        assert_eq!(at(65, 65), [0, 0, 4]);
        assert_eq!(at(2, 2), [255, 255, 255], "outside the disc");
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

    #[test]
    fn bins_are_those_of_the_angles() {
        let (rows, columns, limit) = (7, 10, 60.0);
        let mut directions = Directions::new((rows, columns), limit);
        // A spiral that jumps; its points keep clear of edges.
        for i in 0..5_000 {
            let (radius, azimuth) = ((f64::from(i) * 0.618_033).fract(), f64::from(i) * 2.399_963);
            let (y, x) = azimuth.sin_cos();
            let row = radius * limit / 90.0 * rows as f64;
            let column =
                ((y.atan2(x).to_degrees() + 180.0) / 360.0 * columns as f64).min(columns as f64 - 0.1);
            let bin = directions.bin_at(radius * x, radius * y);
            assert_eq!(bin, Some([row as usize, column as usize]), "{radius} {azimuth}");
        }
        assert_eq!(directions.bin_at(0.8, 0.8), None);
    }
}
