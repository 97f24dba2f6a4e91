// Paths of the sampled rays: the state before each event, at its place. PATH_THRESHOLD / 2^32 of the rays are sampled
// by a hash of their id.

fn is_sampled(ray: Ray) -> bool {
    return RECORD_ALL_PATHS || draw_first(ray.key, PATH_SAMPLE) < PATH_THRESHOLD;
}

fn record_birth(ray: Ray) {
    if is_sampled(ray) {
        append_event(ray, EVENT_BIRTH, range.emitter);
    }
}

fn record_surface(ray: Ray, primitive: u32) {
    if is_sampled(ray) {
        append_event(ray, EVENT_SURFACE, primitive);
    }
}

fn record_sensor(ray: Ray, sensor: u32) {
    if is_sampled(ray) {
        append_event(ray, EVENT_SENSOR, sensor);
    }
}

// Optiland logs a death only for escape, depth and roulette.
fn record_death(ray: Ray) {
    if ray.fate >= ESCAPED && is_sampled(ray) {
        append_event(ray, EVENT_DEATH, ray.fate);
    }
}
