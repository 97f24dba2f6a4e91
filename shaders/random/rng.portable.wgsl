// Keyed PCG32 (XSH-RR 64/32) on pairs (lo, hi) of 32-bit integers. Twin of rng.native.wgsl, bit for bit. Source:
// O'Neill, PCG: A Family of Simple Fast Space-Efficient Statistically Good Algorithms for Random Number Generation,
// 2014.

// The ray's part of the stream selector: ray_id * 0x9E3779B97F4A7C15.
alias RayKey = vec2<u32>;

fn ray_key(id_lo: u32, id_hi: u32) -> RayKey {
    return pair_mul(vec2<u32>(id_lo, id_hi), vec2<u32>(0x7F4A7C15u, 0x9E3779B9u));
}

fn pair_add(a: vec2<u32>, b: vec2<u32>) -> vec2<u32> {
    let lo = a.x + b.x;
    return vec2<u32>(lo, a.y + b.y + select(0u, 1u, lo < a.x));
}

// All 64 bits of the product of two 32-bit integers, from 16-bit limbs: WGSL has no high word of a product.
fn wide_mul(a: u32, b: u32) -> vec2<u32> {
    let a0 = a & 0xFFFFu;
    let a1 = a >> 16u;
    let b0 = b & 0xFFFFu;
    let b1 = b >> 16u;
    let low = a0 * b0;
    let cross = a1 * b0 + (low >> 16u);
    let middle = a0 * b1 + (cross & 0xFFFFu);
    return vec2<u32>((middle << 16u) | (low & 0xFFFFu), a1 * b1 + (cross >> 16u) + (middle >> 16u));
}

// The low 64 bits of the product of two 64-bit integers.
fn pair_mul(a: vec2<u32>, b: vec2<u32>) -> vec2<u32> {
    let low = wide_mul(a.x, b.x);
    return vec2<u32>(low.x, low.y + a.x * b.y + a.y * b.x);
}

// a ^ (a >> shift), for 0 < shift < 32.
fn pair_xorshift(a: vec2<u32>, shift: u32) -> vec2<u32> {
    return a ^ vec2<u32>((a.x >> shift) | (a.y << (32u - shift)), a.y >> shift);
}

// Finaliser of SplitMix64 (Steele, Lea, Flood, Fast Splittable Pseudorandom Number Generators, 2014).
fn splitmix64(key: vec2<u32>) -> vec2<u32> {
    let a = pair_add(key, vec2<u32>(0x7F4A7C15u, 0x9E3779B9u));
    let b = pair_mul(pair_xorshift(a, 30u), vec2<u32>(0x1CE4E5B9u, 0xBF58476Du));
    let c = pair_mul(pair_xorshift(b, 27u), vec2<u32>(0x133111EBu, 0x94D049BBu));
    return pair_xorshift(c, 31u);
}

// The random sequence of one (ray, slot). Its state moves on by one step per draw.
struct Stream {
    state: vec2<u32>,
    increment: vec2<u32>,
}

// Q of step 0, as words (lo, hi): MULT + 1.
const FIRST_STEP: vec2<u32> = vec2<u32>(0x4C957F2Eu, 0x5851F42Du);

// The stream at the step whose jump is (P.lo, P.hi, Q.lo, Q.hi). A slot that is a literal costs nothing, because the
// compiler folds its product.
fn stream_at(key: RayKey, slot: u32, jump: vec4<u32>) -> Stream {
    let selector = splitmix64(key ^ pair_mul(vec2<u32>(slot, 0u), vec2<u32>(0x27D4EB4Fu, 0xC2B2AE3Du)));
    let increment = vec2<u32>((selector.x << 1u) | 1u, (selector.y << 1u) | (selector.x >> 31u));
    return Stream(pair_add(jump.xy, pair_mul(jump.zw, increment)), increment);
}

// The stream one step on.
fn stream_next(stream: Stream) -> Stream {
    let product = pair_mul(stream.state, vec2<u32>(0x4C957F2Du, 0x5851F42Du));
    return Stream(pair_add(product, stream.increment), stream.increment);
}

fn stream_bits(stream: Stream) -> u32 {
    let state = stream.state;
    let mixed = pair_xorshift(state, 18u);
    let xorshifted = (mixed.x >> 27u) | (mixed.y << 5u);
    let rotation = state.y >> 27u;
    return (xorshifted >> rotation) | (xorshifted << ((32u - rotation) & 31u));
}
