//! The ways to trace a scene: the plain one, and each setting that changes the error for the same time.

use crate::bench::accuracy::scenes::{is_refractive, set_splat};
use crate::model::{ReflectProb, SceneIr, Splat};
use crate::program::{Precision, Sampler};

/// One way to trace.
#[derive(Debug, Clone, PartialEq)]
pub struct Method {
    /// The name in files and charts.
    pub name: String,
    /// Precision of the physics.
    pub precision: Precision,
    /// The kind of draws.
    pub sampler: Sampler,
    /// The difference from the plain scene.
    pub setting: Setting,
}

/// A setting that differs from Optiland's default.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Setting {
    /// None.
    Plain,
    /// `reflect_prob`.
    ReflectProb(ReflectProb),
    /// `rr_start_flux`.
    Roulette(f64),
    /// `split_depth` and `split_budget`.
    Split,
    /// A splat.
    Splat(Splat),
}

/// Splits rays of fewer events than this, and follows every branch. With ten faces, only a ghost of a ghost is left to
/// chance.
const SPLIT_DEPTH: u32 = 6;
const SPLIT_BUDGET: f64 = 7.0;
/// Flux below which roulette begins, in units of a new ray's flux.
const ROULETTE: f64 = 0.5;

impl Setting {
    /// A scene with this setting.
    pub fn apply(self, plain: &SceneIr) -> SceneIr {
        let mut ir = plain.clone();
        match self {
            Setting::Plain => {}
            Setting::ReflectProb(probability) => ir.sampling.reflect_prob = probability,
            Setting::Roulette(start) => ir.sampling.rr_start_flux = start,
            Setting::Split => {
                (ir.sampling.split_depth, ir.sampling.split_budget) = (SPLIT_DEPTH, SPLIT_BUDGET);
            }
            Setting::Splat(splat) => set_splat(&mut ir, splat),
        }
        ir
    }
}

/// The ways to trace a scene: the plain one in every precision, the others in the last precision.
pub fn methods(plain: &SceneIr, precisions: &[Precision]) -> Vec<Method> {
    let tier = |&precision: &Precision| Method {
        name: precision.name().into(),
        precision,
        sampler: Sampler::Pcg,
        setting: Setting::Plain,
    };
    let mut all: Vec<Method> = precisions.iter().map(tier).collect();
    let Some(&precision) = precisions.last() else { return all };
    let mut add = |name: String, sampler, setting| all.push(Method { name, precision, sampler, setting });
    add("sobol".into(), Sampler::Sobol, Setting::Plain);
    if is_refractive(plain) {
        let auto = Setting::ReflectProb(ReflectProb::Auto);
        add("reflect_prob auto".into(), Sampler::Pcg, auto);
        add(format!("split_depth {SPLIT_DEPTH}"), Sampler::Pcg, Setting::Split);
        add(format!("split_depth {SPLIT_DEPTH}, sobol"), Sampler::Sobol, Setting::Split);
    }
    add(format!("rr_start_flux {ROULETTE}"), Sampler::Pcg, Setting::Roulette(ROULETTE));
    add("bilinear splat".into(), Sampler::Pcg, Setting::Splat(Splat::Bilinear));
    add("gaussian splat".into(), Sampler::Pcg, Setting::Splat(Splat::Gaussian { sigma: 1.0 }));
    all
}

/// The way that converges fastest, which computes the answer.
pub fn best(plain: &SceneIr, precision: Precision) -> Method {
    let setting = if is_refractive(plain) { Setting::Split } else { Setting::Plain };
    Method { name: "answer".into(), precision, sampler: Sampler::Sobol, setting }
}
