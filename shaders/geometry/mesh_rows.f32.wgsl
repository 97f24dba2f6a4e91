// Triangles stand after the trees: plain WebGPU has few buffers. Twin of mesh_rows.f64.wgsl.

fn mesh_row(i: u32) -> vec4<real> {
    return bitcast<vec4<f32>>(tree_row(FIRST_TRIANGLE + i));
}
