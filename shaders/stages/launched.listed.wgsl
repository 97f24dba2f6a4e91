// The id of a launched ray of a list (ids.listed.wgsl). Twin of launched.range.wgsl.
fn launched_id(index: u32) -> vec2<u32> {
    return listed_ids[index];
}
