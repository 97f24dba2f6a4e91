//! Shaders whose arithmetic is as written: every operation is rounded by itself, in its order.
//!
//! A compiler may fuse and reorder floating-point operations, and may do so differently in each shader. Two shaders of
//! the same formulas may then round differently, for example with constants compiled in or read from tables. SPIR-V has
//! a decoration against this, NoContraction. WGSL has none, and naga writes none. So on Vulkan this file writes the
//! module itself, decorates it, and hands it to the driver as it is.

use crate::error::{Error, Result};
use crate::gpu::Gpu;
use crate::gpu::compute::Binding;
use naga::back::spv;
use naga::compact::{KeepUnused, compact};
use naga::proc::{BoundsCheckPolicies, BoundsCheckPolicy};
use naga::valid::{Capabilities, ValidationFlags, Validator};
use std::borrow::Cow;
use std::collections::BTreeMap;

/// Words before the first instruction: magic number, version, generator, bound of the ids, schema.
const HEADER: usize = 5;
/// `OpDecorate`, `OpMemberDecorate` and the like.
const DECORATIONS: [u32; 3] = [71, 72, 5632];
/// The first of the opcodes that declare types; with them the annotations end.
const FIRST_TYPE: u32 = 19;
const LAST_TYPE: u32 = 39;
/// The decoration `NoContraction`.
const NO_CONTRACTION: u32 = 42;

/// True for arithmetic on floats: negation, the four operations, remainders, products of vectors and matrices.
fn is_float_arithmetic(opcode: u32) -> bool {
    matches!(opcode, 127 | 129 | 131 | 133 | 136 | 140..=148)
}

/// The instructions of a module: (opcode, index of the first word).
fn instructions(words: &[u32]) -> impl Iterator<Item = (u32, usize)> {
    let mut at = HEADER;
    std::iter::from_fn(move || {
        let first = *words.get(at)?;
        let here = at;
        at += (first >> 16).max(1) as usize;
        Some((first & 0xFFFF, here))
    })
}

/// Decorates the results of all float arithmetic.
pub fn without_contraction(words: &[u32]) -> Vec<u32> {
    let is_place = |opcode: u32| DECORATIONS.contains(&opcode) || (FIRST_TYPE..=LAST_TYPE).contains(&opcode);
    let place = instructions(words).find(|(opcode, _)| is_place(*opcode)).map_or(words.len(), |(_, at)| at);
    let results = instructions(words)
        .filter(|(opcode, _)| is_float_arithmetic(*opcode))
        .filter_map(|(_, at)| words.get(at + 2));
    let decorations = results.flat_map(|&id| [3 << 16 | DECORATIONS[0], id, NO_CONTRACTION]);
    words[..place].iter().copied().chain(decorations).chain(words[place..].iter().copied()).collect()
}

/// A module reduced to one entry point and what that entry point uses.
fn only(module: &naga::Module, entry_point: &str) -> naga::Module {
    let mut own = module.clone();
    own.entry_points.retain(|entry| entry.name == entry_point);
    compact(&mut own, KeepUnused::No);
    own
}

/// The numbers that wgpu gives to the bindings of a group in Vulkan: their positions in the layout.
fn binding_map(bindings: &[Binding]) -> spv::BindingMap {
    let mut next: BTreeMap<u32, u32> = BTreeMap::new();
    let numbered = bindings.iter().map(|binding| {
        let counter = next.entry(binding.group).or_default();
        let info =
            spv::BindingInfo { descriptor_set: binding.group, binding: *counter, binding_array_size: None };
        *counter += 1;
        (naga::ResourceBinding { group: binding.group, binding: binding.number }, info)
    });
    numbered.collect()
}

impl Gpu {
    /// Compiles an entry point and what it uses, without fused or reordered operations. The layouts have the same
    /// bindings.
    ///
    /// Only what is used is compiled, because a driver may go through all functions that it is given. Mesa takes half a
    /// second for the functions of a dozen stages, again for each stage.
    ///
    /// # Errors
    /// [`Error::Usage`] where the device takes no SPIR-V, [`Error::Internal`] if the module is invalid.
    pub fn strict_shader(
        &self,
        entry_point: &str,
        module: &naga::Module,
        bindings: &[Binding],
    ) -> Result<wgpu::ShaderModule> {
        if !self.info.strict {
            return Err(Error::Usage(format!(
                "the adapter `{}` ({}) takes no SPIR-V, which strict arithmetic is written in; use --strict=off, or an \
                 adapter of Vulkan",
                self.info.name, self.info.backend
            )));
        }
        let invalid =
            |error: &dyn std::error::Error| Error::internal("the shader for strict arithmetic", error);
        let module = only(module, entry_point);
        let info = Validator::new(ValidationFlags::all(), Capabilities::all())
            .validate(&module)
            .map_err(|error| invalid(&error))?;
        let words = spv::write_vec(&module, &info, &self.spirv_options(bindings), None)
            .map_err(|error| invalid(&error))?;
        let entry_points = module.entry_points.iter().map(|entry| wgpu::PassthroughShaderEntryPoint {
            name: Cow::Borrowed(entry.name.as_str()),
            workgroup_size: entry.workgroup_size.into(),
        });
        let descriptor = wgpu::ShaderModuleDescriptorPassthrough {
            label: Some(entry_point),
            entry_points: entry_points.collect::<Vec<_>>().into(),
            spirv: Some(without_contraction(&words).into()),
            ..Default::default()
        };
        // SAFETY: naga has validated the module and written it, and decorations change no meaning. The layouts have the
        // same bindings, and indices and loops are bounded as in `Gpu::shader`.
        #[allow(unsafe_code)]
        Ok(unsafe { self.device.create_shader_module_passthrough(descriptor) })
    }

    /// The options with which wgpu's Vulkan backend writes modules.
    fn spirv_options(&self, bindings: &[Binding]) -> spv::Options<'static> {
        let policy =
            if self.runtime_checks { BoundsCheckPolicy::Restrict } else { BoundsCheckPolicy::Unchecked };
        spv::Options {
            lang_version: (1, 3),
            flags: spv::WriterFlags::empty(),
            binding_map: binding_map(bindings),
            bounds_check_policies: BoundsCheckPolicies {
                index: policy,
                buffer: policy,
                image_load: policy,
                binding_array: policy,
            },
            zero_initialize_workgroup_memory: spv::ZeroInitializeWorkgroupMemoryMode::Polyfill,
            force_loop_bounding: self.runtime_checks,
            emit_int_div_checks: self.runtime_checks,
            ..spv::Options::default()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const WGSL: &str = "
        @group(0) @binding(3) var<storage, read_write> x: array<vec3<f32>>;
        @compute @workgroup_size(1)
        fn main(@builtin(global_invocation_id) id: vec3<u32>) {
            let i = id.x + 1u;
            x[i] = 2.0 * x[i] + x[i] * x[i] - dot(x[i], x[i]) / x[i] + vec3<f32>(f32(i32(id.y) - 3));
        }";

    fn written() -> Vec<u32> {
        let module = naga::front::wgsl::parse_str(WGSL).unwrap();
        let info = Validator::new(ValidationFlags::all(), Capabilities::all()).validate(&module).unwrap();
        spv::write_vec(&module, &info, &spv::Options::default(), None).unwrap()
    }

    fn decorated(words: &[u32]) -> Vec<u32> {
        let decorations =
            instructions(words).filter(|(opcode, at)| *opcode == 71 && words[at + 2] == NO_CONTRACTION);
        decorations.map(|(_, at)| words[at + 1]).collect()
    }

    #[test]
    fn every_result_of_float_arithmetic_is_decorated_once() {
        let plain = written();
        let strict = without_contraction(&plain);
        let results: Vec<u32> = instructions(&strict)
            .filter(|(opcode, _)| is_float_arithmetic(*opcode))
            .map(|(_, at)| strict[at + 2])
            .collect();
        // Two products, a dot product, a quotient, three sums and differences.
        assert!(results.len() >= 7, "{results:?}");
        assert_eq!(decorated(&strict), results);
        assert!(decorated(&plain).is_empty());
        assert_eq!(strict.len(), plain.len() + 3 * results.len());
    }

    #[test]
    fn decorations_stand_among_the_annotations() {
        let strict = without_contraction(&written());
        let opcodes: Vec<u32> = instructions(&strict).map(|(opcode, _)| opcode).collect();
        let first = opcodes.iter().position(|opcode| *opcode == 71).unwrap();
        let types = opcodes.iter().position(|opcode| (FIRST_TYPE..=LAST_TYPE).contains(opcode)).unwrap();
        assert!(opcodes[first..types].iter().all(|opcode| DECORATIONS.contains(opcode)), "{opcodes:?}");
    }

    #[test]
    fn bindings_are_counted_group_by_group() {
        let binding = |group, number| Binding { group, number, access: super::super::compute::Access::Read };
        let map = binding_map(&[binding(0, 0), binding(0, 4), binding(0, 12), binding(1, 2)]);
        let numbers: Vec<(u32, u32)> = map.values().map(|info| (info.descriptor_set, info.binding)).collect();
        assert_eq!(numbers, [(0, 0), (0, 1), (0, 2), (1, 0)]);
    }
}
