// Rows of trees (geometry/boxes.wgsl) in a buffer. Twin of software/tree.texels.wgsl.
@group(0) @binding(19) var<storage, read> tree_rows: array<vec4<u32>>;

fn tree_row(i: u32) -> vec4<u32> {
    return tree_rows[i];
}
