// An entry of the log in f64: what it is, exactly a number; its weight; the fractions of its taps.
@group(0) @binding(20) var<storage, read_write> end_log: array<real>;

fn write_entry(number: u32, entry: u32, weight: real, fractions: vec2<real>) {
    let word = number * LOG_WORDS;
    end_log[word] = real(entry);
    end_log[word + 1u] = weight;
    if HAS_BILINEAR {
        end_log[word + 2u] = fractions.x;
        end_log[word + 3u] = fractions.y;
    }
}
