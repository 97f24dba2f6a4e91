// What depends on the bits of an f32: draws as numbers, weights as integers. Twin of real.f64.wgsl.

// bits / 2^32, cut to the 24 leading bits: the conversion is then exact on every device, the result never reaches 1
// (0xFFFFFFFF gives 1 - 2^-24), and small draws keep all their bits.
fn uniform_of(bits: u32) -> real {
    return f32(bits & ~(0xFFu >> countLeadingZeros(bits | 1u))) * 2.3283064365386963e-10;
}

// bits / 2^32 < p, exactly, for any p: if the number that was cut to 24 bits is below p, so is every number that is cut
// to it, because p has no more bits itself. False for NaN.
fn below(bits: u32, p: real) -> bool {
    return uniform_of(bits) < p;
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
