// Rays against axis-aligned boxes, in f32 in both tiers. The host pads boxes, or the ray its own slack, by more than
// all rounding: of boxes, ray and slabs.

// A ray as boxes see it. The slack [mm] widens every box: its lower corner is compared with `above`, its upper one with
// `below`.
struct BoxRay {
    above: vec3<f32>,
    below: vec3<f32>,
    inverse: vec3<f32>,
}

fn box_ray(base: vec3<f32>, direction: vec3<f32>, slack: f32) -> BoxRay {
    return BoxRay(base + slack, base - slack, box_inverse(direction));
}

// A component near zero is turned by less than a box is padded, so that no infinity occurs.
fn box_inverse(d: vec3<f32>) -> vec3<f32> {
    return vec3<f32>(1.0) / select(d, vec3<f32>(1e-18), abs(d) < vec3<f32>(1e-18));
}

const BOX_MISS: f32 = 3e38;

// Where the ray enters a box between `start` and `end`, or BOX_MISS.
fn box_entry(ray: BoxRay, lower: vec3<f32>, upper: vec3<f32>, start: f32, end: f32) -> f32 {
    let at_lower = (lower - ray.above) * ray.inverse;
    let at_upper = (upper - ray.below) * ray.inverse;
    let entries = min(at_lower, at_upper);
    let exits = max(at_lower, at_upper);
    let entry = max(max(entries.x, entries.y), max(entries.z, start));
    let exit = min(min(exits.x, exits.y), min(exits.z, end));
    return select(BOX_MISS, entry, entry <= exit);
}
