// How rays that were split wait and go on, under the names that stages/split.wgsl calls. An addition that keeps
// something beside a waiting ray takes the place of this file (shaders/paths/families.wgsl).

fn child(parent: Ray, weight: real) -> Ray {
    return plain_child(parent, weight);
}

fn restore_triangle(triangle: u32) {
    plain_restore_triangle(triangle);
}
