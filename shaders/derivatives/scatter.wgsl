// Whether a ray scatters is drawn, and so is whether the lobe lies beyond the surface. The share of the branch is
// attached to the weight. The plain function's weights of branches undo the clipping of the fraction. The derivative of
// such a weight is the derivative of the share.

fn scatter(ray: ptr<function, Ray>, surface: Surface, n_geometric: vec3<real>, incoming: vec3<real>) {
    let key = (*ray).key;
    let step = (*ray).bounce;
    plain_scatter(ray, surface, n_geometric, incoming);
    if surface.bsdf != SMOOTH {
        let fraction = surface.scatter_fraction;
        let scatters = below(draw(key, SCATTER_BRANCH, step), fraction);
        var share = select(1.0 - fraction, fraction, scatters);
        if HAS_TRANSMISSIVE_LOBES && scatters {
            let through = surface.transmissive_fraction;
            share *= select(1.0 - through, through, below(draw(key, BSDF_LOBE_BRANCH, step), through));
        }
        (*ray).weight *= attached(1.0, share / detached(share));
    }
}
