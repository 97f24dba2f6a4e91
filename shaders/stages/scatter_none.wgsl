// No surface scatters.

fn scatter(ray: ptr<function, Ray>, surface: Surface, n_geometric: vec3<real>, incoming: vec3<real>) {
}
