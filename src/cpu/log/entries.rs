//! Entries of the deposit log, as they lie in memory (shaders/cpu/log/entries.*.wgsl). [`crate::cpu::log::positions`]
//! has the entries that are positions.

use crate::cpu::log::format::CELL_BITS;
use crate::cpu::log::reals::Real;
use bytemuck::Pod;

// The parts of what an entry is (`END_*` in ends.logged.wgsl and passes.logged.wgsl).
/// The cell.
pub const CELL_MASK: u32 = (1 << CELL_BITS) - 1;
/// The second tap lies in the next column.
pub const NEXT_COLUMN: u32 = 1 << 22;
/// The third tap lies in the next row.
pub const NEXT_ROW: u32 = 1 << 23;
/// The pixel that was hit lies in the next column.
pub const HIT_NEXT_COLUMN: u32 = 1 << 24;
/// The pixel that was hit lies in the next row.
pub const HIT_NEXT_ROW: u32 = 1 << 25;
/// The cell takes the whole weight.
pub const IN_CELL: u32 = 1 << 26;
/// Four taps share the weight.
pub const IN_TAPS: u32 = 1 << 27;
/// The ray had no place.
pub const WITHOUT_POSITION: u32 = 1 << 28;
/// The ray goes on.
pub const PASSES: u32 = 1 << 29;
/// The ray failed a guard of the hot path. The low bits are the event of that guard.
pub const GUARD_FAILED: u32 = 1 << 30;

/// An entry of the log.
#[derive(Debug, Clone, Copy)]
pub struct End<T> {
    /// Its cell, and what it is (`END_*` in ends.logged.wgsl).
    pub what: u32,
    /// The weight.
    pub weight: T,
    /// How far the position is from the first tap to the next, by columns and by rows.
    pub fractions: [T; 2],
}

/// An entry as it lies in the log (`write_entry` in shaders/cpu/log/entries.*.wgsl).
pub trait Entry: Pod {
    /// The precision of the trace.
    type Real: Real;

    /// Sums follow from counts.
    const IS_COUNTED: bool = false;

    /// The end that the entry records.
    fn read(&self) -> End<Self::Real>;
}

/// What the low and the high half of a word hold.
fn halves(word: u64) -> [u32; 2] {
    [word as u32, (word >> 32) as u32]
}

impl Entry for [u32; 1] {
    type Real = f32;

    const IS_COUNTED: bool = true;

    fn read(&self) -> End<f32> {
        End { what: self[0], weight: 0.0, fractions: [0.0; 2] }
    }
}

impl Entry for [u64; 1] {
    type Real = f32;

    fn read(&self) -> End<f32> {
        let [what, weight] = halves(self[0]);
        End { what, weight: f32::from_bits(weight), fractions: [0.0; 2] }
    }
}

impl Entry for [u64; 2] {
    type Real = f32;

    fn read(&self) -> End<f32> {
        let [what, weight] = halves(self[0]);
        End { what, weight: f32::from_bits(weight), fractions: halves(self[1]).map(f32::from_bits) }
    }
}

impl Entry for [f64; 2] {
    type Real = f64;

    fn read(&self) -> End<f64> {
        End { what: self[0] as u32, weight: self[1], fractions: [0.0; 2] }
    }
}

impl Entry for [f64; 4] {
    type Real = f64;

    fn read(&self) -> End<f64> {
        let [what, weight, x, y] = *self;
        End { what: what as u32, weight, fractions: [x, y] }
    }
}
