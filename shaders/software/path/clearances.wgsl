// What shows that a ray does not meet a primitive before it has gone `distance`, without a root or a quotient
// (software::path::clearance). Each is sufficient, with room for what the search of geometry/quadric.wgsl and shapes/ rounds; a ray
// for which one fails may meet the primitive or not. In the primitive's frame, as the search is.

// Both have the same sign, and are farther from 0 than the margin. |x + y| - |x - y| is twice the smaller of |x| and |y|
// where the signs agree, and not positive where they do not: one comparison for several, each of which takes wide machines
// as long as a few products.
fn both_off(x: real, y: real, margin: real) -> bool {
    return abs(x + y) > abs(x - y) + 2.0 * margin;
}

// The ray leaves the quadric: its other crossing, at -2 g / a, lies behind the ray or beyond. That is so unless g lies
// between 0 and -a distance / 2. Room is needed for that quotient alone: g and a are the search's own.
fn leaves(o: vec3<real>, d: vec3<real>, s: Quadric, distance: real) -> bool {
    let half = 0.2505 * distance * square_along(d, s);
    // A g so small that its square is lost makes the search's crossing half as far.
    return abs(slope_along(o, d, s) + half) > abs(half) + 1e-15;
}

// The quadric keeps its sign, and off 0 by the margin: so do its values at both ends and the value halfway of its tangent,
// and between the least and the largest of these it lies all along (Bernstein's form).
fn stays_off(o: vec3<real>, d: vec3<real>, s: Quadric, margin: real, distance: real) -> bool {
    let g = slope_along(o, d, s);
    let f = value_at(o, s);
    let halfway = f + distance * g;
    let there = halfway + distance * (g + square_along(d, s) * distance);
    return both_off(f, halfway, margin) & both_off(halfway, there, margin);
}

// Both ends lie before what fills z from low to high, or both behind it.
fn stays_beside(o: vec3<real>, d: vec3<real>, low: real, high: real, distance: real) -> bool {
    let off = o.z - 0.5 * (low + high);
    return both_off(off, off + distance * d.z, 0.5 * (high - low));
}

// Both ends are nearer to the axis than the root of the limit, and so is what lies between.
fn stays_inside(o: vec3<real>, d: vec3<real>, limit: real, distance: real) -> bool {
    let x = o.x + distance * d.x;
    let y = o.y + distance * d.y;
    return (o.x * o.x + o.y * o.y < limit) & (x * x + y * y < limit);
}

// A ray that goes on along z leaves the slab that holds a primitive for good; from then on it is clear. The ray goes 1 along
// z, or against it where the pace is negative, while it goes no farther than the pace;
fn keeps_pace(d: vec3<real>, pace: real) -> bool {
    return d.z * pace >= 1.0;
}

// so it is beyond a plane, where the slab ends, before it has gone so far. Not positive where it begins there.
fn exit_distance(o: vec3<real>, plane: real, pace: real) -> real {
    return (plane - o.z) * pace;
}

fn is_past(exit_distance: real) -> bool {
    return exit_distance <= 0.0;
}
