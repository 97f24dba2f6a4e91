// Stage scatter: after reflection or refraction, a share of the rays leaves in a direction drawn from the surface's
// BSDF. `sample_bsdf` is composed for the kinds of the scene, each in its own file under bsdfs/. Twin of
// scatter.none.wgsl.

// The surface has no BSDF. The other codes are those of model::BsdfKind.
const SMOOTH: u32 = 0u;

// The input of a BSDF. A mirror scatters the incident ray. A refractive surface scatters the ray that Fresnel's branch
// sends on, as in Optiland. The normal faces the ray as it was before reflection or refraction.
struct Scattering {
    key: RayKey,
    step: u32,
    incident: vec3<real>,
    normal: vec3<real>,
}

struct Lobe {
    direction: vec3<real>,
    weight: real,
}

// Draws whether the ray scatters, with the clipped fraction. The weights of both branches undo the clipping (on the
// host: program::layout::bsdf::Branch).
fn plain_scatter(ray: ptr<function, Ray>, surface: Surface, n_geometric: vec3<real>, incoming: vec3<real>) {
    if surface.bsdf == SMOOTH {
        return;
    }
    let key = (*ray).key;
    let step = (*ray).bounce;
    var share = surface.pass_weight;
    if below(draw(key, SCATTER_BRANCH, step), surface.scatter_fraction) {
        let n = select(n_geometric, -n_geometric, dot(incoming, n_geometric) > 0.0);
        let incident = select((*ray).direction, incoming, surface.interaction == REFLECTIVE);
        let lobe = sample_bsdf(Scattering(key, step, incident, n), surface);
        (*ray).direction = lobe.direction;
        share = surface.scatter_weight * lobe.weight;
        if HAS_REFRACTIVE && surface.interaction == REFRACTIVE {
            enter_side(ray, surface, n_geometric);
        }
    }
    let before = (*ray).weight;
    let after = before * share;
    deposit_loss(CELL_BSDF, before, after);
    deposit_loss(CELL_BSDF_GAIN, after, before);
    (*ray).weight = after;
}

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
