// No surface of this scene is a mesh, so a waiting branch keeps no triangle. Twin of split_triangle.mesh.wgsl.

fn standing_triangle() -> u32 {
    return 0u;
}

fn plain_restore_triangle(triangle: u32) {}
