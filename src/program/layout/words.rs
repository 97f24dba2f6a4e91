//! The words that sums lie in.

/// What the elements of a buffer are.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Words {
    /// The lower 64 bits of a cell: `sums` on 64-bit atomics.
    Low,
    /// The 32 bits above them: `tops`.
    Top,
    /// The three words of a cell, the lowest first: `sums` on 32-bit atomics.
    All,
    /// Counters of 32 bits.
    Counter,
}

impl Words {
    /// Bytes of an element.
    pub fn element_bytes(self) -> u64 {
        match self {
            Words::Low => 8,
            Words::Top | Words::All | Words::Counter => 4,
        }
    }

    /// Elements of a cell.
    pub fn per_cell(self) -> u64 {
        match self {
            Words::All => 3,
            Words::Low | Words::Top | Words::Counter => 1,
        }
    }

    /// What the elements from `first` on add to their cells: (cell, value); zeros are left out.
    pub fn values(self, first: u64, bytes: &[u8]) -> impl Iterator<Item = (usize, u128)> {
        // Passed over at once where nothing is in them.
        let blocks = (0..).step_by(BLOCK).zip(bytes.chunks(BLOCK));
        let lit = blocks.filter(|(_, block)| !is_zero(block));
        lit.flat_map(move |(at, block)| self.values_of_block(first + at / self.element_bytes(), block))
    }

    fn values_of_block(self, first: u64, bytes: &[u8]) -> impl Iterator<Item = (usize, u128)> {
        let lowest_bit = if self == Words::Top { 64 } else { 0 };
        let elements = (first..).zip(bytes.chunks_exact(self.element_bytes() as usize));
        elements.filter(|(_, element)| !is_zero(element)).map(move |(at, element)| {
            let value = element.iter().rev().fold(0, |value, &byte| (value << 8) | u128::from(byte));
            let (cell, word) = (at / self.per_cell(), at % self.per_cell());
            (cell as usize, value << (lowest_bit + 32 * word))
        })
    }
}

/// Bytes that are passed over together.
const BLOCK: usize = 512;

/// True if all bytes are zero, of at most a block. A comparison of memory is fast also where nothing is optimised.
fn is_zero(bytes: &[u8]) -> bool {
    *bytes == [0; BLOCK][..bytes.len()]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_layouts_give_the_same_cells() {
        let expected = [1_u128, 0, (0x99AA_BBCC << 64) | 0x1122_3344_5566_7788];
        let bytes = |shift: u32, num: usize| -> Vec<u8> {
            expected.iter().flat_map(|cell| (cell >> shift).to_le_bytes()[..num].to_vec()).collect()
        };
        let cells = |buffers: &[(Words, u64, &[u8])]| {
            let mut cells = [0; 3];
            for (words, first, bytes) in buffers {
                words.values(*first, bytes).for_each(|(cell, value)| cells[cell] += value);
            }
            cells
        };
        assert_eq!(cells(&[(Words::Low, 0, &bytes(0, 8)), (Words::Top, 0, &bytes(64, 4))]), expected);
        // Parts end where they end, also within a cell.
        let words = bytes(0, 12);
        assert_eq!(cells(&[(Words::All, 0, &words[..28]), (Words::All, 7, &words[28..])]), expected);
    }

    #[test]
    fn zeros_are_passed_over() {
        let bytes = [0, 5, 0, 0, 7_u32].map(u32::to_le_bytes).concat();
        assert_eq!(Words::Counter.values(10, &bytes).collect::<Vec<_>>(), [(11, 5), (14, 7)]);
    }
}
