// Each invocation of trace_main_path stores its own arrivals. Twin of lanes.together.wgsl.
struct Invocation {
    @builtin(global_invocation_id) id: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
}

fn begin_lanes(invocation: Invocation) {}

// The ray that an invocation follows.
fn ray_of(invocation: u32) -> u32 {
    return invocation;
}
