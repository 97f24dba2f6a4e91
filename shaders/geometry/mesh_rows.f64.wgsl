// Triangles have a buffer of their own, because an f64 cannot be read out of the trees' u32 words. Twin of
// mesh_rows.f32.wgsl.
@group(GROUP_SCENE) @binding(BINDING_MESH_ROWS) var<storage, read> mesh_rows: array<vec4<real>>;

fn mesh_row(i: u32) -> vec4<real> {
    return mesh_rows[i];
}
