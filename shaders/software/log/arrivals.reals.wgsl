// One arrival in the log of a path (software/path/path_log.arrivals.wgsl), in f64. Twin of arrivals.reals_together.wgsl.
@group(0) @binding(20) var<storage, read_write> place_log: array<vec2<real>>;

fn write_place(number: u32, place: vec2<real>, weight: real) {
    place_log[number] = place;
}
