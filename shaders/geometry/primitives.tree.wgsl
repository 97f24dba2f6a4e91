// Primitives of the table by a tree of boxes (program::tree). It finds what every primitive in turn would find: `nearer`
// settles ties by the list, whatever the order of the visits. The last rows are primitives: those of the tree in its order,
// then those that have no box (`try_placed`, in placed.*.wgsl). A few detectors stand apart (`nearest_apart` is composed).

// Turns are short: a ray that has found a primitive soon does not wait until all others of its vector have. Scattered rays
// on spheres gain a tenth, lenses nothing, and meshes, where most visits lead to no triangle, would lose.
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
        if is_dispatched() & (walk.items != 0u) {
            best = try_placed(best, ray, here, take_item(&walk));
        }
        round += 1u;
        if round >= TREE_ROWS || is_over(&walk) {
            break;
        }
    }
    return best;
}

// A mesh notes the triangle that it hits; what turns out to be no nearer than the best must not stay noted.
fn try_in_any_order(best: Hit, ray: Ray, here: Standing, i: u32, p: Primitive) -> Hit {
    let triangle = noted_triangle();
    let hit = try_primitive(best, ray, here, i, p);
    if hit.primitive != i {
        note_triangle(triangle);
    }
    return hit;
}
