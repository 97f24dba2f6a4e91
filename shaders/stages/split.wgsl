// Stage split: a ray of few events that meets a refractive surface is split in two, and both branches are followed.
//
// The ray goes on as the reflected branch. The transmitted one is a ray of its own, with an id and so with draws of its
// own (model::ray_id): it waits here, as it arrived, until the reflected branch and all that came of it have ended, and then
// takes up the same event. So one invocation follows a whole family, and of a family no more rays are alive at a time
// than its budget. Those that wait for a ray are the other halves of its own reflections: so the budget that is left to
// it depends on its lineage alone. Where nothing is left the branch is drawn, as it is without splitting.

struct Waiting {
    ray: Ray,
    budget: u32,
    triangle: u32,
}

var<private> waiting: array<Waiting, WAITING_RAYS>;
var<private> num_waiting: u32 = 0u;
// Of the ray that is followed: how many rays may be alive while it is, itself included, beside those that wait; and true
// while it is to transmit.
var<private> budget: u32 = 0u;
var<private> transmits: bool = false;

// The draw that gives a share of the families one ray more, where the budget is a fraction.
const SPLIT_BUDGET: u32 = 12u;

@compute @workgroup_size(WORKGROUP_SIZE)
fn trace_split(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    begin();
    let index = id.y * groups.x * WORKGROUP_SIZE + id.x;
    if index >= range.count {
        return;
    }
    var ray = generate(index);
    record_birth(ray);
    budget = FAMILY_BUDGET + select(0u, 1u, draw_first(ray.key, SPLIT_BUDGET) < FAMILY_BUDGET_FRACTION);
    loop {
        if is_dispatched() & (ray.fate == ALIVE) {
            follow(&ray);
        }
        if num_waiting == 0u {
            break;
        }
        num_waiting -= 1u;
        ray = waiting[num_waiting].ray;
        budget = waiting[num_waiting].budget;
        restore_triangle(waiting[num_waiting].triangle);
        transmits = true;
    }
    flush_bins();
    flush_reached();
    notice_cut_loops();
}

// A ray that has waited stands where it was split.
fn intersect(ray: Ray) -> Hit {
    if transmits {
        return Hit(0.0, ray.last);
    }
    let hit = nearest_primitive(ray, Hit(MISS, NONE));
    keep_triangle();
    return hit;
}

fn draw_reflection(
    ray: ptr<function, Ray>, bits: u32, reflectance: Share, transmittance: real, total_reflection: bool,
) -> bool {
    if transmits {
        transmits = false;
        return false;
    }
    if (*ray).bounce >= SPLIT_DEPTH || total_reflection {
        return draw_branch(ray, bits, reflectance, transmittance, total_reflection);
    }
    if budget < 2u {
        note_saturation();
        return draw_branch(ray, bits, reflectance, transmittance, total_reflection);
    }
    return split(ray, bits, quotient(reflectance), transmittance);
}

// Reading first spares the atomic in all but the first few events.
fn note_saturation() {
    if atomicLoad(&counters[COUNTER_SATURATED]) == 0u {
        atomicStore(&counters[COUNTER_SATURATED], 1u);
    }
}

// Both branches, unless one has no weight. True if the ray goes on as the reflected one.
fn split(ray: ptr<function, Ray>, bits: u32, reflectance: real, transmittance: real) -> bool {
    let steps = weight_steps((*ray).weight);
    if CUTS_WEIGHTS {
        cut_weight(ray, steps);
    }
    let weight = (*ray).weight;
    let reflects_less = reflectance < 0.5;
    let lesser = lesser_weight(weight, select(transmittance, reflectance, reflects_less), bits, steps);
    if lesser == 0.0 {
        return !reflects_less;
    }
    let transmitted = child(*ray, select(lesser, weight - lesser, reflects_less));
    waiting[num_waiting] = Waiting(transmitted, budget, standing_triangle());
    num_waiting += 1u;
    budget -= 1u;
    (*ray).weight = select(weight - lesser, lesser, reflects_less);
    return true;
}

// What weights are split into: a power of two, no less than a quantum nor than what the significand of the weight
// resolves.
struct Steps {
    size: real,
    per_unit: real,
}

fn weight_steps(weight: real) -> Steps {
    var steps = Steps(2.220446049250313e-16, 4503599627370496.0);
    while (steps.size * SIGNIFICANDS <= weight) & (steps.size < 1048576.0) {
        steps.size *= 2.0;
        steps.per_unit *= 0.5;
    }
    return steps;
}

// A pair of f32 can hold more than whole steps: the ray loses what is beyond them, of which the sums of the branches would
// be a rounding.
fn cut_weight(ray: ptr<function, Ray>, steps: Steps) {
    let before = (*ray).weight;
    (*ray).weight = floor(before * steps.per_unit) * steps.size;
    deposit_loss(CELL_IMPORTANCE_LOSS, before, (*ray).weight);
}

// The weight of the branch with the smaller share. It is a whole number of steps, so that the other branch takes the
// rest without rounding and no quantum is lost between them. Rounded by chance, so that no share is too small to be met
// on average.
fn lesser_weight(weight: real, share: real, bits: u32, steps: Steps) -> real {
    let exact = weight * share * steps.per_unit;
    let whole = floor(exact);
    return (whole + select(real(0.0), real(1.0), below(bits, exact - whole))) * steps.size;
}

// Of a child's number the bit of this event is set.
fn child(parent: Ray, weight: real) -> Ray {
    var ray = parent;
    ray.weight = weight;
    ray.index |= (1u << ray.bounce) << INDEX_BITS;
    ray.key = family_key(ray.index);
    let jump = rng_table[ray.bounce];
    ray.fresnel = stream_at(ray.key, FRESNEL_BRANCH, jump);
    ray.roulette = stream_at(ray.key, RR, jump);
    return ray;
}

// The key of a ray whose number stands above its position in the range. ray_id = launched ray + number * 2^40.
fn family_key(index: u32) -> RayKey {
    let lo = range.first_lo + (index & ((1u << INDEX_BITS) - 1u));
    let hi = range.first_hi + select(0u, 1u, lo < range.first_lo);
    return key_of_id(lo, hi + ((index >> INDEX_BITS) << 8u));
}
