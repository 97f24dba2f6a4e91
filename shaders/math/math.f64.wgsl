// Elementary functions: the part that depends on the bits of an f64. Those bits cannot be read everywhere, so
// comparisons and powers of two stand in for them. Twin of math.f32.wgsl.

// pi/4 in two parts; the product of the high part with the integers it meets is exact.
const QUARTER_PI_HI: real = 0.7853981633974483;
const QUARTER_PI_LO: real = 3.061616997868383e-17;

// x * 2^n, for n between -1022 and 1023. If the result is a normal number, so is every intermediate one.
fn scaled(x: real, n: i32) -> real {
    let down = n < 0;
    let steps = u32(abs(n));
    var y = x;
    y *= choose(1.0, choose(2.0, 0.5, down), (steps & 1u) != 0u);
    y *= choose(1.0, choose(4.0, 0.25, down), (steps & 2u) != 0u);
    y *= choose(1.0, choose(16.0, 0.0625, down), (steps & 4u) != 0u);
    y *= choose(1.0, choose(256.0, 0.00390625, down), (steps & 8u) != 0u);
    y *= choose(1.0, choose(65536.0, 1.52587890625e-05, down), (steps & 16u) != 0u);
    y *= choose(1.0, choose(4294967296.0, 2.3283064365386963e-10, down), (steps & 32u) != 0u);
    y *= choose(1.0, choose(1.8446744073709552e+19, 5.421010862427522e-20, down), (steps & 64u) != 0u);
    y *= choose(1.0, choose(3.402823669209385e+38, 2.938735877055719e-39, down), (steps & 128u) != 0u);
    y *= choose(1.0, choose(1.157920892373162e+77, 8.636168555094445e-78, down), (steps & 256u) != 0u);
    y *= choose(1.0, choose(1.3407807929942597e+154, 7.458340731200207e-155, down), (steps & 512u) != 0u);
    return y;
}

// exp(x): 0 below -708.39, where the result would no longer be a normal number, and exp(709) from 709 on. Error: 1 ulp.
fn exp_real(x: real) -> real {
    let clamped = clamp(x, -708.39, 709.0);
    let n = floor(clamped * 1.4426950408889634 + 0.5);
    let r = (clamped - n * LN2_HI) - n * LN2_LO;
    return select(scaled(1.0 + (r + r * (r * poly_exp(r))), i32(n)), 0.0, x < -708.39);
}

// exp(x) for |x| <= NEAR_ZERO, with the same bits as exp_real: there is no power of two to take out.
const NEAR_ZERO: real = 0.34;

fn exp_near_zero(x: real) -> real {
    return 1.0 + (x + x * (x * poly_exp(x)));
}

// One step of taking powers of two out of a number (significand, exponent): takes out 2^size if the significand is as
// large.
fn without_power(number: vec2<real>, size: real, power: real, inverse: real) -> vec2<real> {
    let reached = number.x >= power;
    return vec2<real>(number.x * choose(1.0, inverse, reached), number.y + choose(0.0, size, reached));
}

// ln(x) of a positive normal number. Error: 1 ulp.
fn log_real(x: real) -> real {
    // The number is first lifted into [1, 2^1024), then brought into [1, 2), then between sqrt(1/2) and sqrt(2).
    let lifted = x < 1.0;
    var n = vec2<real>(select(x, x * 8.98846567431158e+307, lifted), choose(0.0, -1023.0, lifted));
    n = without_power(n, 512.0, 1.3407807929942597e+154, 7.458340731200207e-155);
    n = without_power(n, 256.0, 1.157920892373162e+77, 8.636168555094445e-78);
    n = without_power(n, 128.0, 3.402823669209385e+38, 2.938735877055719e-39);
    n = without_power(n, 64.0, 1.8446744073709552e+19, 5.421010862427522e-20);
    n = without_power(n, 32.0, 4294967296.0, 2.3283064365386963e-10);
    n = without_power(n, 16.0, 65536.0, 1.52587890625e-05);
    n = without_power(n, 8.0, 256.0, 0.00390625);
    n = without_power(n, 4.0, 16.0, 0.0625);
    n = without_power(n, 2.0, 4.0, 0.25);
    n = without_power(n, 1.0, 2.0, 0.5);
    let doubled = n.x > 1.4142135623730951;
    return log_kernel(n.y + choose(0.0, 1.0, doubled), n.x * choose(1.0, 0.5, doubled) - 1.0);
}
