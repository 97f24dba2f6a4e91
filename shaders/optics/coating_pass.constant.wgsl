// T / (1 - R) of a coating, the same for every wavelength; 1 where there is no coating.

fn coating_pass_of(surface: Surface, primitive: u32, wavelength: u32) -> real {
    return surface.coating_pass;
}
