// Reduction of arguments: constants whose parts suit both f64 and pairs of f32.

// ln 2 in two parts; the product of the high part with the integers it meets is exact.
const LN2_HI: real = 0.6931471803691238;
const LN2_LO: real = 1.9082149292705877e-10;

// x - quarters * pi/2, with pi/2 in three parts (Cody and Waite, Software Manual for the Elementary Functions, 1980).
fn beyond_quarters(x: real, quarters: real) -> real {
    let first = x - quarters * 1.5707963267341256;
    let second = first - quarters * 6.077100506303966e-11;
    return second - quarters * 2.0222662487959506e-21;
}
