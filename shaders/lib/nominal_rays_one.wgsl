// An invocation of trace_nominal follows one ray. Twin of nominal_rays_several.wgsl.

fn follow_nominal_rays(invocation: u32) {
    follow_nominal(invocation);
}
