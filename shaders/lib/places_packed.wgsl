// A place in f32 on 64-bit integers. Twin of places_words.wgsl.
fn write_place(number: u32, place: vec2<real>) {
    end_log[number] = joined(bitcast<u32>(place.x), bitcast<u32>(place.y));
}
