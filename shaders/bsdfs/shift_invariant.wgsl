// Lobes whose height depends on one number alone: the distance of direction cosines from the reference direction. The
// reference direction is the mirrored ray or, for a transmissive lobe, the ray itself. Directions keep their full
// weight; the lobe's level is the surface's scatter_fraction.

// The direction at the distance `beta` from the reference direction, at a random azimuth.
fn shift_invariant_lobe(s: Scattering, surface: Surface, beta: real) -> Lobe {
    let centre = select(mirrored(s.incident, s.normal), s.incident, lobe_transmits(s, surface));
    let tangents = tangents_of(s.normal);
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
