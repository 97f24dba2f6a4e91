// Paths of the sampled rays: the state before each event, at its place. PATH_THRESHOLD / 2^32 of the rays are sampled
// by a hash of their id.

fn is_sampled(ray: Ray) -> bool {
    return RECORD_ALL_PATHS || draw_first(ray.key, PATH_SAMPLE) < PATH_THRESHOLD;
}

fn record_birth(ray: Ray) {
    if is_sampled(ray) {
        append_event(ray, EVENT_BIRTH, range.source);
    }
}

// One place for either: every append is a dozen scattered stores to compile.
fn record_hit(ray: Ray, primitive: u32) {
    if is_sampled(ray) {
        let is_surface = primitive < NUM_SURFACES;
        let subject = select(primitive - NUM_SURFACES, primitive, is_surface);
        append_event(ray, select(EVENT_DETECTOR, EVENT_SURFACE, is_surface), subject);
    }
}

// Optiland logs a death only for escape, depth and roulette.
fn record_death(ray: Ray) {
    if ray.fate >= ESCAPED && is_sampled(ray) {
        append_event(ray, EVENT_DEATH, ray.fate);
    }
}
