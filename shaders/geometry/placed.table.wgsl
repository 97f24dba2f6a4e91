// A primitive by its place among the rows of the tree, which give its number: the primitive stands in a table. Twin of
// software/placed.texels.wgsl.

fn try_placed(best: Hit, ray: Ray, here: Standing, place: u32) -> Hit {
    let i = tree_row(FIRST_PRIMITIVE + PRIMITIVE_ROWS * place).x;
    return try_in_any_order(best, ray, here, i, primitive_of(i));
}
