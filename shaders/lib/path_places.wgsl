// Where rays that keep to the nominal path arrive on its detectors: all that is logged of them, because the host knows what
// they weigh there (program::path_log). Places of a ray are range.log_stride apart. One that has strayed is off all
// detectors in the first of them, and the others mean nothing. Twin of path_entries.wgsl.

var<private> first_place: vec2<real> = vec2<real>(0.0, 0.0);

// One event of the path on a detector.
fn arrives(ray: ptr<function, Ray>, hit: Hit, primitive: u32) -> bool {
    reach(ray, Hit(hit.distance, primitive));
    return hit.primitive == primitive;
}

// Where the ray is on a detector [mm].
fn place_on(ray: Ray, sensor_index: u32) -> vec2<real> {
    return local_position(ray, sensor_of(sensor_index)).xy;
}

// Logs where the ray is on a detector: the position in pixels. The first one waits for the end, which tells whether it
// counts.
fn log_place(number: u32, ray: Ray, sensor_index: u32) -> vec2<real> {
    let sensor = sensor_of(sensor_index);
    let p = local_position(ray, sensor);
    let place = marked_position(bilinear_taps(sensor, p, sensor.cell, 1u, sensor.cell + hit_pixel(p, sensor)));
    if number == 0u {
        first_place = place;
    } else {
        write_place(number * range.log_stride + ray.index, place);
    }
    return p.xy;
}

fn begin_path() {}

fn end_path(ray: Ray, holds: bool) {
    if !holds {
        restore_bins();
    }
    write_place(ray.index, select(vec2<real>(OFF_DETECTORS, 0.0), first_place, holds));
}

fn use_entries() {}
