// Reflectance of a mirror or of a coating, the same for every wavelength.

fn reflectance_of(surface: Surface, primitive: u32, wavelength: u32) -> real {
    return surface.reflectance;
}
