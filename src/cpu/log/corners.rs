//! Sums of logged positions on a detector, one row for each corner between pixels. At a corner the four taps of a
//! position lie side by side, and are added as one vector. Pixels get their sums when all is added up.

use crate::cpu::log::format::Grid;
use crate::cpu::log::reals::pixels_at;

/// Quanta at the corners of a grid.
#[derive(Debug)]
pub struct CornerSums {
    grid: Grid,
    /// Four sums for each corner, in the order of its taps.
    words: Vec<u64>,
    /// Where the first corner begins, so that no corner lies in two lines of a cache.
    start: usize,
}

/// Words of a corner.
const TAPS: usize = 4;

impl CornerSums {
    /// Sums of 0.
    pub fn new(grid: Grid) -> Self {
        let num_corners: usize = grid.size.iter().map(|&num_pixels| num_pixels as usize + 1).product();
        // The allocator gives words of zero untouched, but not larger types. So the first corner is aligned here.
        let words = vec![0; TAPS * (num_corners + 1)];
        let start = words.as_ptr().align_offset(TAPS * size_of::<u64>()).min(TAPS);
        CornerSums { grid, words, start }
    }

    /// Whether these are the sums of this grid.
    pub fn are_of(&self, grid: &Grid) -> bool {
        self.grid == *grid
    }

    /// Adds quanta below 2^63 to the taps of a corner. The result is whether a sum has lost a carry.
    #[inline(always)]
    pub fn add(&mut self, corner: u32, quanta: [u64; TAPS]) -> Option<bool> {
        let first = self.start + TAPS * corner as usize;
        let sums: &mut [u64; TAPS] = self.words.get_mut(first..first + TAPS)?.try_into().ok()?;
        let mut lost = 0;
        for (sum, more) in sums.iter_mut().zip(quanta) {
            let before = *sum;
            *sum = before.wrapping_add(more);
            lost |= before & !*sum;
        }
        Some(lost >> 63 != 0)
    }

    /// The cells of those taps of a corner whose sums, to which so much was added last, have lost a carry.
    #[cold]
    pub fn carries(&self, corner: u32, quanta: [u64; TAPS]) -> impl Iterator<Item = usize> {
        let sums = self.words.iter().skip(self.start + TAPS * corner as usize);
        let lost = sums.zip(quanta).map(|(&sum, more)| sum < more);
        self.cells(corner).into_iter().zip(lost).filter(|(_, lost)| *lost).map(|(cell, _)| cell)
    }

    /// The sums of all taps with their cells: a cell comes once for each corner that it touches.
    pub fn by_cell(&self) -> impl Iterator<Item = (usize, u64)> {
        let corners = (0..).zip(self.words[self.start..].chunks_exact(TAPS));
        let lit = corners.filter(|(_, sums)| sums.iter().any(|&sum| sum != 0));
        lit.flat_map(|(corner, sums)| self.cells(corner).into_iter().zip(sums.iter().copied()))
    }

    /// The cells of a corner's taps.
    fn cells(&self, corner: u32) -> [usize; TAPS] {
        let Grid { first, column, row, size } = self.grid;
        let corners_per_row = size[0] + 1;
        let [left, right] = pixels_at(corner % corners_per_row, size[0]).map(|x| column * x as usize);
        let [above, below] = pixels_at(corner / corners_per_row, size[1]).map(|y| first + row * y as usize);
        [above + left, above + right, below + left, below + right]
    }
}
