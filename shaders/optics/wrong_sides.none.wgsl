// No ray can be on a wrong side, or nobody asks. Twin of wrong_sides.counted.wgsl.

fn plain_leave_boundary(ray: ptr<function, Ray>, surface: Surface, entering_back: bool, reflects: bool) {
    pass_boundary(ray, surface, entering_back, reflects);
}

fn settle(ray: Ray) {
    settle_end(ray);
}
