// The plane z = 0, unbounded or within a rectangle or disk. A ray that leaves a plane never meets the plane again. A
// distance of MISS or more is never taken (`nearer`).

fn plane_distance(o: vec3<real>, d: vec3<real>, leaving: bool) -> real {
    let t = -o.z / d.z;
    return select(MISS, t, (d.z != 0.0) & !leaving & (t > 0.0));
}

fn rectangle_distance(o: vec3<real>, d: vec3<real>, half_width: real, half_height: real, leaving: bool) -> real {
    let t = plane_distance(o, d, leaving);
    let inside = (abs(o.x + t * d.x) <= half_width) & (abs(o.y + t * d.y) <= half_height);
    return select(MISS, t, inside);
}

// `aperture` is the squared radius.
fn disk_distance(o: vec3<real>, d: vec3<real>, aperture: real, leaving: bool) -> real {
    let t = plane_distance(o, d, leaving);
    let x = o.x + t * d.x;
    let y = o.y + t * d.y;
    return select(MISS, t, x * x + y * y <= aperture);
}

// True if a point of the plane belongs to the surface:

fn plane_holds(p: vec3<real>) -> bool {
    return true;
}

fn rectangle_holds(p: vec3<real>, half_width: real, half_height: real) -> bool {
    return (abs(p.x) <= half_width) & (abs(p.y) <= half_height);
}

fn disk_holds(p: vec3<real>, aperture: real) -> bool {
    return p.x * p.x + p.y * p.y <= aperture;
}
