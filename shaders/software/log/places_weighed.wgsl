// A place in the log and what the ray weighs there (software/path/path_places.wgsl): one store, where a driver takes the lanes one by
// one. Twin of places_weighed_together.wgsl.
@group(0) @binding(20) var<storage, read_write> place_log: array<vec4<real>>;

fn write_place(number: u32, place: vec2<real>, weight: real) {
    place_log[number] = vec4<real>(place, weight, 0.0);
}
