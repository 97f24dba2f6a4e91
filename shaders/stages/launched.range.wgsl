// The id of a launched ray of the range (low word, high word), from which the ids of its family follow. Twin of
// launched.listed.wgsl.
fn launched_id(index: u32) -> vec2<u32> {
    let lo = range.first_lo + index;
    return vec2<u32>(lo, range.first_hi + select(0u, 1u, lo < range.first_lo));
}
