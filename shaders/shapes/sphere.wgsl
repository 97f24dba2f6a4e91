// Sphere around the local origin, with the normal pointing inward.

// `aperture` is the squared limit of the distance from local z. As in Optiland, the first crossing ahead decides: the
// ray misses where that crossing is outside the aperture.
fn sphere_distance(o: vec3<real>, d: vec3<real>, radius: real, aperture: real, leaving: bool) -> real {
    let c = crossings(o, d, sphere_quadric(radius), leaving);
    let t = first_ahead(c, true, true);
    let p = o + t * d;
    return select(MISS, t, p.x * p.x + p.y * p.y <= aperture);
}

fn sphere_quadric(radius: real) -> Quadric {
    let curvature = 1.0 / radius;
    return Quadric(-curvature, -curvature, 0.0, radius);
}

// True if a point of the sphere belongs to the surface.
fn sphere_holds(p: vec3<real>, radius: real, aperture: real) -> bool {
    return p.x * p.x + p.y * p.y <= aperture;
}
