// Contacts (program::geometry::contact): faces in one place form a group, and a ray meets each face at most once on its
// way through. Sides and media decide which face comes next, as in the limit of a vanishing gap. Distances among the
// faces decide nothing, because distances differ by rounding.
//
// Example: two plates of glass touch. A ray in the first plate first meets the face that bounds its own glass. Then, in
// the vacuum of the gap, the ray meets the face of the other plate. The order of the list has no effect.

// Roles of a face (program::geometry::contact::Role).
const ROLE_SURFACE: u32 = 0u;
const ROLE_ABSORBER: u32 = 1u;
const ROLE_DETECTOR: u32 = 2u;

// In Ray.below_it: the ray has arrived on a face from afar.
const ARRIVES: u32 = 0x80000000u;
const ALL_LAYERS: u32 = 0x7fffffffu;

// The highest level of a face in its group.
const LAST_LEVEL: u32 = 0xffffffu;

// How far a mesh is searched beyond what is in contact with it, in tolerances.
const TOLERANCES_BEYOND: real = 64.0;

// The group of the faces where the ray stands (0: no group), and the level of the face that the ray leaves.
struct Standing {
    group: u32,
    level: u32,
}

fn standing(ray: Ray) -> Standing {
    if ray.last == NONE {
        return Standing(0u, 0u);
    }
    let contact = contact_at(ray.last, arrived_on());
    return Standing(contact.group, contact.level);
}

fn stands_on(here: Standing, contact: Contact) -> bool {
    return (contact.group != 0u) & (here.group == contact.group);
}

// True if the ray was born within rounding of a shape. Such a ray leaves the shape, on the side to which it goes.
fn is_born_on(ray: Ray, o: vec3<real>, s: Quadric) -> bool {
    let slope = vec3<real>(s.radial * o.x, s.radial * o.y, s.axial * o.z + s.offset);
    let height = 0.5 * value_at(o, s);
    return (ray.last == NONE) & (height * height <= BIRTH_TOLERANCE * BIRTH_TOLERANCE * dot(slope, slope));
}

// True if a direction goes along the group's normal, at a face with the normal n.
fn goes_forward(d: vec3<real>, n: vec3<real>, contact: Contact) -> bool {
    return (dot(d, n) > 0.0) == (contact.flipped == 0u);
}

// Called before an event at this distance: a ray that has travelled arrives from afar.
fn leave_contact(ray: ptr<function, Ray>, distance: real) {
    if distance > 0.0 {
        (*ray).below_it = ARRIVES;
    }
}

// Called after an event on a face with the normal n, at which the ray arrived along `incoming`. Notes on which side of
// the face the ray now goes, and which layers of the group lie below it.
fn note_side(ray: ptr<function, Ray>, n: vec3<real>, incoming: vec3<real>) {
    let contact = contact_at((*ray).last, arrived_on());
    let came_forward = goes_forward(incoming, n, contact);
    let forward = goes_forward((*ray).direction, n, contact);
    let at_first = select(ALL_LAYERS, 0u, came_forward);
    let before = select((*ray).below_it, at_first, (*ray).below_it == ARRIVES);
    let passed = select(before & ~contact.layer, before | contact.layer, forward);
    (*ray).below_it = select(before, passed, forward == came_forward);
    (*ray).forward = forward;
}

// Called after a detector has let the ray pass.
fn note_passing(ray: ptr<function, Ray>, detector: Detector) {
    note_side(ray, detector_normal(detector), (*ray).direction);
}

fn detector_normal(detector: Detector) -> vec3<real> {
    return from_detector(detector, vec3<real>(0.0, 0.0, 1.0));
}

// The normal of a primitive at a position; for a mesh, the normal of the triangle noted last.
fn normal_of(primitive: u32, position: vec3<real>) -> vec3<real> {
    if primitive >= NUM_SURFACES {
        return detector_normal(detector_of(primitive - NUM_SURFACES));
    }
    return noted_normal(surface_of(primitive), position);
}

// The medium on this side of a face, for a ray that goes forward or back.
fn near_medium(contact: Contact, forward: bool) -> u32 {
    return select(contact.above, contact.below, forward);
}

fn far_medium(contact: Contact, forward: bool) -> u32 {
    return select(contact.below, contact.above, forward);
}

// True if a face of the group where the ray stands comes next: the face lies ahead, and nothing hides it.
//
// Faces of the level that the ray leaves may be hidden. An absorber or a detector there was met on arrival, or is
// hidden by what the ray has left. A refracting face is hidden if the ray is already in its far medium, and not in its
// near one. Such a face lies behind the ray: a second facet in the same place adds no matter.
fn comes_next(ray: Ray, here: Standing, contact: Contact) -> bool {
    let is_ahead = ((ray.below_it & contact.layer) == 0u) == ray.forward;
    let is_beyond = (near_medium(contact, ray.forward) != ray.medium) & (far_medium(contact, ray.forward) == ray.medium);
    let hides = (contact.role != ROLE_SURFACE) | ((contact.refracts != 0u) & is_beyond);
    return stands_on(here, contact) & is_ahead & !((contact.level == here.level) & hides);
}

// Of faces that a ray can meet in one place, the face with the lowest number comes first. The number orders faces first
// by level, then surfaces before detectors, then by whether the face bounds the ray's own medium. A face with that
// medium on both sides comes before a face by which the ray leaves the medium.
fn precedence(contact: Contact, forward: bool, medium: u32) -> u32 {
    let near = near_medium(contact, forward);
    let is_inner = (contact.refracts == 0u) | (far_medium(contact, forward) == near);
    let bounds = select(2u, select(1u, 0u, is_inner), near == medium);
    let level = select(LAST_LEVEL - contact.level, contact.level, forward);
    return (level << 3u) | select(0u, 4u, contact.role == ROLE_DETECTOR) | bounds;
}

// True if the ray meets the face `own` before the face `other` in the same place. The lower number comes first, and the
// list breaks ties. The list also decides where physics has no answer, as for an absorber in a mirror.
fn precedes(
    own: Contact, own_place: u32, other: Contact, other_place: u32, forward: bool, medium: u32,
) -> bool {
    let by_list = own_place < other_place;
    let an_absorber = (own.role == ROLE_ABSORBER) | (other.role == ROLE_ABSORBER);
    let no_detector = (own.role != ROLE_DETECTOR) & (other.role != ROLE_DETECTOR);
    let a = precedence(own, forward, medium);
    let b = precedence(other, forward, medium);
    let by_physics = (a < b) | ((a == b) & by_list);
    return select(by_physics, by_list, (own.level == other.level) & an_absorber & no_detector);
}

// `nearer` for a face of a group. `elsewhere` is the distance at which the ray meets the face away from where the ray
// stands. `holds` is true if the face extends to where the ray stands.
fn nearer_in_contact(
    best: Hit, ray: Ray, here: Standing, primitive: u32, contact: Contact, elsewhere: real, holds: bool,
) -> Hit {
    let distance = select(elsewhere, 0.0, comes_next(ray, here, contact) & holds);
    return first_of(best, noted_triangle(), ray, distance, primitive, contact);
}

// The hit that comes first: `best`, or this primitive at `distance`. `triangle` is the triangle noted for `best`.
fn first_of(best: Hit, triangle: u32, ray: Ray, distance: real, primitive: u32, contact: Contact) -> Hit {
    if distance >= MISS {
        return best;
    }
    if (best.primitive != NONE) & (contact.group != 0u) {
        let rival = contact_at(best.primitive, triangle);
        let n = normal_of(primitive, ray.position + distance * ray.direction);
        let gap = abs((distance - best.distance) * dot(ray.direction, n));
        if (rival.group == contact.group) & (gap <= CONTACT_TOLERANCE) {
            let forward = select(goes_forward(ray.direction, n, contact), ray.forward, distance == 0.0);
            let comes_first = precedes(contact, primitive, rival, best.primitive, forward, ray.medium);
            return Hit(select(best.distance, distance, comes_first), select(best.primitive, primitive, comes_first));
        }
    }
    return nearer(best, distance, primitive);
}
