// Rows of trees (geometry/boxes.wgsl) in a buffer. Twin of cpu/tree.texels.wgsl.
@group(GROUP_SCENE) @binding(BINDING_TREE_ROWS) var<storage, read> tree_rows: array<vec4<u32>>;

fn tree_row(i: u32) -> vec4<u32> {
    return tree_rows[i];
}
