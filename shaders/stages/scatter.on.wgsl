// Stage scatter: after reflection or refraction, a share of the rays leaves in a direction drawn from the surface's
// BSDF. `sample_bsdf` is composed for the kinds of the scene, each in its own file under bsdfs/. Twin of
// scatter.none.wgsl and scatter.to.wgsl.

// The surface has no BSDF. model::BsdfKind has the other codes.
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

// Whether the ray scatters is drawn with the clipped fraction. The weights of both branches undo the clipping (on the
// host: program::layout::bsdf::Branch).
fn plain_scatter(ray: ptr<function, Ray>, surface: Surface, n_geometric: vec3<real>, incoming: vec3<real>) {
    if surface.bsdf == SMOOTH {
        return;
    }
    let key = (*ray).key;
    let step = (*ray).bounce;
    var share = surface.pass_weight;
    if draw_scattering(ray, surface, draw(key, SCATTER_BRANCH, step)) {
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
