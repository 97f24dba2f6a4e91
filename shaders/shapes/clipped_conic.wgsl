// Conic within an aperture that need be neither round nor on the axis.

// The aperture stands in the buffer of tables at `clip` (geometry/clip.table.wgsl). `axial` is (1 + K) c, and `limit` the
// squared semi-diameter.
fn clipped_conic_distance(
    o: vec3<real>, d: vec3<real>, clip: real, curvature: real, axial: real, limit: real, leaving: bool,
) -> real {
    let c = crossings(o, d, clipped_conic_quadric(curvature, axial), leaving);
    let first = c.base + c.first * d;
    let second = c.base + c.second * d;
    return first_ahead(
        c,
        clipped_conic_holds(first, clip, curvature, axial, limit),
        clipped_conic_holds(second, clip, curvature, axial, limit),
    );
}

fn clipped_conic_quadric(curvature: real, axial: real) -> Quadric {
    return Quadric(-curvature, -axial, 1.0, 0.0);
}

// True if a point of the quadric belongs to the surface: to the sheet through its vertex, and to what the aperture leaves.
fn clipped_conic_holds(p: vec3<real>, clip: real, curvature: real, axial: real, limit: real) -> bool {
    let is_limited = (1.0 - axial * p.z >= 0.0) & (p.x * p.x + p.y * p.y <= limit);
    return is_limited && clip_holds(p, clip);
}
