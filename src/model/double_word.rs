//! Numbers as pairs of f32: what df64 holds.

/// A number as the unevaluated sum of two f32: (high, low), where high is the sum rounded to nearest.
pub fn split(value: f64) -> [f32; 2] {
    let high = value as f32;
    let low = value - f64::from(high);
    [high, if low.is_finite() { low as f32 } else { 0.0 }]
}

/// The number that a pair stands for. The sum is exact for the pair of any f64.
pub fn join([high, low]: [f32; 2]) -> f64 {
    f64::from(high) + f64::from(low)
}

/// An f64 as a pair holds it.
pub fn rounded(value: f64) -> f64 {
    join(split(value))
}
