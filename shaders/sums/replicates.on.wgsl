// Independent scrambles of Sobol points, each with its own sums, from which errors are estimated. Evenly spread points
// do not show their error themselves; the spread of these sums does. Twin of replicates.none.wgsl.
//
// A ray's lowest bits choose its scramble, so that any range of rays has its share of each scramble. Source: Owen,
// Randomly permuted (t,m,s)-nets and (t,s)-sequences (1995).

// The key of a ray. The bits above the lowest are the index of the ray's point, and the part of the id beyond the
// index. Ids have 63 bits, so the highest bits of the key are free for the scramble.
fn key_of_id(id_lo: u32, id_hi: u32) -> RayKey {
    let replicate = id_lo & ((1u << REPLICATE_BITS) - 1u);
    let rest = (id_lo >> REPLICATE_BITS) | (id_hi << (32u - REPLICATE_BITS));
    return ray_key(rest, (id_hi >> REPLICATE_BITS) | (replicate << (32u - REPLICATE_BITS)));
}

// The detector, with its cells moved to the sums of the ray's scramble.
fn detector_for(key: RayKey, detector: Detector) -> Detector {
    var own = detector;
    own.cell += (key.y >> (32u - REPLICATE_BITS)) * REPLICATE_STRIDE;
    return own;
}
