// The branch at a refractive surface: its share of the light is attached to the weight.

fn draw_reflection(
    ray: ptr<function, Ray>, bits: u32, reflectance: Share, transmittance: real, total_reflection: bool,
) -> bool {
    let before = (*ray).weight;
    let reflects = draw_reflection_of_value(ray, bits, reflectance, transmittance, total_reflection);
    if !total_reflection {
        (*ray).weight = weight_of_branch(before, (*ray).weight, select(transmittance, quotient(reflectance), reflects));
    }
    return reflects;
}
