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
        /// Passed over at once where nothing is in them.
        const BLOCK: usize = 512;
        let blocks = (0..).step_by(BLOCK).zip(bytes.chunks(BLOCK));
        let lit = blocks.filter(|(_, block)| block.iter().fold(0, |all, byte| all | byte) != 0);
        lit.flat_map(move |(at, block)| self.values_of_block(first + at / self.element_bytes(), block))
    }

    fn values_of_block(self, first: u64, bytes: &[u8]) -> impl Iterator<Item = (usize, u128)> {
        let lowest_bit = if self == Words::Top { 64 } else { 0 };
        let elements = (first..).zip(bytes.chunks_exact(self.element_bytes() as usize));
        elements.filter(|(_, element)| element.iter().any(|&byte| byte != 0)).map(move |(at, element)| {
            let value = element.iter().rev().fold(0, |value, &byte| (value << 8) | u128::from(byte));
            let (cell, word) = (at / self.per_cell(), at % self.per_cell());
            (cell as usize, value << (lowest_bit + 32 * word))
        })
    }
}
