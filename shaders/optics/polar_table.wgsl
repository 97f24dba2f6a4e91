// Directions that are drawn by a table over the polar angle and the azimuth about an axis: PolarTable::numbers of
// model::polar_table. The function is linear in each angle between the table's, and the inverse of its distribution is exact.

// A direction in the table's frame, by two uniform numbers. The polar angle comes first, by the light around each cone. The azimuth
// follows, by the light along that cone.
fn drawn_from_polar_table(first: u32, u_polar: real, u_azimuth: real) -> vec3<real> {
    let num_knots = u32(tables[first]);
    let num_azimuths = u32(tables[first + 1u]);
    let shares = first + 2u;
    let knots = shares + 2u * num_knots;
    let azimuths = knots + 4u * num_knots;

    let k = interval_of(u_polar, shares, num_knots);
    let knot = knots + 4u * k;
    let length = tables[knot];
    let s = polar_step(knot, position_in(u_polar, shares + k));

    let row = azimuths + num_azimuths + 2u * num_azimuths * k;
    let azimuth = azimuth_of(azimuths, num_azimuths, row, s / length, u_azimuth);
    let sine = small_sine(s);
    let cosine = small_cosine(s);
    let across = tables[knot + 1u] * cosine + tables[knot + 2u] * sine;
    let along = tables[knot + 2u] * cosine - tables[knot + 1u] * sine;
    return vec3<real>(across * cos_real(azimuth), across * sin_real(azimuth), along);
}

// Sine and cosine of a step between knots, which is at most 0.02: exact to 1e-13.
fn small_sine(s: real) -> real {
    let square = s * s;
    return s * (1.0 - square / 6.0 * (1.0 - square / 20.0));
}

fn small_cosine(s: real) -> real {
    let square = s * s;
    return 1.0 - square / 2.0 * (1.0 - square / 12.0);
}

// The angle beyond a knot below which lies this part of the light up to the next knot, by Newton's method. The light around
// the cone at a step t is (total + slope t) sin(angle + t).
fn polar_step(knot: u32, part: real) -> real {
    let length = tables[knot];
    let total = tables[knot + 3u];
    let slope = (tables[knot + 7u] - total) / length;
    let light = light_below(knot, total, slope, length) * part;
    // As if the light around the cone were linear.
    let here = light_at(knot, total, slope, 0.0);
    let there = light_at(knot, total, slope, length);
    let root = here + sqrt(max(here * here + (there * there - here * here) * part, 0.0));
    var s = real(0.0);
    if root > 0.0 {
        s = clamp_step(length * (here + there) * part / root, length);
    }
    for (var i = 0u; i < 5u; i++) {
        let slant = light_at(knot, total, slope, s);
        if slant > 0.0 {
            s = clamp_step(s - (light_below(knot, total, slope, s) - light) / slant, length);
        }
    }
    return s;
}

fn clamp_step(s: real, length: real) -> real {
    return min(max(s, 0.0), length);
}

fn light_at(knot: u32, total: real, slope: real, s: real) -> real {
    return (total + slope * s) * (tables[knot + 1u] * small_cosine(s) + tables[knot + 2u] * small_sine(s));
}

// The integral of light_at from 0 to s. Its twin on the host is `flux_within`.
fn light_below(knot: u32, total: real, slope: real, s: real) -> real {
    let square = s * s;
    let of_sine = square / 2.0 * (1.0 - square / 12.0 * (1.0 - square / 30.0));
    let with_cosine = square / 2.0 * (1.0 - square / 4.0 * (1.0 - square / 18.0));
    let with_sine = square * s / 3.0 * (1.0 - square / 10.0 * (1.0 - square / 28.0));
    let even = tables[knot + 1u] * small_sine(s) + tables[knot + 2u] * of_sine;
    let rising = tables[knot + 1u] * with_cosine + tables[knot + 2u] * with_sine;
    return total * even + slope * rising;
}

// The azimuth below which lies the share u of a cone's light. The cone stands a part of the way from the knot of `row`
// to the next knot. Each knot has its values and then their sums.
fn azimuth_of(azimuths: u32, count: u32, row: u32, part: real, u: real) -> real {
    let next = row + 2u * count;
    let light = u * between_knots(row + 2u * count - 1u, next + 2u * count - 1u, part);
    // As interval_of, whose numbers lie in one table.
    var low = 0u;
    var high = count - 1u;
    var step = 0u;
    loop {
        let middle = (low + high) / 2u;
        if always_true() & (high - low > 1u) {
            if between_knots(row + count + middle, next + count + middle, part) <= light {
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
    let width = tables[azimuths + low + 1u] - tables[azimuths + low];
    let left = between_knots(row + low, next + low, part);
    let right = between_knots(row + low + 1u, next + low + 1u, part);
    let rest = (light - between_knots(row + count + low, next + count + low, part)) / width;
    let root = left + sqrt(max(left * left + 2.0 * (right - left) * rest, 0.0));
    var share = real(0.0);
    if root > 0.0 {
        share = min(max(2.0 * rest / root, 0.0), 1.0);
    }
    return tables[azimuths + low] + share * width;
}

fn between_knots(here: u32, there: u32, part: real) -> real {
    return tables[here] * (1.0 - part) + tables[there] * part;
}
