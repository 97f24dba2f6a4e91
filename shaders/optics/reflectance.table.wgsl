// Reflectance per surface and wavelength.
@group(GROUP_SCENE) @binding(BINDING_REFLECTANCES) var<storage, read> reflectances: array<real>;

fn reflectance_of(surface: Surface, primitive: u32, wavelength: u32) -> real {
    return reflectances[primitive * NUM_WAVELENGTHS + wavelength];
}
