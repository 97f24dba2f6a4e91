// An entry of the log in f32, on 64-bit integers. A processor's driver takes the lanes of a store one by one, so wide
// stores are cheap.
//
// The first word holds the kind of entry and the weight, the second the fractions of the taps. Where positions are
// logged, the first word is the position, and the second the weight. There is no second word if the weights of all rays
// are known.
@group(GROUP_SCENE) @binding(BINDING_LOG) var<storage, read_write> deposit_log: array<u64>;

fn write_entry(number: u32, entry: u32, weight: real, place: vec2<real>) {
    let word = number * LOG_WORDS;
    let second = packed_position(place);
    if LOGS_POSITIONS {
        let is_position = (entry & END_IN_TAPS) != 0u;
        deposit_log[word] = select(joined(bitcast<u32>(OFF_DETECTORS), entry), second, is_position);
        if LOGS_WEIGHTS {
            deposit_log[word + 1u] = u64(bitcast<u32>(weight));
        }
        return;
    }
    deposit_log[word] = joined(entry, bitcast<u32>(weight));
    if HAS_BILINEAR {
        deposit_log[word + 1u] = second;
    }
}

fn joined(low: u32, high: u32) -> u64 {
    return u64(low) | (u64(high) << 32u);
}

fn packed_position(place: vec2<real>) -> u64 {
    return joined(bitcast<u32>(place.x), bitcast<u32>(place.y));
}
