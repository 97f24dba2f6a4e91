// The rows after the nodes are primitives: first those in the tree, in its order, then those without a box.
// `try_placed` in placed.*.wgsl tries them. A few detectors are tried outside the tree (`nearest_apart`, which is
// composed).

// Visits in a turn, before items are tried. Short turns help a ray that soon finds a primitive: the ray need not wait
// until all others of its vector have found one. Scattered rays on spheres gain a tenth, and lenses nothing. Meshes
// would lose, because most visits there lead to no triangle.
const MOST_VISITS: u32 = 4u;

fn nearest_primitive(ray: Ray, start: Hit) -> Hit {
    let here = standing(ray);
    var best = nearest_apart(ray, start);
    if BOXED_PRIMITIVES < TREE_PRIMITIVES {
        var place = BOXED_PRIMITIVES;
        loop {
            best = try_placed(best, ray, here, place);
            place += 1u;
            if place >= TREE_PRIMITIVES {
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
        descend(&walk, boxes, 0.0, f32(best.distance), MOST_VISITS);
        if always_true() & (walk.items != 0u) {
            best = try_placed(best, ray, here, take_item(&walk));
        }
        round += 1u;
        if round >= TREE_ROWS || is_over(&walk) {
            break;
        }
    }
    return best;
}

// Tries a primitive. A mesh notes the triangle that it hits; the note is taken back if the hit is no nearer than the
// best.
fn try_in_any_order(best: Hit, ray: Ray, here: Standing, i: u32, p: Primitive) -> Hit {
    let triangle = noted_triangle();
    let hit = try_primitive(best, ray, here, i, p);
    if hit.primitive != i {
        note_triangle(triangle);
    }
    return hit;
}
