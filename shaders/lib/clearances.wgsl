// What shows that a ray does not meet a primitive before it has gone `distance`, without a root or a quotient
// (program::clearance). Each is sufficient, with room for what the search of lib/quadric.wgsl and shapes/ rounds; a ray
// for which one fails may meet the primitive or not. In the primitive's frame, as the search is.

// The ray leaves the quadric: its other crossing, at -2 g / a, lies behind the ray or beyond. No room for roundings is
// needed but in that quotient: g and a are the search's own.
fn leaves(o: vec3<real>, d: vec3<real>, s: Quadric, distance: real) -> bool {
    let a = square_along(d, s);
    let g = slope_along(o, d, s);
    // A g so small that its square is lost makes the search's crossing half as far.
    let is_beyond = (abs(g) > 0.501 * distance * abs(a)) & (abs(g) > 1e-15);
    return ((g < 0.0) == (a < 0.0)) | is_beyond;
}

// The quadric keeps its sign, and off 0 by the margin: at both ends, and between them where it bends away from 0 or does
// not turn.
fn stays_off(o: vec3<real>, d: vec3<real>, s: Quadric, margin: real, distance: real) -> bool {
    let a = square_along(d, s);
    let g = slope_along(o, d, s);
    let f = value_at(o, s);
    let g_there = g + a * distance;
    let f_there = f + distance * (g + g_there);
    let is_off = (abs(f) > margin) & (abs(f_there) > margin) & ((f < 0.0) == (f_there < 0.0));
    let turns = (g < 0.0) != (g_there < 0.0);
    return is_off & (!turns | ((a < 0.0) != (f < 0.0)));
}

// Both ends lie before what fills z from low to high, or both behind it.
fn stays_beside(o: vec3<real>, d: vec3<real>, low: real, high: real, distance: real) -> bool {
    let z = o.z + distance * d.z;
    return ((o.z < low) & (z < low)) | ((o.z > high) & (z > high));
}
