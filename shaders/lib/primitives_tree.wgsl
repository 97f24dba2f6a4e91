// Primitives of the table by a tree of boxes (program::tree). It finds what every primitive in turn would find: `nearer`
// settles ties by the list, whatever the order of the visits. The last rows are primitives, one each: those of the tree
// in its order, then those that have no box. A few detectors stand apart (`nearest_apart` is composed).

fn nearest_primitive(ray: Ray, start: Hit) -> Hit {
    let here = standing(ray);
    var best = nearest_apart(ray, start);
    if FIRST_BOUNDLESS < TREE_ROWS {
        var row = FIRST_BOUNDLESS;
        loop {
            best = try_in_any_order(best, ray, here, tree_row(row).x);
            row += 1u;
            if row >= TREE_ROWS {
                break;
            }
        }
    }
    let position = vec3<f32>(ray.position);
    let size = max(max(abs(position.x), abs(position.y)), abs(position.z));
    let boxes = box_ray(position, vec3<f32>(ray.direction), TREE_SLACK * size);
    var walk = walk_from(TREE_ROOT);
    var round = 0u;
    loop {
        descend(&walk, boxes, 0.0, f32(best.distance));
        var i = 0u;
        loop {
            if is_dispatched() & (walk.items != 0u) {
                best = try_in_any_order(best, ray, here, tree_row(FIRST_PRIMITIVE + take_item(&walk)).x);
            }
            i += 1u;
            if i >= NODE_CHILDREN || walk.items == 0u {
                break;
            }
        }
        round += 1u;
        if round >= TREE_ROWS || walk.node == NONE {
            break;
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
