// Reflection is drawn with its own probability R: both branches keep their weight.
// (Optiland clips R to [1e-12, 1 - 1e-12] here and scales the weight by up to 1 + 1e-12: we do not.)

fn draw_reflection(
    ray: ptr<function, Ray>, bits: u32, reflectance: Share, transmittance: real, total_reflection: bool,
) -> bool {
    return below_share(bits, reflectance) | total_reflection;
}

// bits / 2^32 < share, to a rounding of either side.
fn below_share(bits: u32, share: Share) -> bool {
    return uniform_of(bits) * share.whole < share.part;
}
