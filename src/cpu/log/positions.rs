//! Ends that are logged as positions on a detector (`LOGS_POSITIONS` in shaders/cpu/log/entries.*.wgsl). For each
//! position this module finds the four pixels around it, and how many quanta each pixel takes. A block of rays is laid
//! out at once and without branches, so that the code is compiled to vectors.

use crate::cpu::log::bits::bits;
use crate::cpu::log::entries::End;
use crate::cpu::log::format::Grid;
use crate::cpu::log::reals::Real;
use bytemuck::Pod;

/// Rays of a block.
pub const BLOCK: usize = 64;

/// Where the rays of a block leave weight, and how much.
#[derive(Debug)]
pub struct Block<T> {
    /// The pixels that were hit.
    pub hits: [u32; BLOCK],
    /// The corners between the pixels of the taps.
    pub corners: [u32; BLOCK],
    /// Quanta of the taps.
    pub quanta: [[u64; 4]; BLOCK],
    /// What is no position, or has a weight whose quanta need more than 63 bits: a bit for each ray.
    pub others: u64,
    is_other: [bool; BLOCK],
    /// What the first three taps take of a weight of 1.
    parts: [[T; BLOCK]; 3],
}

/// The taps of a position on a map whose pixels have one cell each, as pixels of irradiance have (`bilinear_taps` in
/// splat.wgsl).
#[derive(Debug, Clone, Copy)]
pub struct PositionTaps<T> {
    /// The pixel that was hit.
    pub hit: u32,
    /// The cells of the taps.
    pub cells: [u32; 4],
    /// The corner between them ([`corner`]).
    pub corner: u32,
    /// How far the position is from the first to the next, by columns and by rows.
    pub fractions: [T; 2],
    /// The position is not NaN.
    pub is_number: bool,
}

/// The number of the corner behind so many columns and rows of a grid: there is one more of each than there are pixels.
#[inline(always)]
fn corner(columns: u32, rows: u32, grid: &Grid) -> u32 {
    rows * (grid.size[0] + 1) + columns
}

/// An entry that is a position where the ray has ended in taps.
pub trait PositionEntry: Pod {
    /// The precision of the trace.
    type Real: Real;

    /// The position in pixels.
    fn position(&self) -> [Self::Real; 2];

    /// The weight; `born` is what the ray was born with.
    fn weight(&self, born: Self::Real) -> Self::Real;

    /// The end that it is, if it is no position.
    fn end(&self, born: Self::Real) -> End<Self::Real>;
}

impl<T> PositionTaps<T> {
    /// The taps of a position on a grid.
    #[inline(always)]
    pub fn of([x, y]: [T; 2], grid: &Grid) -> Self
    where
        T: Real,
    {
        let (column, row) = (x.tap(grid.size[0]), y.tap(grid.size[1]));
        let start = |row: u32| grid.first as u32 + row * grid.row as u32;
        let (above, below) = (start(row.first), start(row.next));
        PositionTaps {
            hit: start(row.hit) + column.hit,
            cells: [above + column.first, above + column.next, below + column.first, below + column.next],
            corner: corner(column.corner, row.corner, grid),
            fractions: [column.fraction, row.fraction],
            is_number: column.is_number & row.is_number,
        }
    }
}

impl<T: Real> Block<T> {
    /// An empty block.
    pub fn new() -> Self {
        let zero = T::nearest(0.0);
        Block {
            hits: [0; BLOCK],
            corners: [0; BLOCK],
            quanta: [[0; 4]; BLOCK],
            others: 0,
            is_other: [false; BLOCK],
            parts: [[zero; BLOCK]; 3],
        }
    }

    /// Quanta that some rays leave together. `rays` has a bit for each ray, and none of [`Block::others`].
    pub fn total(&self, rays: u64) -> u128 {
        bits(rays).map(|ray| u128::from(self.quanta[ray].iter().sum::<u64>())).sum()
    }

    /// Lays out what at most [`BLOCK`] rays have logged. Each ray leaves each of these weights. Where rays log their
    /// own weights, `weights` has one element, whose value means nothing.
    pub fn lay_out<E: PositionEntry<Real = T>>(&mut self, entries: &[E], weights: &[T], grid: &Grid) {
        match entries.try_into() {
            Ok(entries) => self.lay_out_all(entries, weights, grid),
            Err(_) => {
                let mut padded = [E::zeroed(); BLOCK];
                padded[..entries.len()].copy_from_slice(entries);
                self.lay_out_all(&padded, weights, grid);
            }
        }
    }

    fn lay_out_all<E: PositionEntry<Real = T>>(&mut self, entries: &[E; BLOCK], weights: &[T], grid: &Grid) {
        #[cfg(target_arch = "x86_64")]
        {
            if is_x86_feature_detected!("avx512f")
                && is_x86_feature_detected!("avx512dq")
                && is_x86_feature_detected!("avx512vl")
            {
                // SAFETY: the processor has what the function is compiled for.
                #[allow(unsafe_code)]
                return unsafe { self.lay_out_in_avx512(entries, weights, grid) };
            }
            if is_x86_feature_detected!("avx2") {
                // SAFETY: likewise.
                #[allow(unsafe_code)]
                return unsafe { self.lay_out_in_avx2(entries, weights, grid) };
            }
        }
        self.lay_out_inline(entries, weights, grid);
    }

    /// The same in vectors of 512 bits, with their conversions to 64-bit integers.
    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx512f,avx512dq,avx512vl")]
    fn lay_out_in_avx512<E: PositionEntry<Real = T>>(
        &mut self,
        entries: &[E; BLOCK],
        weights: &[T],
        grid: &Grid,
    ) {
        self.lay_out_inline(entries, weights, grid);
    }

    /// In vectors of 256 bits.
    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2")]
    fn lay_out_in_avx2<E: PositionEntry<Real = T>>(
        &mut self,
        entries: &[E; BLOCK],
        weights: &[T],
        grid: &Grid,
    ) {
        self.lay_out_inline(entries, weights, grid);
    }

    #[inline(always)]
    fn lay_out_inline<E: PositionEntry<Real = T>>(
        &mut self,
        entries: &[E; BLOCK],
        weights: &[T],
        grid: &Grid,
    ) {
        self.place(entries, grid);
        match weights.split_first() {
            None => self.quanta = [[0; 4]; BLOCK],
            Some((&first, more)) => {
                self.share_any(|i| entries[i].weight(first), |_, quanta| quanta);
                for &weight in more {
                    self.share_any(|i| entries[i].weight(weight), u64::wrapping_add);
                }
            }
        }
        self.others = (0..BLOCK).fold(0, |bits, i| bits | u64::from(self.is_other[i]) << i);
    }

    /// Finds the taps.
    #[inline(always)]
    fn place<E: PositionEntry<Real = T>>(&mut self, entries: &[E; BLOCK], grid: &Grid) {
        for (i, entry) in entries.iter().enumerate() {
            let taps = PositionTaps::of(entry.position(), grid);
            self.hits[i] = taps.hit;
            self.corners[i] = taps.corner;
            let parts = T::parts(taps.fractions);
            self.parts.iter_mut().zip(parts).for_each(|(all, part)| all[i] = part);
            self.is_other[i] = !taps.is_number | entry.position()[0].is_off_detectors();
        }
    }

    /// Shares a weight among the taps of each ray. `made` gives a tap's new quanta, from what it had and what it takes.
    #[inline(always)]
    fn share_any(&mut self, weight: impl Fn(usize) -> T, made: impl Fn(u64, u64) -> u64) {
        if (0..BLOCK).all(|i| weight(i).is_at_most_one()) {
            self.share::<true>(weight, made);
        } else {
            self.share::<false>(weight, made);
        }
    }

    #[inline(always)]
    fn share<const AT_MOST_ONE: bool>(
        &mut self,
        weight: impl Fn(usize) -> T,
        made: impl Fn(u64, u64) -> u64,
    ) {
        for i in 0..BLOCK {
            let parts = [self.parts[0][i], self.parts[1][i], self.parts[2][i]];
            let (quanta, is_small) = T::quanta::<AT_MOST_ONE>(weight(i), parts);
            self.quanta[i].iter_mut().zip(quanta).for_each(|(all, taken)| *all = made(*all, taken));
            self.is_other[i] |= !is_small;
        }
    }
}

/// x, y; then the weight, if it is logged; then what fills a word, or a vector.
macro_rules! position_entry {
    ([$word:ty; $num:literal], $real:ty, $real_of:expr, $weight:expr) => {
        impl PositionEntry for [$word; $num] {
            type Real = $real;

            #[inline(always)]
            fn position(&self) -> [$real; 2] {
                [self[0], self[1]].map($real_of)
            }

            #[inline(always)]
            fn weight(&self, born: $real) -> $real {
                let weight: fn(&Self, $real) -> $real = $weight;
                weight(self, born)
            }

            fn end(&self, born: $real) -> End<$real> {
                // What the end is: the bits of an f32, or the number of an f64.
                End { what: self[1] as u32, weight: self.weight(born), fractions: [0.0; 2] }
            }
        }
    };
}

position_entry!([u32; 2], f32, f32::from_bits, |_, born| born);
position_entry!([u32; 4], f32, f32::from_bits, |entry, _| f32::from_bits(entry[2]));
position_entry!([f64; 2], f64, |real| real, |_, born| born);
position_entry!([f64; 3], f64, |real| real, |entry, _| entry[2]);
position_entry!([f64; 4], f64, |real| real, |entry, _| entry[2]);
