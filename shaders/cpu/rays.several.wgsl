// An invocation of trace_new follows several rays, one after the other, so that its bins go to memory once for all of
// them. The rays lie one workgroup's size apart, so that neighbours write side by side. Twin of stages/rays.one.wgsl,
// which spares large shaders the loop.

fn follow_rays(invocation: u32) -> Ray {
    let local = invocation % WORKGROUP_SIZE;
    let first = (invocation - local) * RAYS_PER_INVOCATION + local;
    var ray: Ray;
    var turn = 0u;
    loop {
        ray = follow_new(first + turn * WORKGROUP_SIZE);
        turn += 1u;
        if turn >= RAYS_PER_INVOCATION {
            break;
        }
    }
    return ray;
}
