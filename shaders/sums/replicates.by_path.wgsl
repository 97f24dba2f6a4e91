// There is one sequence of draws, and a copy of the detectors' cells for each of some paths (paths/sums.maps.wgsl).
// Twin of replicates.none.wgsl.

fn key_of_id(id_lo: u32, id_hi: u32) -> RayKey {
    return ray_key(id_lo, id_hi);
}

fn detector_for(key: RayKey, detector: Detector) -> Detector {
    var own = detector;
    own.cell += path_map * REPLICATE_STRIDE;
    return own;
}
