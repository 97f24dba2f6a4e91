// An invocation that follows a path follows several rays, as an invocation of trace_new does
// (cpu/rays.several.wgsl). Paths are followed so if the path takes from its rays something that they do not log.

// The first ray of an invocation. The argument is the invocation's number as if each ray had its own invocation.
fn first_turn(invocation: u32) -> u32 {
    let local = invocation % WORKGROUP_SIZE;
    return (invocation - local) * PATH_RAYS_PER_INVOCATION + local;
}

fn next_turn(invocation: u32) -> u32 {
    return invocation + WORKGROUP_SIZE;
}
