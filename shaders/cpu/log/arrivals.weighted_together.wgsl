// The arrivals and weights of LANES_TOGETHER lanes: two in f32, four in f64. The first lanes of a subgroup store them
// (cpu/path/lanes.together.wgsl). Twin of arrivals.weighted.wgsl.
@group(GROUP_SCENE) @binding(BINDING_LOG) var<storage, read_write> arrival_log: array<vec4<real>>;

const NUM_STORING: u32 = LANES / LANES_TOGETHER;

fn write_arrival(number: u32, place: vec2<real>, weight: real) {
    let own = vec4<real>(place, weight, 0.0);
    let second = place_of(lane ^ NUM_STORING, own);
    if lane < NUM_STORING {
        arrival_log[number] = own;
        arrival_log[number + 1u] = second;
    }
    if LANES_TOGETHER == 4u {
        let third = place_of(lane ^ (2u * NUM_STORING), own);
        let fourth = place_of(lane ^ (3u * NUM_STORING), own);
        if lane < NUM_STORING {
            arrival_log[number + 2u] = third;
            arrival_log[number + 3u] = fourth;
        }
    }
}

fn place_of(other: u32, own: vec4<real>) -> vec4<real> {
    return vec4<real>(subgroupShuffle(own.x, other), subgroupShuffle(own.y, other), subgroupShuffle(own.z, other), 0.0);
}
