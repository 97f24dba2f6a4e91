// No surface is a mirror or coated.

fn reflectance_of(surface: Surface, primitive: u32, wavelength: u32) -> real {
    return 1.0;
}
