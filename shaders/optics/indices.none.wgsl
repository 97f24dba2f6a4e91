// No surface refracts.

fn indices_of(surface: Surface, wavelength: u32) -> vec2<real> {
    return vec2<real>(1.0, 1.0);
}
