// A ray ends as soon as no light of its path can be kept any more. Twin of ending.late.wgsl.

// How such a ray ended.
const FILTERED_OUT: u32 = 6u;

fn end_early(ray: ptr<function, Ray>) {
    if (*ray).fate == ALIVE && !may_match() {
        (*ray).fate = FILTERED_OUT;
    }
}

fn generate(index: u32) -> Ray {
    var ray = followed_generate(index);
    end_early(&ray);
    return ray;
}

fn interact(ray: ptr<function, Ray>, surface: Surface, primitive: u32) {
    followed_interact(ray, surface, primitive);
    end_early(ray);
}

fn flush_bins() {
    flush_not_followed();
    followed_flush_bins();
}

fn deposit_fate(ray: Ray) {
    if ray.fate == FILTERED_OUT {
        filter_out(ray.weight, true);
    } else {
        followed_deposit_fate(ray);
    }
}
