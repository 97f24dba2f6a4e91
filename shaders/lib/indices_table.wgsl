// Indices (front, back) of a surface, from the table over media and wavelengths.

fn indices_of(surface: Surface, wavelength: u32) -> vec2<real> {
    return vec2<real>(
        medium_at(surface.front * NUM_WAVELENGTHS + wavelength).x,
        medium_at(surface.back * NUM_WAVELENGTHS + wavelength).x,
    );
}
