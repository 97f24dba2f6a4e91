// Reflection is drawn with a chosen probability p. The weight is multiplied by R / p or T / (1 - p), so both branches
// keep their share on average. Twin of branch.fresnel.wgsl.

fn draw_branch(
    ray: ptr<function, Ray>, bits: u32, reflectance: Share, transmittance: real, total_reflection: bool,
) -> bool {
    let reflected = quotient(reflectance);
    let p = clamp(reflect_probability(reflected), 1e-12, 1.0 - 1e-12);
    let reflects = below(bits, p) | total_reflection;
    let share = select(transmittance / (1.0 - p), reflected / p, reflects);
    let before = (*ray).weight;
    let after = before * select(share, 1.0, total_reflection);
    deposit_loss(CELL_IMPORTANCE_LOSS, before, after);
    deposit_loss(CELL_IMPORTANCE_GAIN, after, before);
    (*ray).weight = after;
    return reflects;
}
