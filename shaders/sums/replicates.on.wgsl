// Independent scrambles of Sobol points, each with sums of its own. Twin of replicates.none.wgsl.
// How far these sums lie apart gives the error, which points that are spread evenly do not show by themselves. A ray's
// lowest bits choose its scramble, so that any range of rays has its share of each. Source: Owen, Randomly permuted
// (t,m,s)-nets and (t,s)-sequences (1995).

// The bits above those are the index of the ray's point, and what tells ids apart beyond it. Ids have 63 bits: the
// highest bits of the key are free to tell the scramble.
fn key_of_id(id_lo: u32, id_hi: u32) -> RayKey {
    let replicate = id_lo & ((1u << REPLICATE_BITS) - 1u);
    let rest = (id_lo >> REPLICATE_BITS) | (id_hi << (32u - REPLICATE_BITS));
    return ray_key(rest, (id_hi >> REPLICATE_BITS) | (replicate << (32u - REPLICATE_BITS)));
}

// The detector, with the sums of the ray's scramble.
fn detector_for(key: RayKey, detector: Detector) -> Detector {
    var own = detector;
    own.cell += (key.y >> (32u - REPLICATE_BITS)) * REPLICATE_STRIDE;
    return own;
}
