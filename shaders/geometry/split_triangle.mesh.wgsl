// Where a ray is split, the waiting branch keeps the triangle on which it stands. Twin of split_triangle.none.wgsl.

fn standing_triangle() -> u32 {
    return arrived_triangle;
}

fn plain_restore_triangle(triangle: u32) {
    arrived_triangle = triangle;
}
