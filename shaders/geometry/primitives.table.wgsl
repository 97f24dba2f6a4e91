// Finds the nearest primitive by trying each one in the table, in turn.

fn nearest_primitive(ray: Ray, start: Hit) -> Hit {
    let here = standing(ray);
    var best = start;
    var i = 0u;
    loop {
        best = try_primitive(best, ray, here, i, primitive_of(i));
        i += 1u;
        if i >= NUM_PRIMITIVES {
            break;
        }
    }
    return best;
}
