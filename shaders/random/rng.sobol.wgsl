// Quasi-random draws: Sobol points with Owen's scrambling, with the same keys as random/rng.native.wgsl. A draw is a
// coordinate of the ray's point; each slot and step has a dimension of its own.
//
// All draws of a source lie in five dimensions of one Sobol sequence. Every further decision has a pair of dimensions.
// The points of a pair are shuffled against the points of other pairs (padding), and lie evenly over every 1024 rays.
//
// Sources: Sobol, On the distribution of points in a cube (1967). Direction numbers: Joe and Kuo, Constructing Sobol
// sequences with better two-dimensional projections (SIAM J. Sci. Comput. 30, 2008). Scrambling: Burley, Practical
// hash-based Owen scrambling (JCGT 9(4), 2020).

// The index of the ray's point, and the part of the id in which rays with this index differ.
alias RayKey = vec2<u32>;

// Each of 2^32 rays has a point of its own. The next 2^32 rays have the same points, scrambled anew.
fn ray_key(id_lo: u32, id_hi: u32) -> RayKey {
    return vec2<u32>(id_lo, id_hi);
}

struct Stream {
    key: RayKey,
    seed: u32,
    slot: u32,
    step: u32,
}

// The half of a jump that step 0 has in common for all seeds: the step, and an unused word.
const FIRST_STEP: vec2<u32> = vec2<u32>(0u, 0u);

fn stream_at(key: RayKey, slot: u32, jump: vec4<u32>) -> Stream {
    return Stream(key, combined(jump.x, jump.y), slot, jump.z);
}

fn stream_next(stream: Stream) -> Stream {
    return Stream(stream.key, stream.seed, stream.slot, stream.step + 1u);
}

fn stream_bits(stream: Stream) -> u32 {
    let place = dimension_of(stream.slot, stream.step);
    let set_seed = combined(combined(stream.seed, stream.key.y), place.x);
    // The set of the sources keeps its order, so that a range of ids is a range of points.
    let index = select(shuffled(stream.key.x, set_seed), stream.key.x, place.x == 0u);
    return scrambled(sobol(index, place.y), combined(set_seed, place.y + 1u));
}

// (set, dimension within it). Set 0 holds the draws of sources.
fn dimension_of(slot: u32, step: u32) -> vec2<u32> {
    if slot <= SOURCE_WAVELENGTH {
        return vec2<u32>(step, slot);
    }
    // Two steps of one kind of decision share a set. So do the two angles of a lobe.
    if slot == FRESNEL_BRANCH || slot == RR {
        return vec2<u32>((slot << 24u) + (step >> 1u), step & 1u);
    }
    let lobe = slot == BSDF_U1 || slot == BSDF_U2;
    return vec2<u32>((select(slot, BSDF_U1, lobe) << 24u) + step, select(0u, slot - BSDF_U1, lobe));
}

// The bits of a coordinate of Sobol's point. The highest bit is the first after the binary point.
fn sobol(index: u32, dimension: u32) -> u32 {
    switch dimension {
        case 0u: { return reverseBits(index); }
        case 1u: { return sobol_1(index); }
        case 2u: { return sobol_2(index); }
        case 3u: { return sobol_3(index); }
        default: { return sobol_4(index); }
    }
}

// The second dimension's matrix is Pascal's triangle modulo 2, which factors into five shifts. Source: Ahmed, An
// implementation algorithm of 2D Sobol sequence fast, elegant, and compact, EGSR 2024.
fn sobol_1(index: u32) -> u32 {
    var x = reverseBits(index);
    x ^= x << 16u;
    x ^= (x & 0x00FF00FFu) << 8u;
    x ^= (x & 0x0F0F0F0Fu) << 4u;
    x ^= (x & 0x33333333u) << 2u;
    x ^= (x & 0x55555555u) << 1u;
    return x;
}

// Owen's nested uniform scrambling: each bit is flipped by a hash of the bits above it. Multiplications carry only
// upwards, hence the reversals. Sources: Laine and Karras; constants by Vegdahl, Building a better LK hash, 2021.
fn scrambled(bits: u32, seed: u32) -> u32 {
    var x = reverseBits(bits);
    x ^= x * 0x3d20adeau;
    x += seed;
    x *= (seed >> 16u) | 1u;
    x ^= x * 0x05526c56u;
    x ^= x * 0x53a22864u;
    return reverseBits(x);
}

// The index, shuffled within its block of 1024. Source: Kensler, Correlated multi-jittered sampling, Pixar TM 13-01,
// 2013, section 3.
//
// A nested shuffle such as Owen's would keep neighbours together: one from either half, in every dimension. The product
// of two sets' coordinates would then have one and a half times the variance of random numbers.
fn shuffled(index: u32, seed: u32) -> u32 {
    let within = index & 1023u;
    let p = combined(seed, index - within);
    var i = (within ^ p) * 0xE170893Du;
    i ^= p >> 16u;
    i ^= (i & 1023u) >> 4u;
    i = (i ^ (p >> 8u)) * 0x0929EB3Fu;
    i ^= p >> 23u;
    i = (i ^ ((i & 1023u) >> 1u)) * ((p >> 27u) | 1u) * 0x6935FA69u;
    i = (i ^ ((i & 1023u) >> 11u)) * 0x74DCB303u;
    i = (i ^ ((i & 1023u) >> 2u)) * 0x9E501CC3u;
    i = (i ^ ((i & 1023u) >> 2u)) * 0xC860A3DFu;
    i &= 1023u;
    i ^= i >> 5u;
    return index - within + ((i + p) & 1023u);
}

// A hash of two words, by the finaliser of MurmurHash3 (Appleby, 2011).
fn combined(a: u32, b: u32) -> u32 {
    var x = a ^ (b * 0x9E3779B9u + 0x7F4A7C15u);
    x ^= x >> 16u;
    x *= 0x85EBCA6Bu;
    x ^= x >> 13u;
    x *= 0xC2B2AE35u;
    x ^= x >> 16u;
    return x;
}
