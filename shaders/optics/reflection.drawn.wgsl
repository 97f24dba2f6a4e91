// One branch of the two at a refractive surface is drawn. An addition to the plain loop may take the place of this file;
// where rays are split, stages/split.wgsl has another function of this name.

fn draw_reflection(
    ray: ptr<function, Ray>, bits: u32, reflectance: Share, transmittance: real, total_reflection: bool,
) -> bool {
    return draw_branch(ray, bits, reflectance, transmittance, total_reflection);
}
