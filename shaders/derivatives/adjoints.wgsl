// The way back: a ray is followed to its end, and its path is then walked from the last event to the first. What the
// loss gains by a change of the ray is the ray's adjoint. Each event hands adjoints on: from the ray after the event to
// the ray before, and to the numbers of the scene. Twin of tangents.wgsl.
//
// program::rewrite::transpose writes the functions that are empty here. For example, `generate_back` is the way back of
// `generate`. Such a function takes the plain function's arguments, then pointers to adjoints of the arguments that
// hold reals. Last comes the adjoint of the result. Source: Griewank and Walther, Evaluating Derivatives (2008),
// section 3.2: reverse propagation of gradients.

fn begin_back() {}
fn generate_back(index: u32, adjoint: Ray) {}
fn next_event_back(ray: ptr<function, Ray>, adjoint: ptr<function, Ray>) {}
fn settle_back(ray: Ray, adjoint: ptr<function, Ray>) {}

// Adds the adjoints of the scene's numbers to the sums of the invocation. If one is no number, none is added, and one more is
// lost. In either case the adjoints are 0 afterwards.
fn add_up_adjoints() {}

// Writes the sums of an invocation for the host, the rays that are lost, and whether loops were cut.
fn write_adjoints(invocation: u32) {}

// Rays of this invocation that are not added: they end at no position, or their adjoints are no numbers.
var<private> lost: real;

// 1 if a driver cut loops of this invocation short (loops.many.wgsl): its sums are void.
var<private> cut_loops: real;

// What the loss gains by a unit of weight in each cell of the detectors.
@group(GROUP_SCENE) @binding(BINDING_ADJOINTS) var<storage, read> cell_adjoints: array<real>;
@group(GROUP_SCENE) @binding(BINDING_ADJOINT_SUMS) var<storage, read_write> adjoint_sums: array<real>;

// All deposits, each times what the loss gains by a unit of weight in its cell: for derivatives by the total flux. The
// deposits of a ray are in proportion to the weight with which it is born.
var<private> noted: real;

fn adjoint_of(cell: u32) -> real {
    return cell_adjoints[cell - FIRST_DETECTOR_CELL];
}

// What functions note whose way back is made of forward derivatives (program::rewrite::transpose::loops).
var<private> forward_noted: real;

fn deposit_tangent(cell: u32, tangent: real, number: u32) {
    forward_noted += cell_adjoints[cell - FIRST_DETECTOR_CELL] * tangent;
}

// The search has no adjoint. On the way back, its result is the one that was kept.
var<private> last_hit: Hit;

fn search(ray: Ray) -> Hit {
    last_hit = plain_intersect(ray);
    return last_hit;
}

fn recalled_hit(ray: Ray) -> Hit {
    return last_hit;
}

fn intersect(ray: Ray) -> Hit {
    let hit = search(ray);
    return Hit(attached(hit.distance, hit.distance - crossing_step(ray, hit)), hit.primitive);
}

// Each event keeps what the way back cannot find again: where the ray came from, its distance, medium and weight, and
// what it met. Of a longer path, the last events are kept. Where these have been walked back, the ray is traced again
// up to them.
const MOST_KEPT: u32 = 16u;
const NUM_KEPT: u32 = min(MAX_DEPTH, MOST_KEPT);

struct Kept {
    directions: array<vec3<real>, NUM_KEPT>,
    distances: array<real, NUM_KEPT>,
    primitives: array<u32, NUM_KEPT>,
    media: array<u32, NUM_KEPT>,
    weights: array<real, NUM_KEPT>,
}

fn keep(kept: ptr<function, Kept>, event: u32, before: Ray) {
    let at = event % NUM_KEPT;
    (*kept).directions[at] = before.direction;
    (*kept).distances[at] = last_hit.distance;
    (*kept).primitives[at] = last_hit.primitive;
    if HAS_BULK_ABSORPTION {
        (*kept).media[at] = before.medium;
    }
    if WEIGHTS_VARY {
        (*kept).weights[at] = before.weight;
    }
}

// Takes the ray from after an event to before it. Sets the hit that the search then found.
fn restore(kept: ptr<function, Kept>, event: u32, ray: ptr<function, Ray>) {
    let at = event % NUM_KEPT;
    last_hit = Hit((*kept).distances[at], (*kept).primitives[at]);
    (*ray).direction = (*kept).directions[at];
    (*ray).position -= select(last_hit.distance, 0.0, last_hit.primitive == NONE) * (*ray).direction;
    if HAS_BULK_ABSORPTION {
        (*ray).medium = (*kept).media[at];
    }
    if WEIGHTS_VARY {
        (*ray).weight = (*kept).weights[at];
    }
    // A ray that has ended did not go on to its next draws.
    if (*ray).bounce > event {
        (*ray).fresnel = stream_before((*ray).fresnel);
        (*ray).roulette = stream_before((*ray).roulette);
    }
    (*ray).bounce = event;
    (*ray).fate = ALIVE;
}

// Adds what one ray gives to the adjoints of the scene's numbers.
fn walk(index: u32) {
    var kept: Kept;
    var adjoint: Ray;
    // Events that are not walked back yet.
    var left = MAX_DEPTH;
    var is_valid = true;
    loop {
        var ray = generate(index);
        var num = 0u;
        loop {
            if always_true() & (ray.fate == ALIVE) & (num < left) {
                let before = ray;
                next_event(&ray);
                keep(&kept, num, before);
                num += 1u;
            }
            if num >= left || ray.fate != ALIVE {
                break;
            }
        }
        if left == MAX_DEPTH {
            is_valid = has_position(ray);
            if is_valid & (HAS_TRANSMISSIVE | (ray.fate == DETECTED)) {
                settle_back(ray, &adjoint);
            } else {
                num = 0u;
            }
        }
        let first = max(num, NUM_KEPT) - NUM_KEPT;
        var event = num;
        loop {
            if always_true() & (event > first) {
                event -= 1u;
                restore(&kept, event, &ray);
                var before = ray;
                next_event_back(&before, &adjoint);
            }
            if event <= first {
                break;
            }
        }
        left = first;
        if MAX_DEPTH <= MOST_KEPT || left == 0u {
            break;
        }
    }
    if is_valid {
        noted += adjoint.weight * source().weight;
        generate_back(index, adjoint);
    } else {
        lost += 1.0;
    }
}

// Walks the rays of an invocation back. To add up the adjoints after each ray would take half as long again. So they are added
// up once, after the last. If they are no numbers, the rays are walked again and added up one by one: so one ray is lost, and not
// all. The sums stand outside of the loop over rays, because CPUs run both sides of a condition in every round.
fn walk_all(first: u32) {
    let num_rays = min(RAYS_PER_INVOCATION, range.count - first);
    var together = num_rays;
    var done = 0u;
    loop {
        let end = done + together;
        loop {
            if always_true() & (done < end) {
                walk(first + done);
            }
            done += 1u;
            if done >= end {
                break;
            }
        }
        let lost_before = lost;
        begin_back();
        add_up_adjoints();
        if together > 1u && lost > lost_before {
            together = 1u;
            done = 0u;
            lost = 0.0;
        } else if done >= num_rays {
            break;
        }
    }
}

@compute @workgroup_size(WORKGROUP_SIZE)
fn trace_back(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    begin();
    let invocation = id.y * groups.x * WORKGROUP_SIZE + id.x;
    let first = invocation * RAYS_PER_INVOCATION;
    if first < range.count {
        walk_all(first);
        cut_loops = choose(0.0, 1.0, loops_were_cut());
        write_adjoints(invocation);
    }
}
