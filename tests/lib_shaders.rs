//! Every combination of the shared shader files is valid, and the portable one asks for no 64-bit capability.

#![allow(clippy::panic, reason = "helpers of tests, outside of #[test]")]

use naga::back::{hlsl, msl, spv};
use naga::valid::{Capabilities, ModuleInfo, ValidationFlags, Validator};
use nsq_gpu::program::layout::rng::Sampler;
use nsq_gpu::program::rewrite::df64;
use nsq_gpu::program::wgsl::library::{Integers, Real, source};

const INT64: Capabilities = Capabilities::SHADER_INT64.union(Capabilities::SHADER_INT64_ATOMIC_ALL_OPS);

fn validate(
    real: Real,
    integers: Integers,
    sampler: Sampler,
    capabilities: Capabilities,
) -> (naga::Module, ModuleInfo) {
    let source = source(real, integers, sampler);
    let mut module = naga::front::wgsl::parse_str(&source)
        .unwrap_or_else(|error| panic!("{real:?} {integers:?}: {}", error.emit_to_string(&source)));
    if real == Real::Df64 {
        (module, _) = df64::rewrite(&module).expect("every operation has a counterpart");
    }
    let info = Validator::new(ValidationFlags::all(), capabilities)
        .validate(&module)
        .unwrap_or_else(|error| panic!("{real:?} {integers:?}: {}", error.emit_to_string(&source)));
    (module, info)
}

#[test]
fn every_combination_is_valid_with_the_capabilities_of_its_tier_alone() {
    for sampler in [Sampler::Pcg, Sampler::Sobol] {
        validate(Real::F32, Integers::Portable, sampler, Capabilities::empty());
        validate(Real::F32, Integers::Native, sampler, INT64);
        validate(Real::Df64, Integers::Portable, sampler, Capabilities::empty());
        validate(Real::Df64, Integers::Native, sampler, INT64);
        validate(Real::F64, Integers::Portable, sampler, Capabilities::FLOAT64);
        validate(Real::F64, Integers::Native, sampler, Capabilities::FLOAT64 | INT64);
    }
}

#[test]
fn portable_library_translates_for_every_platform() {
    for sampler in [Sampler::Pcg, Sampler::Sobol] {
        let (module, info) = validate(Real::F32, Integers::Portable, sampler, Capabilities::empty());
        spv::write_vec(&module, &info, &spv::Options::default(), None).expect("SPIR-V");
        // As in tests/portability/targets.rs.
        let options = msl::Options { lang_version: (2, 3), ..Default::default() };
        msl::write_string(&module, &info, &options, &msl::PipelineOptions::default()).expect("MSL");
        let (options, pipeline) = (hlsl::Options::default(), hlsl::PipelineOptions::default());
        let mut text = String::new();
        hlsl::Writer::new(&mut text, &options, &pipeline).write(&module, &info, None).expect("HLSL");
    }
}
