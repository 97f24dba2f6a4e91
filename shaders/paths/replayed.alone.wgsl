// No ray is split: the host is told of each ray of the list. Twin of replayed.families.wgsl.

fn is_step_replayed(ray: Ray) -> bool {
    return true;
}

fn is_end_replayed(ray: Ray) -> bool {
    return true;
}
