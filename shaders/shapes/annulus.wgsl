// Annulus: the ring between two radii at z = z_offset.

// `inner` and `outer` are the squared radii.
fn annulus_distance(o: vec3<real>, d: vec3<real>, inner: real, outer: real, z_offset: real, leaving: bool) -> real {
    let t = plane_distance(vec3<real>(o.x, o.y, o.z - z_offset), d, leaving);
    let x = o.x + t * d.x;
    let y = o.y + t * d.y;
    let r2 = x * x + y * y;
    return select(MISS, t, (r2 >= inner) & (r2 <= outer));
}

// True if a point of the plane belongs to the ring.
fn annulus_holds(p: vec3<real>, inner: real, outer: real, z_offset: real) -> bool {
    let r2 = p.x * p.x + p.y * p.y;
    return (r2 >= inner) & (r2 <= outer);
}
