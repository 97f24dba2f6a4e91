//! The WGSL files that every shader shares, chosen by precision and by integers.

use super::rng::Sampler;

/// Precision of `real` in the shaders.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Real {
    /// 32-bit floats: every adapter.
    F32,
    /// f64 in the text, for [`super::df64::rewrite`] to make pairs of 32-bit floats of.
    Df64,
    /// 64-bit floats: adapters with `SHADER_F64`.
    F64,
}

/// How the shaders count in 64 bits and more. Both give the same bits.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Integers {
    /// 64-bit integers and atomics: `SHADER_INT64` and `SHADER_INT64_ATOMIC_ALL_OPS`.
    Native,
    /// Pairs of 32-bit integers: every adapter.
    Portable,
}

macro_rules! shader {
    ($name:literal) => {
        include_str!(concat!(env!("CARGO_MANIFEST_DIR"), "/shaders/lib/", $name))
    };
}

/// The shared functions as one WGSL source: `alias real`, draws, mathematics and sums. The order of declarations means
/// nothing to WGSL.
pub fn source(real: Real, integers: Integers, sampler: Sampler) -> String {
    let shared = [shader!("rng_slots.wgsl"), shader!("math.wgsl"), shader!("sums.wgsl")];
    let by_real = match real {
        Real::F32 => [
            "alias real = f32;\n",
            shader!("real_f32.wgsl"),
            shader!("math_f32.wgsl"),
            shader!("polynomials_f32.wgsl"),
            shader!("quanta_f32.wgsl"),
        ],
        Real::Df64 => [
            "alias real = f64;\n",
            shader!("real_df64.wgsl"),
            shader!("math_df64.wgsl"),
            concat!(shader!("reduction_f64.wgsl"), shader!("polynomials_f64.wgsl")),
            concat!(shader!("quanta_f32.wgsl"), shader!("df64.wgsl")),
        ],
        Real::F64 => [
            "alias real = f64;\n",
            shader!("real_f64.wgsl"),
            shader!("math_f64.wgsl"),
            concat!(shader!("reduction_f64.wgsl"), shader!("polynomials_f64.wgsl")),
            "",
        ],
    };
    let sums = match integers {
        Integers::Native => shader!("sums_native.wgsl"),
        Integers::Portable => shader!("sums_portable.wgsl"),
    };
    let draws = match (sampler, integers) {
        (Sampler::Pcg, Integers::Native) => [shader!("rng_native.wgsl"), ""],
        (Sampler::Pcg, Integers::Portable) => [shader!("rng_portable.wgsl"), ""],
        (Sampler::Sobol, _) => [shader!("rng_sobol.wgsl"), shader!("sobol_matrices.wgsl")],
    };
    [by_real.concat(), shared.concat(), draws.concat(), sums.into()].concat()
}
