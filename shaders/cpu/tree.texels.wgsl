// Rows of trees (geometry/boxes.wgsl) in an image, a texel each. A processor's driver reads a texel as a whole, but the
// words of a buffer lane by lane, with a check each. Twin of geometry/tree.storage.wgsl.
@group(GROUP_SCENE) @binding(BINDING_TREE_ROWS) var tree_rows: texture_storage_2d<rgba32uint, read>;

fn tree_row(i: u32) -> vec4<u32> {
    return textureLoad(tree_rows, vec2<u32>(i % TEXELS_PER_LINE, i / TEXELS_PER_LINE));
}
