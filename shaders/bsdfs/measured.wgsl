// Measured: values over the angle of incidence, and over two angles about the specular direction (model::bsdfs::measured).
//
// A direction is drawn by the exact inverse of the values. So a ray carries all the light of the table times the
// direction's cosine with the normal. The light of the table is the integral of the values over all directions. Below
// the surface no direction lies.

// The table holds the angles of incidence [deg]. For each of them follow the light of its row, and where the table of that row
// begins (optics/polar_table.wgsl), counted from here.
fn sample_measured(s: Scattering, surface: Surface) -> Lobe {
    let about = specular_frame(s, surface);
    let rows = measured_rows(about, surface);
    if rows.light <= 0.0 {
        return Lobe(about.specular, 0.0);
    }
    let u = uniform_of(draw(s.key, BSDF_U1, s.step));
    let is_high = u < rows.high_share;
    // What is left of the draw is uniform again.
    let low_share = 1.0 - rows.high_share;
    let rest = select((u - rows.high_share) / select(1.0, low_share, low_share > 0.0),
        u / select(1.0, rows.high_share, is_high), is_high);
    let local = drawn_from_polar_table(
        select(rows.low, rows.high, is_high), uniform_of(draw(s.key, BSDF_U2, s.step)), rest,
    );
    let direction =
        renormalize(local.x * about.towards_normal + local.y * about.across + local.z * about.specular);
    let cosine = dot(direction, about.normal);
    // A ray that is drawn below the surface keeps the specular direction, and gets no weight.
    if cosine <= 0.0 {
        return Lobe(about.specular, 0.0);
    }
    return Lobe(direction, rows.light * cosine);
}

// The two rows about an angle of incidence.
struct MeasuredRows {
    // Where their tables begin.
    low: u32,
    high: u32,
    // The light of both.
    light: real,
    // The share of the high one.
    high_share: real,
}

fn measured_rows(about: SpecularFrame, surface: Surface) -> MeasuredRows {
    let angles = surface.bsdf_table;
    let count = surface.num_incidences;
    let asked = about.incidence * 57.29577951308232;
    let theta_i = min(max(asked, tables[angles]), tables[angles + count - 1u]);
    let i = interval_of(theta_i, angles, count);
    let part = position_in(theta_i, angles + i);
    let row = angles + count + 2u * i;
    let low = (1.0 - part) * tables[row];
    let high = part * tables[row + 2u];
    let light = low + high;
    let share = high / select(1.0, light, light > 0.0);
    return MeasuredRows(angles + u32(tables[row + 1u]), angles + u32(tables[row + 3u]), light, share);
}

// The axes about the specular direction, which is the mirrored ray or the ray itself.
struct SpecularFrame {
    // The azimuth is 0 here.
    towards_normal: vec3<real>,
    across: vec3<real>,
    specular: vec3<real>,
    // On the side to which the specular direction goes.
    normal: vec3<real>,
    // The angle between the two [rad].
    incidence: real,
}

fn specular_frame(s: Scattering, surface: Surface) -> SpecularFrame {
    let specular = select(mirrored(s.incident, s.normal), s.incident, lobe_transmits(s, surface));
    let normal = select(s.normal, -s.normal, dot(specular, s.normal) < 0.0);
    let slant = perpendicular_to(specular, normal);
    let any = perpendicular_to(specular, tangents_of(s.normal).t);
    // At normal incidence any direction is towards the normal.
    let towards = select(slant, any, dot(slant, slant) < 1e-10);
    let towards_normal = towards / sqrt(dot(towards, towards));
    // An arc cosine would lose half the digits near normal incidence.
    let incidence = atan2_real(sqrt(dot(slant, slant)), dot(specular, normal));
    return SpecularFrame(towards_normal, cross(specular, towards_normal), specular, normal, incidence);
}

// The part of a vector that is perpendicular to a unit vector.
fn perpendicular_to(axis: vec3<real>, v: vec3<real>) -> vec3<real> {
    return v - dot(v, axis) * axis;
}
