// Whether a ray scatters is drawn by its surface's fraction. An addition to the plain loop may take the place of this file.

fn draw_scattering(ray: ptr<function, Ray>, surface: Surface, bits: u32) -> bool {
    return below(bits, surface.scatter_fraction);
}
