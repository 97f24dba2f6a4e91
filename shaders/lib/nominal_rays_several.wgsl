// An invocation of trace_nominal follows several rays, as one of trace_new does (lib/rays_several.wgsl). Twin of
// nominal_rays_one.wgsl: where the path takes nothing from its rays, or they log what they have left, there is nothing to gain.

fn follow_nominal_rays(invocation: u32) {
    let local = invocation % WORKGROUP_SIZE;
    let first = (invocation - local) * NOMINAL_RAYS_PER_INVOCATION + local;
    var turn = 0u;
    loop {
        follow_nominal(first + turn * WORKGROUP_SIZE);
        turn += 1u;
        if turn >= NOMINAL_RAYS_PER_INVOCATION {
            break;
        }
    }
}
