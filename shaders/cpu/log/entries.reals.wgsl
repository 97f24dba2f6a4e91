// An entry of the log in f64: the kind of entry as a number, the weight, the fractions of the taps. Where positions are
// logged: the position, and the weight, unless rays keep the weight they are born with.
@group(GROUP_SCENE) @binding(BINDING_LOG) var<storage, read_write> deposit_log: array<real>;

fn write_entry(number: u32, entry: u32, weight: real, place: vec2<real>) {
    let word = number * LOG_WORDS;
    if LOGS_POSITIONS {
        let is_position = (entry & END_IN_TAPS) != 0u;
        deposit_log[word] = select(OFF_DETECTORS, place.x, is_position);
        deposit_log[word + 1u] = select(real(entry), place.y, is_position);
        if LOGS_WEIGHTS {
            deposit_log[word + 2u] = weight;
        }
        return;
    }
    deposit_log[word] = real(entry);
    deposit_log[word + 1u] = weight;
    if HAS_BILINEAR {
        deposit_log[word + 2u] = place.x;
        deposit_log[word + 3u] = place.y;
    }
}
