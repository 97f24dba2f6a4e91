// Triangle mesh: a tree of boxes over triangles (geometry/boxes.wgsl).
//
// A ray through an edge or a vertex hits at least one of the triangles around it. Every vertex is projected along the
// ray on its own, so both triangles of an edge compute the same number for its sign. Source: Woop, Benthin and Wald,
// Watertight Ray/Triangle Intersection, JCGT 2013.
//
// The projection here is onto an orthonormal basis around the ray, not a shear along the largest axis. The basis saves
// selecting components by index. Source: Duff et al., Building an Orthonormal Basis, Revisited, JCGT 2017.

// A triangle has three rows (`mesh_row`), each a corner and a component of the normal. Seen from where the normal
// points, the corners run counter-clockwise. Triangles are stored in the order of the trees.
const TRIANGLE_ROWS: u32 = 3u;

// The triangle of the nearest hit so far, and the triangle on which the ray has arrived, each by its first row. A
// triangle counts only where the surface that is hit, or left, is a mesh. Ray and Hit do not hold triangles, because
// scenes without meshes share those structs.
var<private> hit_triangle: u32 = 0u;
var<private> arrived_triangle: u32 = 0u;

fn keep_triangle() {
    arrived_triangle = hit_triangle;
}

fn noted_triangle() -> u32 {
    return hit_triangle;
}

fn note_triangle(triangle: u32) {
    hit_triangle = triangle;
}

fn geometric_normal(surface: Surface, position: vec3<real>) -> vec3<real> {
    if surface.mesh == 0u {
        return quadric_normal(surface, position);
    }
    let row = arrived_triangle;
    return from_surface(surface, vec3<real>(mesh_row(row).w, mesh_row(row + 1u).w, mesh_row(row + 2u).w));
}

// A ray in the mesh's frame. Distances count from `base`, the ray's point of closest approach to the frame's origin, as
// in `crossings`. Coordinates there are of the mesh's size. The ray begins at the distance `start`.
struct MeshRay {
    base: vec3<real>,
    direction: vec3<real>,
    across_x: vec3<real>,
    across_y: vec3<real>,
    start: real,
    // The triangle that the ray leaves.
    leaves: u32,
    boxes: BoxRay,
}

fn mesh_ray(o: vec3<real>, d: vec3<real>, leaving: bool) -> MeshRay {
    let shift = select(-dot(o, d), 0.0, leaving);
    let base = o + shift * d;
    let side = choose(-1.0, 1.0, d.z >= 0.0);
    let a = -1.0 / (side + d.z);
    let b = d.x * d.y * a;
    return MeshRay(
        base, d,
        vec3<real>(1.0 + side * d.x * d.x * a, side * b, -side * d.x),
        vec3<real>(b, side + d.y * d.y * a, -d.y),
        -shift, select(NONE, arrived_triangle, leaving),
        box_ray(vec3<f32>(base), vec3<f32>(d), 0.0),
    );
}

// A corner as the ray sees it: two coordinates across the ray, and one along it.
fn seen(ray: MeshRay, corner: vec3<real>) -> vec3<real> {
    let v = corner - ray.base;
    return vec3<real>(dot(ray.across_x, v), dot(ray.across_y, v), dot(ray.direction, v));
}

// Twice the area between the ray and an edge. The two triangles of an edge must get opposite numbers. A compiler may
// fuse one of the products with the subtraction, so the ends are put in order first.
fn edge(p: vec3<real>, q: vec3<real>) -> real {
    let swapped = p.x > q.x || (p.x == q.x && p.y > q.y);
    let a = select(p, q, swapped);
    let b = select(q, p, swapped);
    let area = a.x * b.y - a.y * b.x;
    return select(area, -area, swapped);
}

// A triangle as the ray sees it: its corners, and opposite each corner twice the area between the ray and the edge.
struct SeenTriangle {
    a: vec3<real>,
    b: vec3<real>,
    c: vec3<real>,
    u: real,
    v: real,
    w: real,
}

fn seen_triangle(ray: MeshRay, a: vec3<real>, b: vec3<real>, c: vec3<real>) -> SeenTriangle {
    let p = seen(ray, a);
    let q = seen(ray, b);
    let r = seen(ray, c);
    return SeenTriangle(p, q, r, edge(q, r), edge(r, p), edge(p, q));
}

// True if the ray's line crosses the triangle. Edges belong to the triangle.
fn is_crossed(s: SeenTriangle) -> bool {
    let outside = min(s.u, min(s.v, s.w)) < 0.0 && max(s.u, max(s.v, s.w)) > 0.0;
    return !outside && s.u + s.v + s.w != 0.0;
}

// The distance to the nearest hit, or MISS. `root` is the root of the mesh's tree. Only hits nearer than `farthest`
// count. Under a tree over primitives, a tie counts as well, and `nearer` settles it.
fn mesh_distance(o: vec3<real>, d: vec3<real>, root: real, leaving: bool, farthest: real) -> real {
    let ray = mesh_ray(o, d, leaving);
    leave_facet(ray, leaving);
    // A bound that the rounding of this sum does not reach.
    var nearest = farthest + ray.start + 1e-6 * (farthest + abs(ray.start));
    var found = NONE;
    var walk = walk_from(u32(root));
    var round = 0u;
    loop {
        descend(&walk, ray.boxes, f32(ray.start), f32(facets_beyond(nearest)), TREE_ROWS);
        var i = 0u;
        loop {
            if always_true() & (walk.items != 0u) {
                let triangle = TRIANGLE_ROWS * take_item(&walk);
                let t = facet_crossing(ray, triangle);
                if facet_comes_first(ray, triangle, t, found, nearest) {
                    nearest = t;
                    found = triangle;
                }
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
    let distance = nearest - ray.start;
    let is_behind = distance > farthest || (!HAS_TREE && distance == farthest);
    let touches = FACETS_TOUCH && nearest == ray.start;
    if found == NONE || (distance <= 0.0 && !touches) || is_behind {
        return MISS;
    }
    hit_triangle = found;
    return distance;
}

// No point belongs to a mesh here: only its facets can be in contact.
fn mesh_holds(p: vec3<real>, root: real) -> bool {
    return false;
}
