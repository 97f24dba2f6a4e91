// One arrival in the log of a path (cpu/path/path_log.arrivals.wgsl), in f64.
@group(GROUP_SCENE) @binding(BINDING_LOG) var<storage, read_write> arrival_log: array<vec2<real>>;

fn write_arrival(number: u32, place: vec2<real>, weight: real) {
    arrival_log[number] = place;
}
