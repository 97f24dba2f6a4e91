// Stage split: where a ray of few events meets a refractive surface, it is split in two, and both branches are
// followed.
//
// The ray goes on as the reflected branch. The transmitted branch is a new ray, with its own id and so its own draws
// (model::ray_id). The new ray waits, as it arrived, until the reflected branch and all its descendants have ended.
// Then the new ray takes up the same event. So one invocation follows a whole family.
//
// A family never has more rays alive at a time than its budget. The rays that wait for a ray are the other halves of
// its own reflections. So the budget left to a ray depends on the ray's lineage alone. Where no budget is left, one
// branch is drawn, as without splitting.

struct Waiting {
    ray: Ray,
    budget: u32,
    triangle: u32,
}

var<private> waiting: array<Waiting, WAITING_RAYS>;
var<private> num_waiting: u32 = 0u;
// State of the ray that is followed. `budget`: how many rays may be alive, this ray included, beside those that wait.
// `transmits`: true while the ray has yet to transmit.
var<private> budget: u32 = 0u;
var<private> transmits: bool = false;

// The slot of the draw that gives some families one ray more, where the budget is a fraction.
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
        if always_true() & (ray.fate == ALIVE) {
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

// The next hit. A ray that has waited stands where it was split.
fn plain_intersect(ray: Ray) -> Hit {
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

// Marks that some family used up its budget. Reading first spares the store in all but the first few events.
fn note_saturation() {
    if atomicLoad(&counters[COUNTER_SATURATED]) == 0u {
        atomicStore(&counters[COUNTER_SATURATED], 1u);
    }
}

// Splits the ray into both branches, unless one has no weight. True if the ray goes on as the reflected branch.
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

// The steps in which weights are split: a power of two that is at least a quantum, and that the weight's significand
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

// Cuts the weight to whole steps. A pair of f32 can hold more than whole steps, and the sum of two branches would round
// that excess.
fn cut_weight(ray: ptr<function, Ray>, steps: Steps) {
    let before = (*ray).weight;
    (*ray).weight = floor(before * steps.per_unit) * steps.size;
    deposit_loss(CELL_IMPORTANCE_LOSS, before, (*ray).weight);
}

// The weight of the branch with the smaller share. The weight is a whole number of steps. So the other branch takes the
// rest without rounding, and no quantum is lost. The rounding is by chance, so that on average even the smallest share
// is met.
fn lesser_weight(weight: real, share: real, bits: u32, steps: Steps) -> real {
    let exact = weight * share * steps.per_unit;
    let whole = floor(exact);
    return (whole + select(real(0.0), real(1.0), below(bits, exact - whole))) * steps.size;
}

// The transmitted ray. The child has its parent's number, with the bit of this event set.
fn plain_child(parent: Ray, weight: real) -> Ray {
    var ray = parent;
    ray.weight = weight;
    ray.index |= (1u << ray.bounce) << INDEX_BITS;
    ray.key = family_key(ray.index);
    let jump = rng_table[ray.bounce];
    ray.fresnel = stream_at(ray.key, FRESNEL_BRANCH, jump);
    ray.roulette = stream_at(ray.key, RR, jump);
    return ray;
}

// The key of a ray of a family, whose number stands in `index` above its position in the range. ray_id = launched ray +
// number * 2^40.
fn family_key(index: u32) -> RayKey {
    let id = launched_id(index & ((1u << INDEX_BITS) - 1u));
    return key_of_id(id.x, id.y + ((index >> INDEX_BITS) << 8u));
}
