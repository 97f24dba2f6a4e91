// How bsdfs/shift_invariant.wgsl draws a direction.

// How far a direction lies from the reference directions of both lobes, in direction cosines: from the mirrored ray, and from
// the ray itself. Directions on the other side than the lobe are beyond all lobes.
fn offsets_from(s: Scattering, direction: vec3<real>) -> vec2<real> {
    let cosine = dot(direction, s.normal);
    let beyond = dot(s.incident, s.normal);
    let mirrored_off = along_surface(direction - mirrored(s.incident, s.normal), s.normal);
    let through_off = along_surface(direction - s.incident, s.normal);
    return vec2<real>(
        select(BEYOND_LOBES, sqrt(dot(mirrored_off, mirrored_off)), (cosine < 0.0) != (beyond < 0.0)),
        select(BEYOND_LOBES, sqrt(dot(through_off, through_off)), (cosine < 0.0) == (beyond < 0.0)),
    );
}

// No direction is so far from another.
const BEYOND_LOBES: real = 4.0;

fn along_surface(v: vec3<real>, normal: vec3<real>) -> vec3<real> {
    return v - dot(v, normal) * normal;
}

// The density of a direction per solid angle, from the densities of both lobes per area of direction cosines.
fn shift_invariant_toward(s: Scattering, surface: Surface, direction: vec3<real>, density: vec2<real>) -> Toward {
    let through = surface.transmissive_fraction;
    let of_both = (1.0 - through) * density.x + through * density.y;
    return Toward(of_both * abs(dot(direction, s.normal)), 1.0);
}
