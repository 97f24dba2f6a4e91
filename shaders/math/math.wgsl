// Elementary functions of `real`, from + - * / sqrt alone. WGSL's own functions do not exist in f64, and are too coarse
// in f32. There sin and cos are good to 2^-11 absolute, log to 2^-21 near 1, acos to 7e-5.
//
// The files math.f32.wgsl and math.f64.wgsl hold the parts that depend on bits, and polynomials.*.wgsl the polynomials.
//
// Errors are in units in the last place (ulp), asserted by tests/lib_math.rs where division and square root round
// correctly. Each ulp that an adapter loses in those adds about one ulp in log, acos and atan2.
//
// The kernels of log, acos and atan2 reduce their arguments as fdlibm does (Sun Microsystems, 1993).

// select for literals: a plain select of two literals would be f32, whatever `real` is.
fn choose(otherwise: real, chosen: real, condition: bool) -> real {
    return select(otherwise, chosen, condition);
}

// (cos, sin) of |x| <= pi/4.
fn sincos_kernel(x: real) -> vec2<real> {
    let z = x * x;
    return vec2<real>(1.0 + z * poly_cos(z), x + x * (z * poly_sin(z)));
}

// (cos, sin) turned on by quarters of a turn.
fn turned(cos_sin: vec2<real>, quarters: u32) -> vec2<real> {
    let odd = select(cos_sin, vec2<real>(-cos_sin.y, cos_sin.x), (quarters & 1u) != 0u);
    return select(odd, -odd, (quarters & 2u) != 0u);
}

// (cos, sin) of 2 pi bits / 2^32, reduced exactly by integers. Error: 2.6 ulp in f32, mostly from rounding bits and pi;
// 2 ulp in f64.
fn sincos_turns(bits: u32) -> vec2<real> {
    let quarters = (bits + 0x20000000u) >> 30u;
    let rest = bitcast<i32>(bits - (quarters << 30u));
    return turned(sincos_kernel(real(rest) * 1.4629180792671596e-09), quarters);
}

// sin(x), |x| <= 1e4. Error: 2.5 ulp in f32, 2 in f64.
fn sin_real(x: real) -> real {
    let quarters = quarters_of(x);
    return turned(sincos_kernel(beyond_quarters(x, quarters)), quarter_index(quarters)).y;
}

// cos(x), |x| <= 1e4. Error: 2.5 ulp in f32, 2 in f64.
fn cos_real(x: real) -> real {
    let quarters = quarters_of(x);
    return turned(sincos_kernel(beyond_quarters(x, quarters)), quarter_index(quarters)).x;
}

// The nearest number of quarters of a turn.
fn quarters_of(x: real) -> real {
    return floor(x * 0.6366197723675814 + 0.5);
}

fn quarter_index(quarters: real) -> u32 {
    return bitcast<u32>(i32(quarters)) & 3u;
}

// exp(x) - 1, accurate relative to itself.
fn exp_less_1(x: real) -> real {
    if abs(x) <= NEAR_ZERO {
        return x + x * (x * poly_exp(x));
    }
    return exp_real(x) - 1.0;
}

// ln(2^exponent (1 + f)), for 1 + f between sqrt(1/2) and sqrt(2).
fn log_kernel(exponent: real, f: real) -> real {
    let s = f / (2.0 + f);
    let z = s * s;
    let half_square = 0.5 * f * f;
    let rest = s * (half_square + z * poly_log(z)) + exponent * LN2_LO;
    return exponent * LN2_HI - ((half_square - rest) - f);
}

// ln(bits / 2^32), accurate relative to itself up to bits = 0xFFFFFFFF; ln(1e-300) for bits = 0. Error: 1.5 ulp in f32,
// 1 in f64.
fn log_uniform(bits: u32) -> real {
    let zeros = countLeadingZeros(bits | 1u);
    let significand = bits << zeros;
    // The exact distance from 1 of the significand, read as a number in [sqrt(1/2), 1) or [1, sqrt(2)).
    let doubled = significand < 0xB504F334u;
    let above = real(significand - 0x80000000u) * 4.656612873077393e-10;
    let under = real(bitcast<i32>(significand)) * 2.3283064365386963e-10;
    let exponent = -real(zeros + select(0u, 1u, doubled));
    return select(log_kernel(exponent, select(under, above, doubled)), -690.7755278982137, bits == 0u);
}

// acos(x); beyond -1 and 1 it stays at pi and 0. Error: 1.5 ulp in f32, 1 in f64.
fn acos_real(x: real) -> real {
    let a = min(abs(x), 1.0);
    let near_zero = a <= 0.5;
    // Where acos is steep, acos(a) = 2 asin(sqrt((1 - a) / 2)).
    let z = select((1.0 - a) * 0.5, x * x, near_zero);
    let s = select(sqrt(z), x, near_zero);
    let tail = s * (z * poly_asin(z));
    let around_zero = 2.0 * QUARTER_PI_HI - (s - (2.0 * QUARTER_PI_LO - tail));
    let doubled = 2.0 * (s + tail);
    let away = select(doubled, 4.0 * QUARTER_PI_HI - (doubled - 4.0 * QUARTER_PI_LO), x < 0.0);
    return select(away, around_zero, near_zero);
}

// The angle of (x, y), in [-pi, pi] [rad]; 0 for (0, 0). The sign of a zero does not count: atan2(-0, -1) is pi. The
// sum |x| + |y| and the ratios must be normal numbers. Error: 2.5 ulp in f32, 1 in f64.
fn atan2_real(y: real, x: real) -> real {
    let large = max(abs(x), abs(y));
    let small = min(abs(x), abs(y));
    // Beyond tan(pi/8), atan(t) = pi/4 + atan((t - 1) / (t + 1)).
    let shifted = small > 0.41421356237309503 * large;
    let numerator = select(small, small - large, shifted);
    let denominator = select(large, small + large, shifted);
    let t = numerator / select(denominator, 1.0, denominator == 0.0);
    let z = t * t;
    let part = t + t * (z * poly_atan(z));
    // The angle is this many quarters of pi, plus or minus the angle of the ratio.
    let steep = abs(y) > abs(x);
    let backward = x < 0.0;
    let in_octant = choose(0.0, 1.0, shifted);
    let in_quadrant = select(in_octant, 2.0 - in_octant, steep);
    let quarters = select(in_quadrant, 4.0 - in_quadrant, backward);
    let angle = select(part, -part, steep != backward);
    let result = quarters * QUARTER_PI_HI + (angle + quarters * QUARTER_PI_LO);
    return select(result, -result, y < 0.0);
}
