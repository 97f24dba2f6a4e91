// Notes in the path that a surface has scattered the ray, and to which side. The normal faces the ray as it came.

fn sample_bsdf(s: Scattering, surface: Surface) -> Lobe {
    let lobe = plain_sample_bsdf(s, surface);
    step_kind = select(SCATTERED_THROUGH, SCATTERED_BACK, dot(lobe.direction, s.normal) > 0.0);
    return lobe;
}
