// Tries one primitive of the table, where some primitives are in contact, facets of meshes among them.

fn try_primitive(best: Hit, ray: Ray, here: Standing, i: u32, p: Primitive) -> Hit {
    let o = to_primitive(p, ray.position - vec3<real>(p.origin_x, p.origin_y, p.origin_z));
    let d = to_primitive(p, ray.direction);
    let contact = contact_of(i);
    if is_mesh(contact) {
        search_facets(ray, here, contact);
        let distance = shape_distance(p, o, d, ray.last == i, farthest_from(best));
        return nearer_facet(best, ray, i, distance);
    }
    let leaving = (ray.last == i) | ((contact.born != 0u) & is_born_on(ray, o, shape_quadric(p, o)));
    if contact.group != 0u {
        let elsewhere = shape_distance(p, o, d, leaving | stands_on(here, contact), best.distance);
        return nearer_in_contact(best, ray, here, i, contact, elsewhere, shape_holds(p, o));
    }
    return nearer(best, shape_distance(p, o, d, leaving, best.distance), i);
}
