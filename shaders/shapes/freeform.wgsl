// Freeform: z = c r^2 / (1 + sqrt(1 - (1 + K) c^2 r^2)) + the sum of c_ij T_i(x / R) T_j(y / R) within an aperture of the
// semi-diameter R. T are Chebyshev polynomials.
//
// At `clip`, the buffer of tables has the aperture (geometry/clip.table.wgsl). The number of rows of coefficients
// follows, then the rows, from the last to the first (model::shapes::Freeform). A row has the number of its
// coefficients, then these, from the last to the first.

// `limit` is R^2, and `per_radius` is 1 / R; `axial` is (1 + K) c^2. `slope` and `bend` bound the derivatives of the sag, and
// `magnitude` the sum of its terms' sizes.
fn freeform_distance(
    o: vec3<real>, d: vec3<real>, clip: real, limit: real, lowest: real, highest: real, slope: real, bend: real, magnitude: real,
    per_radius: real, curvature: real, axial: real, leaving: bool,
) -> real {
    var search = sag_search(o, d, clip, limit, lowest, highest, slope, bend, 0.0, magnitude, leaving);
    while search.phase == SAG_SINGLE {
        search = sag_single(search, freeform_sag(search.place, clip, per_radius, curvature, axial));
    }
    while search.phase != SAG_DONE {
        search = sag_next(search, freeform_sag(search.place, clip, per_radius, curvature, axial));
    }
    return search.distance;
}

// The sag below a point, and its derivatives along x and y. Clenshaw's recurrence b = c + 2 u b' - b'' runs along y within
// each row, and along x over the rows; its derivatives run beside it.
fn freeform_sag(p: vec3<real>, clip: real, per_radius: real, curvature: real, axial: real) -> vec3<real> {
    let u = p.x * per_radius;
    let v = p.y * per_radius;
    // The last two values of each recurrence: of the sum, of its derivative along u, and along v.
    var sum = vec2<real>(0.0, 0.0);
    var along_u = vec2<real>(0.0, 0.0);
    var along_v = vec2<real>(0.0, 0.0);
    var at = u32(clip);
    at += 1u + u32(tables[at]);
    var rows = u32(tables[at]);
    at += 1u;
    while rows > 0u {
        var row = vec2<real>(0.0, 0.0);
        var rate = vec2<real>(0.0, 0.0);
        let end = at + 1u + u32(tables[at]);
        at += 1u;
        while at < end {
            rate = vec2<real>(2.0 * (row.x + v * rate.x) - rate.y, rate.x);
            row = vec2<real>(tables[at] + 2.0 * v * row.x - row.y, row.x);
            at += 1u;
        }
        let row_value = row.x - v * row.y;
        let row_rate = rate.x - row.y - v * rate.y;
        along_u = vec2<real>(2.0 * (sum.x + u * along_u.x) - along_u.y, along_u.x);
        along_v = vec2<real>(row_rate + 2.0 * u * along_v.x - along_v.y, along_v.x);
        sum = vec2<real>(row_value + 2.0 * u * sum.x - sum.y, sum.x);
        rows -= 1u;
    }
    let value = sum.x - u * sum.y;
    let rate_u = along_u.x - sum.y - u * along_u.y;
    let rate_v = along_v.x - u * along_v.y;
    let s = p.x * p.x + p.y * p.y;
    let root = sqrt(abs(1.0 - axial * s));
    let slope = curvature / root;
    return vec3<real>(curvature * s / (1.0 + root) + value, slope * p.x + per_radius * rate_u, slope * p.y + per_radius * rate_v);
}

fn freeform_holds(
    p: vec3<real>, clip: real, limit: real, lowest: real, highest: real, slope: real, bend: real, magnitude: real,
    per_radius: real, curvature: real, axial: real,
) -> bool {
    return p.x * p.x + p.y * p.y <= limit && clip_holds(p, clip);
}

fn freeform_normal(
    p: vec3<real>, clip: real, limit: real, lowest: real, highest: real, slope: real, bend: real, magnitude: real,
    per_radius: real, curvature: real, axial: real,
) -> vec3<real> {
    return sag_normal(freeform_sag(p, clip, per_radius, curvature, axial));
}

fn freeform_height(
    p: vec3<real>, clip: real, limit: real, lowest: real, highest: real, slope: real, bend: real, magnitude: real,
    per_radius: real, curvature: real, axial: real,
) -> real {
    return sag_height(p, freeform_sag(p, clip, per_radius, curvature, axial));
}
