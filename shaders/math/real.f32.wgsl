// The part of `real` that depends on the bits of an f32: draws as numbers, weights as integers. Twin of real.f64.wgsl.

// bits / 2^32, cut to the 24 leading bits. The conversion is then exact on every device, and small draws keep all their
// bits. The result never reaches 1: 0xFFFFFFFF gives 1 - 2^-24.
fn uniform_of(bits: u32) -> real {
    return f32(bits & ~(0xFFu >> countLeadingZeros(bits | 1u))) * 2.3283064365386963e-10;
}

// bits / 2^32 < p, exactly, for any p. Cutting to 24 bits does not change the answer, because p has no more bits
// itself. False for NaN.
fn below(bits: u32, p: real) -> bool {
    return uniform_of(bits) < p;
}

// False for NaN and infinity. The function looks at the bits, because a compiler may assume that NaN and infinity do
// not occur.
fn is_number(x: real) -> bool {
    return (bitcast<u32>(x) & 0x7F800000u) != 0x7F800000u;
}

// True if a sum can hold the weight: 0 <= w < 2^43. The function looks at the bits, because a compiler may assume that
// NaN and infinity do not occur.
fn is_depositable(w: real) -> bool {
    let bits = bitcast<u32>(w);
    return (bits < 0x55000000u) | (bits == 0x80000000u);
}

// floor(w * 2^52) as words (lo, hi, top), for a depositable weight.
fn quanta_words(w: real) -> vec3<u32> {
    return quanta_of_f32(w);
}
