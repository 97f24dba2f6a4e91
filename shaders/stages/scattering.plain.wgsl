// What all kinds of scattering have in common.

// A scattered ray travels in the medium on the side to which it leaves. Whether the ray entered a solid is left to
// Fresnel's branch, as in Optiland.
//
// Optiland sets the medium by whether the lobe was called transmissive. A lobe around Fresnel's reflected ray is then
// in the wrong medium.
fn enter_side(ray: ptr<function, Ray>, surface: Surface, n_geometric: vec3<real>) {
    (*ray).medium = select(surface.front, surface.back, dot((*ray).direction, n_geometric) > 0.0);
}

// Two tangents that make a right-handed frame with a unit normal (Duff et al., Building an Orthonormal Basis,
// Revisited, JCGT 2017).
struct Tangents {
    t: vec3<real>,
    b: vec3<real>,
}

fn tangents_of(n: vec3<real>) -> Tangents {
    let s = choose(1.0, -1.0, n.z < 0.0);
    let a = -1.0 / (s + n.z);
    let b = n.x * n.y * a;
    return Tangents(
        vec3<real>(1.0 + s * n.x * n.x * a, s * b, -s * n.x),
        vec3<real>(b, s + n.y * n.y * a, -n.y),
    );
}

// A direction about a normal, and its cosine with it.
struct Scattered {
    direction: vec3<real>,
    cosine: real,
}

// A direction drawn cosine-weighted over the hemisphere of n: azimuth u1 turns, cos = sqrt(u2).
fn cosine_weighted(s: Scattering, n: vec3<real>) -> Scattered {
    let turn = sincos_turns(draw(s.key, BSDF_U1, s.step));
    let u = uniform_of(draw(s.key, BSDF_U2, s.step));
    let cosine = sqrt(u);
    let sine = sqrt(1.0 - u);
    let tangents = tangents_of(n);
    let direction = sine * turn.x * tangents.t + sine * turn.y * tangents.b + cosine * n;
    return Scattered(renormalize(direction), cosine);
}

// True if this event's lobe lies beyond the surface.
fn lobe_transmits(s: Scattering, surface: Surface) -> bool {
    if !HAS_TRANSMISSIVE_LOBES {
        return false;
    }
    return below(draw(s.key, BSDF_LOBE_BRANCH, s.step), surface.transmissive_fraction);
}

// The normal about which this event scatters.
fn lobe_normal(s: Scattering, surface: Surface) -> vec3<real> {
    return select(s.normal, -s.normal, lobe_transmits(s, surface));
}
