// The state of a ray, and what the stages hand to each other.
// Positions [mm] and directions are in the frame that the host re-centred on the scene.

// "No surface": nothing was hit, or the ray has not left any surface yet.
const NONE: u32 = 0xffffffffu;
// A distance that no hit has [mm]; finite in both tiers, because WGSL may assume that infinities do not occur.
const MISS: real = 1e38;

// How a ray ended; ALIVE while it has not.
const ALIVE: u32 = 0u;
const DETECTED: u32 = 1u;
const ABSORBED: u32 = 2u;
const ESCAPED: u32 = 3u;
const DEPTH_KILLED: u32 = 4u;
const ROULETTE_KILLED: u32 = 5u;

struct Ray {
    position: vec3<real>,
    direction: vec3<real>,
    weight: real,
    key: RayKey,
    // The draws that every event may need, at the step of its bounce count: moving a stream on by one step costs less
    // than jumping to it from the key.
    fresnel: Stream,
    roulette: Stream,
    // Position in the dispatch's range of ray ids, or in the list of them.
    index: u32,
    bounce: u32,
    // The primitive that the ray leaves; surfaces first, then detectors.
    last: u32,
    wavelength: u32,
    medium: u32,
    // True if the ray entered a solid after it was last in vacuum. Optiland's medium stack is empty exactly when this
    // is false: a pop never empties it (depth 1 has only vacuum below, and entering vacuum clears the whole stack).
    entered_solid: bool,
    // The side of the face `last` to which the ray left it, and which faces in its place lie below it, a bit a layer
    // (geometry/contact.on.wgsl).
    forward: bool,
    below_it: u32,
    fate: u32,
}

struct Hit {
    distance: real,
    primitive: u32,
}

// Where a decision costs little, `&`, `|` and select stand for `&&`, `||` and `if`: wide machines run both sides of a
// branch anyway, and pay for the branch on top.
//
// Loops ask at both ends of a round whether to go on. lavapipe makes the first round in any case, and looks at its end
// whether some lane wants another. So a loop that asks only before its rounds makes one of them for nothing; where rays end
// at their first surface, that is every other event. A loop that asks only after them goes wrong there (Mesa 22.3): it
// computes on for lanes that have left it, and reads zeros from memory for them. The outcome of a branch stays theirs: so
// whatever is used after a loop and may differ between lanes changes within a branch alone, and `is_dispatched` keeps Mesa
// from seeing that whoever comes again takes it. Where all lanes make the same rounds, to ask after them is enough, and
// where rounds are short, before them.

// The nearer of two hits; the earlier in the list wins a tie. In turn, it is the one that was met first; from a tree,
// it may come later.
fn nearer(best: Hit, distance: real, primitive: u32) -> Hit {
    let tied = HAS_TREE & (distance == best.distance) & (distance < MISS) & (primitive < best.primitive);
    let closer = (distance < best.distance) | tied;
    return Hit(select(best.distance, distance, closer), select(best.primitive, primitive, closer));
}

// What one dispatch traces: rays first..first+count of one source, or so many that are listed (software/path/ids.listed.wgsl).
struct Range {
    first_lo: u32,
    first_hi: u32,
    count: u32,
    source: u32,
    // The seed's words in the row of step 0 (program::layout::rng::step_table).
    seed_lo: u32,
    seed_hi: u32,
    // From an entry of a ray in the log to its next (software/log/passes.logged.wgsl).
    log_stride: u32,
    // The primitives that earlier passes reached, a bit each (sums/reached.bits.wgsl).
    reached: u32,
}

// Uniform, because every invocation reads the same values. Every entry point copies it before its first branch (`begin`):
// behind one, lavapipe reads even these lane by lane.
@group(GROUP_SCENE) @binding(BINDING_RANGE) var<uniform> range_uniform: Range;

var<private> range: Range;

// Always true, which compilers do not see. Nothing has NO_COUNT rays: a number that differs with the width of the driver's
// vectors, because a driver may keep compiled shaders and not know for which width they were (Mesa 22.3).
fn is_dispatched() -> bool {
    return range.count != NO_COUNT;
}

// The row of rng_table for step 0.
fn first_jump() -> vec4<u32> {
    return vec4<u32>(range.seed_lo, range.seed_hi, FIRST_STEP);
}

// The 32 bits of (ray, slot, 0).
fn draw_first(key: RayKey, slot: u32) -> u32 {
    return stream_bits(stream_at(key, slot, first_jump()));
}

// The key of a ray of the range.
fn key_in_range(index: u32) -> RayKey {
    let lo = range.first_lo + index;
    return key_of_id(lo, range.first_hi + select(0u, 1u, lo < range.first_lo));
}

// One Newton step towards unit length, for a vector whose length is 1 to rounding.
fn renormalize(v: vec3<real>) -> vec3<real> {
    return v * (1.5 - 0.5 * dot(v, v));
}
