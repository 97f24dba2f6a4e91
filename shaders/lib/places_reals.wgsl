// A place in f64.
fn write_place(number: u32, place: vec2<real>) {
    end_log[2u * number] = place.x;
    end_log[2u * number + 1u] = place.y;
}
