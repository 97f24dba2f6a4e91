//! Values of a map along a line.

use crate::result::figures::field::{Cell, Field};

/// A line through a plot.
pub type Line = [(f64, f64); 2];

/// One cell that a line crosses.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sample {
    /// The distances from the line's first end at which the line enters and leaves the cell.
    pub span: (f64, f64),
    /// The cell.
    pub cell: Cell,
    /// The cell's value.
    pub value: f64,
    /// The cell's standard error; NaN if unknown.
    pub sigma: f64,
}

/// The cells along a line, in order. A cell counts if the line is in it for at least a tenth of a cell.
pub fn profile(field: &Field, [start, end]: Line) -> Vec<Sample> {
    const STEPS_PER_CELL: f64 = 10.0;
    const MOST_STEPS: f64 = 1e6;
    let length = (end.0 - start.0).hypot(end.1 - start.1);
    let steps = (length / field.finest() * STEPS_PER_CELL).ceil().clamp(1.0, MOST_STEPS);
    let mut samples: Vec<Sample> = Vec::new();
    let mut last = None;
    for step in 0..steps as usize {
        let part = (step as f64 + 0.5) / steps;
        let at = (start.0 + part * (end.0 - start.0), start.1 + part * (end.1 - start.1));
        let span = (length * step as f64 / steps, length * (step + 1) as f64 / steps);
        let cell = field.cell_at(at.0, at.1);
        match (cell, samples.last_mut()) {
            (Some(_), Some(sample)) if cell == last => sample.span.1 = span.1,
            (Some(cell), _) => {
                samples.push(Sample { span, cell, value: field.values[cell], sigma: field.sigma[cell] });
            }
            (None, _) => {}
        }
        last = cell;
    }
    samples
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::result::IrradianceMap;
    use ndarray::{Array1, Array2};

    fn field() -> Field {
        Field::of_result(&IrradianceMap {
            irradiance: Array2::from_shape_fn((4, 8), |(y, x)| (10 * y + x) as f64),
            x_coords: Array1::zeros(8),
            y_coords: Array1::zeros(4),
            hits: Array2::from_elem((4, 8), 25),
            width: 8.0,
            height: 4.0,
            standard_error: None,
        })
    }

    #[test]
    fn a_line_along_a_row_reads_that_row() {
        let samples = profile(&field(), [(-4.0, 0.5), (4.0, 0.5)]);
        let values: Vec<f64> = samples.iter().map(|sample| sample.value).collect();
        assert_eq!(values, (0..8).map(|x| f64::from(20 + x)).collect::<Vec<_>>());
        for (index, sample) in samples.iter().enumerate() {
            assert!((sample.span.0 - index as f64).abs() < 1e-9, "{sample:?}");
            assert!((sample.span.1 - index as f64 - 1.0).abs() < 1e-9, "{sample:?}");
            assert_eq!(sample.sigma, sample.value / 5.0);
        }
    }

    #[test]
    fn a_diagonal_crosses_each_cell_once() {
        let samples = profile(&field(), [(-4.0, -2.0), (4.0, 2.0)]);
        let mut cells: Vec<Cell> = samples.iter().map(|sample| sample.cell).collect();
        assert_eq!((cells[0], cells[cells.len() - 1]), ((0, 0), (3, 7)));
        let count = cells.len();
        cells.dedup();
        assert_eq!(cells.len(), count);
    }

    #[test]
    fn outside_of_the_map_nothing_is_read() {
        assert!(profile(&field(), [(-9.0, 3.0), (9.0, 3.0)]).is_empty());
        let samples = profile(&field(), [(-9.0, 0.0), (9.0, 0.0)]);
        assert_eq!(samples.len(), 8);
        assert!((samples[0].span.0 - 5.0).abs() < 0.1);
    }
}
