// No surface of this scene is a mesh: no triangle waits.

fn standing_triangle() -> u32 {
    return 0u;
}

fn restore_triangle(triangle: u32) {}
