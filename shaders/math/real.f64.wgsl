// The part of `real` that depends on the bits of an f64: draws as numbers, weights as integers. Twin of real.f32.wgsl.

// bits / 2^32, exactly; never 1.
fn uniform_of(bits: u32) -> real {
    return f64(bits) * 2.3283064365386963e-10;
}

// bits / 2^32 < p, exactly, for any p: an f64 holds all 32 bits, and scaling by 2^32 is exact. False for NaN.
fn below(bits: u32, p: real) -> bool {
    return uniform_of(bits) < p;
}

// False for NaN and infinity: the comparison must be true to pass (see is_depositable).
fn is_number(x: real) -> bool {
    return abs(x) < 1e300;
}

// True if a sum can hold the weight: 0 <= w < 2^43. Comparisons that must be true, joined and never negated, refuse a
// NaN. A compiler may turn !(a < b) into a >= b, and the bits of an f64 cannot be read everywhere.
fn is_depositable(w: real) -> bool {
    return (w >= 0.0) & (w < 8796093022208.0);
}

// floor(w * 2^52) as words (lo, hi, top), for a depositable weight. Every step is exact, as a scaling by powers of two
// or a remainder of floor.
fn quanta_words(w: real) -> vec3<u32> {
    let top = floor(w * 0.000244140625);
    let upper = (w - top * 4096.0) * 1048576.0;
    let hi = floor(upper);
    let lo = floor((upper - hi) * 4294967296.0);
    return vec3<u32>(u32(lo), u32(hi), u32(top));
}
