// An invocation of trace_new follows one ray. Twin of rays_several.wgsl.

fn follow_rays(invocation: u32) -> Ray {
    return follow_new(invocation);
}
