// Facets of meshes that are in contact (geometry/contact.on.wgsl). Facets touch in a plane of one mesh, on a flat face,
// on facets of another mesh, or where a source lies on a mesh. The host computes each facet's place in its group
// (program::layout::tables::FacetTable). Twin of facets.apart.wgsl.

@group(GROUP_SCENE) @binding(BINDING_FACETS) var<storage, read> facet_contacts: array<vec2<u32>>;

// Values of Contact.facets: for a primitive that is no mesh, and for a mesh without facets in contact.
const NO_MESH: u32 = 0xffffffffu;
const NO_FACETS: u32 = 0xfffffffeu;

// What a search of a mesh needs beside the MeshRay: the ray, where it stands, and what the mesh's facets share.
struct FacetSearch {
    here: Standing,
    ray: Ray,
    mesh: Contact,
    // The triangle noted for the best hit so far.
    before: u32,
}

var<private> facet_search: FacetSearch;

fn search_facets(ray: Ray, here: Standing, mesh: Contact) {
    facet_search = FacetSearch(here, ray, mesh, hit_triangle);
}

fn is_mesh(contact: Contact) -> bool {
    return contact.facets != NO_MESH;
}

// The contact of a facet, found by the first row of its triangle. Any other primitive has its own contact.
fn facet_contact(contact: Contact, triangle: u32) -> Contact {
    if contact.facets >= NO_FACETS {
        return contact;
    }
    let words = facet_contacts[contact.facets + triangle / TRIANGLE_ROWS];
    let flipped = (words.y >> 5u) & 1u;
    var facet = contact;
    facet.group = words.x;
    facet.layer = 1u << (words.y & 31u);
    facet.level = words.y >> 6u;
    facet.flipped = flipped;
    facet.below = select(contact.below, contact.above, flipped != 0u);
    facet.above = select(contact.above, contact.below, flipped != 0u);
    return facet;
}

fn contact_at(primitive: u32, triangle: u32) -> Contact {
    return facet_contact(contact_of(primitive), triangle);
}

fn arrived_on() -> u32 {
    return arrived_triangle;
}

fn facet_normal(triangle: u32) -> vec3<real> {
    return vec3<real>(mesh_row(triangle).w, mesh_row(triangle + 1u).w, mesh_row(triangle + 2u).w);
}

fn noted_normal(surface: Surface, position: vec3<real>) -> vec3<real> {
    if surface.mesh == 0u {
        return quadric_normal(surface, position);
    }
    return from_surface(surface, facet_normal(hit_triangle));
}

// Where the ray meets a facet, or MISS. A straight ray that leaves a plane never comes back to the plane. So of the
// facets in that plane, the ray meets only a facet that comes next where it stands.
fn facet_crossing(ray: MeshRay, triangle: u32) -> real {
    let contact = facet_contact(facet_search.mesh, triangle);
    if stands_on(facet_search.here, contact) {
        let facet = seen_triangle(ray, mesh_row(triangle).xyz, mesh_row(triangle + 1u).xyz, mesh_row(triangle + 2u).xyz);
        let touches = comes_next(facet_search.ray, facet_search.here, contact) && is_crossed(facet);
        return select(MISS, ray.start, touches);
    }
    let crossing = triangle_crossing(ray, triangle);
    if (contact.born != 0u) & (facet_search.ray.last == NONE) {
        let height = abs((crossing - ray.start) * dot(ray.direction, facet_normal(triangle)));
        if height <= BIRTH_TOLERANCE {
            return MISS;
        }
    }
    return select(MISS, crossing, (crossing > ray.start) & (triangle != ray.leaves));
}

// True if the ray meets a facet at t before the one found so far.
fn facet_comes_first(ray: MeshRay, triangle: u32, t: real, found: u32, nearest: real) -> bool {
    if (found != NONE) & (t < MISS) {
        let contact = facet_contact(facet_search.mesh, triangle);
        let rival = facet_contact(facet_search.mesh, found);
        let n = facet_normal(triangle);
        let gap = abs((t - nearest) * dot(ray.direction, n));
        if (contact.group != 0u) & (rival.group == contact.group) & (gap <= CONTACT_TOLERANCE) {
            let forward = select(goes_forward(ray.direction, n, contact), facet_search.ray.forward, t == ray.start);
            return precedes(contact, triangle, rival, found, forward, facet_search.ray.medium);
        }
    }
    return (t < nearest) & (t < MISS);
}

// How far a mesh is searched: a facet in contact with the best hit may lie beyond that hit and still come first.
fn farthest_from(best: Hit) -> real {
    return min(best.distance + TOLERANCES_BEYOND * CONTACT_TOLERANCE, MISS);
}

fn facets_beyond(nearest: real) -> real {
    return nearest + TOLERANCES_BEYOND * CONTACT_TOLERANCE;
}

// `nearer` for the facet that a search has noted.
fn nearer_facet(best: Hit, ray: Ray, primitive: u32, distance: real) -> Hit {
    if distance >= MISS {
        note_triangle(facet_search.before);
        return best;
    }
    let contact = facet_contact(facet_search.mesh, noted_triangle());
    let hit = first_of(best, facet_search.before, ray, distance, primitive, contact);
    if hit.primitive != primitive {
        note_triangle(facet_search.before);
    }
    return hit;
}
