// No surface is coated. Twin of coating.on.wgsl.

fn coated_reflectance(surface: Surface, primitive: u32, wavelength: u32, bare: Share) -> Share {
    return bare;
}

fn coated_transmittance(surface: Surface, bare: real, reflectance: Share) -> real {
    return bare;
}

fn pass_coating(ray: ptr<function, Ray>, surface: Surface, primitive: u32) {
}
