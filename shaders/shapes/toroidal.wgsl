// Toroid: a profile h(y) within an aperture, turned about the line z = 1 / cx, x = 0. The profile is h = c y^2 / (1 +
// sqrt(1 - (1 + K) c^2 y^2)) + c1 y^2 + c2 y^4 + ... + c10 y^20. With w = 1 - cx h, z = h + cx x^2 / (w + sqrt(w^2 -
// cx^2 x^2)).

// The aperture stands in the buffer of tables at `clip` (geometry/clip.table.wgsl). `limit` is the squared
// semi-diameter R^2, and `per_limit` its inverse; `axial` is (1 + K) c^2. `slope` and `bend` bound the derivatives of
// the sag, and `magnitude` the sum of its terms' sizes. The coefficients belong to powers of y / R.
fn toroidal_distance(
    o: vec3<real>, d: vec3<real>, clip: real, limit: real, lowest: real, highest: real, slope: real, bend: real, magnitude: real,
    per_limit: real, curvature_x: real, curvature: real, axial: real,
    c1: real, c2: real, c3: real, c4: real, c5: real, c6: real, c7: real, c8: real, c9: real, c10: real, leaving: bool,
) -> real {
    var search = sag_search(o, d, clip, limit, lowest, highest, slope, bend, 0.0, magnitude, leaving);
    while search.phase == SAG_SINGLE {
        let sag = toroidal_sag(search.place, per_limit, curvature_x, curvature, axial, c1, c2, c3, c4, c5, c6, c7, c8, c9, c10);
        search = sag_single(search, sag);
    }
    while search.phase != SAG_DONE {
        let sag = toroidal_sag(search.place, per_limit, curvature_x, curvature, axial, c1, c2, c3, c4, c5, c6, c7, c8, c9, c10);
        search = sag_next(search, sag);
    }
    return search.distance;
}

// The sag below a point, and its derivatives along x and y.
fn toroidal_sag(
    p: vec3<real>, per_limit: real, curvature_x: real, curvature: real, axial: real,
    c1: real, c2: real, c3: real, c4: real, c5: real, c6: real, c7: real, c8: real, c9: real, c10: real,
) -> vec3<real> {
    let s = p.y * p.y;
    let root = sqrt(abs(1.0 - axial * s));
    let q = s * per_limit;
    let terms = q * (c1 + q * (c2 + q * (c3 + q * (c4 + q * (c5 + q * (c6 + q * (c7 + q * (c8 + q * (c9 + q * c10)))))))));
    let high_rates = 6.0 * c6 + q * (7.0 * c7 + q * (8.0 * c8 + q * (9.0 * c9 + q * (10.0 * c10))));
    let rates = c1 + q * (2.0 * c2 + q * (3.0 * c3 + q * (4.0 * c4 + q * (5.0 * c5 + q * high_rates))));
    let profile = curvature * s / (1.0 + root) + terms;
    let rate = (curvature / root + 2.0 * per_limit * rates) * p.y;
    let w = 1.0 - curvature_x * profile;
    let bent = curvature_x * p.x;
    let turned = sqrt(abs((w - bent) * (w + bent)));
    return vec3<real>(profile + bent * p.x / (w + turned), bent / turned, w * rate / turned);
}

fn toroidal_holds(
    p: vec3<real>, clip: real, limit: real, lowest: real, highest: real, slope: real, bend: real, magnitude: real, per_limit: real,
    curvature_x: real, curvature: real, axial: real,
    c1: real, c2: real, c3: real, c4: real, c5: real, c6: real, c7: real, c8: real, c9: real, c10: real,
) -> bool {
    return p.x * p.x + p.y * p.y <= limit && clip_holds(p, clip);
}

fn toroidal_normal(
    p: vec3<real>, clip: real, limit: real, lowest: real, highest: real, slope: real, bend: real, magnitude: real, per_limit: real,
    curvature_x: real, curvature: real, axial: real,
    c1: real, c2: real, c3: real, c4: real, c5: real, c6: real, c7: real, c8: real, c9: real, c10: real,
) -> vec3<real> {
    let sag = toroidal_sag(p, per_limit, curvature_x, curvature, axial, c1, c2, c3, c4, c5, c6, c7, c8, c9, c10);
    return sag_normal(sag);
}

fn toroidal_height(
    p: vec3<real>, clip: real, limit: real, lowest: real, highest: real, slope: real, bend: real, magnitude: real, per_limit: real,
    curvature_x: real, curvature: real, axial: real,
    c1: real, c2: real, c3: real, c4: real, c5: real, c6: real, c7: real, c8: real, c9: real, c10: real,
) -> real {
    let sag = toroidal_sag(p, per_limit, curvature_x, curvature, axial, c1, c2, c3, c4, c5, c6, c7, c8, c9, c10);
    return sag_height(p, sag);
}
