// Quanta of a weight, or of a part of one, from the bits of an f32.

// floor(w * 2^52) as words (lo, hi, top), for a depositable w.
fn quanta_of_f32(w: f32) -> vec3<u32> {
    let bits = bitcast<u32>(w);
    let exponent = (bits >> 23u) & 0xFFu;
    // A subnormal weight is less than one quantum, and so is every weight whose shift leaves nothing.
    let significand = (bits & 0x7FFFFFu) | 0x800000u;
    let small = significand >> min(98u - min(exponent, 98u), 31u);
    let shift = max(exponent, 98u) - 98u;
    let within = shift & 31u;
    let lower = significand << within;
    let upper = (significand >> 1u) >> (31u - within);
    let word = shift >> 5u;
    let x = select(0u, select(lower, small, exponent < 98u), word == 0u);
    let y = select(select(0u, lower, word == 1u), upper, word == 0u);
    let z = select(select(0u, lower, word == 2u), upper, word == 1u);
    return vec3<u32>(x, y, z);
}
