// A primitive by its place among the rows of the tree: it stands there, four words a texel, where a processor's driver would
// read the words of a table one by one, and lane by lane. Twin of placed_table.wgsl.

fn try_placed(best: Hit, ray: Ray, here: Standing, place: u32) -> Hit {
    let p = primitive_at(FIRST_PRIMITIVE + PRIMITIVE_ROWS * place);
    return try_in_any_order(best, ray, here, p.number, p);
}
