// Frustum: the cone of radius r0 + slope z between z_front and z_back; a cylinder where slope is 0.

fn frustum_distance(
    o: vec3<real>, d: vec3<real>, r0: real, slope: real, z_front: real, z_back: real, leaving: bool,
) -> real {
    let c = crossings(o, d, frustum_quadric(r0, slope), leaving);
    let first = frustum_holds(c.base + c.first * d, r0, slope, z_front, z_back);
    let second = frustum_holds(c.base + c.second * d, r0, slope, z_front, z_back);
    return first_ahead(c, first, second);
}

fn frustum_quadric(r0: real, slope: real) -> Quadric {
    return Quadric(1.0, -slope * slope, -slope * r0, -r0 * r0);
}

// True if a point of the cone belongs to the surface.
fn frustum_holds(p: vec3<real>, r0: real, slope: real, z_front: real, z_back: real) -> bool {
    return (p.z >= z_front) & (p.z <= z_back);
}
