// Double-word arithmetic: a real as the unevaluated sum of two f32, (high, low), where high is the sum rounded to
// nearest. The host rewrites every f64 of the other files into these (program::rewrite::df64). The unit of roundoff is
// u = 2^-24. Algorithms and bounds: Joldes, Muller and Popescu, Tight and rigorous error bounds for basic building
// blocks of double-word arithmetic (ACM TOMS 44(2), 2017). Norms: Lefevre, Louvet, Muller, Picot and Rideau, Accurate
// calculation of Euclidean norms using double-word arithmetic (ACM TOMS 49(1), 2023).

// A zero whose value no compiler knows. An exclusive or with it protects a rounded result on every platform. A compiler
// could otherwise simplify the result, as (a + b) - a to b, fuse it with what follows, or reorder it.
//
// The zero lies in a storage buffer, because drivers may compile in the contents of uniforms, as Mesa's lavapipe does.
// Entry points copy it (program::rewrite::df64).
@group(GROUP_SCENE) @binding(BINDING_DF64_ZERO) var<storage, read> df64_zero_source: u32;
var<private> df64_zero: u32;

fn df64_rounded(x: f32) -> f32 {
    return bitcast<f32>(bitcast<u32>(x) ^ df64_zero);
}

// a + b, exactly, for |a| >= |b|.
fn df64_fast_two_sum(a: f32, b: f32) -> vec2<f32> {
    let sum = df64_rounded(a + b);
    let taken = df64_rounded(sum - a);
    return vec2<f32>(sum, df64_rounded(b - taken));
}

// a + b, exactly.
fn df64_two_sum(a: f32, b: f32) -> vec2<f32> {
    let ordered = abs(a) >= abs(b);
    return df64_fast_two_sum(select(b, a, ordered), select(a, b, ordered));
}

// The leading 12 bits of a. The remainder has 12 bits too.
fn df64_leading(a: f32) -> f32 {
    return bitcast<f32>(bitcast<u32>(a) & 0xFFFFF000u);
}

// a b, exactly, if the low part does not underflow (Dekker, A floating-point technique for extending the available
// precision, 1971). Every product below is exact, and so is every sum.
fn df64_two_product(a: f32, b: f32) -> vec2<f32> {
    let product = df64_rounded(a * b);
    let a_high = df64_leading(a);
    let b_high = df64_leading(b);
    let a_low = df64_rounded(a - a_high);
    let b_low = df64_rounded(b - b_high);
    let first = df64_rounded(a_high * b_high - product);
    let second = df64_rounded(first + a_high * b_low);
    let third = df64_rounded(second + a_low * b_high);
    return vec2<f32>(product, df64_rounded(third + a_low * b_low));
}

// Error: 3 u^2 (AccurateDWPlusDW).
fn df64_add(x: vec2<f32>, y: vec2<f32>) -> vec2<f32> {
    let high = df64_two_sum(x.x, y.x);
    let low = df64_two_sum(x.y, y.y);
    let first = df64_fast_two_sum(high.x, df64_rounded(high.y + low.x));
    return df64_fast_two_sum(first.x, df64_rounded(low.y + first.y));
}

fn df64_sub(x: vec2<f32>, y: vec2<f32>) -> vec2<f32> {
    return df64_add(x, -y);
}

// Error: 2 u^2 (DWPlusFP).
fn df64_add_f(x: vec2<f32>, y: f32) -> vec2<f32> {
    let sum = df64_two_sum(x.x, y);
    return df64_fast_two_sum(sum.x, df64_rounded(x.y + sum.y));
}

// Error: 5 u^2 (DWTimesDW1).
fn df64_mul(x: vec2<f32>, y: vec2<f32>) -> vec2<f32> {
    let product = df64_two_product(x.x, y.x);
    return df64_fast_two_sum(product.x, df64_rounded(product.y + (x.x * y.y + x.y * y.x)));
}

fn df64_square(x: vec2<f32>) -> vec2<f32> {
    let product = df64_two_product(x.x, x.x);
    return df64_fast_two_sum(product.x, df64_rounded(product.y + 2.0 * (x.x * x.y)));
}

// Error: 3 u^2 (DWTimesFP2).
fn df64_mul_f(x: vec2<f32>, y: f32) -> vec2<f32> {
    let product = df64_two_product(x.x, y);
    return df64_fast_two_sum(product.x, df64_rounded(product.y + x.y * y));
}

// Error: 15 u^2 where division rounds correctly (DWDivDW2).
fn df64_div(x: vec2<f32>, y: vec2<f32>) -> vec2<f32> {
    let quotient = df64_rounded(x.x / y.x);
    let product = df64_mul_f(y, quotient);
    let rest = df64_rounded(x.x - product.x) + df64_rounded(x.y - product.y);
    return df64_fast_two_sum(quotient, df64_rounded(rest / y.x));
}

// Error: 25/8 u^2 where the square root rounds correctly (SQRTDWtoDW). For x >= 0.
fn df64_sqrt(x: vec2<f32>) -> vec2<f32> {
    let root = df64_rounded(sqrt(x.x));
    let square = df64_two_product(root, root);
    let rest = df64_rounded(df64_rounded(x.x - square.x) - square.y) + x.y;
    return select(df64_fast_two_sum(root, df64_rounded(rest / (2.0 * root))), vec2<f32>(0.0, 0.0), x.x == 0.0);
}

// Adds a product to a sum. The sums below add two or three products of reals. Error: a few u^2 of the sum of the
// products' sizes.
fn df64_add_product(sum: vec2<f32>, x: vec2<f32>, y: vec2<f32>) -> vec2<f32> {
    let product = df64_two_product(x.x, y.x);
    let high = df64_two_sum(sum.x, product.x);
    return vec2<f32>(high.x, df64_rounded((sum.y + high.y) + (product.y + (x.x * y.y + x.y * y.x))));
}

fn df64_dot(a: mat3x2<f32>, b: mat3x2<f32>) -> vec2<f32> {
    let first = df64_add_product(vec2<f32>(0.0, 0.0), a[0], b[0]);
    let sum = df64_add_product(df64_add_product(first, a[1], b[1]), a[2], b[2]);
    return df64_two_sum(sum.x, sum.y);
}

fn df64_determinant(a: vec2<f32>, b: vec2<f32>, c: vec2<f32>, d: vec2<f32>) -> vec2<f32> {
    let first = df64_add_product(vec2<f32>(0.0, 0.0), a, d);
    let sum = df64_add_product(first, -b, c);
    return df64_two_sum(sum.x, sum.y);
}

fn df64_cross(a: mat3x2<f32>, b: mat3x2<f32>) -> mat3x2<f32> {
    return mat3x2<f32>(
        df64_determinant(a[1], a[2], b[1], b[2]),
        df64_determinant(a[2], a[0], b[2], b[0]),
        df64_determinant(a[0], a[1], b[0], b[1]),
    );
}

fn df64_less(x: vec2<f32>, y: vec2<f32>) -> bool {
    return (x.x < y.x) | ((x.x == y.x) & (x.y < y.y));
}

fn df64_less_equal(x: vec2<f32>, y: vec2<f32>) -> bool {
    return (x.x < y.x) | ((x.x == y.x) & (x.y <= y.y));
}

fn df64_abs(x: vec2<f32>) -> vec2<f32> {
    return select(x, -x, x.x < 0.0);
}

fn df64_min(x: vec2<f32>, y: vec2<f32>) -> vec2<f32> {
    return select(x, y, df64_less(y, x));
}

fn df64_max(x: vec2<f32>, y: vec2<f32>) -> vec2<f32> {
    return select(x, y, df64_less(x, y));
}

fn df64_clamp(x: vec2<f32>, low: vec2<f32>, high: vec2<f32>) -> vec2<f32> {
    return df64_min(df64_max(x, low), high);
}

fn df64_floor(x: vec2<f32>) -> vec2<f32> {
    let whole = floor(x.x);
    return select(vec2<f32>(whole, 0.0), df64_fast_two_sum(x.x, floor(x.y)), whole == x.x);
}

fn df64_ceil(x: vec2<f32>) -> vec2<f32> {
    return -df64_floor(-x);
}

// Exact. All conversions below are exact, too, where the result can hold the number.
fn df64_from_u32(n: u32) -> vec2<f32> {
    return df64_fast_two_sum(f32(n >> 16u) * 65536.0, f32(n & 0xFFFFu));
}

fn df64_from_i32(n: i32) -> vec2<f32> {
    return df64_fast_two_sum(f32(n >> 16u) * 65536.0, f32(n & 0xFFFF));
}

// Rounds towards zero, and clamps to the range of u32.
fn df64_to_u32(x: vec2<f32>) -> u32 {
    let whole = df64_floor(x);
    let inside = (x.x >= 0.0) & (whole.x < 4294967296.0);
    let below_end = (whole.x == 4294967296.0) & (whole.y < 0.0);
    let sum = select(u32(whole.x), 0u, below_end) + bitcast<u32>(i32(whole.y));
    return select(select(0xFFFFFFFFu, 0u, x.x < 0.0), sum, inside | below_end);
}

fn df64_to_i32(x: vec2<f32>) -> i32 {
    let whole = select(df64_floor(x), df64_ceil(x), x.x < 0.0);
    return select(i32(whole.x), i32(whole.x) + i32(whole.y), abs(whole.x) < 2147483648.0);
}
