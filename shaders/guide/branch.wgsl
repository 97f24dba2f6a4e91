// Reflection is drawn with the probability that the guide has for it, mixed with the face's own. Twin of
// optics/branch.fresnel.wgsl.
//
// Let the guide alone draw a path with the probability Q, and plain rays with P. Here the path is drawn with a P + (1 -
// a) Q, where a is PLAIN_SHARE. So its weight is a plain ray's weight times 1 / (a + (1 - a) Q / P), and at most 1 / a
// of it. Each event keeps that mixture: the probability of a branch is the mean of both, weighted by how likely either
// would have come so far. The ray carries Q / P (Veach and Guibas, Optimally combining sampling techniques for
// Monte Carlo rendering, SIGGRAPH 1995, section 3: one-sample balance heuristic).

@group(GROUP_SCENE) @binding(BINDING_GUIDE) var<storage, read> guide: array<u32>;

// The mark of a node that does not guide at a face, beside the node after a reflection and after scattering through.
const GUIDE_IS_PLAIN: u32 = 0x80000000u;

// Q / P stays below this.
const MOST_RATIO: f32 = 1e30;

// What a node asks for at a face: the probability of scattering, and of a reflection where the ray does not scatter.
// Below 0: the face's own.
struct GuideChoice {
    reflect: f32,
    scatter: f32,
}

// Where a node has its words for a face (GUIDE_WORDS of them, model::guide::Guide).
fn guide_place(node: u32, face: u32) -> u32 {
    return GUIDE_WORDS * (node * NUM_SURFACES + face);
}

// The word of the node after a turn.
fn guide_after(place: u32, kind: u32) -> u32 {
    return guide[place + 1u + kind];
}

fn guide_choice(node: u32, face: u32) -> GuideChoice {
    let place = guide_place(node, face);
    let probabilities = vec2<f32>(f32(guide[place]), f32(guide[place + 1u])) * 2.3283064365386963e-10f;
    let reflects_plainly = (guide_after(place, REFLECTED) & GUIDE_IS_PLAIN) != 0u;
    let scatters_plainly = (guide_after(place, SCATTERED_THROUGH) & GUIDE_IS_PLAIN) != 0u;
    return GuideChoice(
        select(probabilities.x, -1f, reflects_plainly),
        select(probabilities.y, -1f, scatters_plainly),
    );
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
        path[GUIDE_NODE] = guide_after(guide_place(path[GUIDE_NODE], number), kind) & ~GUIDE_IS_PLAIN;
    }
}

// Draws the first of two branches, or the second. Nothing is drawn where one has no light. Light has the shares `first`
// and `second`, and guided rays `guided`.
fn draw_guided(
    ray: ptr<function, Ray>, bits: u32, first: real, second: real, guided: vec2<f32>, is_plain: bool,
) -> bool {
    let plain = vec2<f32>(f32(first), f32(second));
    let ratio = guide_ratio();
    let mixed = PLAIN_SHARE * plain.x + (1f - PLAIN_SHARE) * ratio * guided.x;
    let p = mixed / (PLAIN_SHARE + (1f - PLAIN_SHARE) * ratio);
    // In units of 2^-32, so that the draw has the very probability by which the weight is divided.
    let units = clamp(u32(clamp(p, 0f, 1f) * 4294967040f), 1u, 4294967040u);
    let is_certain = (plain.x <= 0f) | (plain.y <= 0f);
    let is_first = select(bits < units, plain.y <= 0f, is_certain);
    let drawn = real(f32(units)) * 2.3283064365386963e-10;
    let share = select(second / (1.0 - drawn), first / drawn, is_first);
    let certain = select(second, first, is_first);
    weigh(ray, select(share, certain, is_certain));
    let gained = select(guided.y / plain.y, guided.x / plain.x, is_first);
    path[GUIDE_RATIO] = bitcast<u32>(select(min(ratio * gained, MOST_RATIO), ratio, is_plain | is_certain));
    return is_first;
}

// The branch that the ray took last at a refractive face, and how many of the guided rays on that branch scatter. Below 0: as
// many as of plain rays.
var<private> branch_reflects: bool = false;
var<private> scattering_of_branch: f32 = -1f;

fn draw_branch(
    ray: ptr<function, Ray>, bits: u32, reflectance: Share, transmittance: real, total_reflection: bool,
) -> bool {
    branch_reflects = draw_guided_branch(ray, bits, reflectance, transmittance, total_reflection);
    return branch_reflects;
}

// Sets `scattering_of_branch`, too.
fn draw_guided_branch(
    ray: ptr<function, Ray>, bits: u32, reflectance: Share, transmittance: real, total_reflection: bool,
) -> bool {
    let choice = guide_choice(path[GUIDE_NODE], (*ray).last);
    scattering_of_branch = choice.scatter;
    if total_reflection {
        return true;
    }
    let reflected = quotient(reflectance);
    let may = branches_that_may_match((*ray).last);
    if may.x != may.y {
        follow_alone(ray, select(transmittance, reflected, may.x));
        return may.x;
    }
    let plain = vec2<f32>(f32(reflected), f32(transmittance));
    let is_plain = (choice.reflect < 0f) | (plain.x <= 0f) | (plain.y <= 0f);
    // Guided rays that are going to scatter take either branch as plain rays do, because rows do not know their branch.
    let scattered = max(choice.scatter, 0f);
    let passing = select(vec2<f32>(choice.reflect, 1f - choice.reflect), plain, is_plain);
    let guided = (1f - scattered) * passing + scattered * plain;
    let reflects = draw_guided(ray, bits, reflected, transmittance, guided, is_plain);
    if scattered > 0f && !is_plain {
        scattering_of_branch = min(scattered * select(plain.y / guided.y, plain.x / guided.x, reflects), 1f);
    }
    return reflects;
}

fn weigh(ray: ptr<function, Ray>, share: real) {
    let before = (*ray).weight;
    let after = before * share;
    deposit_loss(CELL_IMPORTANCE_LOSS, before, after);
    deposit_loss(CELL_IMPORTANCE_GAIN, after, before);
    (*ray).weight = after;
}
