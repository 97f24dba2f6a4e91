// The first lanes of a subgroup store the arrivals of the other lanes, too. Twin of lanes.alone.wgsl.
//
// A driver takes the lanes of a store one by one, out of vectors that it writes to memory anew for each lane. Some
// processors read the later half of a wide vector, just stored, ten times as slowly as the first half. On Intel's
// Sapphire Rapids with 512 bits: 6.8 ns against 0.6. So lanes that lie half a subgroup apart, or a quarter, follow
// neighbours in the log.
//
// The lanes of a subgroup must be neighbours in their workgroup, from a multiple of LANES on, as the lanes of
// lavapipe's vectors are.
struct Invocation {
    @builtin(global_invocation_id) id: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(subgroup_invocation_id) lane: u32,
}

var<private> lane: u32 = 0u;

fn begin_lanes(invocation: Invocation) {
    lane = invocation.lane;
}

// The ray that an invocation follows.
fn ray_of(invocation: u32) -> u32 {
    let storing = LANES / LANES_TOGETHER;
    return invocation - lane + LANES_TOGETHER * (lane % storing) + lane / storing;
}
