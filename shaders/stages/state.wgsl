// The state of a ray, and the data that stages hand to each other. Positions [mm] and directions are in the scene's
// frame, which the host re-centred.

// "No surface": nothing was hit, or the ray has not left any surface yet.
const NONE: u32 = 0xffffffffu;
// A distance that no hit has [mm]. MISS is finite in both tiers, because WGSL may assume that infinities do not occur.
const MISS: real = 1e38;

// How a ray ended (ALIVE: it has not).
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
    // The streams of the draws that every event may need, at the step of the bounce count. Moving a stream on by one
    // step costs less than jumping there from the key.
    fresnel: Stream,
    roulette: Stream,
    // Position in the dispatch's range of ray ids, or in the list of them.
    index: u32,
    bounce: u32,
    // The primitive that the ray leaves, or NONE. Surfaces come first, then detectors.
    last: u32,
    wavelength: u32,
    medium: u32,
    // True if the ray entered a solid after it was last in vacuum. Where this is false, Optiland's medium stack is
    // empty, and only there. A pop never empties that stack: depth 1 has only vacuum below, and entering vacuum clears
    // the whole stack.
    entered_solid: bool,
    // `forward`: the side of the face `last` to which the ray left it. `below_it`: which faces in the same place lie
    // below the ray, a bit a layer (geometry/contact.on.wgsl).
    forward: bool,
    below_it: u32,
    fate: u32,
}

struct Hit {
    distance: real,
    primitive: u32,
}

// How decisions and loops are written here, and why.
//
// Where both sides are cheap, `&`, `|` and select replace `&&`, `||` and `if`. Wide machines run both sides of a branch
// anyway, and pay for the branch on top.
//
// Loops ask at both ends of an iteration whether to go on. Lavapipe always makes the first iteration, and at its end
// asks whether some lane wants another. So a loop that asks only before its iterations makes one for nothing. Where
// rays end at their first surface, that is every other event.
//
// A loop that asks only after its iterations goes wrong on lavapipe (Mesa 22.3). The loop computes on for lanes that have
// left it, and memory reads of those lanes give zeros. A branch still skips such lanes. So a variable that is used
// after a loop, and may differ between lanes, changes only within a branch. `always_true` keeps Mesa from seeing that
// a lane that comes again always takes that branch.
//
// Where all lanes make the same iterations, asking after them is enough. Where iterations are short, asking before them
// is enough.

// The nearer of two hits. The earlier primitive in the list wins a tie. Without a tree the earlier one was met first; a
// tree may meet it later.
fn nearer(best: Hit, distance: real, primitive: u32) -> Hit {
    let tied = HAS_TREE & (distance == best.distance) & (distance < MISS) & (primitive < best.primitive);
    let closer = (distance < best.distance) | tied;
    return Hit(select(best.distance, distance, closer), select(best.primitive, primitive, closer));
}

// The rays that one dispatch traces: first..first+count of one source, or as many that are listed
// (stages/ids.listed.wgsl).
struct Range {
    first_lo: u32,
    first_hi: u32,
    count: u32,
    source: u32,
    // The seed's words in the row of step 0 (program::layout::rng::step_table).
    seed_lo: u32,
    seed_hi: u32,
    // The stride in the log from an entry of a ray to its next (cpu/log/passes.logged.wgsl).
    log_stride: u32,
    // The primitives that earlier passes reached, a bit each (sums/reached.bits.wgsl).
    reached: u32,
}

// Uniform, because every invocation reads the same values. Every entry point copies the range before its first branch
// (`begin`): after a branch, lavapipe reads even a uniform lane by lane.
@group(GROUP_SCENE) @binding(BINDING_RANGE) var<uniform> range_uniform: Range;

var<private> range: Range;

// Always true, in a way that compilers cannot see: no dispatch has IMPOSSIBLE_COUNT rays. IMPOSSIBLE_COUNT differs with
// the width of the driver's vectors. A driver may keep compiled shaders without noting their width (Mesa 22.3). The
// number makes shaders of different widths differ.
fn always_true() -> bool {
    return range.count != IMPOSSIBLE_COUNT;
}

// The row of rng_table for step 0.
fn first_jump() -> vec4<u32> {
    return vec4<u32>(range.seed_lo, range.seed_hi, FIRST_STEP);
}

// The 32 bits of the draw (ray, slot, 0).
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
