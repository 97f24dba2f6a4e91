// Small trees in a uniform buffer, which processors read without a check of every lane.
@group(0) @binding(19) var<uniform> tree_rows: array<vec4<u32>, TREE_ROWS>;
