// A primitive by its place among the rows of the tree, where it stands itself, four words a texel. Twin of
// geometry/placed.table.wgsl, whose words a processor's driver would read one by one, and lane by lane.

fn try_placed(best: Hit, ray: Ray, here: Standing, place: u32) -> Hit {
    let p = primitive_at(FIRST_PRIMITIVE + PRIMITIVE_ROWS * place);
    return try_in_any_order(best, ray, here, p.number, p);
}
