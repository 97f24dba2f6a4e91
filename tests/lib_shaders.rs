//! Every combination of the shared shader files is valid, and the portable one asks for no 64-bit capability.

use naga::valid::{Capabilities, ValidationFlags, Validator};
use nsq_gpu::program::library::{Integers, Real, source};

const INT64: Capabilities = Capabilities::SHADER_INT64.union(Capabilities::SHADER_INT64_ATOMIC_ALL_OPS);

fn validate(real: Real, integers: Integers, capabilities: Capabilities) {
    let source = source(real, integers);
    let module = naga::front::wgsl::parse_str(&source)
        .unwrap_or_else(|error| panic!("{real:?} {integers:?}: {}", error.emit_to_string(&source)));
    Validator::new(ValidationFlags::all(), capabilities)
        .validate(&module)
        .unwrap_or_else(|error| panic!("{real:?} {integers:?}: {}", error.emit_to_string(&source)));
}

#[test]
fn every_combination_is_valid_with_the_capabilities_of_its_tier_alone() {
    validate(Real::F32, Integers::Portable, Capabilities::empty());
    validate(Real::F32, Integers::Native, INT64);
    validate(Real::F64, Integers::Portable, Capabilities::FLOAT64);
    validate(Real::F64, Integers::Native, Capabilities::FLOAT64 | INT64);
}
