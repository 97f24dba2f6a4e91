// Conic: z = c r^2 / (1 + sqrt(1 - (1 + K) c^2 r^2)) within an aperture.

// `axial` is (1 + K) c, and `aperture` the squared semi-diameter.
fn conic_distance(o: vec3<real>, d: vec3<real>, curvature: real, axial: real, aperture: real, leaving: bool) -> real {
    let c = crossings(o, d, conic_quadric(curvature, axial), leaving);
    let first = conic_holds(c.base + c.first * d, curvature, axial, aperture);
    let second = conic_holds(c.base + c.second * d, curvature, axial, aperture);
    return first_ahead(c, first, second);
}

fn conic_quadric(curvature: real, axial: real) -> Quadric {
    return Quadric(-curvature, -axial, 1.0, 0.0);
}

// True if a point of the quadric belongs to the surface. Of the quadric's two sheets, only the sheet through the vertex
// belongs: 1 - (1 + K) c z >= 0.
fn conic_holds(p: vec3<real>, curvature: real, axial: real, aperture: real) -> bool {
    return (1.0 - axial * p.z >= 0.0) & (p.x * p.x + p.y * p.y <= aperture);
}

// conic_distance, without its second quotient, where the crossing nearer to the base of the line comes first. That
// crossing lies at t = F / q from the base. Elsewhere the result is t + shift or MISS.
//
// The other crossing lies at u = q / A. The crossing u does not come first where it lies behind the ray's origin, u <
// -shift, or beyond t. Both are one condition, with room for rounding: |u - (t - shift) / 2| > (t + shift) / 2.
fn nearer_conic_distance(
    o: vec3<real>, d: vec3<real>, curvature: real, axial: real, aperture: real, leaving: bool,
) -> real {
    let line = approach(o, d, conic_quadric(curvature, axial), leaving);
    let t = line.f / line.q;
    let is_met = (line.q != 0.0) & line.has_roots;
    let distance = t + line.shift;
    let room = abs(distance) + 0.002 * (abs(t) + abs(line.shift));
    let comes_first = abs(2.0 * line.q - line.a * (t - line.shift)) > abs(line.a) * room;
    let on_shape = conic_holds(line.base + t * d, curvature, axial, aperture);
    return select(MISS, distance, is_met & comes_first & on_shape & (distance > 0.0));
}
