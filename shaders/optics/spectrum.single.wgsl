// One wavelength in the whole scene: nothing is drawn.

fn draw_wavelength(key: RayKey, e: Source) -> u32 {
    return 0u;
}
