// Conic within an aperture that need be neither round nor on the axis.

// `axial` is (1 + K) c, and `limit` the squared semi-diameter. The aperture has its middle at x and y, the inverses of its
// semi-axes, and a squared hole. Its mode is 0 for an ellipse and 1 for a rectangle; 2 more means all that it leaves out.
fn clipped_conic_distance(
    o: vec3<real>, d: vec3<real>, curvature: real, axial: real, limit: real, x: real, y: real, per_x: real, per_y: real,
    hole: real, mode: real, leaving: bool,
) -> real {
    let c = crossings(o, d, clipped_conic_quadric(curvature, axial), leaving);
    let first = c.base + c.first * d;
    let second = c.base + c.second * d;
    return first_ahead(
        c,
        clipped_conic_holds(first, curvature, axial, limit, x, y, per_x, per_y, hole, mode),
        clipped_conic_holds(second, curvature, axial, limit, x, y, per_x, per_y, hole, mode),
    );
}

fn clipped_conic_quadric(curvature: real, axial: real) -> Quadric {
    return Quadric(-curvature, -axial, 1.0, 0.0);
}

// True if a point of the quadric belongs to the surface: to the sheet through its vertex, and to what the aperture leaves.
fn clipped_conic_holds(
    p: vec3<real>, curvature: real, axial: real, limit: real, x: real, y: real, per_x: real, per_y: real, hole: real,
    mode: real,
) -> bool {
    let u = p.x - x;
    let v = p.y - y;
    let along = u * per_x;
    let across = v * per_y;
    let is_rectangle = (mode == 1.0) | (mode == 3.0);
    let in_rectangle = (abs(along) <= 1.0) & (abs(across) <= 1.0);
    let in_ellipse = along * along + across * across <= 1.0;
    let inside = select(in_ellipse, in_rectangle, is_rectangle) & (u * u + v * v >= hole);
    let is_limited = (1.0 - axial * p.z >= 0.0) & (p.x * p.x + p.y * p.y <= limit);
    return is_limited & (inside != (mode >= 2.0));
}
