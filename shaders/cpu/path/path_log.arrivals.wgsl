// Rays that keep to the path log only where they arrive on its detectors, and their weights there unless the host knows
// them (src/cpu/path/path_log.rs). Twin of path_log.entries.wgsl.
//
// Arrivals of a ray lie range.log_stride apart. The first arrival of a failed ray is off all detectors, in the row of
// the event whose guard the ray failed. Further arrivals of a failed ray mean nothing.

var<private> first_arrival: vec2<real> = vec2<real>(0.0, 0.0);
var<private> first_weight: real = 0.0;

// One event of the path on a detector.
fn arrives(ray: ptr<function, Ray>, hit: Hit, primitive: u32) -> bool {
    reach_next(ray, Hit(hit.distance, primitive));
    return hit.primitive == primitive;
}

// The ray's position on a detector [mm].
fn arrival_on(ray: Ray, detector_index: u32) -> vec2<real> {
    return local_position(ray, detector_of(detector_index)).xy;
}

// A ray's position on a detector, and whether the position decides which pixel is hit.
struct Arrival {
    // [mm]
    at: vec2<real>,
    is_sure: bool,
}

// Logs the ray's position on a detector in pixels, marked with the pixel that is hit according to the pixels' edges.
fn log_arrival(number: u32, ray: Ray, detector_index: u32) -> Arrival {
    let detector = detector_of(detector_index);
    let p = local_position(ray, detector);
    let taps = bilinear_taps(detector, p, detector.cell, 1u, detector.cell + hit_pixel(p, detector));
    keep_arrival(number, ray, marked_position(taps.position, hits_right(taps), hits_below(taps)));
    return Arrival(p.xy, true);
}

// Logs the same where nearly all rays are off the edges: the position itself decides which pixel is hit. Within
// `edge_room` [pixels] of an edge, rounding could decide. Such a ray fails the guard.
fn log_arrival_off_edges(number: u32, ray: Ray, detector_index: u32, edge_room: vec2<real>) -> Arrival {
    let detector = detector_of(detector_index);
    let p = local_position(ray, detector);
    let position = pixel_position(p, detector);
    let from_edge = (position - floor(position)) - 0.5;
    keep_arrival(number, ray, marked_position(position, from_edge.x >= 0.0, from_edge.y >= 0.0));
    return Arrival(p.xy, (abs(from_edge.x) > edge_room.x) & (abs(from_edge.y) > edge_room.y));
}

// Logs an arrival. The first arrival waits until the end of the path, which decides whether it counts.
fn keep_arrival(number: u32, ray: Ray, place: vec2<real>) {
    if number == 0u {
        first_arrival = place;
        first_weight = ray.weight;
    } else {
        write_arrival(number * range.log_stride + ray.index, place, ray.weight);
    }
}

fn begin_path() {}

fn end_on_path(ray: Ray, holds: bool) {
    if !holds {
        restore_bins();
    }
    let place = select(vec2<real>(OFF_DETECTORS, real(kept_events)), first_arrival, holds);
    write_arrival(ray.index, place, first_weight);
}

fn use_entries() {}
