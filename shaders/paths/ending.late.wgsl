// A ray is followed to its end, whether its light is kept or not. Twin of ending.early.wgsl.

fn generate(index: u32) -> Ray {
    return followed_generate(index);
}

fn interact(ray: ptr<function, Ray>, surface: Surface, primitive: u32) {
    followed_interact(ray, surface, primitive);
}

fn flush_bins() {
    followed_flush_bins();
}

fn deposit_fate(ray: Ray) {
    followed_deposit_fate(ray);
}
