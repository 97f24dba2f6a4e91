// Reflection is drawn with the probability R, so both branches keep their weight. Optiland clips R here to [1e-12, 1 -
// 1e-12], and scales the weight by up to 1 + 1e-12; we do neither. Twin of branch.importance.wgsl.

fn draw_branch(
    ray: ptr<function, Ray>, bits: u32, reflectance: Share, transmittance: real, total_reflection: bool,
) -> bool {
    return below_share(bits, reflectance) | total_reflection;
}

// bits / 2^32 < share, up to a rounding of either side. No quotient is taken.
fn below_share(bits: u32, share: Share) -> bool {
    return uniform_of(bits) * share.whole < share.part;
}
