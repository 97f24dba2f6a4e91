// Tries a primitive by its place in the tree's order, where the primitive itself is stored, four words a texel. Twin of
// geometry/placed.table.wgsl, whose words a processor's driver would read one by one, and lane by lane.

fn try_placed(best: Hit, ray: Ray, here: Standing, place: u32) -> Hit {
    let p = primitive_at(FIRST_PRIMITIVE + PRIMITIVE_ROWS * place);
    return try_in_any_order(best, ray, here, p.number, p);
}
