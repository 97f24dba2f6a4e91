// Takes the rays of a dispatch from its range of ids. Twin of stages/ids.listed.wgsl.
fn key_of(index: u32) -> RayKey {
    return key_in_range(index);
}
