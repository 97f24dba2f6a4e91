// Whether a ray scatters is drawn, and the share of the branch is attached to the weight. The plain function's weights of
// branches undo the clipping of the fraction; their derivatives are those of the share.

fn scatter(ray: ptr<function, Ray>, surface: Surface, n_geometric: vec3<real>, incoming: vec3<real>) {
    let scatters = below(draw((*ray).key, SCATTER_BRANCH, (*ray).bounce), surface.scatter_fraction);
    scatter_of_value(ray, surface, n_geometric, incoming);
    if surface.bsdf != SMOOTH {
        let fraction = surface.scatter_fraction;
        let share = select(1.0 - fraction, fraction, scatters);
        (*ray).weight *= attached(1.0, share / detached(share));
    }
}
