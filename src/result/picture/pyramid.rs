//! A map at coarser resolutions. A frame then reads about as many numbers as the screen has pixels, however many cells
//! the map has.

use ndarray::{Array2, ArrayView2, s};
use std::ops::{AddAssign, Range};

/// Sums of a map's cells over blocks of 2 x 2, 4 x 4, ... cells. Blocks at the far edges may hold fewer.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Pyramid {
    coarser: Vec<Blocks>,
}

#[derive(Debug, Clone, PartialEq)]
struct Blocks {
    sums: Array2<f64>,
    /// Numbers of cells that have a value; `None` if all cells have one.
    known: Option<Array2<u32>>,
}

/// One resolution of a map.
#[derive(Debug, Clone, Copy)]
pub struct Level<'a> {
    /// Cells along the side of a block.
    pub side: usize,
    /// Sums over the blocks. A block of a single cell is NaN if the cell has no value.
    pub sums: ArrayView2<'a, f64>,
    known: Option<&'a Array2<u32>>,
    cells: (usize, usize),
}

/// Most cells of a map that is read whole.
const SMALL: usize = 512 * 512;

impl Pyramid {
    /// The pyramid of a map.
    pub fn of(values: &Array2<f64>) -> Self {
        let is_small = |cells: usize| cells <= SMALL;
        let mut pyramid = Pyramid::default();
        if is_small(values.len()) {
            return pyramid;
        }
        let known = |value: &f64| u32::from(!value.is_nan());
        let all_known = values.iter().all(|value| !value.is_nan());
        let mut blocks = Blocks {
            sums: halved(values, |value| if value.is_nan() { 0.0 } else { *value }),
            known: (!all_known).then(|| halved(values, known)),
        };
        while !is_small(blocks.sums.len()) {
            let next = Blocks {
                sums: halved(&blocks.sums, |sum| *sum),
                known: blocks.known.as_ref().map(|known| halved(known, |count| *count)),
            };
            pyramid.coarser.push(std::mem::replace(&mut blocks, next));
        }
        pyramid.coarser.push(blocks);
        pyramid
    }

    /// The coarsest resolution with blocks of at most `cells` cells along the side. `values` must be the map of this
    /// pyramid.
    pub fn level<'a>(&'a self, values: &'a Array2<f64>, cells: f64) -> Level<'a> {
        let halvings = (cells.max(1.0).log2() as usize).min(self.coarser.len());
        let blocks = halvings.checked_sub(1).map(|index| &self.coarser[index]);
        Level {
            side: 1 << halvings,
            sums: blocks.map_or(values.view(), |blocks| blocks.sums.view()),
            known: blocks.and_then(|blocks| blocks.known.as_ref()),
            cells: values.dim(),
        }
    }
}

impl Level<'_> {
    /// Number of cells with a value in a range of blocks. Where blocks are single cells, all of them count.
    pub fn count(&self, rows: &Range<usize>, columns: &Range<usize>) -> usize {
        let within = |blocks: &Range<usize>, cells: usize| {
            (blocks.end * self.side).min(cells) - blocks.start * self.side
        };
        match self.known {
            _ if rows.is_empty() || columns.is_empty() => 0,
            None => within(rows, self.cells.0) * within(columns, self.cells.1),
            Some(known) => {
                known.slice(s![rows.clone(), columns.clone()]).iter().map(|count| *count as usize).sum()
            }
        }
    }
}

/// Sums over blocks of 2 x 2.
fn halved<T, U: Copy + Default + AddAssign>(cells: &Array2<T>, of: impl Fn(&T) -> U) -> Array2<U> {
    let (rows, columns) = cells.dim();
    let mut sums = Array2::default((rows.div_ceil(2), columns.div_ceil(2)));
    for (row, cells) in cells.outer_iter().enumerate() {
        let mut sums = sums.row_mut(row / 2);
        cells.iter().enumerate().for_each(|(column, cell)| sums[column / 2] += of(cell));
    }
    sums
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A map with an odd number of rows and columns, large enough to be halved twice.
    fn map() -> Array2<f64> {
        Array2::from_shape_fn((1301, 1103), |(row, column)| ((row * 31 + column * 17) % 101) as f64)
    }

    #[test]
    fn blocks_hold_the_sums_of_their_cells() {
        let values = map();
        let pyramid = Pyramid::of(&values);
        for (cells, side) in [(0.3, 1), (1.9, 1), (2.0, 2), (3.9, 2), (4.0, 4), (99.0, 4)] {
            let level = pyramid.level(&values, cells);
            assert_eq!(level.side, side, "{cells} cells a pixel");
            assert_eq!(level.sums.dim(), (1301_usize.div_ceil(side), 1103_usize.div_ceil(side)));
            for ((row, column), &sum) in level.sums.indexed_iter() {
                let span = |at: usize, end: usize| at * side..((at + 1) * side).min(end);
                let cells = values.slice(s![span(row, 1301), span(column, 1103)]);
                assert_eq!(sum, cells.sum());
                assert_eq!(level.count(&(row..row + 1), &(column..column + 1)), cells.len());
            }
        }
    }

    #[test]
    fn cells_without_a_value_do_not_count() {
        let mut values = map();
        values[(0, 0)] = f64::NAN;
        values.slice_mut(s![4..8, 4..8]).fill(f64::NAN);
        let pyramid = Pyramid::of(&values);
        let level = pyramid.level(&values, 4.0);
        assert_eq!(level.count(&(0..1), &(0..1)), 15);
        assert_eq!((level.count(&(1..2), &(1..2)), level.sums[(1, 1)]), (0, 0.0));
        assert_eq!(level.count(&(0..2), &(0..2)), 64 - 17);
    }

    #[test]
    fn a_small_map_is_read_whole() {
        let values = Array2::zeros((512, 512));
        assert_eq!(Pyramid::of(&values), Pyramid::default());
        assert_eq!(Pyramid::of(&values).level(&values, 8.0).side, 1);
    }
}
