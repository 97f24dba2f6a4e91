// An invocation that follows a path does so with several rays, as one of trace_new does (software/rays.several.wgsl), where
// the path takes from its rays what they do not log.

// The first of them, by what would be its invocation if each had its own.
fn first_turn(invocation: u32) -> u32 {
    let local = invocation % WORKGROUP_SIZE;
    return (invocation - local) * PATH_RAYS_PER_INVOCATION + local;
}

fn next_turn(invocation: u32) -> u32 {
    return invocation + WORKGROUP_SIZE;
}
