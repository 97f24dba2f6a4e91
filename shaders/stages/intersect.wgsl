// Stage intersect: the nearest primitive ahead. `nearest_primitive` is composed for the scene: surfaces in list order,
// then detectors, each nearer only if strictly so, which settles every tie as Optiland does.

fn intersect(ray: Ray) -> Hit {
    let hit = nearest_primitive(ray, Hit(MISS, NONE));
    keep_triangle();
    return hit;
}
