// A lamp, whose directions follow a table of intensities. Rays are born on a rectangle of the width p0 and the height
// p1, or on a disk of the radius p2 [mm]. All three are 0 for a point. The table begins at p3.
//
// The inverse of the distribution is exact (optics/polar_table.wgsl), so all rays weigh the same.

fn emit_tabulated(key: RayKey, e: Source) -> LocalRay {
    let polar = uniform_of(draw_first(key, SOURCE_U3));
    let direction = drawn_from_polar_table(u32(e.p3), polar, uniform_of(draw_first(key, SOURCE_U4)));
    if e.p2 > 0.0 {
        return LocalRay(disk_point(key, e.p2), direction);
    }
    let x = (uniform_of(draw_first(key, SOURCE_U1)) - 0.5) * e.p0;
    let y = (uniform_of(draw_first(key, SOURCE_U2)) - 0.5) * e.p1;
    return LocalRay(vec3<real>(x, y, 0.0), direction);
}
