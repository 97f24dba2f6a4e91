// Elementary functions: the part that depends on the bits of an f32. Twin of math.f64.wgsl.

// ln 2 and pi/4 in two parts; the product of the high part with the integers it meets is exact.
const LN2_HI: real = 0.693145751953125;
const LN2_LO: real = 1.428606765330187e-06;
const QUARTER_PI_HI: real = 0.785398006439209;
const QUARTER_PI_LO: real = 1.5695823663008923e-07;

// x - quarters * pi/2, with pi/2 in four parts (Cody and Waite, Software Manual for the Elementary Functions, 1980).
// Every product is exact, so fma gives the same whether it fuses or not. Without fma, a compiler that may reorder sums
// (Metal's) could join the parts again.
fn beyond_quarters(x: real, quarters: real) -> real {
    let first = fma(-quarters, 1.5703125, x);
    let second = fma(-quarters, 0.0004837512969970703, first);
    let third = fma(-quarters, 7.549533620476723e-08, second);
    return fma(-quarters, 2.5633440682570896e-12, third);
}

// exp(x): 0 below -87.33, where the result would no longer be a normal number, and exp(88) from 88 on. Error: 1.5 ulp.
fn exp_real(x: real) -> real {
    let clamped = clamp(x, -87.33, 88.0);
    let n = floor(clamped * 1.4426950408889634 + 0.5);
    let r = fma(-n, LN2_LO, fma(-n, LN2_HI, clamped));
    let power = bitcast<f32>(u32(i32(n) + 127) << 23u);
    return select((1.0 + (r + r * (r * poly_exp(r)))) * power, 0.0, x < -87.33);
}

// exp(x) for |x| <= NEAR_ZERO, with the same bits as exp_real: there is no power of two to take out.
const NEAR_ZERO: real = 0.34;

fn exp_near_zero(x: real) -> real {
    return 1.0 + (x + x * (x * poly_exp(x)));
}

// ln(x) of a positive normal number. Error: 1 ulp.
fn log_real(x: real) -> real {
    // Bits minus the bits of sqrt(1/2), so that the significand lies between sqrt(1/2) and sqrt(2).
    let bits = bitcast<u32>(x) - 0x3F3504F3u;
    let exponent = real(bitcast<i32>(bits) >> 23u);
    return log_kernel(exponent, bitcast<f32>((bits & 0x7FFFFFu) + 0x3F3504F3u) - 1.0);
}
