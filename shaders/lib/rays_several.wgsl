// An invocation of trace_new follows several rays, one after the other: what its bins hold goes to memory once for all of
// them. They are as far apart as its workgroup is large, so that what neighbours write lies side by side. Twin of
// rays_one.wgsl: a loop of one round would cost lavapipe a quarter of its speed in large shaders.

fn follow_rays(invocation: u32) -> Ray {
    let local = invocation % WORKGROUP_SIZE;
    let first = (invocation - local) * RAYS_PER_INVOCATION + local;
    var ray: Ray;
    for (var turn = 0u; turn < RAYS_PER_INVOCATION; turn++) {
        ray = follow_new(first + turn * WORKGROUP_SIZE);
    }
    return ray;
}
