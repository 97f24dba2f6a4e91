// Rays that keep to the path deposit what they lose on their way, as all other rays do. Twin of
// path_losses.reported.wgsl.

fn reach_next(ray: ptr<function, Ray>, hit: Hit) {
    reach(ray, hit);
}

fn go_on_along(ray: ptr<function, Ray>) {
    go_on(ray);
}
