// Point source: uniform in solid angle within a cap around local +z. p0 = 1 - cos(half angle), computed by the host
// without cancellation.

fn emit_point(key: RayKey, e: Source) -> LocalRay {
    return LocalRay(vec3<real>(0.0, 0.0, 0.0), cap_direction(key, SOURCE_U1, SOURCE_U2, e.p0));
}
