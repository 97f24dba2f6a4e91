// One arrival in the log of a path (cpu/path/path_log.arrivals.wgsl), in f32 on 32-bit integers. Twin of
// arrivals.packed.wgsl and arrivals.words_together.wgsl.
@group(GROUP_SCENE) @binding(BINDING_LOG) var<storage, read_write> arrival_log: array<vec2<u32>>;

fn write_arrival(number: u32, place: vec2<real>, weight: real) {
    arrival_log[number] = bitcast<vec2<u32>>(place);
}
