// One arrival in the log of a path (cpu/path/path_log.arrivals.wgsl), in f32 on 64-bit integers. An arrival is a
// single store, because a driver takes the lanes of a store one by one.
@group(GROUP_SCENE) @binding(BINDING_LOG) var<storage, read_write> arrival_log: array<u64>;

fn write_arrival(number: u32, place: vec2<real>, weight: real) {
    arrival_log[number] = packed_position(place);
}
