// The scatter of a surface, under the name that the loop calls. An addition to the plain loop may take the place of this
// file.

fn scatter(ray: ptr<function, Ray>, surface: Surface, n_geometric: vec3<real>, incoming: vec3<real>) {
    plain_scatter(ray, surface, n_geometric, incoming);
}
