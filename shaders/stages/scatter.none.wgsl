// No surface scatters. Twin of scatter.on.wgsl.

fn scatter(ray: ptr<function, Ray>, surface: Surface, n_geometric: vec3<real>, incoming: vec3<real>) {
}
