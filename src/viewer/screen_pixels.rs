//! Pictures of values and rays at the resolution of the screen: their cost depends on the window, not on the detector.

use crate::result::figures::field::{CellGeometry, Field};
use crate::result::picture::polar::{Disc, Window};
use crate::result::picture::pyramid::Pyramid;
use crate::result::picture::raster::{Means, disc, runs};
use crate::result::picture::scale::{Palette, Scale};
use crate::result::picture::true_color::TrueColors;
use crate::viewer::plot::View;
use crate::viewer::spots::Spots;
use eframe::egui::{Color32, ColorImage};

/// Draws a map as pixels, top row first. A large map is drawn from blocks of cells, which are no larger than a pixel.
pub fn map(
    field: &Field,
    pyramid: &Pyramid,
    colors: Option<&TrueColors>,
    (scale, palette): (&Scale, &Palette),
    view: &View,
    size: [usize; 2],
) -> ColorImage {
    let color = palette.lookup();
    let color = |value: f64| color(scale.shade(value));
    let raster = match field.geometry {
        CellGeometry::Rectangles => {
            let (along_x, along_y) = cells_per_pixel(field, view, size);
            let block = along_x.min(along_y) / BLOCKS;
            let level = pyramid.level(&field.values, block);
            let (rows, columns) = level.sums.dim();
            let blocks = |(low, high): (f64, f64), ends: (f64, f64), cells: usize| {
                let at = |end: f64| (end - low) / (high - low) * cells as f64 / level.side as f64;
                (at(ends.0), at(ends.1))
            };
            let cells = field.dim();
            let y = runs(blocks(field.y_range, view.y, cells.0), rows, size[1]);
            let x = runs(blocks(field.x_range, view.x, cells.1), columns, size[0]);
            match colors {
                Some(colors) => colors.pixels(block, (&y, &x), (scale, palette)),
                None => Means::new(&level, &y, &x).paint(color),
            }
        }
        CellGeometry::Polar => {
            let limit = field.x_range.1;
            let radii = |(low, high): (f64, f64)| (low / limit, high / limit);
            let colors = match colors {
                Some(colors) => colors.of_cells(scale, palette),
                None => field.values.mapv(color),
            };
            let disc = Disc { colors: &colors, limit, reach: limit, outside: palette.missing };
            disc.draw(Window { x: radii(view.x), y: radii(view.y) }, size)
        }
    };
    ColorImage::from_rgb(size, &raster.rgb)
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
    let mut canvas = DotSums { size, sums: vec![[0.0; 4]; size[0] * size[1]] };
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
struct DotSums {
    size: [usize; 2],
    sums: Vec<[f32; 4]>,
}

impl DotSums {
    fn dot(&mut self, at: (f64, f64), radius: f64, color: Color32) {
        for (pixel, cover) in disc(self.size, at, radius) {
            let cover = cover as f32;
            let ink = [color.r(), color.g(), color.b()].map(|part| cover * f32::from(part));
            let sums = self.sums[pixel].iter_mut().zip(ink.into_iter().chain([cover]));
            sums.for_each(|(sum, part)| *sum += part);
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
    use crate::result::picture::scale::{ColorMap, ScaleKind};
    use ndarray::{Array1, Array2};

    fn field(values: Array2<f64>) -> Field {
        let (rows, columns) = values.dim();
        Field::of_result(&IrradianceMap {
            hits: Array2::zeros((rows, columns)),
            x_coords: Array1::zeros(columns),
            y_coords: Array1::zeros(rows),
            width: columns as f64,
            height: rows as f64,
            irradiance: values,
            standard_error: None,
        })
    }

    const MISSING: Color32 = Color32::BLUE;

    fn palette(field: &Field) -> (Scale, Palette) {
        let scale = Scale::fit(ScaleKind::Linear, 99.0, [&field.values]);
        (scale, Palette::of_window(ColorMap::Grey, &scale, [MISSING.r(), MISSING.g(), MISSING.b()]))
    }

    fn picture(field: &Field, view: View, size: [usize; 2]) -> Vec<Color32> {
        let (scale, palette) = palette(field);
        map(field, &Pyramid::of(&field.values), None, (&scale, &palette), &view, size).pixels
    }

    /// The colour of a part of the largest value of a field.
    fn grey(part: f64) -> Color32 {
        let (_, palette) = palette(&field(ndarray::array![[1.0]]));
        let [r, g, b] = if part == 0.0 { palette.zero } else { palette.at(part) };
        Color32::from_rgb(r, g, b)
    }

    #[test]
    fn the_first_row_stands_at_the_bottom() {
        let field = field(ndarray::array![[1.0, 2.0], [4.0, 0.0]]);
        let pixels = picture(&field, View::new((-1.0, 1.0), (-1.0, 1.0)), [2, 2]);
        assert_eq!(pixels, [grey(1.0), grey(0.0), grey(0.25), grey(0.5)]);
    }

    #[test]
    fn a_pixel_over_many_cells_shows_their_mean() {
        let mut values = Array2::zeros((512, 512));
        values[(0, 0)] = 4.0;
        values[(511, 511)] = 8.0;
        let field = field(values);
        let pixels = picture(&field, View::new((-256.0, 256.0), (-256.0, 256.0)), [256, 256]);
        // Means of four cells against a scale that ends at the largest cell.
        assert_eq!((pixels[255], pixels[255 * 256]), (grey(0.25), grey(0.125)));
        assert_eq!(pixels.iter().filter(|pixel| **pixel == grey(0.0)).count(), 256 * 256 - 2);
    }

    /// Some pixel shows a single bright cell, wherever the cell lies, and however large the map is on the screen.
    #[test]
    fn no_cell_is_passed_over() {
        for (cells, pixels) in [(100, 69), (100, 99), (100, 31), (300, 201), (300, 95)] {
            for bright in [0, 1, cells / 3, cells / 2 + 1, cells - 1] {
                let mut values = Array2::zeros((cells, cells));
                values[(bright, cells - 1 - bright)] = 1.0;
                let half = cells as f64 / 2.0;
                let view = View::new((-half, half), (-half, half));
                let shown = picture(&field(values), view, [pixels, pixels]);
                let lit = shown.iter().filter(|pixel| **pixel != grey(0.0)).count();
                assert_eq!(lit, 1, "cell {bright} of {cells} on {pixels} pixels");
            }
        }
    }

    #[test]
    fn beside_the_map_there_is_nothing() {
        let pixels = picture(&field(ndarray::array![[1.0]]), View::new((-1.5, 1.5), (-0.5, 0.5)), [3, 1]);
        assert_eq!(pixels, [MISSING, grey(1.0), MISSING]);
    }
}
