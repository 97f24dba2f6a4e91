// Crossings of triangles in f64 and in pairs of f32, where rounding of a ray's position does not matter. Twin of
// edges.f32.wgsl.

fn leave_facet(ray: MeshRay, leaving: bool) {}

// Where the ray crosses a triangle, or MISS.
fn triangle_crossing(ray: MeshRay, triangle: u32) -> real {
    let s = seen_triangle(ray, mesh_row(triangle).xyz, mesh_row(triangle + 1u).xyz, mesh_row(triangle + 2u).xyz);
    return select(MISS, (s.u * s.a.z + s.v * s.b.z + s.w * s.c.z) / (s.u + s.v + s.w), is_crossed(s));
}
