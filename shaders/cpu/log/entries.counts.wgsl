// An entry of the log where sums follow from counts: one word, which says what the entry is.
@group(GROUP_SCENE) @binding(BINDING_LOG) var<storage, read_write> deposit_log: array<u32>;

fn write_entry(number: u32, entry: u32, weight: real, place: vec2<real>) {
    deposit_log[number] = entry;
}
