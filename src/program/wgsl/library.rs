//! The WGSL files that all shaders share, chosen by precision and by the kind of integers.

use crate::program::layout::bindings;
use crate::program::layout::rng::Sampler;
use crate::program::wgsl::text::Text;
use crate::shaders::{ShaderFile, shader};

/// Precision of `real` in the shaders.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Real {
    /// 32-bit floats: every adapter.
    F32,
    /// Pairs of 32-bit floats: the text has f64, and [`crate::program::rewrite::df64::rewrite`] makes the pairs.
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

const F32: &[ShaderFile] = &[
    shader!("math/real.f32.wgsl"),
    shader!("math/dot.wgsl"),
    shader!("math/math.f32.wgsl"),
    shader!("math/polynomials.f32.wgsl"),
    shader!("sums/quanta_f32.wgsl"),
];

const DF64: &[ShaderFile] = &[
    shader!("math/real.df64.wgsl"),
    shader!("math/math.df64.wgsl"),
    shader!("math/reduction_f64.wgsl"),
    shader!("math/polynomials.f64.wgsl"),
    shader!("sums/quanta_f32.wgsl"),
    shader!("math/df64.wgsl"),
];

const F64: &[ShaderFile] = &[
    shader!("math/real.f64.wgsl"),
    shader!("math/dot.wgsl"),
    shader!("math/math.f64.wgsl"),
    shader!("math/reduction_f64.wgsl"),
    shader!("math/polynomials.f64.wgsl"),
];

const SHARED: &[ShaderFile] =
    &[shader!("random/rng_slots.wgsl"), shader!("math/math.wgsl"), shader!("sums/sums.wgsl")];

/// The shared functions as one WGSL source: `alias real`, bindings, draws, mathematics and sums.
pub fn source(real: Real, integers: Integers, sampler: Sampler) -> String {
    let mut text = Text::default();
    add(&mut text, real, integers, sampler);
    text.file(shader!("sums/deposit.plain.wgsl"));
    bindings::declared(&text.into_string())
}

/// Adds the shared functions to a module.
pub(super) fn add(text: &mut Text, real: Real, integers: Integers, sampler: Sampler) {
    let (name, by_real) = match real {
        Real::F32 => ("f32", F32),
        Real::Df64 => ("f64", DF64),
        Real::F64 => ("f64", F64),
    };
    let sums = match integers {
        Integers::Native => shader!("sums/sums.native.wgsl"),
        Integers::Portable => shader!("sums/sums.portable.wgsl"),
    };
    let draws: &[ShaderFile] = match (sampler, integers) {
        (Sampler::Pcg, Integers::Native) => &[shader!("random/rng.native.wgsl")],
        (Sampler::Pcg, Integers::Portable) => &[shader!("random/rng.portable.wgsl")],
        (Sampler::Sobol, _) => &[shader!("random/rng.sobol.wgsl"), shader!("random/sobol_matrices.wgsl")],
    };
    text.composed("program::wgsl::library", &format!("alias real = {name};\n"));
    text.files([by_real, SHARED, draws, &[sums]].concat());
}
