// K-correlation: b0 / (1 + (B beta)^2)^(s/2), a lobe of shift_invariant.wgsl.
//
// Its radial distribution over beta = 0 to 2 has an inverse in closed form. Let p = 1 - s/2, and t = ln(1 + (B beta)^2),
// which is T at beta = 2. A draw u then has exp(p t) = 1 + u (exp(p T) - 1). The columns of `surface` are
// k_correlation_width = 1 / B, k_correlation_growth = (exp(p T) - 1) / p, k_correlation_rest = exp(p T) and
// k_correlation_power = p. All are smooth at p = 0, where the growth is T, and t = u T: derivatives by s want that.

fn sample_k_correlation(s: Scattering, surface: Surface) -> Lobe {
    let t = k_correlation_logarithm(draw(s.key, BSDF_U1, s.step), surface);
    return shift_invariant_lobe(s, surface, sqrt(exp_less_1(t)) * surface.k_correlation_width);
}

// ln(1 + (B beta)^2) of a draw.
fn k_correlation_logarithm(bits: u32, surface: Surface) -> real {
    let u = uniform_of(bits);
    let growth = u * surface.k_correlation_growth;
    let change = growth * surface.k_correlation_power;
    // Where the power exp(p t) is near 1, only what it differs by has all its digits. Where it is far below 1, only the
    // sum of what the draw lacks of 1, and of the rest, has them.
    if abs(change) < 0.29 {
        return growth * log_ratio(change);
    }
    let lacking = uniform_of(~bits) + 2.3283064365386963e-10;
    return log_real(lacking + u * surface.k_correlation_rest) / surface.k_correlation_power;
}

// ln(1 + f) / f, which is 1 at f = 0, by the series of log_kernel.
fn log_ratio(f: real) -> real {
    let s = f / (2.0 + f);
    let z = s * s;
    return 1.0 - (0.5 * f - (0.5 * f * f + z * poly_log(z)) / (2.0 + f));
}
