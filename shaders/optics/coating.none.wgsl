// No surface is coated. Twin of coating.simple.wgsl and coating.tabulated.wgsl.

fn mirror_reflectance(surface: Surface, primitive: u32, wavelength: u32, cosine: real) -> real {
    return reflectance_of(surface, primitive, wavelength);
}

fn coated_reflectance(surface: Surface, primitive: u32, wavelength: u32, cosine: real, bare: Share) -> Share {
    return bare;
}

fn coated_transmittance(surface: Surface, bare: real, reflectance: Share) -> real {
    return bare;
}

fn pay_coating(
    ray: ptr<function, Ray>, surface: Surface, primitive: u32, cosine: real, total_reflection: bool, reflects: bool,
) {
}
