// The table of paths: a slot for each sequence, found by the sequence's key.
//
// The table has some marks, slots, and rows of sums. A slot holds the three words of a key, what is at the sequence's
// end, and a ray that took the path. Invocations fill slots side by side, without locks. Each word of a key is set
// once, from 0, by whoever comes first. Whoever then finds another word there goes on to the next slot. All go through
// the slots in an order that the key alone decides, so no key has two slots. No slot stays half filled: whoever finds
// or sets a word goes on to set the next one.
//
// A table that takes no key out keeps its keys in any order of insertions. Source: Shun and Blelloch, Phase-concurrent
// hash tables for determinism (SPAA 2014), section 3.
//
// Rows of sums lie once for each of several shards. The rays of a workgroup are added to one shard, so that workgroups
// seldom wait for each other. The host adds the shards up.

@group(GROUP_SCENE) @binding(BINDING_PATHS) var<storage, read_write> path_table: array<atomic<u32>>;

// How large the table is, and whether it takes new keys. Every entry point copies the uniform before its first branch, as
// the range of rays.
struct PathHead {
    slot_mask: u32,
    shard_mask: u32,
    // 0: no key is added.
    is_open: u32,
    // The word where rows begin.
    first_row: u32,
}

@group(GROUP_SCENE) @binding(BINDING_PATHS_HEAD) var<uniform> path_head_uniform: PathHead;

var<private> path_head: PathHead;

// Marks, the first words. Not 0: some key found no slot.
const PATHS_OVERFLOW: u32 = 0u;
// Not 0: some square is too large to be summed.
const PATHS_LARGE_SQUARE: u32 = 1u;
const PATHS_MARKS: u32 = 8u;

// Words of a slot.
const SLOT_KEY: u32 = 0u;
const SLOT_END: u32 = 3u;
const SLOT_RAY: u32 = 4u;
const SLOT_SOURCE: u32 = 6u;
const SLOT_MAP: u32 = 7u;
const SLOT_WORDS: u32 = 8u;

// A key that finds so many slots taken finds none. A table that is half full has one such key in 2^64.
const MOST_TRIES: u32 = 64u;

// Squares of this size are not summed: a sum of fewer of them cannot overflow.
const LARGEST_SQUARE: real = 4096.0;

// True if the last word was set by this invocation.
var<private> was_set: bool = false;

fn path_slot(slot: u32) -> u32 {
    return PATHS_MARKS + slot * SLOT_WORDS;
}

// True if the word is the value, or was free and now is the value.
fn takes_word(at: u32, value: u32, is_open: bool) -> bool {
    was_set = false;
    var known = atomicLoad(&path_table[at]);
    loop {
        if known != 0u || !is_open {
            break;
        }
        let result = atomicCompareExchangeWeak(&path_table[at], 0u, value);
        was_set = result.exchanged;
        known = select(result.old_value, value, result.exchanged);
    }
    return known == value;
}

fn takes_slot(at: u32, key: vec3<u32>, is_open: bool) -> bool {
    if !takes_word(at, key.x, is_open) {
        return false;
    }
    if !takes_word(at + 1u, key.y, is_open) {
        return false;
    }
    return takes_word(at + 2u, key.z, is_open);
}

// The slot of a key, or NONE. `was_set` is then true if this invocation made the key whole.
fn find_path_slot(key: vec3<u32>, is_open: bool) -> u32 {
    let mask = path_head.slot_mask;
    let stride = key.y | 1u;
    var slot = key.x & mask;
    var found = NONE;
    var tries = 0u;
    loop {
        if always_true() & (found == NONE) & (tries < MOST_TRIES) {
            if takes_slot(path_slot(slot), key, is_open) {
                found = slot;
            } else {
                slot = (slot + stride) & mask;
            }
            tries += 1u;
        }
        if found != NONE || tries >= MOST_TRIES {
            break;
        }
    }
    return found;
}

// The first word of a row of sums. A key with a slot has the slot's row. A key without one has the row of its end. Rows
// of ends lie behind the rows of slots.
fn path_row(slot: u32, place: u32, index: u32) -> u32 {
    let num_slots = path_head.slot_mask + 1u;
    let shard = ((index & PATH_INDEX_MASK) / WORKGROUP_SIZE) & path_head.shard_mask;
    let row = select(slot, num_slots + place, slot == NONE);
    return path_head.first_row + (shard * (num_slots + NUM_ENDS) + row) * PATH_ROW_WORDS;
}

// Adds quanta to three words (lo, hi, top). A number below zero is added by its complement.
fn add_to_path(at: u32, q: Quanta) {
    let carry = add_path_word(at, q.x);
    let hi = q.y + carry;
    let top = q.z + select(0u, 1u, hi < carry) + add_path_word(at + 1u, hi);
    if top != 0u {
        atomicAdd(&path_table[at + 2u], top);
    }
}

// Adds to a word, and returns the carry out of it.
fn add_path_word(at: u32, value: u32) -> u32 {
    if value == 0u {
        return 0u;
    }
    return select(0u, 1u, atomicAdd(&path_table[at], value) > ~value);
}
