// Reflectance per surface and wavelength.
@group(0) @binding(7) var<storage, read> reflectances: array<real>;

fn reflectance_of(surface: Surface, primitive: u32, wavelength: u32) -> real {
    return reflectances[primitive * NUM_WAVELENGTHS + wavelength];
}
