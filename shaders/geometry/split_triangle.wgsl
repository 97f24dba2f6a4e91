// The triangle that a ray stands on waits with it.

fn standing_triangle() -> u32 {
    return arrived_triangle;
}

fn restore_triangle(triangle: u32) {
    arrived_triangle = triangle;
}
