// A coating has its own reflectance R and transmittance T in place of Fresnel's, the same at every angle. Where R + T < 1,
// the rest is absorbed. Twin of coating.none.wgsl and coating.tabulated.wgsl.

fn mirror_reflectance(surface: Surface, primitive: u32, wavelength: u32, cosine: real) -> real {
    return reflectance_of(surface, primitive, wavelength);
}

fn coated_reflectance(surface: Surface, primitive: u32, wavelength: u32, cosine: real, bare: Share) -> Share {
    let is_coated = surface.coated != 0u;
    let coated = reflectance_of(surface, primitive, wavelength);
    return Share(select(bare.part, coated, is_coated), select(bare.whole, 1.0, is_coated));
}

// The share 1 - R that is not reflected; `pay_coating` then takes from it what the coating absorbs.
fn coated_transmittance(surface: Surface, bare: real, reflectance: Share) -> real {
    return select(1.0 - quotient(reflectance), bare, surface.coated == 0u);
}

// A coating transmits T / (1 - R) of the light that it does not reflect.
fn pay_coating(
    ray: ptr<function, Ray>, surface: Surface, primitive: u32, cosine: real, total_reflection: bool, reflects: bool,
) {
    if reflects {
        return;
    }
    let before = (*ray).weight;
    let after = before * coating_pass_of(surface, primitive, (*ray).wavelength);
    deposit_loss(CELL_COATING, before, after);
    (*ray).weight = after;
}
