// An invocation of trace_new follows one ray. Twin of cpu/rays.several.wgsl.

fn follow_rays(invocation: u32) -> Ray {
    return follow_new(invocation);
}
