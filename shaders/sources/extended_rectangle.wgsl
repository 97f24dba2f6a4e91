// Extended source: a rectangle. p0 = width [mm], p1 = height [mm], p2 = 1 - cos(half angle); a negative p2 means
// Lambertian.

fn emit_extended_rectangle(key: RayKey, e: Source) -> LocalRay {
    let x = (uniform_of(draw_first(key, SOURCE_U1)) - 0.5) * e.p0;
    let y = (uniform_of(draw_first(key, SOURCE_U2)) - 0.5) * e.p1;
    return LocalRay(vec3<real>(x, y, 0.0), extended_direction(key, e.p2));
}
