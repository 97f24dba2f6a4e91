// Coatings: reflectance and transmittance of their own in place of Fresnel's. What R + T < 1 leaves is absorbed.

fn coated_reflectance(surface: Surface, primitive: u32, wavelength: u32, bare: Share) -> Share {
    let is_coated = surface.coated != 0u;
    let coated = reflectance_of(surface, primitive, wavelength);
    return Share(select(bare.part, coated, is_coated), select(bare.whole, 1.0, is_coated));
}

// What is not reflected; `pass_coating` takes from it what the coating absorbs.
fn coated_transmittance(surface: Surface, bare: real, reflectance: Share) -> real {
    return select(1.0 - quotient(reflectance), bare, surface.coated == 0u);
}

// Of the light that it does not reflect, a coating lets T / (1 - R) pass.
fn pass_coating(ray: ptr<function, Ray>, surface: Surface, primitive: u32) {
    let before = (*ray).weight;
    let after = before * coating_pass_of(surface, primitive, (*ray).wavelength);
    deposit_loss(CELL_COATING, before, after);
    (*ray).weight = after;
}
