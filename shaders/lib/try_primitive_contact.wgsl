// One primitive of the table; some faces are in contact.

fn try_primitive(best: Hit, ray: Ray, here: Standing, i: u32, p: Primitive) -> Hit {
    let o = to_primitive(p, ray.position - vec3<real>(p.origin_x, p.origin_y, p.origin_z));
    let d = to_primitive(p, ray.direction);
    let leaving = ray.last == i;
    if i < NUM_SURFACES && contact_of(i).group != 0u {
        let elsewhere = shape_distance(p, o, d, leaving || stands_on(here, contact_of(i)), best.distance);
        return nearer_in_contact(best, ray, here, i, elsewhere, shape_holds(p, o));
    }
    return nearer(best, shape_distance(p, o, d, leaving, best.distance), i);
}
