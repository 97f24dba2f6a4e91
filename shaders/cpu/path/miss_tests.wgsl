// Cheap tests that a ray does not meet a primitive before it has gone `distance`, without a root or a quotient
// (cpu::path::miss_test). All coordinates are in the primitive's frame, as in the search.
//
// Each test is sufficient, with room for what the search of geometry/quadric.wgsl and shapes/ rounds. A ray that fails
// a test may meet the primitive or not.

// True if x and y have the same sign, and are farther from 0 than the margin.
//
// If the signs agree, |x + y| - |x - y| is twice the smaller of |x| and |y|; if not, it is not positive. So one
// comparison does for several. A comparison takes wide machines as long as a few products.
fn both_off(x: real, y: real, margin: real) -> bool {
    return abs(x + y) > abs(x - y) + 2.0 * margin;
}

// True for a ray that leaves the quadric, if its other crossing, at -2 g / a, lies behind the ray or beyond `distance`.
// The test fails only if g lies between 0 and -a distance / 2. Room is needed for that quotient alone: g and a are the
// search's own.
fn leaves(o: vec3<real>, d: vec3<real>, s: Quadric, distance: real) -> bool {
    let half = 0.2505 * distance * square_along(d, s);
    // Where g is so small that its square underflows, the search finds the crossing at half the distance.
    return abs(slope_along(o, d, s) + half) > abs(half) + 1e-15;
}

// True if the quadric keeps its sign along the way, and stays off 0 by the margin. Three values decide: the quadric's
// values at both ends, and the tangent's value halfway. The quadric lies between the least and the largest of the three
// (Bernstein's form).
fn stays_off(o: vec3<real>, d: vec3<real>, s: Quadric, margin: real, distance: real) -> bool {
    let g = slope_along(o, d, s);
    let f = value_at(o, s);
    let halfway = f + distance * g;
    let there = halfway + distance * (g + square_along(d, s) * distance);
    return both_off(f, halfway, margin) & both_off(halfway, there, margin);
}

// True if both ends lie before the slab from low to high in z, or both behind it.
fn stays_beside(o: vec3<real>, d: vec3<real>, low: real, high: real, distance: real) -> bool {
    let off = o.z - 0.5 * (low + high);
    return both_off(off, off + distance * d.z, 0.5 * (high - low));
}

// True if both ends are nearer to the axis than the root of the limit; then so is the way between them.
fn stays_inside(o: vec3<real>, d: vec3<real>, limit: real, distance: real) -> bool {
    let x = o.x + distance * d.x;
    let y = o.y + distance * d.y;
    return (o.x * o.x + o.y * o.y < limit) & (x * x + y * y < limit);
}

// True if the ray goes 1 along z while it goes at most |pace|. A negative pace means against z. A ray that keeps such a
// pace leaves for good the slab that holds a primitive, and from then on misses the primitive.
fn keeps_pace(d: vec3<real>, pace: real) -> bool {
    return d.z * pace >= 1.0;
}

// The distance after which a ray that keeps the pace is beyond the plane where the slab ends. Not positive for a ray
// that begins there.
fn exit_distance(o: vec3<real>, plane: real, pace: real) -> real {
    return (plane - o.z) * pace;
}

fn is_past(exit_distance: real) -> bool {
    return exit_distance <= 0.0;
}
