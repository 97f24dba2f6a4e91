// Tries a primitive by its place in the tree's order: the rows give its number, and the table gives the primitive. Twin
// of cpu/placed.texels.wgsl.

fn try_placed(best: Hit, ray: Ray, here: Standing, place: u32) -> Hit {
    let i = tree_row(FIRST_PRIMITIVE + PRIMITIVE_ROWS * place).x;
    return try_in_any_order(best, ray, here, i, primitive_of(i));
}
