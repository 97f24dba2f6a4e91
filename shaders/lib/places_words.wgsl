// A place in f32 on 32-bit integers. Twin of places_packed.wgsl.
fn write_place(number: u32, place: vec2<real>) {
    end_log[2u * number] = bitcast<u32>(place.x);
    end_log[2u * number + 1u] = bitcast<u32>(place.y);
}
