//! What a map shows: values over a plane, for every kind of detector.

use crate::result::detectors::{CellMap, Span};
use crate::result::picture::polar;
use crate::result::{Detector, SpectralMap};
use ndarray::{Array2, Axis, Ix2};

/// How the cells of a field lie in the plane of a plot.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum CellGeometry {
    /// Equal rectangles.
    Rectangles,
    /// Directions as a disc: the polar angle grows from the middle, and the azimuth turns counter-clockwise from the
    /// right.
    Polar,
}

/// Values over a plane. Row 0 lies at the smallest y.
#[derive(Debug, Clone, PartialEq)]
pub struct Field {
    /// How the cells lie in the plane.
    pub geometry: CellGeometry,
    /// What the plot spans.
    pub x_range: (f64, f64),
    /// What the plot spans.
    pub y_range: (f64, f64),
    /// Axes and quantity, with their units.
    pub labels: Labels,
    /// Value per cell; NaN if there is none, as in a ratio.
    pub values: Array2<f64>,
    /// Rays per cell.
    pub hits: Array2<u64>,
    /// Standard error per cell, NaN where it is unknown.
    pub sigma: Array2<f64>,
    /// Flux of a cell per unit of its value, by row: an area \[mm^2\] or a solid angle \[sr\].
    pub measure: Vec<f64>,
}

/// Names and units.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Labels {
    /// Horizontal axis.
    pub x: (&'static str, &'static str),
    /// Vertical axis.
    pub y: (&'static str, &'static str),
    /// The values.
    pub value: (&'static str, &'static str),
    /// The flux, which is the sum of value times measure.
    pub flux: &'static str,
}

/// A cell: row and column.
pub type Cell = (usize, usize);

/// The standard errors of a result; if it has none, the errors of equal deposits.
fn sigma_of(errors: Option<&Array2<f64>>, values: &Array2<f64>, hits: &Array2<u64>) -> Array2<f64> {
    // An error of 0 means that no ray came, and says nothing.
    let known = |error: f64| if error > 0.0 { error } else { f64::NAN };
    errors.map_or_else(|| sigma_from_hits(values, hits), |errors| errors.mapv(known))
}

/// Standard errors of equal deposits: value / sqrt(hits).
fn sigma_from_hits(values: &Array2<f64>, hits: &Array2<u64>) -> Array2<f64> {
    let sigma =
        |(&value, &hits): (&f64, &u64)| if hits > 0 { value / (hits as f64).sqrt() } else { f64::NAN };
    let sigma = values.iter().zip(hits).map(sigma).collect();
    Array2::from_shape_vec(values.dim(), sigma).unwrap_or_else(|_| Array2::from_elem(values.dim(), f64::NAN))
}

const IRRADIANCE: Labels =
    Labels { x: ("x", "mm"), y: ("y", "mm"), value: ("Irradiance", "W/mm²"), flux: "W" };
impl Field {
    /// A map of rows and columns over equal rectangles; none of one with more indices.
    pub(crate) fn of_map(map: &CellMap<'_>) -> Option<Field> {
        let values = map.values.to_owned().into_dimensionality::<Ix2>().ok()?;
        let hits = map.hits.to_owned().into_dimensionality::<Ix2>().ok()?;
        let errors =
            map.errors.as_ref().and_then(|errors| errors.to_owned().into_dimensionality::<Ix2>().ok());
        let (rows, columns) = values.dim();
        let length = |Span { range: (low, high), .. }: Span| high - low;
        let area = (length(map.x) / columns as f64) * (length(map.y) / rows as f64);
        Some(Field {
            geometry: CellGeometry::Rectangles,
            x_range: map.x.range,
            y_range: map.y.range,
            labels: Labels { x: map.x.label, y: map.y.label, value: map.quantity, flux: "W" },
            sigma: sigma_of(errors.as_ref(), &values, &hits),
            measure: if map.are_alike { vec![area; rows] } else { map.sizes.clone() },
            values,
            hits,
        })
    }

    /// The map of a detector, in photometric units if it was traced for them. `None` if the detector has no rows and
    /// columns.
    pub fn of_detector(detector: &Detector) -> Option<Field> {
        let map = detector.data.result().map()?;
        Field::of_map(&match &detector.luminous {
            Some(seen) => map.in_units_of(seen),
            None => map,
        })
        .map(|field| Field {
            labels: Labels { flux: detector.luminous.as_ref().map_or("W", |_| "lm"), ..field.labels },
            ..field
        })
    }

    /// The field of a result, for tests.
    #[cfg(test)]
    pub(crate) fn of_result(result: &impl crate::result::detectors::DetectorResult) -> Field {
        result.map().and_then(|map| Field::of_map(&map)).unwrap()
    }

    /// Irradiance over x and y: the sum over the wavelength bins, each bin times its weight.
    pub fn of_spectral(map: &SpectralMap, weights: &[f64]) -> Field {
        let pixels = &map.pixels;
        let (rows, columns, _) = pixels.irradiance.dim();
        let (mut values, mut variance) =
            (Array2::zeros((rows, columns)), Array2::<f64>::zeros((rows, columns)));
        let mut all_hits = Array2::zeros((rows, columns));
        for (bin, &weight) in weights.iter().enumerate().filter(|(_, weight)| **weight != 0.0) {
            let (irradiance, hits) =
                (pixels.irradiance.index_axis(Axis(2), bin), pixels.hits.index_axis(Axis(2), bin));
            let errors =
                pixels.standard_error.as_ref().map(|errors| errors.index_axis(Axis(2), bin).to_owned());
            let sigma = sigma_of(errors.as_ref(), &irradiance.to_owned(), &hits.to_owned());
            let sums = values.iter_mut().zip(&mut variance).zip(&mut all_hits);
            for ((((value, variance), all_hits), (&irradiance, &hits)), &sigma) in
                sums.zip(irradiance.iter().zip(hits)).zip(&sigma)
            {
                *value += weight * irradiance;
                *all_hits += hits;
                // A ray has one wavelength, so two bins get their flux from different rays.
                *variance += if sigma.is_nan() { 0.0 } else { (weight * sigma).powi(2) };
            }
        }
        let sigma = variance.mapv(|variance| if variance > 0.0 { variance.sqrt() } else { f64::NAN });
        Field { sigma, ..Field::over_pixels((pixels.width, pixels.height), values, all_hits) }
    }

    fn over_pixels((width, height): (f64, f64), values: Array2<f64>, hits: Array2<u64>) -> Field {
        let (rows, columns) = values.dim();
        Field {
            geometry: CellGeometry::Rectangles,
            x_range: (-width / 2.0, width / 2.0),
            y_range: (-height / 2.0, height / 2.0),
            labels: IRRADIANCE,
            sigma: sigma_from_hits(&values, &hits),
            measure: vec![(width / columns as f64) * (height / rows as f64); rows],
            values,
            hits,
        }
    }

    /// A far field as a disc of directions.
    pub fn as_disc(self) -> Field {
        let range = (-self.y_range.1, self.y_range.1);
        let labels = Labels { x: ("θx", "°"), y: ("θy", "°"), ..self.labels };
        Field { geometry: CellGeometry::Polar, x_range: range, y_range: range, labels, ..self }
    }

    /// The same field in photometric units; `efficacy` is in lm/W.
    pub fn photometric(mut self, efficacy: f64) -> Field {
        let per_area = self.labels.value.1 == IRRADIANCE.value.1;
        // 1 lm/mm² is 10^6 lx.
        let (name, unit, factor) =
            if per_area { ("Illuminance", "lx", 1e6) } else { ("Luminous intensity", "cd", 1.0) };
        self.labels.value = (name, unit);
        self.labels.flux = "lm";
        self.values *= efficacy * factor;
        self.sigma *= efficacy * factor;
        self.measure.iter_mut().for_each(|measure| *measure /= factor);
        self
    }

    /// Rows and columns.
    pub fn dim(&self) -> (usize, usize) {
        self.values.dim()
    }

    /// The cell at a point of the plot.
    pub fn cell_at(&self, x: f64, y: f64) -> Option<Cell> {
        let (rows, columns) = self.dim();
        let bin = |at: f64, (low, high): (f64, f64), bins: usize| {
            let part = (at - low) / (high - low) * bins as f64;
            (part >= 0.0 && part < bins as f64).then_some(part as usize)
        };
        match self.geometry {
            CellGeometry::Rectangles => Some((bin(y, self.y_range, rows)?, bin(x, self.x_range, columns)?)),
            CellGeometry::Polar => {
                let phi = y.atan2(x).to_degrees();
                // The azimuth begins anew at 180 degrees.
                let phi = if phi >= 180.0 { phi - 360.0 } else { phi };
                Some((bin(x.hypot(y), (0.0, self.x_range.1), rows)?, bin(phi, (-180.0, 180.0), columns)?))
            }
        }
    }

    /// The middle of a cell, in the plot.
    pub fn centre(&self, cell: Cell) -> (f64, f64) {
        self.place(cell, (0.5, 0.5))
    }

    /// A place of a cell, in the plot. (0, 0) is the corner at the smallest row and column, and (1, 1) the corner at
    /// the largest.
    pub fn place(&self, (row, column): Cell, (down, along): (f64, f64)) -> (f64, f64) {
        let (rows, columns) = self.dim();
        let at = |index: f64, (low, high): (f64, f64), bins: usize| low + (high - low) * index / bins as f64;
        let (row, column) = (row as f64 + down, column as f64 + along);
        match self.geometry {
            CellGeometry::Rectangles => (at(column, self.x_range, columns), at(row, self.y_range, rows)),
            CellGeometry::Polar => {
                let theta = self.polar_angle(row);
                let (sin, cos) = at(column, (-180.0, 180.0), columns).to_radians().sin_cos();
                (theta * cos, theta * sin)
            }
        }
    }

    /// The polar angle of a place among the rings of a far field: row 1.5 is the middle of the second ring.
    pub fn polar_angle(&self, row: f64) -> f64 {
        self.x_range.1 * row / self.dim().0 as f64
    }

    /// The same field in larger cells of `by` rows and columns each. `by` divides the rows and the columns of the
    /// field. The flux of cells is kept. Errors hold for cells that are independent.
    pub fn coarser(&self, by: usize) -> Field {
        let (rows, columns) = self.dim();
        let (num_rows, num_columns) = (rows / by, columns / by);
        let block = |row: usize, column: usize| {
            (row * by..(row + 1) * by)
                .flat_map(move |row| (column * by..(column + 1) * by).map(move |column| (row, column)))
        };
        let measure: Vec<f64> =
            self.measure.chunks_exact(by).map(|rows| rows.iter().sum::<f64>() * by as f64).collect();
        let of_block = |sum: &dyn Fn(Cell) -> f64| {
            Array2::from_shape_fn((num_rows, num_columns), |(row, column)| {
                block(row, column).map(sum).sum::<f64>()
            })
        };
        let mut values = of_block(&|cell| self.flux_of(cell));
        let mut sigma =
            of_block(&|cell| (self.known_error(cell) * self.measure[cell.0]).powi(2)).mapv(f64::sqrt);
        for ((mut values, mut sigma), measure) in
            values.outer_iter_mut().zip(sigma.outer_iter_mut()).zip(&measure)
        {
            values /= *measure;
            sigma /= *measure;
        }
        let hits = Array2::from_shape_fn((num_rows, num_columns), |(row, column)| {
            block(row, column).map(|cell| self.hits[cell]).sum::<u64>()
        });
        Field { values, sigma, hits, measure, ..self.clone() }
    }

    /// The map with each cell in the place of itself and its neighbours: their flux over their measure. Errors stay errors of
    /// single cells.
    pub fn smoothed(&self) -> Field {
        let (rows, columns) = self.dim();
        let near = |at: usize, num: usize| at.saturating_sub(1)..(at + 2).min(num);
        let about = |(row, column): Cell| -> Vec<Cell> {
            let columns: Vec<usize> = match self.geometry {
                CellGeometry::Rectangles => near(column, columns).collect(),
                CellGeometry::Polar => (0..3).map(|step| (column + columns + step - 1) % columns).collect(),
            };
            near(row, rows).flat_map(|row| columns.iter().map(move |&column| (row, column))).collect()
        };
        let mean = |cell: Cell, of: &dyn Fn(Cell) -> f64| {
            let cells = about(cell);
            let measure: f64 = cells.iter().map(|cell| self.measure[cell.0]).sum();
            cells.iter().map(|&cell| of(cell) * self.measure[cell.0]).sum::<f64>() / measure
        };
        let all = |of: &dyn Fn(Cell) -> f64| Array2::from_shape_fn((rows, columns), |cell| mean(cell, of));
        let values = all(&|cell| self.values[cell]);
        let sigma = all(&|cell| self.known_error(cell).powi(2)).mapv(f64::sqrt);
        Field { values, sigma, ..self.clone() }
    }

    /// A far field in cells of about equal solid angle, shown in its own cells ([`polar::in_equal_solid_angles`]). Cells that
    /// share their light have one error.
    pub fn of_equal_solid_angles(&self) -> Field {
        let variances = Array2::from_shape_fn(self.dim(), |cell| self.known_error(cell).powi(2));
        let sigma = polar::by_groups(&variances, &self.measure, |group| {
            let num = group.len() as f64;
            (group.sum() / num / num).sqrt()
        });
        Field { values: polar::in_equal_solid_angles(&self.values, &self.measure), sigma, ..self.clone() }
    }

    /// The standard error of a cell; 0 where none is known.
    pub fn known_error(&self, cell: Cell) -> f64 {
        let error = self.sigma[cell];
        if error.is_finite() { error } else { 0.0 }
    }

    /// A length that resolves every cell.
    pub fn finest(&self) -> f64 {
        let (rows, columns) = self.dim();
        let pitch = |(low, high): (f64, f64), bins: usize| (high - low) / bins as f64;
        match self.geometry {
            CellGeometry::Rectangles => pitch(self.x_range, columns).min(pitch(self.y_range, rows)),
            CellGeometry::Polar => self.x_range.1 / rows as f64,
        }
    }

    /// Value times measure \[W or lm\].
    pub fn flux_of(&self, (row, column): Cell) -> f64 {
        self.values[(row, column)] * self.measure[row]
    }

    /// Sum over all cells \[W or lm\].
    pub fn total(&self) -> f64 {
        self.values.outer_iter().zip(&self.measure).map(|(row, measure)| row.sum() * measure).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::result::{FarFieldPattern, IrradianceMap};
    use ndarray::Array1;

    fn pattern(rows: usize, columns: usize) -> FarFieldPattern {
        let centres = |low: f64, high: f64, bins: usize| -> Array1<f64> {
            (0..bins).map(|bin| low + (high - low) * (bin as f64 + 0.5) / bins as f64).collect()
        };
        FarFieldPattern {
            intensity: Array2::from_elem((rows, columns), 2.0),
            theta: centres(0.0, 90.0, rows),
            phi: centres(-180.0, 180.0, columns),
            hits: Array2::from_elem((rows, columns), 4),
            standard_error: None,
        }
    }

    #[test]
    fn every_cell_holds_its_own_middle() {
        let pattern = pattern(9, 16);
        for field in [Field::of_result(&pattern), Field::of_result(&pattern).as_disc()] {
            for row in 0..9 {
                for column in 0..16 {
                    let (x, y) = field.centre((row, column));
                    assert_eq!(field.cell_at(x, y), Some((row, column)), "{:?}", field.geometry);
                }
            }
        }
    }

    #[test]
    fn outside_of_the_disc_there_is_nothing() {
        let field = Field::of_result(&pattern(9, 16)).as_disc();
        assert_eq!(field.cell_at(80.0, 80.0), None);
        assert_eq!(field.cell_at(-89.0, 0.0), Some((8, 0)));
    }

    #[test]
    fn an_even_intensity_over_a_hemisphere_sums_to_two_pi() {
        let field = Field::of_result(&pattern(900, 8)).as_disc();
        let expected = 2.0 * 2.0 * std::f64::consts::PI;
        // The midpoint rule for sin over a quarter turn errs by h^2 / 24, h = 0.1 degrees.
        assert!((field.total() / expected - 1.0).abs() < 2e-7);
        assert_eq!(field.sigma[(3, 3)], 1.0);
    }

    #[test]
    fn lux_times_area_is_lumen() {
        let map = IrradianceMap {
            irradiance: Array2::from_elem((4, 5), 0.5),
            x_coords: Array1::zeros(5),
            y_coords: Array1::zeros(4),
            hits: Array2::zeros((4, 5)),
            width: 10.0,
            height: 2.0,
            standard_error: None,
        };
        let field = Field::of_result(&map);
        assert!((field.total() - 10.0).abs() < 1e-12);
        assert!(field.sigma.iter().all(|sigma| sigma.is_nan()));
        let field = field.photometric(683.0);
        assert_eq!((field.values[(0, 0)], field.labels.value.1), (0.5 * 683.0 * 1e6, "lx"));
        assert!((field.total() - 6830.0).abs() < 1e-9);
    }
}
