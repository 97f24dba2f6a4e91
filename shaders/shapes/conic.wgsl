// Conic: z = c r^2 / (1 + sqrt(1 - (1 + K) c^2 r^2)) within an aperture.

// `axial` is (1 + K) c, `aperture` the squared semi-diameter.
fn conic_distance(o: vec3<real>, d: vec3<real>, curvature: real, axial: real, aperture: real, leaving: bool) -> real {
    let c = crossings(o, d, Quadric(-curvature, -axial, 1.0, 0.0), leaving);
    let first = conic_holds(c.base + c.first * d, curvature, axial, aperture);
    let second = conic_holds(c.base + c.second * d, curvature, axial, aperture);
    return first_ahead(c, first, second);
}

// True if a point of the quadric belongs to the surface. Of its two sheets only the one through the vertex does:
// 1 - (1 + K) c z >= 0.
fn conic_holds(p: vec3<real>, curvature: real, axial: real, aperture: real) -> bool {
    return (1.0 - axial * p.z >= 0.0) & (p.x * p.x + p.y * p.y <= aperture);
}
