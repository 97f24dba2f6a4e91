// Conic: z = c r^2 / (1 + sqrt(1 - (1 + K) c^2 r^2)) within an aperture.

// `axial` is (1 + K) c, `aperture` the squared semi-diameter.
fn conic_distance(o: vec3<real>, d: vec3<real>, curvature: real, axial: real, aperture: real, leaving: bool) -> real {
    let c = crossings(o, d, Quadric(-curvature, -axial, 1.0, 0.0), leaving);
    let first = conic_crossing(c, d, c.first, axial, aperture);
    let second = conic_crossing(c, d, c.second, axial, aperture);
    return min(first, second);
}

// Of the quadric, only the sheet through the vertex is the surface: 1 - (1 + K) c z >= 0.
fn conic_crossing(c: Crossings, d: vec3<real>, distance: real, axial: real, aperture: real) -> real {
    let p = c.base + distance * d;
    let on_sheet = 1.0 - axial * p.z >= 0.0;
    return ahead(distance, c.shift, on_sheet & (p.x * p.x + p.y * p.y <= aperture));
}

// True if a point of the quadric belongs to the surface.
fn conic_holds(p: vec3<real>, curvature: real, axial: real, aperture: real) -> bool {
    return (1.0 - axial * p.z >= 0.0) & (p.x * p.x + p.y * p.y <= aperture);
}
