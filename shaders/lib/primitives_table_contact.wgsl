// Every primitive in turn, from the table; some faces are in contact.

fn nearest_primitive(ray: Ray, start: Hit) -> Hit {
    let here = standing(ray);
    var best = start;
    for (var i = 0u; i < NUM_PRIMITIVES; i++) {
        let p = primitive_of(i);
        let o = to_primitive(p, ray.position - vec3<real>(p.origin_x, p.origin_y, p.origin_z));
        let d = to_primitive(p, ray.direction);
        let leaving = ray.last == i;
        if i < NUM_SURFACES && contact_of(i).group != 0u {
            let elsewhere = shape_distance(p, o, d, leaving || stands_on(here, contact_of(i)), best.distance);
            best = nearer_in_contact(best, ray, here, i, elsewhere, shape_holds(p, o));
        } else {
            best = nearer(best, shape_distance(p, o, d, leaving, best.distance), i);
        }
    }
    return best;
}
