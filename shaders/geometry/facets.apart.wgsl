// Meshes whose facets are not in contact. Twin of facets.touching.wgsl.

fn facet_crossing(ray: MeshRay, triangle: u32) -> real {
    let crossing = triangle_crossing(ray, triangle);
    return select(MISS, crossing, (crossing > ray.start) & (triangle != ray.leaves));
}

fn facet_comes_first(ray: MeshRay, triangle: u32, t: real, found: u32, nearest: real) -> bool {
    return t < nearest;
}

fn facets_beyond(nearest: real) -> real {
    return nearest;
}
