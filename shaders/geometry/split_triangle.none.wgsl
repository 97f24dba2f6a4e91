// No surface of this scene is a mesh: no triangle waits. Twin of split_triangle.mesh.wgsl.

fn standing_triangle() -> u32 {
    return 0u;
}

fn restore_triangle(triangle: u32) {}
