// T / (1 - R) per surface and wavelength, stored after the reflectances; 1 where there is no coating.

fn coating_pass_of(surface: Surface, primitive: u32, wavelength: u32) -> real {
    return reflectances[(NUM_SURFACES + primitive) * NUM_WAVELENGTHS + wavelength];
}
