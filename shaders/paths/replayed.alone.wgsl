// No ray is split: each ray of the list makes events for the host. Twin of replayed.families.wgsl.

fn is_step_replayed(ray: Ray) -> bool {
    return true;
}

fn is_end_replayed(ray: Ray) -> bool {
    return true;
}
