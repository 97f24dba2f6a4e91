// One arrival in the log of a path, with the ray's weight there (cpu/path/path_log.arrivals.wgsl). An arrival is a
// single store, because a driver takes the lanes of a store one by one.
@group(GROUP_SCENE) @binding(BINDING_LOG) var<storage, read_write> arrival_log: array<vec4<real>>;

fn write_arrival(number: u32, place: vec2<real>, weight: real) {
    arrival_log[number] = vec4<real>(place, weight, 0.0);
}
