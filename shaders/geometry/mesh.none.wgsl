// No surface of this scene is a mesh.

fn keep_triangle() {}

fn geometric_normal(surface: Surface, position: vec3<real>) -> vec3<real> {
    return quadric_normal(surface, position);
}

fn noted_triangle() -> u32 {
    return 0u;
}

fn note_triangle(triangle: u32) {}
