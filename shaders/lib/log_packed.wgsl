// An entry of the log in f32 on 64-bit integers: what it is and its weight; the fractions of its taps. A processor's
// driver takes the lanes of a store one by one, so wide stores are cheap. Twin of log_words.wgsl.
@group(0) @binding(20) var<storage, read_write> end_log: array<u64>;

fn write_entry(number: u32, entry: u32, weight: real, fractions: vec2<real>) {
    let word = number * LOG_WORDS;
    end_log[word] = joined(entry, bitcast<u32>(weight));
    if HAS_BILINEAR {
        end_log[word + 1u] = joined(bitcast<u32>(fractions.x), bitcast<u32>(fractions.y));
    }
}

fn joined(low: u32, high: u32) -> u64 {
    return u64(low) | (u64(high) << 32u);
}
