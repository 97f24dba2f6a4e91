// Guards against rays on wrong sides, in stages that follow a path. Such stages do not count these rays
// (optics/wrong_sides.counted.wgsl). The ray fails a guard, and trace_new traces it anew and counts it. Where the path
// says how its rays cross, media are constants, and compilers remove these guards. Twin of sides.none.wgsl.

fn begin_ray() {
    is_provisional = true;
    went_wrong = false;
    begin_on_path();
}

fn end_path(ray: Ray, holds: bool) {
    let ends_anywhere = (ray.fate != ABSORBED) & (ray.fate != DEPTH_KILLED);
    let is_inside = ends_anywhere & (ray.medium != 0u) & (ray.medium != source().medium);
    end_on_path(ray, holds & !went_wrong & !is_inside);
}
