// Primitives of the table by a tree of boxes (program::tree), walked front to back. It finds what every primitive in
// turn would find: `nearer` settles ties by the list, whatever the order of the visits.
//
// Two siblings have four rows: (lower corner, link) and (upper corner, 0) of either. A link is 1 + the first row of the
// two boxes within, or -1 - the primitive within; 0 ends the walk. After them stand the primitives that have no box.
// A few detectors stand apart (`nearest_apart` is composed).

struct Walk {
    // The next to visit.
    link: f32,
    num_waiting: u32,
    waiting: array<f32, TREE_DEPTH>,
}

fn nearest_primitive(ray: Ray, start: Hit) -> Hit {
    let here = standing(ray);
    var best = nearest_apart(ray, start);
    for (var row = FIRST_BOUNDLESS; row < TREE_ROWS; row++) {
        best = try_in_any_order(best, ray, here, u32(tree_rows[row].x));
    }
    let position = vec3<f32>(ray.position);
    let size = max(max(abs(position.x), abs(position.y)), abs(position.z));
    let boxes = box_ray(position, vec3<f32>(ray.direction), TREE_SLACK * size);
    var walk: Walk;
    walk.link = TREE_ROOT;
    walk.num_waiting = 1u;
    walk.waiting[0] = 0.0;
    // Loops rather than branches: wide machines run all of a branch, and no more of a loop than some ray needs. Every
    // box and every primitive is visited at most once.
    for (var round = 0u; round <= NUM_PRIMITIVES && walk.link != 0.0; round++) {
        for (var level = 0u; level < TREE_ROWS && walk.link > 0.0; level++) {
            descend(&walk, boxes, f32(best.distance));
        }
        for (var leaf = 0u; leaf < NUM_PRIMITIVES && walk.link < 0.0; leaf++) {
            best = try_in_any_order(best, ray, here, u32(-walk.link) - 1u);
            take_waiting(&walk);
        }
    }
    return best;
}

// To the nearer of the two boxes within; the other waits.
fn descend(walk: ptr<function, Walk>, boxes: BoxRay, end: f32) {
    let row = u32((*walk).link) - 1u;
    let first = tree_rows[row];
    let second = tree_rows[row + 2u];
    let first_entry = box_entry(boxes, first.xyz, tree_rows[row + 1u].xyz, 0.0, end);
    let second_entry = box_entry(boxes, second.xyz, tree_rows[row + 3u].xyz, 0.0, end);
    let in_order = first_entry <= second_entry;
    (*walk).link = select(second.w, first.w, in_order);
    if max(first_entry, second_entry) < BOX_MISS {
        (*walk).waiting[(*walk).num_waiting] = select(first.w, second.w, in_order);
        (*walk).num_waiting += 1u;
    }
    if min(first_entry, second_entry) >= BOX_MISS {
        take_waiting(walk);
    }
}

// Whether it has fallen behind the nearest hit is left to its own boxes: an entry would have to wait with every link.
fn take_waiting(walk: ptr<function, Walk>) {
    (*walk).num_waiting -= 1u;
    (*walk).link = (*walk).waiting[(*walk).num_waiting];
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
