// Rays are those of the range.
fn key_of(index: u32) -> RayKey {
    return key_in_range(index);
}
