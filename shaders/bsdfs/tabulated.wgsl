// Tabulated: values over the polar angles of incidence and of scatter [deg], bilinear between them and 0 beyond.
// Directions are drawn cosine-weighted, so a ray carries pi times the value at its angles.
//
// Optiland differs in two points. Optiland cuts the weight off at 1, which dims every lobe that is higher than a
// Lambertian one. And it assumes 90 degrees of incidence for a ray that comes from the side opposite to the lobe's.

// The table holds the angles of incidence, the angles of scatter, then one row per angle of incidence. A row is pi
// times the value [1/sr] (model::bsdfs::Tabulated::table).
fn sample_tabulated(s: Scattering, surface: Surface) -> Lobe {
    let n = lobe_normal(s, surface);
    let scattered = cosine_weighted(s, n);
    let theta_i = degrees_of(abs(dot(s.incident, s.normal)));
    let theta_s = degrees_of(scattered.cosine);
    return Lobe(scattered.direction, tabulated_value(theta_i, theta_s, surface));
}

// An angle [deg], clamped to 90: a right angle that rounding lifts would fall off the table.
fn degrees_of(cosine: real) -> real {
    return min(acos_real(cosine) * 57.29577951308232, 90.0);
}

fn tabulated_value(theta_i: real, theta_s: real, surface: Surface) -> real {
    let angles_i = surface.bsdf_table;
    let angles_s = angles_i + surface.num_theta_i;
    let values = angles_s + surface.num_theta_s;
    if !covers(angles_i, surface.num_theta_i, theta_i) || !covers(angles_s, surface.num_theta_s, theta_s) {
        return 0.0;
    }
    let i = interval_of(theta_i, angles_i, surface.num_theta_i);
    let j = interval_of(theta_s, angles_s, surface.num_theta_s);
    let u = position_in(theta_i, angles_i + i);
    let v = position_in(theta_s, angles_s + j);
    let low = values + i * surface.num_theta_s + j;
    let high = low + surface.num_theta_s;
    return (1.0 - u) * ((1.0 - v) * tables[low] + v * tables[low + 1u])
        + u * ((1.0 - v) * tables[high] + v * tables[high + 1u]);
}

fn covers(first: u32, count: u32, x: real) -> bool {
    return x >= tables[first] && x <= tables[first + count - 1u];
}
