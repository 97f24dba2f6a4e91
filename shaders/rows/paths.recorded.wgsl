// Records the paths of sampled rays: the state before each event, at the event's position. A hash of a ray's id samples
// PATH_THRESHOLD / 2^32 of the rays. Twin of paths.none.wgsl.

fn is_sampled(ray: Ray) -> bool {
    return RECORD_ALL_PATHS || draw_first(ray.key, PATH_SAMPLE) < PATH_THRESHOLD;
}

fn record_birth(ray: Ray) {
    if is_sampled(ray) {
        append_event(ray, EVENT_BIRTH, range.source);
    }
}

// One append serves surfaces and detectors: every append compiles to a dozen scattered stores.
fn record_hit(ray: Ray, primitive: u32) {
    if is_sampled(ray) {
        let is_surface = primitive < NUM_SURFACES;
        let subject = select(primitive - NUM_SURFACES, primitive, is_surface);
        append_event(ray, select(EVENT_DETECTOR, EVENT_SURFACE, is_surface), subject);
    }
}

// As in Optiland, a death is recorded only for escape, depth and roulette.
fn record_death(ray: Ray) {
    if ray.fate >= ESCAPED && is_sampled(ray) {
        append_event(ray, EVENT_DEATH, ray.fate);
    }
}
