// Harvey-Shack: b0 / (1 + (beta / l0)^s). Here beta is the distance of direction cosines from the reference direction.
// The reference direction is the mirrored ray or, for a transmissive lobe, the ray itself. Directions keep their full
// weight; the lobe's height is the surface's scatter_fraction.

// Knots of the radial distribution, at beta = 0 to 2 in equal steps: model::bsdfs::HarveyShack::distribution.
const HARVEY_SHACK_KNOTS: u32 = 4096u;
const HARVEY_SHACK_STEP: real = 0.0004884004884004884;

fn sample_harvey_shack(s: Scattering, surface: Surface) -> Lobe {
    let centre = select(mirrored(s.incident, s.normal), s.incident, lobe_transmits(s, surface));
    let tangents = tangents_of(s.normal);
    let beta = harvey_shack_offset(uniform_of(draw(s.key, BSDF_U1, s.step)), surface.bsdf_table);
    let turn = sincos_turns(draw(s.key, BSDF_U2, s.step));
    let x = dot(centre, tangents.t) + beta * turn.x;
    let y = dot(centre, tangents.b) + beta * turn.y;
    let r2 = x * x + y * y;
    // No direction lies beyond the unit disk. A ray drawn there keeps the reference direction, and gets no weight.
    if r2 >= 1.0 {
        return Lobe(centre, 0.0);
    }
    let height = sqrt(1.0 - r2);
    let z = select(height, -height, dot(centre, s.normal) < 0.0);
    return Lobe(renormalize(x * tangents.t + y * tangents.b + z * s.normal), 1.0);
}

// The inverse of the radial distribution at u, linear between the knots.
fn harvey_shack_offset(u: real, table: u32) -> real {
    let knot = interval_of(u, table, HARVEY_SHACK_KNOTS);
    let low = tables[table + knot];
    let high = tables[table + knot + 1u];
    let start = real(knot) * HARVEY_SHACK_STEP;
    return start + (u - low) * (HARVEY_SHACK_STEP / (high - low));
}
