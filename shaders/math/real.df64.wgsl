// The part of `real` that depends on the two f32 of a pair: draws as numbers, weights as integers. Twin of
// real.f64.wgsl. The high part of a real is f32(x), and the low part is x less that.

fn low_part(x: real) -> f32 {
    return f32(x - real(f32(x)));
}

// bits / 2^32, exactly; never 1.
fn uniform_of(bits: u32) -> real {
    return real(bits) * 2.3283064365386963e-10;
}

// bits / 2^32 < p, exactly, for any p: a pair holds all 32 bits, and scaling by 2^32 is exact. False for NaN.
fn below(bits: u32, p: real) -> bool {
    return real(bits) < p * 4294967296.0;
}

fn is_part(x: f32) -> bool {
    return (bitcast<u32>(x) & 0x7F800000u) != 0x7F800000u;
}

// False for NaN and infinity. The function looks at the bits, because a compiler may assume that NaN and infinity do
// not occur.
fn is_number(x: real) -> bool {
    return is_part(f32(x)) & is_part(low_part(x));
}

// True if a sum can hold the weight: 0 <= w < 2^43. The function looks at the bits, because a compiler may assume that
// NaN and infinity do not occur.
fn is_depositable(w: real) -> bool {
    let bits = bitcast<u32>(f32(w));
    return ((bits < 0x55000000u) | (bits == 0x80000000u)) & is_part(low_part(w));
}

fn is_whole_quanta(part: f32) -> bool {
    let quanta = part * 4503599627370496.0;
    return floor(quanta) == quanta;
}

// floor(w * 2^52) as words (lo, hi, top), for a depositable weight. Where the high part is no whole number of quanta,
// the low part is less than what is missing.
fn quanta_words(w: real) -> vec3<u32> {
    let high = f32(w);
    let low = low_part(w);
    let quanta = quanta_of_f32(high);
    let rest = quanta_of_f32(abs(low));
    let rest_up = q_add(rest, vec3<u32>(select(1u, 0u, is_whole_quanta(low)), 0u, 0u));
    let sum = select(q_add(quanta, rest), q_sub(quanta, rest_up), low < 0.0);
    return select(quanta, sum, is_whole_quanta(high));
}
