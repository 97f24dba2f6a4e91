// Triangles in a buffer of their own: no bits of trees make an f64. Twin of mesh_rows.f32.wgsl.
@group(0) @binding(17) var<storage, read> mesh_rows: array<vec4<real>>;

fn mesh_row(i: u32) -> vec4<real> {
    return mesh_rows[i];
}
