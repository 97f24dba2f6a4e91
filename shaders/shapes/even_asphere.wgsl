// Even asphere: z = c r^2 / (1 + sqrt(1 - (1 + K) c^2 r^2)) + c1 r^2 + c2 r^4 + ... + c10 r^20 within an aperture.

// `limit` is the squared semi-diameter, `axial` is (1 + K) c^2; `slope` and `bend` bound the derivatives of the sag.
fn even_asphere_distance(
    o: vec3<real>, d: vec3<real>, limit: real, lowest: real, highest: real, slope: real, bend: real, curvature: real,
    axial: real, c1: real, c2: real, c3: real, c4: real, c5: real, c6: real, c7: real, c8: real, c9: real, c10: real,
    leaving: bool,
) -> real {
    var search = sag_search(o, d, limit, lowest, highest, slope, bend, leaving);
    while search.phase != SAG_DONE {
        let sag = even_asphere_sag(search.place, curvature, axial, c1, c2, c3, c4, c5, c6, c7, c8, c9, c10);
        search = sag_next(search, sag);
    }
    return search.distance;
}

// The sag below a point, and its derivatives along x and y.
fn even_asphere_sag(
    p: vec3<real>, curvature: real, axial: real, c1: real, c2: real, c3: real, c4: real, c5: real, c6: real, c7: real,
    c8: real, c9: real, c10: real,
) -> vec3<real> {
    let s = p.x * p.x + p.y * p.y;
    let root = sqrt(abs(1.0 - axial * s));
    let terms = s * (c1 + s * (c2 + s * (c3 + s * (c4 + s * (c5 + s * (c6 + s * (c7 + s * (c8 + s * (c9 + s * c10)))))))));
    let high_rates = 6.0 * c6 + s * (7.0 * c7 + s * (8.0 * c8 + s * (9.0 * c9 + s * (10.0 * c10))));
    let rates = c1 + s * (2.0 * c2 + s * (3.0 * c3 + s * (4.0 * c4 + s * (5.0 * c5 + s * high_rates))));
    let slope = curvature / root + 2.0 * rates;
    return vec3<real>(curvature * s / (1.0 + root) + terms, slope * p.x, slope * p.y);
}

fn even_asphere_holds(
    p: vec3<real>, limit: real, lowest: real, highest: real, slope: real, bend: real, curvature: real, axial: real,
    c1: real, c2: real, c3: real, c4: real, c5: real, c6: real, c7: real, c8: real, c9: real, c10: real,
) -> bool {
    return p.x * p.x + p.y * p.y <= limit;
}

fn even_asphere_normal(
    p: vec3<real>, limit: real, lowest: real, highest: real, slope: real, bend: real, curvature: real, axial: real,
    c1: real, c2: real, c3: real, c4: real, c5: real, c6: real, c7: real, c8: real, c9: real, c10: real,
) -> vec3<real> {
    let sag = even_asphere_sag(p, curvature, axial, c1, c2, c3, c4, c5, c6, c7, c8, c9, c10);
    return vec3<real>(-sag.y, -sag.z, 1.0) / sqrt(1.0 + sag.y * sag.y + sag.z * sag.z);
}

fn even_asphere_height(
    p: vec3<real>, limit: real, lowest: real, highest: real, slope: real, bend: real, curvature: real, axial: real,
    c1: real, c2: real, c3: real, c4: real, c5: real, c6: real, c7: real, c8: real, c9: real, c10: real,
) -> real {
    let sag = even_asphere_sag(p, curvature, axial, c1, c2, c3, c4, c5, c6, c7, c8, c9, c10);
    return (p.z - sag.x) / sqrt(1.0 + sag.y * sag.y + sag.z * sag.z);
}
