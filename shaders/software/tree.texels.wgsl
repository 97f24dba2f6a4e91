// Rows of trees (geometry/boxes.wgsl) in an image, a texel each. Twin of geometry/tree.storage.wgsl.
// A processor's driver reads the words of a buffer lane by lane, with a check each, but a texel as a whole.
@group(0) @binding(19) var tree_rows: texture_storage_2d<rgba32uint, read>;

fn tree_row(i: u32) -> vec4<u32> {
    return textureLoad(tree_rows, vec2<u32>(i % TEXELS_PER_LINE, i / TEXELS_PER_LINE));
}
