// The branch at a refractive surface, drawn with the probability of its share of the light: the weight carries the share.
// Twin of branch.importance.wgsl.

fn draw_reflection(
    ray: ptr<function, Ray>, bits: u32, reflectance: Share, transmittance: real, total_reflection: bool,
) -> bool {
    let before = (*ray).weight;
    let reflects = draw_branch(ray, bits, reflectance, transmittance, total_reflection);
    if !total_reflection {
        let share = select(transmittance, quotient(reflectance), reflects);
        (*ray).weight = attached((*ray).weight, before * (share / detached(share)));
    }
    return reflects;
}
