// Elementary functions: the part that depends on the two f32 of a pair. Twin of math.f64.wgsl.
//
// Errors of these functions and of those in math.wgsl are in units of 2^-47 of the power of two below the result
// (tests/lib_math.rs). Sine and cosine: 2.7; log_uniform and acos: 1.3; exp: 1.2; atan2: 2.5; log: 0.8.

// pi/4 in two parts; the product of the high part with the integers it meets is exact.
const QUARTER_PI_HI: real = 0.7853981633974456;
const QUARTER_PI_LO: real = 2.6951514290790595e-15;

// 2^n, for n from -126 to 127.
fn power_of_two(n: i32) -> real {
    return real(bitcast<f32>(u32(n + 127) << 23u));
}

// exp(x): 0 below -87.33, where the result would no longer be a normal number, and exp(88) from 88 on. The low part of
// results below 2^-102 underflows.
fn exp_real(x: real) -> real {
    let clamped = clamp(x, -87.33, 88.0);
    let n = floor(clamped * 1.4426950408889634 + 0.5);
    let r = (clamped - n * LN2_HI) - n * LN2_LO;
    return select((1.0 + (r + r * (r * poly_exp(r)))) * power_of_two(i32(n)), 0.0, x < -87.33);
}

// exp(x) for |x| <= NEAR_ZERO, with the same bits as exp_real: there is no power of two to take out.
const NEAR_ZERO: real = 0.34;

fn exp_near_zero(x: real) -> real {
    return 1.0 + (x + x * (x * poly_exp(x)));
}

// ln(x) of a positive normal number.
fn log_real(x: real) -> real {
    // Bits minus the bits of sqrt(1/2), so that the significand lies between sqrt(1/2) and sqrt(2).
    let bits = bitcast<u32>(f32(x)) - 0x3F3504F3u;
    let exponent = bitcast<i32>(bits) >> 23u;
    let half = exponent >> 1u;
    let significand = (x * power_of_two(-half)) * power_of_two(half - exponent);
    return log_kernel(real(exponent), significand - 1.0);
}
