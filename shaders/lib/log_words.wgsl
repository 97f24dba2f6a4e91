// An entry of the log in f32 on 32-bit integers: what it is, its weight, the fractions of its taps. Twin of
// log_packed.wgsl.
@group(0) @binding(20) var<storage, read_write> end_log: array<u32>;

fn write_entry(number: u32, entry: u32, weight: real, fractions: vec2<real>) {
    let word = number * LOG_WORDS;
    end_log[word] = entry;
    end_log[word + 1u] = bitcast<u32>(weight);
    if HAS_BILINEAR {
        end_log[word + 2u] = bitcast<u32>(fractions.x);
        end_log[word + 3u] = bitcast<u32>(fractions.y);
    }
}
