// The arrivals of two lanes in one store, in f32. The lanes in the first half of a subgroup store them
// (cpu/path/lanes.together.wgsl). Twin of arrivals.packed.wgsl and arrivals.words.wgsl.
@group(GROUP_SCENE) @binding(BINDING_LOG) var<storage, read_write> arrival_log: array<vec4<u32>>;

fn write_arrival(number: u32, place: vec2<real>, weight: real) {
    let own = bitcast<vec2<u32>>(place);
    let other = lane ^ (LANES / 2u);
    let next = vec2<u32>(subgroupShuffle(own.x, other), subgroupShuffle(own.y, other));
    if lane < LANES / 2u {
        arrival_log[number / 2u] = vec4<u32>(own, next);
    }
}
