// A place in the log (software/path/path_places.wgsl), in f32 on 64-bit integers: one store, where a driver takes the lanes one by
// one. Twin of places_words.wgsl and places_words_together.wgsl.
@group(0) @binding(20) var<storage, read_write> place_log: array<u64>;

fn write_place(number: u32, place: vec2<real>, weight: real) {
    place_log[number] = packed_place(place);
}
