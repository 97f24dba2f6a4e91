// An entry of the log in f32, on 32-bit integers: the kind of entry, the weight, the fractions of the taps. Where
// positions are logged: the position, and the weight, unless rays keep the weight they are born with. Twin of
// entries.packed.wgsl.
@group(GROUP_SCENE) @binding(BINDING_LOG) var<storage, read_write> end_log: array<u32>;

fn write_entry(number: u32, entry: u32, weight: real, place: vec2<real>) {
    let word = number * LOG_WORDS;
    if LOGS_POSITIONS {
        let is_position = (entry & END_IN_TAPS) != 0u;
        end_log[word] = bitcast<u32>(select(OFF_DETECTORS, place.x, is_position));
        end_log[word + 1u] = select(entry, bitcast<u32>(place.y), is_position);
        if LOGS_WEIGHTS {
            end_log[word + 2u] = bitcast<u32>(weight);
        }
        return;
    }
    end_log[word] = entry;
    end_log[word + 1u] = bitcast<u32>(weight);
    if HAS_BILINEAR {
        end_log[word + 2u] = bitcast<u32>(place.x);
        end_log[word + 3u] = bitcast<u32>(place.y);
    }
}
