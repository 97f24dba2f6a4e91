//! Every combination of the shared shader files is valid, and the portable one asks for no 64-bit capability.

#![allow(clippy::panic, reason = "helpers of tests, outside of #[test]")]

use naga::back::{hlsl, msl, spv};
use naga::valid::{Capabilities, ModuleInfo, ValidationFlags, Validator};
use nsq_gpu::program::library::{Integers, Real, source};

const INT64: Capabilities = Capabilities::SHADER_INT64.union(Capabilities::SHADER_INT64_ATOMIC_ALL_OPS);

fn validate(real: Real, integers: Integers, capabilities: Capabilities) -> (naga::Module, ModuleInfo) {
    let source = source(real, integers);
    let module = naga::front::wgsl::parse_str(&source)
        .unwrap_or_else(|error| panic!("{real:?} {integers:?}: {}", error.emit_to_string(&source)));
    let info = Validator::new(ValidationFlags::all(), capabilities)
        .validate(&module)
        .unwrap_or_else(|error| panic!("{real:?} {integers:?}: {}", error.emit_to_string(&source)));
    (module, info)
}

#[test]
fn every_combination_is_valid_with_the_capabilities_of_its_tier_alone() {
    validate(Real::F32, Integers::Portable, Capabilities::empty());
    validate(Real::F32, Integers::Native, INT64);
    validate(Real::F64, Integers::Portable, Capabilities::FLOAT64);
    validate(Real::F64, Integers::Native, Capabilities::FLOAT64 | INT64);
}

#[test]
fn portable_library_translates_for_every_platform() {
    let (module, info) = validate(Real::F32, Integers::Portable, Capabilities::empty());
    spv::write_vec(&module, &info, &spv::Options::default(), None).expect("SPIR-V");
    msl::write_string(&module, &info, &msl::Options::default(), &msl::PipelineOptions::default())
        .expect("MSL");
    let (options, pipeline) = (hlsl::Options::default(), hlsl::PipelineOptions::default());
    let mut text = String::new();
    hlsl::Writer::new(&mut text, &options, &pipeline).write(&module, &info, None).expect("HLSL");
}
