// Sphere about the local origin, its normal inward.

// `aperture` is the squared limit of the distance from local z. As in Optiland, the crossing ahead that comes first
// decides: where it is outside the aperture, the ray misses.
fn sphere_distance(o: vec3<real>, d: vec3<real>, radius: real, aperture: real, leaving: bool) -> real {
    let curvature = 1.0 / radius;
    let c = crossings(o, d, Quadric(-curvature, -curvature, 0.0, radius), leaving);
    let t = first_ahead(c, true, true);
    let p = o + t * d;
    return select(MISS, t, p.x * p.x + p.y * p.y <= aperture);
}

// True if a point of the sphere belongs to the surface.
fn sphere_holds(p: vec3<real>, radius: real, aperture: real) -> bool {
    return p.x * p.x + p.y * p.y <= aperture;
}
