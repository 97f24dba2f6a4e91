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
    let knots = first + 2u + num_knots;
    let azimuths = knots + 4u * num_knots;
    let sine = sqrt(local.x * local.x + local.y * local.y);
    // The last knot that is not beyond the polar angle.
    var low = 0u;
    var high = num_knots - 1u;
    var step = 0u;
    loop {
        let middle = (low + high) / 2u;
        if always_true() & (high - low > 1u) {
            if sine_beyond(knots + 4u * middle, sine, local.z) >= 0.0 {
                low = middle;
            } else {
                high = middle;
            }
        }
        step += 1u;
        if step >= 32u || high - low <= 1u {
            break;
        }
    }
    // The end of the table lies beyond its last knot.
    if sine_beyond(knots + 4u * (num_knots - 1u), sine, local.z) > 0.0 {
        return 0.0;
    }
    let knot = knots + 4u * low;
    let beyond = sine_beyond(knot, sine, local.z);
    // asin of at most 0.02.
    let square = beyond * beyond;
    let angle = beyond * (1.0 + square / 6.0 * (1.0 + square * 0.45));
    let part = min(max(angle / tables[knot], 0.0), 1.0);
    let turned = atan2_real(local.y, local.x);
    let azimuth = min(select(turned, turned + 6.283185307179586, turned < 0.0), tables[azimuths + num_azimuths - 1u]);
    let i = interval_of(azimuth, azimuths, num_azimuths);
    let v = position_in(azimuth, azimuths + i);
    let row = azimuths + num_azimuths + 2u * num_azimuths * low + i;
    let next = row + 2u * num_azimuths;
    return (1.0 - v) * between_knots(row, next, part) + v * between_knots(row + 1u, next + 1u, part);
}

// The sine of the angle by which a direction lies beyond a knot.
fn sine_beyond(knot: u32, sine: real, cosine: real) -> real {
    return sine * tables[knot + 2u] - cosine * tables[knot + 1u];
}
