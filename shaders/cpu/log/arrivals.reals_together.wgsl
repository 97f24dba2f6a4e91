// The arrivals of four lanes in two stores, in f64. The lanes in the first quarter of a subgroup store them
// (cpu/path/lanes.together.wgsl). Twin of arrivals.reals.wgsl.
@group(GROUP_SCENE) @binding(BINDING_LOG) var<storage, read_write> arrival_log: array<vec4<real>>;

fn write_arrival(number: u32, place: vec2<real>, weight: real) {
    let second = place_of(lane ^ (LANES / 4u), place);
    let third = place_of(lane ^ (LANES / 2u), place);
    let fourth = place_of(lane ^ (3u * LANES / 4u), place);
    if lane < LANES / 4u {
        arrival_log[number / 2u] = vec4<real>(place, second);
        arrival_log[number / 2u + 1u] = vec4<real>(third, fourth);
    }
}

fn place_of(other: u32, place: vec2<real>) -> vec2<real> {
    return vec2<real>(subgroupShuffle(place.x, other), subgroupShuffle(place.y, other));
}
