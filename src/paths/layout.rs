//! The table of paths, as shaders/paths/table.wgsl has it: marks, slots, and rows of sums; and the head, which says how large
//! the table is.

use crate::model::SceneIr;
use crate::model::sequence::{End, SequenceKey};

/// Words of the marks, the first of a table.
pub const MARK_WORDS: u32 = 8;
/// The word that is not 0 where some key found no slot.
pub const OVERFLOW: usize = 0;
/// The word that is not 0 where some square was too large.
pub const LARGE_SQUARE: usize = 1;
/// Words of a slot.
pub const SLOT_WORDS: u32 = 8;
/// The map of a slot that has none.
pub const NO_MAP: u32 = u32::MAX;
/// Words of a sum: 96 bits.
const SUM_WORDS: u32 = 3;
/// Most shards of rows.
const MOST_SHARDS: u32 = 16;

/// What the rows of a scene's table are.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PathTableLayout {
    /// Ends of paths: rows behind the rows of slots.
    pub num_ends: u32,
    /// Words of a row.
    pub row_words: u32,
}

/// How a table of some size lies in its buffer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PathTableSize {
    /// Slots, a power of two.
    pub slots: u32,
    /// Copies of the rows, a power of two.
    pub shards: u32,
}

/// What a slot holds, beside its key.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Slot {
    /// Where the sequence ends.
    pub end: End,
    /// The id of a ray that took the path.
    pub ray: u64,
    /// Its source.
    pub source: u32,
}

impl PathTableLayout {
    /// The rows that hold counts and, where weights vary, sums and squares.
    pub fn of_totals(ir: &SceneIr, has_ends: bool, constant_weights: bool) -> Self {
        let row_words = if constant_weights { 1 } else { 1 + 2 * SUM_WORDS };
        PathTableLayout { num_ends: num_ends(ir, has_ends), row_words }
    }

    /// The rows that hold where light lies: the sums of weight times x, y and their squares.
    pub fn of_maps(ir: &SceneIr, has_ends: bool) -> Self {
        PathTableLayout { num_ends: num_ends(ir, has_ends), row_words: 3 * SUM_WORDS }
    }

    /// Words of the largest table with so many slots.
    pub fn words(&self, slots: u32) -> u64 {
        let size = PathTableSize { slots, shards: 1 };
        let fewest = PathTableSize { slots: slots.min(1 << 12), shards: MOST_SHARDS };
        self.end(size).max(self.end(fewest))
    }

    /// The word where rows begin.
    pub fn first_row(&self, size: PathTableSize) -> u64 {
        u64::from(MARK_WORDS) + u64::from(size.slots) * u64::from(SLOT_WORDS)
    }

    /// The word after the last.
    pub fn end(&self, size: PathTableSize) -> u64 {
        let rows = u64::from(size.shards) * (u64::from(size.slots) + u64::from(self.num_ends));
        self.first_row(size) + rows * u64::from(self.row_words)
    }

    /// So many slots, with as many shards as a buffer of `words` holds and rays give work to.
    pub fn size(&self, slots: u32, words: u64, num_rays: u64) -> PathTableSize {
        let fits = |shards: u32| self.end(PathTableSize { slots, shards }) <= words;
        let wanted = (num_rays >> 14).clamp(1, MOST_SHARDS.into()) as u32;
        let mut shards = wanted.next_power_of_two();
        while shards > 1 && !fits(shards) {
            shards /= 2;
        }
        PathTableSize { slots, shards }
    }

    /// The words that rows of one number add up to, over all shards. `words` begin with the first row.
    pub fn row<'w>(
        &self,
        words: &'w [u32],
        size: PathTableSize,
        row: u32,
    ) -> impl Iterator<Item = &'w [u32]> + use<'w> {
        let (rows, row_words) = ((size.slots + self.num_ends) as usize, self.row_words as usize);
        let starts = (0..size.shards as usize).map(move |shard| (shard * rows + row as usize) * row_words);
        starts.map(move |start| &words[start..start + row_words])
    }
}

/// The slots of a table of so many keys: half of them stay free.
pub fn slots_for(num_keys: usize) -> u32 {
    (2 * num_keys.max(32)).next_power_of_two() as u32
}

/// The number of the ends that have rows.
fn num_ends(ir: &SceneIr, has_ends: bool) -> u32 {
    match has_ends {
        true => End::all(ir).len() as u32,
        false => ir.detectors.len() as u32,
    }
}

/// The head of a table: the uniform `PathHead`.
pub fn head(layout: &PathTableLayout, size: PathTableSize, is_closed: bool) -> [u32; 4] {
    [size.slots - 1, size.shards - 1, u32::from(!is_closed), layout.first_row(size) as u32]
}

/// The key and the contents of a slot; none if it is free, or not whole.
pub fn read_slot(words: &[u32]) -> Option<(SequenceKey, Slot)> {
    let key = SequenceKey([words[0], words[1], words[2]]);
    let end = End::of_code(words[3])?;
    let ray = u64::from(words[4]) | u64::from(words[5]) << 32;
    key.0.iter().all(|word| *word != 0).then_some((key, Slot { end, ray, source: words[6] }))
}

/// Puts a key into its slot, as the shaders would, and returns the slot's number; none if the table is full.
pub fn insert(words: &mut [u32], size: PathTableSize, key: SequenceKey, contents: [u32; 5]) -> Option<u32> {
    const MOST_TRIES: u32 = 64;
    let (mask, stride) = (size.slots - 1, key.0[1] | 1);
    let mut slot = key.0[0] & mask;
    for _ in 0..MOST_TRIES {
        let at = (slot * SLOT_WORDS) as usize;
        if words[at] == 0 {
            words[at..at + 3].copy_from_slice(&key.0);
            words[at + 3..at + 8].copy_from_slice(&contents);
            return Some(slot);
        }
        slot = slot.wrapping_add(stride) & mask;
    }
    None
}

/// A sum of three words.
pub fn sum(words: &[u32]) -> u128 {
    words.iter().rev().fold(0, |sum, word| sum << 32 | u128::from(*word))
}

/// A sum of three words of either sign.
pub fn signed_sum(words: &[u32]) -> i128 {
    (sum(words) << 32) as i128 >> 32
}
