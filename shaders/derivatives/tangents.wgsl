// Forward derivatives: tangents go beside reals, and to sums of their own (program::rewrite::jvp). Twin of adjoints.wgsl.

// Adds a tangent to a copy of the detectors' cells. A parameter has two: one for tangents above zero, and one for those below.
// So a tangent takes one atomic, as a weight does. A tangent that no sum can hold is counted, and nothing is added.
fn deposit_tangent(cell: u32, tangent: real, number: u32) {
    let copy = 2u * number + select(1u, 2u, tangent < 0.0);
    let at = cell + copy * REPLICATE_STRIDE;
    let size = abs(tangent);
    if !(is_depositable(size) & (size < LARGEST_TANGENT)) {
        count(at);
        return;
    }
    let q = quantize(size);
    if !q_is_zero(q) {
        deposit(at, q);
    }
}

// The distance to the next hit is found by the plain search. The distance has the derivative of one Newton step, whose
// value is zero.
fn intersect(ray: Ray) -> Hit {
    let hit = plain_intersect(ray);
    return Hit(attached(hit.distance, hit.distance - crossing_step(ray, hit)), hit.primitive);
}
