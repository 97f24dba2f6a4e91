// Biconic: z = cx x^2 / (1 + sqrt(1 - (1 + kx) cx^2 x^2)) and the same of y, added up, within an aperture.

// The aperture stands in the buffer of tables at `clip` (geometry/clip.table.wgsl). `limit` is the squared semi-diameter; `axial_x` is (1 + kx) cx^2. `slope` and `bend` bound the derivatives of the sag, and
// `magnitude` the sum of its terms' sizes.
fn biconic_distance(
    o: vec3<real>, d: vec3<real>, clip: real, limit: real, lowest: real, highest: real, slope: real, bend: real, magnitude: real,
    curvature_x: real, axial_x: real, curvature_y: real, axial_y: real, leaving: bool,
) -> real {
    var search = sag_search(o, d, clip, limit, lowest, highest, slope, bend, 0.0, magnitude, leaving);
    while search.phase == SAG_SINGLE {
        search = sag_single(search, biconic_sag(search.place, curvature_x, axial_x, curvature_y, axial_y));
    }
    while search.phase != SAG_DONE {
        search = sag_next(search, biconic_sag(search.place, curvature_x, axial_x, curvature_y, axial_y));
    }
    return search.distance;
}

// The sag below a point, and its derivatives along x and y.
fn biconic_sag(p: vec3<real>, curvature_x: real, axial_x: real, curvature_y: real, axial_y: real) -> vec3<real> {
    let root_x = sqrt(abs(1.0 - axial_x * p.x * p.x));
    let root_y = sqrt(abs(1.0 - axial_y * p.y * p.y));
    let height = curvature_x * p.x * p.x / (1.0 + root_x) + curvature_y * p.y * p.y / (1.0 + root_y);
    return vec3<real>(height, curvature_x * p.x / root_x, curvature_y * p.y / root_y);
}

fn biconic_holds(
    p: vec3<real>, clip: real, limit: real, lowest: real, highest: real, slope: real, bend: real, magnitude: real,
    curvature_x: real, axial_x: real, curvature_y: real, axial_y: real,
) -> bool {
    return p.x * p.x + p.y * p.y <= limit && clip_holds(p, clip);
}

fn biconic_normal(
    p: vec3<real>, clip: real, limit: real, lowest: real, highest: real, slope: real, bend: real, magnitude: real,
    curvature_x: real, axial_x: real, curvature_y: real, axial_y: real,
) -> vec3<real> {
    return sag_normal(biconic_sag(p, curvature_x, axial_x, curvature_y, axial_y));
}

fn biconic_height(
    p: vec3<real>, clip: real, limit: real, lowest: real, highest: real, slope: real, bend: real, magnitude: real,
    curvature_x: real, axial_x: real, curvature_y: real, axial_y: real,
) -> real {
    return sag_height(p, biconic_sag(p, curvature_x, axial_x, curvature_y, axial_y));
}
