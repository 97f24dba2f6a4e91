// What depends on the bits of an f32: draws as numbers, weights as integers. Twin of real_f64.wgsl.

// bits / 2^32, cut to the 24 leading bits: the conversion is then exact on every device, the result never reaches 1
// (0xFFFFFFFF gives 1 - 2^-24), and small draws keep all their bits.
fn uniform_of(bits: u32) -> real {
    return f32(bits & ~(0xFFu >> countLeadingZeros(bits | 1u))) * 2.3283064365386963e-10;
}

// bits / 2^32 < p, exactly, for any finite p: scaling by 2^32 and rounding up are exact, so the integers decide.
fn below(bits: u32, p: real) -> bool {
    return (p >= 1.0) | ((p > 0.0) & (bits < u32(ceil(p * 4294967296.0))));
}

// False for NaN and infinity, by the bits: a compiler may take for granted that there are none.
fn is_number(x: real) -> bool {
    return (bitcast<u32>(x) & 0x7F800000u) != 0x7F800000u;
}

// True if a sum can hold the weight: 0 <= w < 2^43. It looks at the bits, because a compiler may take for granted that
// no number is NaN or infinite.
fn is_depositable(w: real) -> bool {
    let bits = bitcast<u32>(w);
    return (bits < 0x55000000u) | (bits == 0x80000000u);
}

// floor(w * 2^52) as words (lo, hi, top), for a depositable weight.
fn quanta_words(w: real) -> vec3<u32> {
    return quanta_of_f32(w);
}
