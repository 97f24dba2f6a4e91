// Faces in contact (program::contact): coincident faces form a group, ranked along the normal of its first face. A ray
// crosses them by rank, forward from the lowest, backward from the highest: the limit of a vanishing gap. Distances
// among them decide nothing, because they differ by rounding.

// True if a direction goes along the group's normal, at a face with the normal n.
fn goes_forward(d: vec3<real>, n: vec3<real>, contact: Contact) -> bool {
    return (dot(d, n) > 0.0) == (contact.flipped == 0u);
}

// After an event on a face with this normal.
fn note_side(ray: ptr<function, Ray>, n: vec3<real>) {
    (*ray).forward = goes_forward((*ray).direction, n, contact_of((*ray).last));
}

alias Standing = Contact;

// The group that the ray stands on, and its rank there.
fn standing(ray: Ray) -> Standing {
    if ray.last < NUM_SURFACES {
        return contact_of(ray.last);
    }
    return Contact(0u, 0u, 0u);
}

fn stands_on(here: Standing, contact: Contact) -> bool {
    return (contact.group != 0u) & (here.group == contact.group);
}

// `nearer` for a face of a group. `elsewhere` is the distance to where the ray meets the face away from where it stands;
// `holds` tells that the face reaches to where it stands.
fn nearer_in_contact(best: Hit, ray: Ray, here: Standing, primitive: u32, elsewhere: real, holds: bool) -> Hit {
    let contact = contact_of(primitive);
    let is_next = ray.forward == (contact.rank > here.rank);
    let touches = stands_on(here, contact) & (ray.last != primitive) & is_next & holds;
    let distance = select(elsewhere, 0.0, touches);
    if distance >= MISS {
        return best;
    }
    if best.primitive < NUM_SURFACES {
        let rival = contact_of(best.primitive);
        let n = geometric_normal(surface_of(primitive), ray.position + distance * ray.direction);
        let gap = abs((distance - best.distance) * dot(ray.direction, n));
        if (rival.group == contact.group) & (gap <= CONTACT_TOLERANCE) {
            let comes_first = goes_forward(ray.direction, n, contact) == (contact.rank < rival.rank);
            return Hit(select(best.distance, distance, comes_first), select(best.primitive, primitive, comes_first));
        }
    }
    return nearer(best, distance, primitive);
}
