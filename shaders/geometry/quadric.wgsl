// Quadrics of revolution, which most analytic shapes are in their own frames:
//
//     radial (x^2 + y^2) + axial z^2 + 2 offset z + constant = 0.
//
// Its gradient (radial x, radial y, axial z + offset) points along the geometric normal.

struct Quadric {
    radial: real,
    axial: real,
    offset: real,
    constant: real,
}

// A ray's line as seen from a quadric. At a distance t from the point `base`, the quadric has the value A t^2 + 2 G t +
// F. The base lies `shift` beyond the ray's origin. With q = -(G + sign(G) sqrt(G^2 - A F)) the roots are q / A and F /
// q, without cancellation.
struct Approach {
    base: vec3<real>,
    shift: real,
    a: real,
    f: real,
    q: real,
    has_roots: bool,
}

// The two crossings of the line with the quadric, as distances from `base`. A crossing that does not exist is -MISS,
// behind every ray.
struct Crossings {
    base: vec3<real>,
    shift: real,
    first: real,
    second: real,
}

fn crossings(o: vec3<real>, d: vec3<real>, s: Quadric, leaving: bool) -> Crossings {
    let line = approach(o, d, s, leaving);
    let first = select(line.q / line.a, -MISS, (line.a == 0.0) | !line.has_roots);
    let second = select(line.f / line.q, -MISS, (line.q == 0.0) | !line.has_roots | leaving);
    return Crossings(line.base, line.shift, first, second);
}

// The base is the point of closest approach to the local origin, which keeps F small for distant rays. Source: Haines
// et al., Ray Tracing Gems, ch. 7. A ray that leaves this quadric has F = 0 exactly. Its one root ahead is q / A, and
// no epsilon is needed.
fn approach(o: vec3<real>, d: vec3<real>, s: Quadric, leaving: bool) -> Approach {
    let shift = select(-dot(o, d), 0.0, leaving);
    let p = o + shift * d;
    let a = square_along(d, s);
    let g = slope_along(p, d, s);
    let f = select(value_at(p, s), 0.0, leaving);
    let discriminant = g * g - a * f;
    // An abs in place of a max: Mesa computes max and min of wide vectors by halves.
    let root = sqrt(abs(discriminant));
    let q = -(g + select(root, -root, g < 0.0));
    return Approach(p, shift, a, f, q, discriminant >= 0.0);
}

// A of the line with the direction d.
fn square_along(d: vec3<real>, s: Quadric) -> real {
    return s.radial * (d.x * d.x + d.y * d.y) + s.axial * d.z * d.z;
}

fn slope_along(p: vec3<real>, d: vec3<real>, s: Quadric) -> real {
    return s.radial * (p.x * d.x + p.y * d.y) + (s.axial * p.z + s.offset) * d.z;
}

fn value_at(p: vec3<real>, s: Quadric) -> real {
    return s.radial * (p.x * p.x + p.y * p.y) + (s.axial * p.z + 2.0 * s.offset) * p.z + s.constant;
}

// The distance from the ray's origin to its first crossing that lies ahead and on the shape. Where there is none, the
// result is MISS or more, which `nearer` never takes.
fn first_ahead(c: Crossings, first_on_shape: bool, second_on_shape: bool) -> real {
    let first = c.first + c.shift;
    let second = c.second + c.shift;
    let met_first = select(MISS, first, first_on_shape & (first > 0.0));
    let met_second = select(MISS, second, second_on_shape & (second > 0.0));
    return select(met_first, met_second, met_second < met_first);
}
