// The branch at a refractive surface, drawn with a chosen probability p: the weight carries its share of the light over p.
// A share of zero has a derivative too, because such branches are drawn. Twin of branch.fresnel.wgsl.

fn draw_reflection(
    ray: ptr<function, Ray>, bits: u32, reflectance: Share, transmittance: real, total_reflection: bool,
) -> bool {
    let before = (*ray).weight;
    let reflects = draw_branch(ray, bits, reflectance, transmittance, total_reflection);
    if !total_reflection {
        let reflected = quotient(reflectance);
        let p = detached(clamp(reflect_probability(reflected), 1e-12, 1.0 - 1e-12));
        (*ray).weight = attached((*ray).weight, before * select(transmittance / (1.0 - p), reflected / p, reflects));
    }
    return reflects;
}
