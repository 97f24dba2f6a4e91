// Cells of three words (lo, hi, top) on 32-bit atomics. Twin of sums.native.wgsl.
@group(GROUP_SCENE) @binding(BINDING_SUMS) var<storage, read_write> sums: array<atomic<u32>>;

// Adds to a cell. The one deposit that wrapped a word takes its carry, so the total is exact once the dispatch has
// ended.
fn deposit(cell: u32, q: Quanta) {
    let carry = add_word(3u * cell, q.x);
    let hi = q.y + carry;
    // hi + carry wraps where q.y is all ones: the word is then unchanged and the carry moves on.
    let top = q.z + select(0u, 1u, hi < carry) + add_word(3u * cell + 1u, hi);
    if top != 0u {
        atomicAdd(&sums[3u * cell + 2u], top);
    }
}

// Adds to a word and returns the carry out of it.
fn add_word(word: u32, value: u32) -> u32 {
    if value == 0u {
        return 0u;
    }
    return select(0u, 1u, atomicAdd(&sums[word], value) > ~value);
}
