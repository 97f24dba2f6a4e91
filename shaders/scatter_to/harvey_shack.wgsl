// How bsdfs/harvey_shack.wgsl draws a direction: its radial distribution is linear between knots, and so a ring's density is
// constant between them.

fn toward_harvey_shack(s: Scattering, surface: Surface, direction: vec3<real>) -> Toward {
    let offsets = offsets_from(s, direction);
    let table = surface.bsdf_table;
    let density = vec2<real>(harvey_shack_density(offsets.x, table), harvey_shack_density(offsets.y, table));
    return shift_invariant_toward(s, surface, direction, density);
}

// Per area of direction cosines.
fn harvey_shack_density(beta: real, table: u32) -> real {
    let last = real(HARVEY_SHACK_KNOTS - 1u);
    if !(beta < last * HARVEY_SHACK_STEP) {
        return 0.0;
    }
    let knot = u32(min(floor(beta / HARVEY_SHACK_STEP), last - 1.0));
    let ring = (tables[table + knot + 1u] - tables[table + knot]) / HARVEY_SHACK_STEP;
    // At the very middle of the lobe the density has no bound.
    return ring / (6.283185307179586 * max(beta, 1e-12));
}
