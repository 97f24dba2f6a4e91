// No ray is split: the host is told of each ray of the list. Twin of told.families.wgsl.

fn is_step_told(ray: Ray) -> bool {
    return true;
}

fn is_end_told(ray: Ray) -> bool {
    return true;
}
