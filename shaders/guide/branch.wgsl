// Reflection is drawn with the probability that the guide has for it, mixed with the face's own. Twin of
// optics/branch.fresnel.wgsl.
//
// Let the guide alone draw a path with the probability Q, and plain rays with P. Here the path is drawn with a P + (1 -
// a) Q, where a is PLAIN_SHARE. So its weight is a plain ray's weight times 1 / (a + (1 - a) Q / P), and at most 1 / a
// of it. Each event keeps that mixture: the probability of a reflection is the mean of both, weighted by how likely
// either would have come so far. The ray carries Q / P (Veach and Guibas, Optimally combining sampling techniques for
// Monte Carlo rendering, SIGGRAPH 1995, section 3: one-sample balance heuristic).

@group(GROUP_SCENE) @binding(BINDING_GUIDE) var<storage, read> guide: array<vec4<u32>>;

// The mark of a node that does not guide at a face.
const GUIDE_IS_PLAIN: u32 = 0x80000000u;

// Q / P stays below this.
const MOST_RATIO: f32 = 1e30;

fn guide_at(node: u32, face: u32) -> vec4<u32> {
    return guide[node * NUM_SURFACES + face];
}

// Q / P.
fn guide_ratio() -> f32 {
    return bitcast<f32>(path[GUIDE_RATIO]);
}

// The path's node, and Q / P, after one more part.
fn extend_guide(kind: u32, number: u32) {
    if kind == FROM_SOURCE {
        path[GUIDE_NODE] = 1u + number;
        path[GUIDE_RATIO] = bitcast<u32>(1f);
        start_alone();
    } else if kind == REFLECTED || kind == SCATTERED_THROUGH || kind == SCATTERED_BACK {
        path[GUIDE_NODE] = guide_at(path[GUIDE_NODE], number)[kind] & ~GUIDE_IS_PLAIN;
    }
}

fn draw_branch(
    ray: ptr<function, Ray>, bits: u32, reflectance: Share, transmittance: real, total_reflection: bool,
) -> bool {
    if total_reflection {
        return true;
    }
    let reflected = quotient(reflectance);
    let may = branches_that_may_match((*ray).last);
    if may.x != may.y {
        follow_alone(ray, select(transmittance, reflected, may.x));
        return may.x;
    }
    let choice = guide_at(path[GUIDE_NODE], (*ray).last);
    let is_plain = (choice.y & GUIDE_IS_PLAIN) != 0u;
    let plain = vec2<f32>(f32(reflected), f32(transmittance));
    let wanted = f32(choice.x) * 2.3283064365386963e-10f;
    let guided = select(vec2<f32>(wanted, 1f - wanted), plain, is_plain);
    let ratio = guide_ratio();
    let mixed = PLAIN_SHARE * plain.x + (1f - PLAIN_SHARE) * ratio * guided.x;
    let p = mixed / (PLAIN_SHARE + (1f - PLAIN_SHARE) * ratio);
    // In units of 2^-32, so that the draw has the very probability by which the weight is divided.
    let units = clamp(u32(clamp(p, 0f, 1f) * 4294967040f), 1u, 4294967040u);
    let is_certain = (plain.x <= 0f) | (plain.y <= 0f);
    let reflects = select(bits < units, plain.y <= 0f, is_certain);
    let drawn = real(f32(units)) * 2.3283064365386963e-10;
    let share = select(transmittance / (1.0 - drawn), reflected / drawn, reflects);
    let certain = select(transmittance, reflected, reflects);
    weigh(ray, select(share, certain, is_certain));
    let gained = select(guided.y / plain.y, guided.x / plain.x, reflects);
    path[GUIDE_RATIO] = bitcast<u32>(select(min(ratio * gained, MOST_RATIO), ratio, is_plain | is_certain));
    return reflects;
}

fn weigh(ray: ptr<function, Ray>, share: real) {
    let before = (*ray).weight;
    let after = before * share;
    deposit_loss(CELL_IMPORTANCE_LOSS, before, after);
    deposit_loss(CELL_IMPORTANCE_GAIN, after, before);
    (*ray).weight = after;
}
