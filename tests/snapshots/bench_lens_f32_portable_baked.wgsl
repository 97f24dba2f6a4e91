// ==== composed by program::layout::bindings
const GROUP_SCENE: u32 = 0u;
const GROUP_QUEUES: u32 = 1u;
const BINDING_RANGE: u32 = 0u;
const BINDING_RNG_TABLE: u32 = 1u;
const BINDING_SUMS: u32 = 2u;
const BINDING_COUNTERS: u32 = 4u;
const BINDING_QUEUE_COUNTS: u32 = 0u;

// ==== composed by program::wgsl::library
alias real = f32;

// <- shaders/math/real.f32.wgsl
// <- shaders/math/dot.wgsl
// <- shaders/math/math.f32.wgsl
// <- shaders/math/polynomials.f32.wgsl
// <- shaders/sums/quanta_f32.wgsl
// <- shaders/random/rng_slots.wgsl
// <- shaders/math/math.wgsl
// <- shaders/sums/sums.wgsl
// <- shaders/random/rng.portable.wgsl
// <- shaders/sums/sums.portable.wgsl
// ==== composed by program::wgsl::constants
const IMPOSSIBLE_COUNT: u32 = 4294967295u;
const WORKGROUP_SIZE: u32 = 64u;
const RAYS_PER_INVOCATION: u32 = 1u;
const EVENTS_PER_DISPATCH: u32 = 16u;
const MAX_DEPTH: u32 = 16u;
const NUM_SURFACES: u32 = 3u;
const NUM_PRIMITIVES: u32 = 4u;
const NUM_WAVELENGTHS: u32 = 1u;
const PATH_THRESHOLD: u32 = 0u;
const CELL_INVALID: u32 = 0u;
const CELL_UNDERFLOWS: u32 = 1u;
const CELL_ROULETTE_GAIN: u32 = 2u;
const CELL_BULK: u32 = 3u;
const CELL_IMPORTANCE_LOSS: u32 = 4u;
const CELL_IMPORTANCE_GAIN: u32 = 5u;
const CELL_ESCAPED: u32 = 6u;
const CELL_DEPTH_KILLED: u32 = 7u;
const CELL_ROULETTE_KILLED: u32 = 8u;
const CELL_COATING: u32 = 9u;
const CELL_BSDF: u32 = 10u;
const CELL_BSDF_GAIN: u32 = 11u;
const CELL_SURFACES: u32 = 12u;
const COUNTER_REACHED: u32 = 4111u;
const COUNTER_ENTERED_TWICE: u32 = 4115u;
const COUNTER_ENDED_INSIDE: u32 = 4118u;
const HAS_REFRACTIVE: bool = true;
const HAS_REFLECTIVE: bool = false;
const HAS_HARD: bool = false;
const HAS_BILINEAR: bool = true;
const HAS_GAUSSIAN: bool = false;
const HAS_TRANSMISSIVE: bool = false;
const HAS_TRANSMISSIVE_LOBES: bool = false;
const HAS_QUEUE: bool = false;
const LOGS_PASSES: bool = false;
const HAS_TOTALS: bool = false;
const UNIT_GRADIENTS: bool = true;
const RECORD_ALL_PATHS: bool = false;
const HAS_TREE: bool = false;
const ROULETTE_THRESHOLD: real = real(0.0);

// <- shaders/stages/state.wgsl
// <- shaders/stages/counts.wgsl
// <- shaders/stages/generate.wgsl
// <- shaders/stages/interact.wgsl
// <- shaders/stages/splat.wgsl
// <- shaders/stages/trace.wgsl
// <- shaders/geometry/transforms.wgsl
// <- shaders/geometry/quadric.wgsl
// <- shaders/shapes/plane.wgsl
// <- shaders/sums/ledger.wgsl
// <- shaders/stages/intersect.wgsl
// <- shaders/detectors/irradiance.wgsl
// <- shaders/stages/ids.range.wgsl
// <- shaders/stages/path.plain.wgsl
// <- shaders/stages/hit.plain.wgsl
// <- shaders/stages/taps.plain.wgsl
// <- shaders/stages/rays.one.wgsl
// <- shaders/stages/loops.few.wgsl
// <- shaders/stages/scatter.none.wgsl
// <- shaders/stages/compact.none.wgsl
// <- shaders/optics/spectrum.single.wgsl
// <- shaders/optics/bulk.none.wgsl
// <- shaders/optics/roulette.none.wgsl
// <- shaders/optics/reflection.drawn.wgsl
// <- shaders/optics/wrong_sides.counted.wgsl
// <- shaders/optics/branch.fresnel.wgsl
// <- shaders/optics/coating.none.wgsl
// <- shaders/optics/reflectance.none.wgsl
// <- shaders/optics/indices.constant.wgsl
// <- shaders/geometry/gradients.smooth.wgsl
// <- shaders/geometry/contact.none.wgsl
// <- shaders/geometry/mesh.none.wgsl
// <- shaders/sums/ends.deposited.wgsl
// <- shaders/sums/passes.deposited.wgsl
// <- shaders/sums/weights.vary.wgsl
// <- shaders/sums/reached.bits.wgsl
// <- shaders/sums/deposit.plain.wgsl
// <- shaders/sums/replicates.none.wgsl
// <- shaders/sums/moments.none.wgsl
// <- shaders/rows/paths.none.wgsl
// <- shaders/shapes/conic.wgsl
// <- shaders/shapes/frustum.wgsl
// <- shaders/sources/collimated_tophat.wgsl
// ==== composed by program::wgsl::rows
struct Surface {
    interaction: u32,
    origin_x: real,
    origin_y: real,
    origin_z: real,
    radial: real,
    axial: real,
    offset: real,
    front: u32,
    back: u32,
    n_front: real,
    n_back: real,
}
fn surface_of(i: u32) -> Surface {
    return Surface(
        select(2u, 0u, (i == 2u)),
        real(0.0),
        real(0.0),
        select(real(-62.5), real(-57.5), (i == 1u)),
        select(select(real(-0.009999999776482582), real(0.009999999776482582), (i == 1u)), real(1.0), (i == 2u)),
        select(select(real(-0.009999999776482582), real(0.009999999776482582), (i == 1u)), real(-0.0), (i == 2u)),
        select(real(1.0), real(-0.0), (i == 2u)),
        select(0u, 1u, (i == 1u)),
        select(0u, 1u, (i == 0u)),
        select(real(1.0), real(1.5), (i == 1u)),
        select(real(1.0), real(1.5), (i == 0u)),
    );
}
struct Detector {
    kind: u32,
    absorb: u32,
    cell: u32,
    origin_x: real,
    origin_y: real,
    origin_z: real,
    half_width: real,
    half_height: real,
    pitch_x: real,
    pitch_y: real,
    num_x: u32,
    num_y: u32,
    splat: u32,
    splat_radius: u32,
    splat_falloff: real,
    bins: u32,
    num_bins: u32,
}
fn detector_of(i: u32) -> Detector {
    return Detector(
        0u,
        1u,
        15u,
        real(0.0),
        real(0.0),
        real(87.5),
        real(25.0),
        real(25.0),
        real(0.78125),
        real(0.78125),
        64u,
        64u,
        1u,
        0u,
        real(0.0),
        0u,
        1u,
    );
}
fn to_surface(r: Surface, v: vec3<real>) -> vec3<real> {
    return v;
}
fn from_surface(r: Surface, v: vec3<real>) -> vec3<real> {
    return v;
}
fn to_detector(r: Detector, v: vec3<real>) -> vec3<real> {
    return v;
}
fn from_detector(r: Detector, v: vec3<real>) -> vec3<real> {
    return v;
}
struct Source {
    kind: u32,
    medium: u32,
    spectrum_first: u32,
    spectrum_count: u32,
    weight: real,
    origin_x: real,
    origin_y: real,
    origin_z: real,
    p0: real,
    p1: real,
    p2: real,
}
fn source_of(i: u32) -> Source {
    return Source(
        1u,
        0u,
        0u,
        1u,
        real(1.0),
        real(0.0),
        real(0.0),
        real(-87.5),
        real(10.0),
        real(0.0),
        real(0.0),
    );
}
fn to_source(r: Source, v: vec3<real>) -> vec3<real> {
    return v;
}
fn from_source(r: Source, v: vec3<real>) -> vec3<real> {
    return v;
}
fn source() -> Source {
    return source_of(0u);
}
fn begin() {
    range = range_uniform;
}

// ==== composed by program::wgsl::search
fn nearest_primitive(ray: Ray, start: Hit) -> Hit {
    var best = start;
    best = nearer(best, conic_distance(ray.position - vec3<real>(real(0.0), real(0.0), real(-62.5)), ray.direction, real(0.009999999776482582), real(0.009999999776482582), real(156.25), ray.last == 0u), 0u);
    best = nearer(best, conic_distance(ray.position - vec3<real>(real(0.0), real(0.0), real(-57.5)), ray.direction, real(-0.009999999776482582), real(-0.009999999776482582), real(156.25), ray.last == 1u), 1u);
    best = nearer(best, frustum_distance(ray.position - vec3<real>(real(0.0), real(0.0), real(-62.5)), ray.direction, real(12.5), real(0.0), real(0.7843258380889893), real(4.21567440032959), ray.last == 2u), 2u);
    best = nearer(best, rectangle_distance(ray.position - vec3<real>(real(0.0), real(0.0), real(87.5)), ray.direction, real(25.0), real(25.0), ray.last == 3u), 3u);
    return best;
}

// ==== composed by program::wgsl::ledger_bins
var<private> bin_0_events: u32 = 0u;
fn add_to_bin(cell: u32, q: Quanta) {
    if cell == CELL_UNDERFLOWS {
        bin_0_events += 1u;
        return;
    }
}
fn plain_flush_bins() {
    flush_count(CELL_UNDERFLOWS, bin_0_events);
}

// ==== composed by program::wgsl::dispatch
fn quadric_normal(surface: Surface, position: vec3<real>) -> vec3<real> {
    return normal_of_quadric(surface, position);
}
fn record(ray: Ray, detector: Detector, index: u32, ends: bool) {
    if detector.kind == 0u { record_irradiance(ray, detector, ends); }
}
fn emit(key: RayKey, e: Source) -> LocalRay {
    return emit_collimated_tophat(key, e);
}

