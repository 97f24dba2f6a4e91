// Crossings of triangles where a ray's position is as good as exact: f64, and pairs of f32. Twin of edges_f32.wgsl.

fn leave_facet(ray: MeshRay, leaving: bool) {}

// Where the ray crosses a triangle, or MISS. Edges belong to the triangle.
fn triangle_crossing(ray: MeshRay, triangle: u32) -> real {
    let a = seen(ray, mesh_row(triangle).xyz);
    let b = seen(ray, mesh_row(triangle + 1u).xyz);
    let c = seen(ray, mesh_row(triangle + 2u).xyz);
    let u = edge(b, c);
    let v = edge(c, a);
    let w = edge(a, b);
    let outside = min(u, min(v, w)) < 0.0 && max(u, max(v, w)) > 0.0;
    let area = u + v + w;
    return select((u * a.z + v * b.z + w * c.z) / area, MISS, outside || area == 0.0);
}
