// All is f32 in both tiers. A margin exceeds all rounding of boxes, ray and slabs. The host pads each box, or the ray
// brings a slack (program::geometry::tree, program::geometry::mesh).

const NODE_ROWS: u32 = 3u;
const NODE_CHILDREN: u32 = 4u;

// A ray as boxes see it. The slack [mm] widens every box: the face where the ray enters is compared with `entry_base`,
// the other face with `exit_base`.
struct BoxRay {
    entry_base: vec3<f32>,
    exit_base: vec3<f32>,
    inverse: vec3<f32>,
    // True along an axis where the ray runs towards lower coordinates, and so enters at the upper corner.
    reversed: vec3<bool>,
}

fn box_ray(base: vec3<f32>, direction: vec3<f32>, slack: f32) -> BoxRay {
    let inverse = box_inverse(direction);
    let reversed = inverse < vec3<f32>(0.0);
    let ahead = base + slack;
    let behind = base - slack;
    return BoxRay(select(ahead, behind, reversed), select(behind, ahead, reversed), inverse, reversed);
}

// 1 / d, finite: a component of d near zero is replaced by 1e-18, which turns the ray by less than boxes are padded.
fn box_inverse(d: vec3<f32>) -> vec3<f32> {
    return vec3<f32>(1.0) / select(d, vec3<f32>(1e-18), abs(d) < vec3<f32>(1e-18));
}

struct Walk {
    // The node to visit next, or NONE.
    node: u32,
    // The items whose boxes the ray enters, in the node visited last: a bit each, from `first_item` on.
    items: u32,
    first_item: u32,
    // Groups of siblings that wait, one a level. The group at the bottom is NONE, and ends the walk.
    num_waiting: u32,
    waiting: array<u32, TREE_DEPTH>,
}

fn walk_from(root: u32) -> Walk {
    var walk: Walk;
    walk.node = root;
    walk.waiting[0] = NONE;
    walk.num_waiting = 1u;
    return walk;
}

// Packs siblings that wait: the number of the first sibling, how many wait (2 bits), and which, nearest first (2 bits
// each).
fn group_of(first_node: u32, keys: vec4<u32>) -> u32 {
    let among = keys & vec4<u32>(3u);
    let count = select(0u, 1u, keys.y != NONE) + select(0u, 1u, keys.z != NONE) + select(0u, 1u, keys.w != NONE);
    return (first_node << 8u) | (count << 6u) | (among.w << 4u) | (among.z << 2u) | among.y;
}

fn nearest_of(group: u32) -> u32 {
    return select((group >> 8u) + (group & 3u), NONE, group == NONE);
}

fn without_nearest(group: u32) -> u32 {
    return (group & 0xFFFFFF00u) | ((group & 0xC0u) - 0x40u) | ((group & 0x3Fu) >> 2u);
}

fn is_empty(group: u32) -> bool {
    return (group & 0xC0u) == 0u;
}

fn bytes_of(word: u32) -> vec4<f32> {
    return vec4<f32>((vec4<u32>(word) >> vec4<u32>(0u, 8u, 16u, 24u)) & vec4<u32>(0xFFu));
}

// The larger, by component. The built-in max and min would first ask about NaN; a comparison with NaN is false anyway.
fn larger(a: vec4<f32>, b: vec4<f32>) -> vec4<f32> {
    return select(b, a, a > b);
}

fn smaller(a: vec4<f32>, b: vec4<f32>) -> vec4<f32> {
    return select(b, a, a < b);
}

// The keys in ascending order.
fn sorted(keys: vec4<u32>) -> vec4<u32> {
    let low = min(keys.xz, keys.yw);
    let high = max(keys.xz, keys.yw);
    let a = max(low.x, low.y);
    let b = min(high.x, high.y);
    return vec4<u32>(min(low.x, low.y), min(a, b), max(a, b), max(high.x, high.y));
}

// Finds the children whose boxes the ray enters between `start` and `end`. The walk goes on to the nearest inner child,
// and the other inner children wait. Where no inner child is entered, the walk goes on in the group that began to wait
// last.
//
// A waiting node may by then lie behind the nearest hit; only its children's boxes notice. Wide machines store by
// index, so keeping an entry distance with every group would cost more than it saves.
fn visit(walk: ptr<function, Walk>, ray: BoxRay, start: f32, end: f32) {
    let row = NODE_ROWS * (*walk).node;
    let grid = tree_row(row);
    let lower = tree_row(row + 1u);
    let upper = tree_row(row + 2u);
    let exponents = (vec3<u32>(grid.w) << vec3<u32>(23u, 15u, 7u)) & vec3<u32>(0x7F800000u);
    let cell = bitcast<vec3<f32>>(exponents) * ray.inverse;
    let origin = bitcast<vec3<f32>>(grid.xyz);
    let entry_side = (origin - ray.entry_base) * ray.inverse;
    let exit_side = (origin - ray.exit_base) * ray.inverse;
    let near = select(lower.xyz, upper.xyz, ray.reversed);
    let far = select(upper.xyz, lower.xyz, ray.reversed);
    let entry = larger(
        larger(bytes_of(near.x) * cell.x + entry_side.x, bytes_of(near.y) * cell.y + entry_side.y),
        larger(bytes_of(near.z) * cell.z + entry_side.z, vec4<f32>(start)),
    );
    let exit = smaller(
        smaller(bytes_of(far.x) * cell.x + exit_side.x, bytes_of(far.y) * cell.y + exit_side.y),
        smaller(bytes_of(far.z) * cell.z + exit_side.z, vec4<f32>(end)),
    );
    let places = vec4<u32>(0u, 1u, 2u, 3u);
    let is_hit = (entry <= exit) & (places < vec4<u32>(grid.w >> 28u));
    let is_inner = places < vec4<u32>((grid.w >> 24u) & 0xFu);

    let items = select(vec4<u32>(0u), vec4<u32>(1u, 2u, 4u, 8u), is_hit & !is_inner);
    (*walk).items = items.x | items.y | items.z | items.w;
    (*walk).first_item = upper.w;

    // Positive floats are in the order of their bits. The last two bits make room for the child's place.
    let distances = bitcast<vec4<u32>>(entry - vec4<f32>(start)) & vec4<u32>(0xFFFFFFFCu);
    let keys = sorted(select(vec4<u32>(NONE), distances | places, is_hit & is_inner));
    let descends = keys.x != NONE;
    let last = (*walk).num_waiting - 1u;
    let group = waiting_at(walk, last);
    let rest = select(without_nearest(group), group_of(lower.w, keys), descends);
    let place = select(last, last + 1u, descends);
    (*walk).node = select(nearest_of(group), lower.w + (keys.x & 3u), descends);
    wait_at(walk, place, rest);
    (*walk).num_waiting = place + select(1u, 0u, is_empty(rest));
}

// Visits nodes until the walk has found items, has nothing left to visit, or has made `most_visits` visits. Descending
// and trying items take turns, in loops of their own. Wide machines run every branch that a ray takes, but only as many
// iterations of a loop as a ray needs. Every node is visited at most once, so no loop makes more iterations than there
// are rows.
fn descend(walk: ptr<function, Walk>, ray: BoxRay, start: f32, end: f32, most_visits: u32) {
    var level = 0u;
    loop {
        if always_true() & is_descending(walk) {
            visit(walk, ray, start, end);
        }
        level += 1u;
        if level >= most_visits || !is_descending(walk) {
            break;
        }
    }
}

fn is_descending(walk: ptr<function, Walk>) -> bool {
    return ((*walk).node != NONE) & ((*walk).items == 0u);
}

fn is_over(walk: ptr<function, Walk>) -> bool {
    return ((*walk).node == NONE) & ((*walk).items == 0u);
}

// Takes the first of the items that are left.
fn take_item(walk: ptr<function, Walk>) -> u32 {
    let items = (*walk).items;
    (*walk).items = items & (items - 1u);
    return (*walk).first_item + firstTrailingBit(items);
}
