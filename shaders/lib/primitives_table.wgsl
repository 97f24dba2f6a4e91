// Every primitive in turn, from the table.

fn nearest_primitive(ray: Ray, start: Hit) -> Hit {
    let here = standing(ray);
    var best = start;
    for (var i = 0u; i < NUM_PRIMITIVES; i++) {
        best = try_primitive(best, ray, here, i);
    }
    return best;
}
