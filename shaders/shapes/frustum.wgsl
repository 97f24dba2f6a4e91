// Frustum: the cone of radius r0 + slope z between z_front and z_back; a cylinder where slope is 0.

fn frustum_distance(
    o: vec3<real>, d: vec3<real>, r0: real, slope: real, z_front: real, z_back: real, leaving: bool,
) -> real {
    let c = crossings(o, d, Quadric(1.0, -slope * slope, -slope * r0, -r0 * r0), leaving);
    let first = frustum_crossing(c, d, c.first, z_front, z_back);
    let second = frustum_crossing(c, d, c.second, z_front, z_back);
    return min(first, second);
}

fn frustum_crossing(c: Crossings, d: vec3<real>, distance: real, z_front: real, z_back: real) -> real {
    let z = c.base.z + distance * d.z;
    return ahead(distance, c.shift, (z >= z_front) & (z <= z_back));
}

// True if a point of the cone belongs to the surface.
fn frustum_holds(p: vec3<real>, r0: real, slope: real, z_front: real, z_back: real) -> bool {
    return (p.z >= z_front) & (p.z <= z_back);
}
