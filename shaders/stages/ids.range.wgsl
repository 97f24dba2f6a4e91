// The rays of a dispatch are those of its range. Twin of stages/ids.listed.wgsl.
fn key_of(index: u32) -> RayKey {
    return key_in_range(index);
}
