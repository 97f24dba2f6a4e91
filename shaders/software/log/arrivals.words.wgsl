// One arrival in the log of a path (software/path/path_log.arrivals.wgsl), in f32 on 32-bit integers. Twin of
// arrivals.packed.wgsl and arrivals.words_together.wgsl.
@group(0) @binding(20) var<storage, read_write> place_log: array<vec2<u32>>;

fn write_place(number: u32, place: vec2<real>, weight: real) {
    place_log[number] = bitcast<vec2<u32>>(place);
}
