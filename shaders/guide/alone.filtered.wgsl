// Where a filter keeps the light of one branch alone, that branch is followed. The other branch's flux is filtered out.
// Twin of alone.none.wgsl.

// Flux of branches that were not followed.
var<private> not_followed: Quanta = NO_QUANTA;

fn start_alone() {
    path[GUIDE_ALONE] = bitcast<u32>(1f);
}

// The probability with which a plain ray would have followed all branches that were followed alone so far.
fn share_followed_alone() -> f32 {
    return bitcast<f32>(path[GUIDE_ALONE]);
}

fn follow_alone(ray: ptr<function, Ray>, share: real) {
    path[GUIDE_ALONE] = bitcast<u32>(max(share_followed_alone() * f32(share), 1e-30f));
    let before = (*ray).weight;
    let after = min(before * share, before);
    not_followed = q_add(not_followed, q_sub(quantize(before), quantize(after)));
    (*ray).weight = after;
}

fn flush_not_followed() {
    deposit(CELL_FILTERED, not_followed);
    not_followed = NO_QUANTA;
}

// True if light of this path may still be kept after one more part.
fn may_match_after(kind: u32, number: u32) -> bool {
    let kept = path;
    extend_filter(kind, number);
    let may = may_match();
    path = kept;
    return may;
}

fn may_match_scattered(face: u32) -> bool {
    return may_match_after(SCATTERED_THROUGH, face) || may_match_after(SCATTERED_BACK, face);
}

// Whether the light of a ray that scatters here may still be kept, and of one that does not.
fn scattering_that_may_match(face: u32, reflects: bool) -> vec2<bool> {
    let scattered = may_match_scattered(face);
    return vec2<bool>(scattered, may_match_after(select(TRANSMITTED, REFLECTED, reflects), face));
}

// Whether the light of the reflected and of the transmitted branch may still be kept. A surface that scatters turns either
// branch to either side.
fn branches_that_may_match(face: u32) -> vec2<bool> {
    let scattered = may_scatter(face) && may_match_scattered(face);
    return vec2<bool>(
        scattered || may_match_after(REFLECTED, face),
        scattered || may_match_after(TRANSMITTED, face),
    );
}
