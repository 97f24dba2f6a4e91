// Indices (front, back) of a surface: one wavelength in the scene.

fn indices_of(surface: Surface, wavelength: u32) -> vec2<real> {
    return vec2<real>(surface.n_front, surface.n_back);
}
