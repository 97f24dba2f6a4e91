// Follows the path of a ray: what happened to the ray, from its source on.
//
// Twin of stages/path.plain.wgsl: most scenes are traced without this file, and nothing of it is then in the loop.
//
// A path is a few words. Each part of the path changes them: the source, each event of a ray that goes on, and the end.
// `extend_path`, which is composed, knows what the words are: the sequence's key, and the state of a filter.
//
// The loop calls `interact` and others, which stand in ending.late.wgsl, or in ending.early.wgsl.

var<private> path: array<u32, PATH_WORDS>;

// Kinds of parts, as in model::sequence.
const TRANSMITTED: u32 = 0u;
const REFLECTED: u32 = 1u;
const SCATTERED_THROUGH: u32 = 2u;
const SCATTERED_BACK: u32 = 3u;
const FROM_SOURCE: u32 = 4u;
const ON_DETECTOR: u32 = 5u;
const ON_ABSORBER: u32 = 6u;
const ELSEWHERE: u32 = 7u;

// What the event does to the ray. A mirror that does not scatter reflects.
var<private> step_kind: u32 = REFLECTED;

fn followed_generate(index: u32) -> Ray {
    start_path();
    extend_path(FROM_SOURCE, range.source);
    return plain_generate(index);
}

fn followed_interact(ray: ptr<function, Ray>, surface: Surface, primitive: u32) {
    step_kind = REFLECTED;
    plain_interact(ray, surface, primitive);
    if (*ray).fate == ALIVE {
        extend_path(step_kind, primitive);
        report_step(*ray, primitive);
    }
}

fn leave_boundary(ray: ptr<function, Ray>, surface: Surface, entering_back: bool, reflects: bool) {
    step_kind = select(TRANSMITTED, REFLECTED, reflects);
    plain_leave_boundary(ray, surface, entering_back, reflects);
}

// Light whose path does not match a filter is on no map: it has a sum of its own.
fn splat(ray: Ray, index: u32, ends: bool) {
    if !keeps_path(index) {
        filter_out(ray.weight, ends);
        return;
    }
    if sum_up_path(ray, ON_DETECTOR, index, index) {
        plain_splat(ray, index, ends);
    }
}

// What an invocation keeps goes to memory.
fn followed_flush_bins() {
    flush_path();
    plain_flush_bins();
}

// Ends of rays that no detector records. The places of such ends follow the detectors' places, as in model::sequence.
fn followed_deposit_fate(ray: Ray) {
    if PATHS_HAVE_ENDS && keeps_path(NONE) {
        if ray.fate == ABSORBED {
            sum_up_path(ray, ON_ABSORBER, ray.last, NUM_DETECTORS + ray.last);
        } else {
            let kind = ray.fate - ESCAPED;
            sum_up_path(ray, ELSEWHERE, kind, NUM_DETECTORS + NUM_SURFACES + kind);
        }
    }
    plain_deposit_fate(ray);
}
