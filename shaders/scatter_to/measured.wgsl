// How bsdfs/measured.wgsl draws a direction.

fn toward_measured(s: Scattering, surface: Surface, direction: vec3<real>) -> Toward {
    let about = specular_frame(s, surface);
    let rows = measured_rows(about, surface);
    let local = vec3<real>(
        dot(direction, about.towards_normal), dot(direction, about.across), dot(direction, about.specular),
    );
    let cosine = dot(direction, about.normal);
    var density: real = 0.0;
    // A dark row has no table.
    if rows.high_share < 1.0 && rows.light > 0.0 {
        density += (1.0 - rows.high_share) * polar_table_density(rows.low, local);
    }
    if rows.high_share > 0.0 {
        density += rows.high_share * polar_table_density(rows.high, local);
    }
    return Toward(density, rows.light * max(cosine, 0.0));
}

// The density of drawn_from_polar_table in a direction of the table's frame [1/sr].
fn polar_table_density(first: u32, local: vec3<real>) -> real {
    let num_knots = u32(tables[first]);
    let num_azimuths = u32(tables[first + 1u]);
    let angles = first + 2u + num_knots;
    let azimuths = angles + 5u * num_knots;
    let polar = atan2_real(sqrt(local.x * local.x + local.y * local.y), local.z);
    if polar > tables[angles + num_knots - 1u] {
        return 0.0;
    }
    let k = interval_of(polar, angles, num_knots);
    let part = min(position_in(polar, angles + k), 1.0);
    let turned = atan2_real(local.y, local.x);
    let azimuth = min(select(turned, turned + 6.283185307179586, turned < 0.0), tables[azimuths + num_azimuths - 1u]);
    let i = interval_of(azimuth, azimuths, num_azimuths);
    let v = position_in(azimuth, azimuths + i);
    let row = azimuths + num_azimuths + 2u * num_azimuths * k + i;
    let next = row + 2u * num_azimuths;
    return (1.0 - v) * between_knots(row, next, part) + v * between_knots(row + 1u, next + 1u, part);
}
