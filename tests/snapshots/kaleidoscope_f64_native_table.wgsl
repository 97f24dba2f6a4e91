// ==== composed by program::layout::bindings
const GROUP_SCENE: u32 = 0u;
const GROUP_QUEUES: u32 = 1u;
const BINDING_RANGE: u32 = 0u;
const BINDING_RNG_TABLE: u32 = 1u;
const BINDING_SUMS: u32 = 2u;
const BINDING_TOPS: u32 = 3u;
const BINDING_COUNTERS: u32 = 4u;
const BINDING_SPECTRA: u32 = 6u;
const BINDING_REFLECTANCES: u32 = 7u;
const BINDING_SPECTRAL_BINS: u32 = 8u;
const BINDING_QUEUE_COUNTS: u32 = 0u;

// ==== composed by program::wgsl::library
alias real = f64;

// <- shaders/math/real.f64.wgsl
// <- shaders/math/dot.wgsl
// <- shaders/math/math.f64.wgsl
// <- shaders/math/reduction_f64.wgsl
// <- shaders/math/polynomials.f64.wgsl
// <- shaders/random/rng_slots.wgsl
// <- shaders/math/math.wgsl
// <- shaders/sums/sums.wgsl
// <- shaders/random/rng.native.wgsl
// <- shaders/sums/sums.native.wgsl
// ==== composed by program::wgsl::constants
const IMPOSSIBLE_COUNT: u32 = 4294967295u;
const WORKGROUP_SIZE: u32 = 64u;
const RAYS_PER_INVOCATION: u32 = 1u;
const EVENTS_PER_DISPATCH: u32 = 16u;
const MAX_DEPTH: u32 = 16u;
const NUM_SURFACES: u32 = 3u;
const NUM_PRIMITIVES: u32 = 5u;
const NUM_WAVELENGTHS: u32 = 3u;
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
const COUNTER_REACHED: u32 = 7951u;
const HAS_REFRACTIVE: bool = false;
const HAS_REFLECTIVE: bool = true;
const HAS_HARD: bool = true;
const HAS_BILINEAR: bool = true;
const HAS_GAUSSIAN: bool = false;
const HAS_TRANSMISSIVE: bool = true;
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
// <- shaders/detectors/bins.wgsl
// <- shaders/detectors/irradiance.wgsl
// <- shaders/detectors/spectral.wgsl
// <- shaders/stages/ids.range.wgsl
// <- shaders/stages/path.plain.wgsl
// <- shaders/stages/hit.plain.wgsl
// <- shaders/stages/taps.plain.wgsl
// <- shaders/stages/rays.one.wgsl
// <- shaders/cpu/loops.many.wgsl
// <- shaders/stages/scatter.none.wgsl
// <- shaders/stages/compact.none.wgsl
// <- shaders/optics/spectrum.discrete.wgsl
// <- shaders/optics/bulk.none.wgsl
// <- shaders/optics/roulette.none.wgsl
// <- shaders/optics/reflection.drawn.wgsl
// <- shaders/optics/wrong_sides.none.wgsl
// <- shaders/optics/branch.fresnel.wgsl
// <- shaders/optics/coating.none.wgsl
// <- shaders/optics/reflectance.table.wgsl
// <- shaders/optics/indices.none.wgsl
// <- shaders/geometry/gradients.smooth.wgsl
// <- shaders/geometry/contact.none.wgsl
// <- shaders/geometry/mesh.none.wgsl
// <- shaders/geometry/primitives.table.wgsl
// <- shaders/geometry/try_primitive.alone.wgsl
// <- shaders/sums/ends.deposited.wgsl
// <- shaders/sums/passes.deposited.wgsl
// <- shaders/sums/weights.vary.wgsl
// <- shaders/sums/reached.counters.wgsl
// <- shaders/sums/deposit.plain.wgsl
// <- shaders/sums/replicates.none.wgsl
// <- shaders/sums/moments.none.wgsl
// <- shaders/rows/paths.none.wgsl
// <- shaders/sources/extended_rectangle.wgsl
// <- shaders/sources/extended_disk.wgsl
// ==== composed by program::wgsl::rows
struct Surface {
    interaction: u32,
    origin_x: real,
    origin_y: real,
    origin_z: real,
    xx: real,
    xy: real,
    xz: real,
    yx: real,
    yy: real,
    yz: real,
    zx: real,
    zy: real,
    zz: real,
    radial: real,
    axial: real,
    offset: real,
    front: u32,
    back: u32,
}
struct SurfaceRow {
    origin_x: real,
    origin_y: real,
    xx: real,
    xy: real,
    yx: real,
    yy: real,
    zx: real,
    zy: real,
}
@group(0) @binding(9) var<storage, read> surface_table: array<SurfaceRow>;
fn surface_of(i: u32) -> Surface {
    let row = surface_table[i];
    return Surface(
        1u,
        row.origin_x,
        row.origin_y,
        real(-29.75),
        row.xx,
        row.xy,
        real(-1.0),
        row.yx,
        row.yy,
        real(0.0),
        row.zx,
        row.zy,
        real(6.123233995736766e-17),
        real(0.0),
        real(0.0),
        real(1.0),
        0u,
        0u,
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
struct DetectorRow {
    kind: u32,
    absorb: u32,
    cell: u32,
    origin_z: real,
    half_width: real,
    half_height: real,
    pitch_x: real,
    pitch_y: real,
    num_x: u32,
    num_y: u32,
    splat: u32,
    bins: u32,
    num_bins: u32,
}
@group(0) @binding(10) var<storage, read> detector_table: array<DetectorRow>;
fn detector_of(i: u32) -> Detector {
    let row = detector_table[i];
    return Detector(
        row.kind,
        row.absorb,
        row.cell,
        real(-1.1865812650530976),
        real(0.28819424987583053),
        row.origin_z,
        row.half_width,
        row.half_height,
        row.pitch_x,
        row.pitch_y,
        row.num_x,
        row.num_y,
        row.splat,
        0u,
        real(0.0),
        row.bins,
        row.num_bins,
    );
}
fn to_surface(r: Surface, v: vec3<real>) -> vec3<real> {
    return to_local(v, Rotation(vec3<real>(r.xx, r.xy, r.xz), vec3<real>(r.yx, r.yy, r.yz), vec3<real>(r.zx, r.zy, r.zz)));
}
fn from_surface(r: Surface, v: vec3<real>) -> vec3<real> {
    return to_global(v, Rotation(vec3<real>(r.xx, r.xy, r.xz), vec3<real>(r.yx, r.yy, r.yz), vec3<real>(r.zx, r.zy, r.zz)));
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
    xx: real,
    xy: real,
    xz: real,
    yx: real,
    yy: real,
    yz: real,
    zx: real,
    zy: real,
    zz: real,
    p0: real,
    p1: real,
    p2: real,
}
@group(0) @binding(13) var<uniform> source_uniform: Source;
var<private> source_copy: Source;
fn to_source(r: Source, v: vec3<real>) -> vec3<real> {
    return to_local(v, Rotation(vec3<real>(r.xx, r.xy, r.xz), vec3<real>(r.yx, r.yy, r.yz), vec3<real>(r.zx, r.zy, r.zz)));
}
fn from_source(r: Source, v: vec3<real>) -> vec3<real> {
    return to_global(v, Rotation(vec3<real>(r.xx, r.xy, r.xz), vec3<real>(r.yx, r.yy, r.yz), vec3<real>(r.zx, r.zy, r.zz)));
}
fn source() -> Source {
    return source_copy;
}
fn begin() {
    range = range_uniform;
    source_copy = source_uniform;
}
struct Primitive {
    shape: u32,
    origin_x: real,
    origin_y: real,
    origin_z: real,
    xx: real,
    xy: real,
    xz: real,
    yx: real,
    yy: real,
    yz: real,
    zx: real,
    zy: real,
    zz: real,
    a0: real,
    a1: real,
    a2: real,
    a3: real,
}
struct PrimitiveRow {
    origin_x: real,
    origin_y: real,
    origin_z: real,
    xx: real,
    xy: real,
    xz: real,
    yx: real,
    yy: real,
    zx: real,
    zy: real,
    zz: real,
    a0: real,
    a1: real,
}
@group(0) @binding(11) var<storage, read> primitive_table: array<PrimitiveRow>;
fn primitive_of(i: u32) -> Primitive {
    let row = primitive_table[i];
    return Primitive(
        2u,
        row.origin_x,
        row.origin_y,
        row.origin_z,
        row.xx,
        row.xy,
        row.xz,
        row.yx,
        row.yy,
        real(0.0),
        row.zx,
        row.zy,
        row.zz,
        row.a0,
        row.a1,
        real(0.0),
        real(0.0),
    );
}

// ==== composed by program::wgsl::search
fn to_primitive(r: Primitive, v: vec3<real>) -> vec3<real> {
    return to_local(v, Rotation(vec3<real>(r.xx, r.xy, r.xz), vec3<real>(r.yx, r.yy, r.yz), vec3<real>(r.zx, r.zy, r.zz)));
}
fn from_primitive(r: Primitive, v: vec3<real>) -> vec3<real> {
    return to_global(v, Rotation(vec3<real>(r.xx, r.xy, r.xz), vec3<real>(r.yx, r.yy, r.yz), vec3<real>(r.zx, r.zy, r.zz)));
}
fn shape_distance(p: Primitive, o: vec3<real>, d: vec3<real>, leaving: bool, farthest: real) -> real {
    return rectangle_distance(o, d, p.a0, p.a1, leaving);
}

// ==== composed by program::wgsl::ledger_bins
fn add_to_bin(cell: u32, q: Quanta) {
    count(cell);
    deposit(cell, q);
}
fn plain_flush_bins() {
}

// ==== composed by program::wgsl::dispatch
fn quadric_normal(surface: Surface, position: vec3<real>) -> vec3<real> {
    return normal_of_quadric(surface, position);
}
fn record(ray: Ray, detector: Detector, index: u32, ends: bool) {
    if detector.kind == 0u { record_irradiance(ray, detector, ends); }
    if detector.kind == 1u { record_spectral(ray, detector, ends); }
}
fn emit(key: RayKey, e: Source) -> LocalRay {
    if e.kind == 3u { return emit_extended_rectangle(key, e); }
    return emit_extended_disk(key, e);
}

