// Harvey-Shack: b0 / (1 + (beta / l0)^s), a lobe of shift_invariant.wgsl.

// Knots of the radial distribution, at beta = 0 to 2 in equal steps: model::bsdfs::HarveyShack::distribution.
const HARVEY_SHACK_KNOTS: u32 = 4096u;
const HARVEY_SHACK_STEP: real = 0.0004884004884004884;

fn sample_harvey_shack(s: Scattering, surface: Surface) -> Lobe {
    let beta = harvey_shack_offset(uniform_of(draw(s.key, BSDF_U1, s.step)), surface.bsdf_table);
    return shift_invariant_lobe(s, surface, beta);
}

// The inverse of the radial distribution at u, linear between the knots.
fn harvey_shack_offset(u: real, table: u32) -> real {
    let knot = interval_of(u, table, HARVEY_SHACK_KNOTS);
    let low = tables[table + knot];
    let high = tables[table + knot + 1u];
    let start = real(knot) * HARVEY_SHACK_STEP;
    return start + (u - low) * (HARVEY_SHACK_STEP / (high - low));
}
