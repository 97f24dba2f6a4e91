// Slots of the keyed draws, with the numbers of Optiland's EventSlot. Each decision draws from its own slot, so no
// decision can shift the numbers of another.
const SOURCE_U1: u32 = 0u;
const SOURCE_U2: u32 = 1u;
const SOURCE_U3: u32 = 2u;
const SOURCE_U4: u32 = 3u;
const SOURCE_WAVELENGTH: u32 = 4u;
const FRESNEL_BRANCH: u32 = 5u;
const SCATTER_BRANCH: u32 = 6u;
const BSDF_U1: u32 = 7u;
const BSDF_U2: u32 = 8u;
const RR: u32 = 9u;
const BSDF_LOBE_BRANCH: u32 = 10u;
const PATH_SAMPLE: u32 = 11u;

// What the sampler needs per step k, from program::layout::rng::step_table. For PCG, a row is (P.lo, P.hi, Q.lo, Q.hi)
// of state_k = P_k + Q_k * inc. For Sobol, a row is (seed.lo, seed.hi, k, 0). The table holds a row for every step that
// is drawn, which is bounce + offset.
@group(GROUP_SCENE) @binding(BINDING_RNG_TABLE) var<storage, read> rng_table: array<vec4<u32>>;

// The 32 bits of (ray, slot, step), where step = bounce + offset.
fn draw(key: RayKey, slot: u32, step: u32) -> u32 {
    return stream_bits(stream_at(key, slot, rng_table[step]));
}
