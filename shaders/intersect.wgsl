// Stage intersect: the nearest primitive ahead. `nearest_primitive` is composed for the scene: surfaces in list order,
// then sensors, each nearer only if strictly so, which settles every tie as Optiland does.

fn intersect(ray: Ray) -> Hit {
    return nearest_primitive(ray, Hit(MISS, NONE));
}
