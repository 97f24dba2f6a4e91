// The triangle that a ray stands on waits with it, where the ray was split. Twin of split_triangle.none.wgsl.

fn standing_triangle() -> u32 {
    return arrived_triangle;
}

fn restore_triangle(triangle: u32) {
    arrived_triangle = triangle;
}
