// Collimated source with a truncated Gaussian profile. p0 = disk radius [mm], p1 = standard deviation [mm].

const GAUSSIAN_ATTEMPTS: u32 = 32u;

// Box-Muller, with rejection outside the disk. Attempt i draws at step i. After the last attempt, the point is put on
// the rim.
fn emit_collimated_gaussian(key: RayKey, e: Source) -> LocalRay {
    let z = vec3<real>(0.0, 0.0, 1.0);
    for (var attempt = 0u; attempt < GAUSSIAN_ATTEMPTS; attempt++) {
        let radius = e.p1 * sqrt(-2.0 * log_uniform(draw(key, SOURCE_U1, attempt)));
        if radius <= e.p0 {
            let turn = sincos_turns(draw(key, SOURCE_U2, attempt));
            let r = accepted_radius(radius, e);
            return LocalRay(vec3<real>(r * turn.x, r * turn.y, 0.0), z);
        }
    }
    let turn = sincos_turns(draw(key, SOURCE_U2, GAUSSIAN_ATTEMPTS));
    return LocalRay(vec3<real>(e.p0 * turn.x, e.p0 * turn.y, 0.0), z);
}
