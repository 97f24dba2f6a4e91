// Tries one primitive of the table.

fn try_primitive(best: Hit, ray: Ray, here: Standing, i: u32, p: Primitive) -> Hit {
    let o = to_primitive(p, ray.position - vec3<real>(p.origin_x, p.origin_y, p.origin_z));
    let d = to_primitive(p, ray.direction);
    return nearer(best, shape_distance(p, o, d, ray.last == i, best.distance), i);
}
