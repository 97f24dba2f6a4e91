// Every primitive in turn, from the table.

fn nearest_primitive(ray: Ray, start: Hit) -> Hit {
    var best = start;
    for (var i = 0u; i < NUM_PRIMITIVES; i++) {
        let p = primitive_of(i);
        let o = to_primitive(p, ray.position - vec3<real>(p.origin_x, p.origin_y, p.origin_z));
        let d = to_primitive(p, ray.direction);
        best = nearer(best, shape_distance(p, o, d, ray.last == i, best.distance), i);
    }
    return best;
}
