// No facet of a mesh is in contact. Only whole primitives are. Twin of the same functions in facets.touching.wgsl.

fn contact_at(primitive: u32, triangle: u32) -> Contact {
    return contact_of(primitive);
}

fn arrived_on() -> u32 {
    return 0u;
}

fn noted_normal(surface: Surface, position: vec3<real>) -> vec3<real> {
    return quadric_normal(surface, position);
}
