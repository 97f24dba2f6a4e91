// Keyed PCG32 (XSH-RR 64/32) on 64-bit integers. Twin of rng.portable.wgsl, bit for bit. Source: O'Neill, PCG: A Family
// of Simple Fast Space-Efficient Statistically Good Algorithms for Random Number Generation, 2014.

// The ray's part of the stream selector: ray_id * 0x9E3779B97F4A7C15.
alias RayKey = u64;

fn ray_key(id_lo: u32, id_hi: u32) -> RayKey {
    return (u64(id_lo) | (u64(id_hi) << 32u)) * 0x9E3779B97F4A7C15lu;
}

// Finaliser of SplitMix64 (Steele, Lea, Flood, Fast Splittable Pseudorandom Number Generators, 2014).
fn splitmix64(key: u64) -> u64 {
    let a = key + 0x9E3779B97F4A7C15lu;
    let b = (a ^ (a >> 30u)) * 0xBF58476D1CE4E5B9lu;
    let c = (b ^ (b >> 27u)) * 0x94D049BB133111EBlu;
    return c ^ (c >> 31u);
}

// The random sequence of one (ray, slot). Its state moves on by one step per draw.
struct Stream {
    state: u64,
    increment: u64,
}

// Q of step 0, as words (lo, hi): MULT + 1.
const FIRST_STEP: vec2<u32> = vec2<u32>(0x4C957F2Eu, 0x5851F42Du);

// The stream at the step whose jump is (P.lo, P.hi, Q.lo, Q.hi). A slot that is a literal costs nothing, because the
// compiler folds its product.
fn stream_at(key: RayKey, slot: u32, jump: vec4<u32>) -> Stream {
    let increment = (splitmix64(key ^ (u64(slot) * 0xC2B2AE3D27D4EB4Flu)) << 1u) | 1lu;
    let p = u64(jump.x) | (u64(jump.y) << 32u);
    let q = u64(jump.z) | (u64(jump.w) << 32u);
    return Stream(p + q * increment, increment);
}

// The stream one step on.
fn stream_next(stream: Stream) -> Stream {
    return Stream(stream.state * 6364136223846793005lu + stream.increment, stream.increment);
}

fn stream_bits(stream: Stream) -> u32 {
    let state = stream.state;
    let xorshifted = u32((((state >> 18u) ^ state) >> 27u) & 0xFFFFFFFFlu);
    let rotation = u32(state >> 59u);
    return (xorshifted >> rotation) | (xorshifted << ((32u - rotation) & 31u));
}
