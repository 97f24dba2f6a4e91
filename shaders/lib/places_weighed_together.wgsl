// The places and weights of four lanes (lib/lanes_together.wgsl): those in the first quarter of a subgroup store them. Twin of
// places_weighed.wgsl.
@group(0) @binding(20) var<storage, read_write> place_log: array<vec4<real>>;

const LANES_TOGETHER: u32 = 4u;

fn write_place(number: u32, place: vec2<real>, weight: real) {
    let own = vec4<real>(place, weight, 0.0);
    let second = place_of(lane ^ (LANES / 4u), own);
    let third = place_of(lane ^ (LANES / 2u), own);
    let fourth = place_of(lane ^ (3u * LANES / 4u), own);
    if lane < LANES / 4u {
        place_log[number] = own;
        place_log[number + 1u] = second;
        place_log[number + 2u] = third;
        place_log[number + 3u] = fourth;
    }
}

fn place_of(other: u32, own: vec4<real>) -> vec4<real> {
    return vec4<real>(subgroupShuffle(own.x, other), subgroupShuffle(own.y, other), subgroupShuffle(own.z, other), 0.0);
}
