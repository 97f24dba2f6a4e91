// There is one sequence of draws, and one sum a cell. Twin of replicates.on.wgsl.

fn key_of_id(id_lo: u32, id_hi: u32) -> RayKey {
    return ray_key(id_lo, id_hi);
}

fn detector_for(key: RayKey, detector: Detector) -> Detector {
    return detector;
}
