// No ray can be on a wrong side. Twin of sides.guarded.wgsl.

fn begin_ray() {
    begin_on_path();
}

fn end_path(ray: Ray, holds: bool) {
    end_on_path(ray, holds);
}
