@group(0) @binding(19) var<storage, read> tree_rows: array<vec4<u32>>;
