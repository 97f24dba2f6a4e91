//! Words of a log: entries, bits, quanta.

use crate::engine::sums::QUANTA_PER_UNIT;
use bytemuck::Pod;

/// The entries of a log, all of one kind. Bytes at the end that make no whole entry are left out.
pub(crate) fn entries_of<E: Pod>(bytes: &[u8]) -> Option<&[E]> {
    let whole = bytes.len() - bytes.len() % size_of::<E>();
    bytemuck::try_cast_slice(&bytes[..whole]).ok()
}

/// The numbers of the bits that are set.
#[inline(always)]
pub(crate) fn bits(mut word: u64) -> impl Iterator<Item = usize> {
    std::iter::from_fn(move || {
        let lowest = word.trailing_zeros();
        word &= word.wrapping_sub(1);
        (lowest < u64::BITS).then_some(lowest as usize)
    })
}

/// `quantize` in sums.wgsl: floor(w 2^52). `None` for a weight that is too large, negative or NaN.
pub(crate) fn quantize(weight: f64) -> Option<u128> {
    const LIMIT: f64 = (1_u64 << 43) as f64;
    (0.0..LIMIT).contains(&weight).then_some((weight * QUANTA_PER_UNIT as f64) as u128)
}
