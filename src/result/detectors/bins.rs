//! Bins of results: their edges, centres and arrays.

use crate::error::{Error, Result};
use crate::model::PixelGrid;
use ndarray::{Array, Array1, Dimension, StrideShape};

/// Values as an array.
pub(crate) fn shaped<D: Dimension, T>(
    shape: impl Into<StrideShape<D>>,
    values: Vec<T>,
) -> Result<Array<T, D>> {
    Array::from_shape_vec(shape, values)
        .map_err(|error| Error::Internal(format!("cells of a detector: {error}")))
}

/// Area of one pixel \[mm^2\], rounded as Optiland rounds it.
pub(crate) fn pixel_area(grid: &PixelGrid) -> f64 {
    (grid.width / f64::from(grid.num_pixels_x)) * (grid.height / f64::from(grid.num_pixels_y))
}

/// The edges of `bins` equal bins, rounded as NumPy's `linspace` rounds them.
pub(crate) fn bin_edges(start: f64, stop: f64, bins: usize) -> Vec<f64> {
    let step = (stop - start) / bins as f64;
    (0..bins).map(|index| index as f64 * step + start).chain([stop]).collect()
}

/// The centres of `bins` equal bins.
pub(crate) fn bin_centres(start: f64, stop: f64, bins: usize) -> Array1<f64> {
    centres(&bin_edges(start, stop, bins))
}

/// The centres between edges.
pub(crate) fn centres(edges: &[f64]) -> Array1<f64> {
    edges.windows(2).map(|edge| 0.5 * (edge[0] + edge[1])).collect()
}
