//! Figures of a region of a map, or of rays.

use crate::result::figures::field::{Cell, CellGeometry, Field};
use ndarray::Array2;
use serde::{Deserialize, Serialize};

/// A region of a plot. A cell belongs to the region if its middle does.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Region {
    /// The shape of the outline.
    pub outline: RegionOutline,
    /// Middle.
    pub centre: (f64, f64),
    /// Half of its width and height.
    pub half: (f64, f64),
}

/// The outline of a region.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum RegionOutline {
    /// A rectangle with its sides along the axes.
    Rectangle,
    /// An ellipse with its axes along the axes of the plot.
    Ellipse,
}

/// Figures of a region. Lengths are in the units of the plot's axes, flux in W or lm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Statistics {
    /// Cells.
    pub num_cells: u64,
    /// Rays.
    pub hits: u64,
    /// Sum of value times measure.
    pub flux: f64,
    /// Standard error of `flux`, for independent cells; NaN if the error of some lit cell is unknown.
    pub flux_sigma: f64,
    /// Mean value, weighted by the measure of the cells.
    pub mean: f64,
    /// Largest value.
    pub peak: f64,
    /// Place of the largest value.
    pub peak_at: (f64, f64),
    /// Smallest value over largest.
    pub uniformity: f64,
    /// Standard deviation of the values over their mean.
    pub variation: f64,
    /// Centre of the flux; NaN without flux.
    pub centroid: (f64, f64),
    /// Root of the mean square distance of the flux from its centroid.
    pub rms_radius: f64,
}

/// The fraction of the flux of a region within a distance of its centroid.
#[derive(Debug, Clone, PartialEq)]
pub struct EncircledEnergy {
    /// Radii, ascending.
    pub radius: Vec<f64>,
    /// Fraction of the flux within each, ending at 1.
    pub fraction: Vec<f64>,
}

impl Region {
    /// The region of a whole map.
    pub fn whole(field: &Field) -> Self {
        let ((x0, x1), (y0, y1)) = (field.x_range, field.y_range);
        Region::between(RegionOutline::Rectangle, (x0, y0), (x1, y1))
    }

    /// The region between two corners.
    pub fn between(outline: RegionOutline, a: (f64, f64), b: (f64, f64)) -> Self {
        Region {
            outline,
            centre: (0.5 * (a.0 + b.0), 0.5 * (a.1 + b.1)),
            half: (0.5 * (a.0 - b.0).abs(), 0.5 * (a.1 - b.1).abs()),
        }
    }

    /// True if a point lies within.
    pub fn contains(&self, (x, y): (f64, f64)) -> bool {
        let (u, v) = ((x - self.centre.0) / self.half.0, (y - self.centre.1) / self.half.1);
        match self.outline {
            RegionOutline::Rectangle => u.abs() <= 1.0 && v.abs() <= 1.0,
            RegionOutline::Ellipse => u * u + v * v <= 1.0,
        }
    }

    /// The directions within a cone about the axis of a far field that is shown as a disc.
    pub fn cone(half_angle_deg: f64) -> Self {
        Region { outline: RegionOutline::Ellipse, centre: (0.0, 0.0), half: (half_angle_deg, half_angle_deg) }
    }

    /// Which share of each cell lies within: of its area or solid angle, to 1/64; exactly for a cone about a far field's axis.
    pub fn shares(&self, field: &Field) -> Array2<f64> {
        const STEPS: usize = 8;
        let within = |step: usize| (step as f64 + 0.5) / STEPS as f64;
        let cosine = |row: usize| field.polar_angle(row as f64).to_radians().cos();
        let is_polar = field.geometry == CellGeometry::Polar;
        let is_round = self.outline == RegionOutline::Ellipse && self.half.0 == self.half.1;
        let is_cone = is_polar && is_round && self.centre == (0.0, 0.0);
        let edge = self.half.0.clamp(0.0, 180.0).to_radians().cos();
        Array2::from_shape_fn(field.dim(), |cell| {
            let [first, last] = [cosine(cell.0), cosine(cell.0 + 1)];
            if is_cone {
                return ((first - edge) / (first - last)).clamp(0.0, 1.0);
            }
            // Points at equal steps of area, or of solid angle.
            let down = |step: usize| match field.geometry {
                CellGeometry::Rectangles => within(step),
                CellGeometry::Polar => {
                    let polar_angle = (first - within(step) * (first - last)).acos().to_degrees();
                    polar_angle / field.polar_angle(1.0) - cell.0 as f64
                }
            };
            let points = (0..STEPS).flat_map(|row| (0..STEPS).map(move |along| (down(row), within(along))));
            let inside = points.filter(|point| self.contains(field.place(cell, *point))).count();
            inside as f64 / (STEPS * STEPS) as f64
        })
    }

    /// Which share of the region lies outside of the map, to some 1 %: of its area, or of its solid angle.
    pub fn share_outside(&self, field: &Field) -> f64 {
        const STEPS: u32 = 200;
        let along = |step: u32, centre: f64, half: f64| {
            centre + half * (2.0 * (f64::from(step) + 0.5) / f64::from(STEPS) - 1.0)
        };
        let reach = field.polar_angle(field.dim().0 as f64);
        let is_outside = |(x, y): (f64, f64)| match field.geometry {
            CellGeometry::Rectangles => {
                x < field.x_range.0 || x > field.x_range.1 || y < field.y_range.0 || y > field.y_range.1
            }
            CellGeometry::Polar => x.hypot(y) > reach,
        };
        let points = (0..STEPS).flat_map(|row| (0..STEPS).map(move |column| (column, row)));
        let places = points.map(|(column, row)| {
            (along(column, self.centre.0, self.half.0), along(row, self.centre.1, self.half.1))
        });
        // The disc of a far field shows solid angles larger towards its rim.
        let measure = |(x, y): (f64, f64)| match (field.geometry, f64::hypot(x, y).to_radians()) {
            (CellGeometry::Polar, angle) if angle > 0.0 => angle.sin().max(0.0) / angle,
            _ => 1.0,
        };
        let (mut outside, mut whole) = (0.0, 0.0);
        for place in places.filter(|place| self.contains(*place)) {
            whole += measure(place);
            outside += if is_outside(place) { measure(place) } else { 0.0 };
        }
        outside / whole
    }

    /// The cells in the region. Only cells near it are tested, so that a small region on a large map can be dragged
    /// smoothly.
    fn cells(self, field: &Field) -> impl Iterator<Item = Cell> + Clone + '_ {
        let (rows, columns) = field.dim();
        let near = |centre: f64, half: f64, (low, high): (f64, f64), bins: usize| {
            let at = |place: f64| ((place - low) / (high - low) * bins as f64).clamp(0.0, bins as f64);
            at(centre - half) as usize..at(centre + half).ceil() as usize
        };
        let (rows, columns) = match field.geometry {
            CellGeometry::Rectangles => (
                near(self.centre.1, self.half.1, field.y_range, rows),
                near(self.centre.0, self.half.0, field.x_range, columns),
            ),
            CellGeometry::Polar => (0..rows, 0..columns),
        };
        let near = rows.flat_map(move |row| columns.clone().map(move |column| (row, column)));
        near.filter(move |cell| self.contains(field.centre(*cell)) && field.values[*cell].is_finite())
    }

    /// The figures of a map in the region; `None` if the region holds no cell.
    pub fn statistics(&self, field: &Field) -> Option<Statistics> {
        let (mut num_cells, mut hits, mut variance) = (0, 0, 0.0);
        let (mut measure, mut sum) = (0.0, 0.0);
        // Moments are taken around the first value, so that nothing cancels where all values are alike.
        let (mut first, mut shifted, mut square) = (None, 0.0, 0.0);
        let (mut peak, mut peak_at, mut least) = (f64::NEG_INFINITY, (0.0, 0.0), f64::INFINITY);
        let mut spot = SpotMoments::default();
        for cell in self.cells(field) {
            let (value, weight, at) = (field.values[cell], field.measure[cell.0], field.centre(cell));
            num_cells += 1;
            hits += field.hits[cell];
            measure += weight;
            sum += value * weight;
            let shift = value - *first.get_or_insert(value);
            shifted += shift * weight;
            square += shift * shift * weight;
            if value != 0.0 {
                variance += (field.sigma[cell] * weight).powi(2);
            }
            if value > peak {
                (peak, peak_at) = (value, at);
            }
            least = least.min(value);
            spot.add(at, value * weight);
        }
        if num_cells == 0 {
            return None;
        }
        let mean = sum / measure;
        let variance_of_values = square / measure - (shifted / measure).powi(2);
        Some(Statistics {
            num_cells,
            hits,
            flux: sum,
            flux_sigma: variance.sqrt(),
            mean,
            peak,
            peak_at,
            uniformity: least / peak,
            variation: variance_of_values.max(0.0).sqrt() / mean,
            centroid: spot.centroid(),
            rms_radius: spot.rms_radius(),
        })
    }

    /// How the flux of a map in the region is spread around its centroid; `None` without flux.
    pub fn encircled_energy(&self, field: &Field) -> Option<EncircledEnergy> {
        encircled_energy(self.cells(field).map(|cell| (field.centre(cell), field.flux_of(cell))))
    }
}

/// Sums of a spot: weight, first and second moments, shifted by the first point so that nothing cancels far from 0.
#[derive(Debug, Clone, Copy, Default)]
pub struct SpotMoments {
    origin: Option<(f64, f64)>,
    weight: f64,
    x: f64,
    y: f64,
    square: f64,
}

impl SpotMoments {
    /// Adds a point with a weight.
    pub fn add(&mut self, at: (f64, f64), weight: f64) {
        let origin = *self.origin.get_or_insert(at);
        let (x, y) = (at.0 - origin.0, at.1 - origin.1);
        self.weight += weight;
        self.x += weight * x;
        self.y += weight * y;
        self.square += weight * (x * x + y * y);
    }

    /// Centre of the weight; NaN without weight.
    pub fn centroid(&self) -> (f64, f64) {
        let origin = self.origin.unwrap_or_default();
        (origin.0 + self.x / self.weight, origin.1 + self.y / self.weight)
    }

    /// Root of the mean square distance from the centroid; NaN without weight.
    pub fn rms_radius(&self) -> f64 {
        let (x, y) = (self.x / self.weight, self.y / self.weight);
        let mean_square = self.square / self.weight - x * x - y * y;
        // With `max`, the NaN of no weight would become a radius of 0.
        if mean_square < 0.0 { 0.0 } else { mean_square.sqrt() }
    }
}

/// Number of rings into which the plane is divided, up to the largest distance.
const RINGS: usize = 4096;

/// How weight is spread around its centroid; `None` without weight. Radii are resolved to 1/4096 of the largest.
pub fn encircled_energy(points: impl Iterator<Item = ((f64, f64), f64)> + Clone) -> Option<EncircledEnergy> {
    let points = points.filter(|(_, weight)| *weight > 0.0);
    let mut spot = SpotMoments::default();
    points.clone().for_each(|(at, weight)| spot.add(at, weight));
    let (x, y) = spot.centroid();
    let distances = points.map(|(at, weight)| ((at.0 - x).hypot(at.1 - y), weight));
    let largest = distances.clone().map(|(distance, _)| distance).fold(0.0, f64::max);
    let mut rings = vec![0.0; RINGS];
    for (distance, weight) in distances {
        let ring = if largest > 0.0 { distance / largest * RINGS as f64 } else { 0.0 };
        rings[(ring as usize).min(RINGS - 1)] += weight;
    }
    let total: f64 = rings.iter().sum();
    let mut curve = EncircledEnergy { radius: Vec::new(), fraction: Vec::new() };
    let mut sum = 0.0;
    for (ring, weight) in rings.iter().enumerate().filter(|(_, weight)| **weight > 0.0) {
        sum += weight;
        curve.radius.push(largest * (ring + 1) as f64 / RINGS as f64);
        curve.fraction.push(sum / total);
    }
    (total > 0.0).then_some(curve)
}

impl EncircledEnergy {
    /// The smallest radius that holds this fraction of the flux.
    pub fn radius_of(&self, fraction: f64) -> f64 {
        // Sums of floats may end slightly below 1.
        let index = self.fraction.partition_point(|held| *held < fraction - 1e-12);
        self.radius[index.min(self.radius.len() - 1)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::result::IrradianceMap;
    use approx::assert_relative_eq;
    use ndarray::{Array1, Array2};

    /// 400 x 400 pixels over 20 x 20 mm.
    fn field(value: impl Fn(f64, f64) -> f64) -> Field {
        const N: usize = 400;
        let at = |index: usize| (index as f64 + 0.5) / N as f64 * 20.0 - 10.0;
        Field::of_result(&IrradianceMap {
            irradiance: Array2::from_shape_fn((N, N), |(y, x)| value(at(x), at(y))),
            x_coords: Array1::zeros(N),
            y_coords: Array1::zeros(N),
            hits: Array2::from_elem((N, N), 100),
            width: 20.0,
            height: 20.0,
            standard_error: None,
        })
    }

    #[test]
    fn an_even_disc_has_the_figures_of_the_textbook() {
        let region = Region { outline: RegionOutline::Ellipse, centre: (1.0, -2.0), half: (6.0, 6.0) };
        let figures = region.statistics(&field(|_, _| 3.0)).unwrap();
        let area = std::f64::consts::PI * 36.0;
        assert_relative_eq!(figures.flux, 3.0 * area, max_relative = 1e-3);
        assert_relative_eq!(figures.mean, 3.0, max_relative = 1e-12);
        assert_relative_eq!(figures.uniformity, 1.0);
        assert_relative_eq!(figures.centroid.0, 1.0, epsilon = 1e-9);
        assert_relative_eq!(figures.centroid.1, -2.0, epsilon = 1e-9);
        // The mean square radius of a disc is R^2 / 2.
        assert_relative_eq!(figures.rms_radius, 6.0 / 2f64.sqrt(), max_relative = 1e-3);
        assert_eq!(figures.variation, 0.0);
        // 100 rays a cell: 10 % each, so 10 % / sqrt(cells) of the sum.
        let expected = figures.flux * 0.1 / (figures.num_cells as f64).sqrt();
        assert_relative_eq!(figures.flux_sigma, expected, max_relative = 1e-9);
        assert_eq!(figures.hits, 100 * figures.num_cells);
    }

    #[test]
    fn encircled_energy_of_an_even_disc_grows_with_the_square_of_the_radius() {
        let region = Region { outline: RegionOutline::Ellipse, centre: (0.0, 0.0), half: (8.0, 8.0) };
        let curve = region.encircled_energy(&field(|_, _| 1.0)).unwrap();
        for fraction in [0.1, 0.5, 0.9f64] {
            assert_relative_eq!(curve.radius_of(fraction), 8.0 * fraction.sqrt(), max_relative = 5e-3);
        }
        assert_relative_eq!(*curve.fraction.last().unwrap(), 1.0, epsilon = 1e-12);
    }

    #[test]
    fn a_gaussian_has_its_own_width() {
        let sigma = 1.5;
        let spot = |x: f64, y: f64| (-((x - 2.0).powi(2) + y * y) / (2.0 * sigma * sigma)).exp();
        let all = Region { outline: RegionOutline::Rectangle, centre: (0.0, 0.0), half: (10.0, 10.0) };
        let field = field(spot);
        let figures = all.statistics(&field).unwrap();
        assert_relative_eq!(figures.flux, 2.0 * std::f64::consts::PI * sigma * sigma, max_relative = 1e-6);
        assert_relative_eq!(figures.rms_radius, sigma * 2f64.sqrt(), max_relative = 1e-4);
        assert_relative_eq!(figures.centroid.0, 2.0, epsilon = 1e-5);
        // Half of a Gaussian's energy lies within sigma sqrt(2 ln 2).
        let half = all.encircled_energy(&field).unwrap().radius_of(0.5);
        assert_relative_eq!(half, sigma * (2.0 * 2f64.ln()).sqrt(), max_relative = 1e-2);
        assert_relative_eq!(figures.peak_at.0, 2.0, epsilon = 0.03);
    }

    #[test]
    fn a_ramp_has_the_uniformity_of_its_ends() {
        let field = field(|x, _| x + 11.0);
        let region = Region::between(RegionOutline::Rectangle, (5.0, 1.0), (-5.0, -1.0));
        let figures = region.statistics(&field).unwrap();
        // Middles of the first and the last pixel: -4.975 and 4.975.
        assert_relative_eq!(figures.uniformity, (11.0 - 4.975) / (11.0 + 4.975), max_relative = 1e-9);
        // Even numbers over a width w have the standard deviation w / sqrt(12).
        assert_relative_eq!(figures.variation, 10.0 / 12f64.sqrt() / 11.0, max_relative = 1e-4);
    }

    #[test]
    fn a_region_without_cells_or_flux_has_no_figures() {
        let nothing = Region { outline: RegionOutline::Ellipse, centre: (0.0, 0.0), half: (1e-6, 1e-6) };
        assert_eq!(nothing.statistics(&field(|_, _| 1.0)), None);
        let dark = Region { half: (5.0, 5.0), ..nothing };
        let figures = dark.statistics(&field(|_, _| 0.0)).unwrap();
        assert!(figures.centroid.0.is_nan() && figures.rms_radius.is_nan() && figures.flux == 0.0);
        assert_eq!(dark.encircled_energy(&field(|_, _| 0.0)), None);
    }

    #[test]
    fn a_spot_far_from_the_origin_keeps_its_width() {
        let mut spot = SpotMoments::default();
        [(-1.0, 0.0), (1.0, 0.0)].iter().for_each(|(x, y)| spot.add((1e9 + x, 1e9 + y), 0.5));
        assert_eq!(spot.rms_radius(), 1.0);
    }
}
