// Stage intersect: the nearest primitive ahead. `nearest_primitive` is composed for the scene: surfaces in list order,
// then detectors. A primitive replaces the best so far only if it is strictly nearer, so ties end as in Optiland.

fn plain_intersect(ray: Ray) -> Hit {
    let hit = nearest_primitive(ray, Hit(MISS, NONE));
    keep_triangle();
    return hit;
}
