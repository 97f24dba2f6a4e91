// Indices (front, back) of a surface, where the scene has one wavelength.

fn indices_of(surface: Surface, wavelength: u32) -> vec2<real> {
    return vec2<real>(surface.n_front, surface.n_back);
}
