// A lens' entrance pupil, filled uniformly. p0, p1 = semi-axes of the beam at z = 0 [mm]. p2, p3, p4 = vector of the
// chief ray. The rim of the pupil adds p5, p6 to that vector along x and y. Tables of aimed rays begin at p7.

fn emit_pupil(key: RayKey, e: Source) -> LocalRay {
    let pupil = disk_point(key, 1.0);
    let aimed = aimed_at(key, e, pupil);
    let start = vec3<real>(e.p0 * pupil.x, e.p1 * pupil.y, 0.0) + aimed.position;
    let vector = vec3<real>(e.p2 + e.p5 * pupil.x, e.p3 + e.p6 * pupil.y, e.p4) + aimed.direction;
    return LocalRay(start, vector / sqrt(dot(vector, vector)));
}
