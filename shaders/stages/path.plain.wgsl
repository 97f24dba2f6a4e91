// The steps of a ray's path, under the names that the loop calls. An addition that follows paths takes the place of this
// file by shaders/paths/followed.wgsl. `generate`, `interact`, `flush_bins` and `deposit_fate` then stand in
// paths/ending.late.wgsl, or in paths/ending.early.wgsl.

fn generate(index: u32) -> Ray {
    return plain_generate(index);
}

fn interact(ray: ptr<function, Ray>, surface: Surface, primitive: u32) {
    plain_interact(ray, surface, primitive);
}

fn leave_boundary(ray: ptr<function, Ray>, surface: Surface, entering_back: bool, reflects: bool) {
    plain_leave_boundary(ray, surface, entering_back, reflects);
}

fn splat(ray: Ray, index: u32, ends: bool) {
    plain_splat(ray, index, ends);
}

fn deposit_fate(ray: Ray) {
    plain_deposit_fate(ray);
}

fn flush_bins() {
    plain_flush_bins();
}
