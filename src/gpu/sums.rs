//! Reads the exact sums of a trace (`shaders/lib/sums*.wgsl`) back from the bytes of their buffers.

/// One unit of weight \[quanta\].
pub const QUANTA_PER_UNIT: u128 = 1 << 52;

/// Index of the counter of deposits that no sum can hold: `INVALID_DEPOSITS` in `sums.wgsl`.
pub const INVALID_DEPOSITS: usize = 0;

/// Bytes of a cell of the buffer `sums` on 64-bit atomics.
pub const NATIVE_CELL_BYTES: usize = 8;

/// Bytes of a cell of the buffer `tops`, which only 64-bit atomics have.
pub const NATIVE_TOP_BYTES: usize = 4;

/// Bytes of a cell of the buffer `sums` on 32-bit atomics.
pub const PORTABLE_CELL_BYTES: usize = 12;

/// The cells of `sums_native.wgsl` \[quanta\]: 64 bits each in `sums`, the 32 bits above them in `tops`.
pub fn read_native(sums: &[u8], tops: &[u8]) -> Vec<u128> {
    let cells = sums.chunks_exact(NATIVE_CELL_BYTES).zip(tops.chunks_exact(NATIVE_TOP_BYTES));
    cells.map(|(sum, top)| integer(sum) | (integer(top) << 64)).collect()
}

/// The cells of `sums_portable.wgsl` \[quanta\]: three words (lo, hi, top) each.
pub fn read_portable(sums: &[u8]) -> Vec<u128> {
    sums.chunks_exact(PORTABLE_CELL_BYTES).map(integer).collect()
}

/// A little-endian integer of up to 16 bytes.
fn integer(bytes: &[u8]) -> u128 {
    bytes.iter().rev().fold(0, |value, &byte| (value << 8) | u128::from(byte))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_layouts_give_the_same_cells() {
        let (low, top) = (0x1122_3344_5566_7788_u64, 0x99AA_BBCC_u32);
        let sums = [1_u64.to_le_bytes(), low.to_le_bytes()].concat();
        let tops = [0_u32.to_le_bytes(), top.to_le_bytes()].concat();
        let expected = [1_u128, (u128::from(top) << 64) | u128::from(low)];
        assert_eq!(read_native(&sums, &tops), expected);

        let cells: Vec<u8> = expected.iter().flat_map(|cell| cell.to_le_bytes()[..12].to_vec()).collect();
        assert_eq!(read_portable(&cells), expected);
    }
}
