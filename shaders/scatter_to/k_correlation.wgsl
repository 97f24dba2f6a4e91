// The density with which bsdfs/k_correlation.wgsl draws a direction: the lobe's height over its integral. In the middle
// of the lobe the density is B^2 / (pi growth).

fn toward_k_correlation(s: Scattering, surface: Surface, direction: vec3<real>) -> Toward {
    let offsets = offsets_from(s, direction);
    let density =
        vec2<real>(k_correlation_density(offsets.x, surface), k_correlation_density(offsets.y, surface));
    return shift_invariant_toward(s, surface, direction, density);
}

// Per area of direction cosines.
fn k_correlation_density(beta: real, surface: Surface) -> real {
    if beta > 2.0 {
        return 0.0;
    }
    let width = surface.k_correlation_width;
    let scaled = beta / width;
    let logarithm = log_real(1.0 + scaled * scaled);
    // s / 2 = 1 - p.
    let half_slope = 1.0 - surface.k_correlation_power;
    let integral = 3.141592653589793 * (width * width) * surface.k_correlation_growth;
    return exp_real(-half_slope * logarithm) / integral;
}
