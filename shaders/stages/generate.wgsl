// Stage generate: a ray is born from its id alone.

struct LocalRay {
    position: vec3<real>,
    direction: vec3<real>,
}

fn plain_generate(index: u32) -> Ray {
    return new_ray(key_of(index), index);
}

fn new_ray(key: RayKey, index: u32) -> Ray {
    let e = source();
    let born = emit(key, e);
    let position = vec3<real>(e.origin_x, e.origin_y, e.origin_z) + from_source(e, born.position);
    let direction = from_source(e, born.direction);
    return Ray(
        position, direction, e.weight, key,
        stream_at(key, FRESNEL_BRANCH, first_jump()), stream_at(key, RR, first_jump()),
        index, 0u, NONE, draw_wavelength(key, e), e.medium, false, false, 0u, ALIVE,
    );
}

// Uniform over a disk: radius sqrt(u1) R, azimuth u2 turns.
fn disk_point(key: RayKey, radius: real) -> vec3<real> {
    let r = radius * sqrt(uniform_of(draw_first(key, SOURCE_U1)));
    let turn = sincos_turns(draw_first(key, SOURCE_U2));
    return vec3<real>(r * turn.x, r * turn.y, 0.0);
}

// Uniform in solid angle within a cap of height 1 - cos(half angle). With v = u height, sin^2 = v (2 - v).
fn cap_direction(key: RayKey, slot_u1: u32, slot_u2: u32, height: real) -> vec3<real> {
    let v = uniform_of(draw_first(key, slot_u1)) * height;
    let s = sqrt(max(v * (2.0 - v), 0.0));
    let turn = sincos_turns(draw_first(key, slot_u2));
    return vec3<real>(s * turn.x, s * turn.y, 1.0 - v);
}

// Cosine-weighted over the hemisphere: cos = sqrt(u).
fn lambertian_direction(key: RayKey, slot_u1: u32, slot_u2: u32) -> vec3<real> {
    let u = uniform_of(draw_first(key, slot_u1));
    let s = sqrt(1.0 - u);
    let turn = sincos_turns(draw_first(key, slot_u2));
    return vec3<real>(s * turn.x, s * turn.y, sqrt(u));
}

fn extended_direction(key: RayKey, height: real) -> vec3<real> {
    if height < 0.0 {
        return lambertian_direction(key, SOURCE_U3, SOURCE_U4);
    }
    return cap_direction(key, SOURCE_U3, SOURCE_U4, height);
}
