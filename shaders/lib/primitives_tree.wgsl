// Primitives of the table by a tree of boxes (program::tree). It finds what every primitive in turn would find: `nearer`
// settles ties by the list, whatever the order of the visits. The last rows are primitives, one each: those of the tree
// in its order, then those that have no box. A few detectors stand apart (`nearest_apart` is composed).

fn nearest_primitive(ray: Ray, start: Hit) -> Hit {
    let here = standing(ray);
    var best = nearest_apart(ray, start);
    for (var row = FIRST_BOUNDLESS; row < TREE_ROWS; row++) {
        best = try_in_any_order(best, ray, here, tree_row(row).x);
    }
    let position = vec3<f32>(ray.position);
    let size = max(max(abs(position.x), abs(position.y)), abs(position.z));
    let boxes = box_ray(position, vec3<f32>(ray.direction), TREE_SLACK * size);
    var walk = walk_from(TREE_ROOT);
    // Loops rather than branches: wide machines run all of a branch, and no more of a loop than some ray needs. Every
    // node is visited at most once.
    for (var round = 0u; round < TREE_ROWS && walk.node != NONE; round++) {
        for (var level = 0u; level < TREE_ROWS && walk.node != NONE && walk.items == 0u; level++) {
            visit(&walk, boxes, 0.0, f32(best.distance));
        }
        for (var i = 0u; i < NODE_CHILDREN && walk.items != 0u; i++) {
            best = try_in_any_order(best, ray, here, tree_row(FIRST_PRIMITIVE + take_item(&walk)).x);
        }
    }
    return best;
}

// A mesh notes the triangle that it hits; what turns out to be no nearer than the best must not stay noted.
fn try_in_any_order(best: Hit, ray: Ray, here: Standing, i: u32) -> Hit {
    let triangle = noted_triangle();
    let hit = try_primitive(best, ray, here, i);
    if hit.primitive != i {
        note_triangle(triangle);
    }
    return hit;
}
