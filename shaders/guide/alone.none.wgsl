// Without a filter, both branches may matter. Twin of alone.filtered.wgsl.

fn branches_that_may_match(face: u32) -> vec2<bool> {
    return vec2<bool>(true, true);
}

fn scattering_that_may_match(face: u32, reflects: bool) -> vec2<bool> {
    return vec2<bool>(true, true);
}

fn start_alone() {}

fn share_followed_alone() -> f32 {
    return 1f;
}

fn follow_alone(ray: ptr<function, Ray>, share: real) {}
