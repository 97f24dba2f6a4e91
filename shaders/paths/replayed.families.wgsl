// Of a family, one ray makes events for the host, and so do the rays from which that ray was split. The ray's number
// stands in the second half of the list. Twin of replayed.alone.wgsl.

fn replayed_number(ray: Ray) -> u32 {
    let place = ray.index & PATH_INDEX_MASK;
    return listed_ids[arrayLength(&listed_ids) / 2u + place].x;
}

// The bits of a number that later splits have set are not set yet.
fn is_step_replayed(ray: Ray) -> bool {
    let so_far = (2u << min(ray.bounce, 30u)) - 1u;
    return (ray.index >> INDEX_BITS) == (replayed_number(ray) & so_far);
}

fn is_end_replayed(ray: Ray) -> bool {
    return (ray.index >> INDEX_BITS) == replayed_number(ray);
}
