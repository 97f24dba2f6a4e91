// Indices (front, back) of a surface, from a table over wavelengths.

fn indices_of(surface: Surface, wavelength: u32) -> vec2<real> {
    return vec2<real>(
        medium_at(surface.front, wavelength).n,
        medium_at(surface.back, wavelength).n,
    );
}
