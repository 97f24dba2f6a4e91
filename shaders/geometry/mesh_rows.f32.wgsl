// Triangles follow the trees in one buffer, because plain WebGPU allows few buffers. Twin of mesh_rows.f64.wgsl.

fn mesh_row(i: u32) -> vec4<real> {
    return bitcast<vec4<f32>>(tree_row(FIRST_TRIANGLE + i));
}
