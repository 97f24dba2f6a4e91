//! Validation with the capabilities of a tier, and translation for each platform with the options that wgpu uses there.

use naga::back::{hlsl, msl, pipeline_constants, spv, wgsl};
use naga::proc::{BoundsCheckPolicies, BoundsCheckPolicy};
use naga::valid::{Capabilities, ModuleInfo, ValidationFlags, Validator};
use naga::{AddressSpace, Module};
use nsq_gpu::program::layout::bindings;
use nsq_gpu::program::{Precision, Program, ProgramOptions};
use std::collections::{BTreeMap, BTreeSet};

/// Storage buffers that plain WebGPU binds per stage.
pub const WEBGPU_STORAGE_BUFFERS: usize = 8;
/// Storage buffers of the portable shader of everything at once: compiled in, and in tables. The table of facets in contact is
/// one of them.
pub const MOST_STORAGE_BUFFERS: (usize, usize) = (12, 12);

/// What shaders are written as.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Target {
    SpirV,
    Msl,
    Hlsl,
    Wgsl,
}

impl Target {
    /// The targets that can say what the options ask for. Metal has neither f64 nor sums by 64-bit atomics.
    pub fn of(options: &ProgramOptions) -> Vec<Target> {
        match (options.precision, options.native) {
            (Precision::F32 | Precision::Df64, false) => {
                vec![Target::SpirV, Target::Msl, Target::Hlsl, Target::Wgsl]
            }
            (Precision::F32 | Precision::Df64, true) => vec![Target::SpirV, Target::Hlsl, Target::Wgsl],
            (Precision::F64, _) => vec![Target::SpirV, Target::Hlsl, Target::Wgsl],
        }
    }

    /// Writes a program, with run-time checks or without.
    pub fn write(self, name: &str, program: &Program, info: &ModuleInfo, checks: bool) {
        self.translate(&program.module, info, program.options.native, checks)
            .unwrap_or_else(|error| panic!("{name}: {self:?}: {error}"));
    }

    fn translate(self, module: &Module, info: &ModuleInfo, native: bool, checks: bool) -> Result<(), String> {
        match self {
            Target::SpirV => spir_v(module, info, checks),
            Target::Msl => metal(module, info, checks),
            Target::Hlsl => hlsl(module, info, native, checks),
            Target::Wgsl => round_trip(module, info),
        }
    }
}

/// What the tier may use, and nothing else.
pub fn capabilities(options: &ProgramOptions) -> Capabilities {
    let floats = match options.precision {
        Precision::F32 | Precision::Df64 => Capabilities::empty(),
        Precision::F64 => Capabilities::FLOAT64,
    };
    let integers = match options.native {
        true => Capabilities::SHADER_INT64 | Capabilities::SHADER_INT64_ATOMIC_ALL_OPS,
        false => Capabilities::empty(),
    };
    floats | integers
}

/// Validates; also that no two variables share a binding but those of the log, which stages write as unlike types: that none
/// uses both is seen by naga.
pub fn validate(name: &str, program: &Program) -> ModuleInfo {
    let mut bindings = BTreeSet::new();
    for (_, variable) in program.module.global_variables.iter() {
        if let Some(binding) = variable.binding {
            assert!(
                bindings.insert((binding.group, binding.binding)) || binding.binding == bindings::LOG,
                "{name}: two variables at {binding:?}"
            );
        }
    }
    Validator::new(ValidationFlags::all(), capabilities(&program.options))
        .validate(&program.module)
        .unwrap_or_else(|error| panic!("{name}: {}", error.emit_to_string(&program.wgsl)))
}

/// Storage buffers of the pipeline layout: every one that is declared counts.
pub fn storage_buffers(module: &Module) -> usize {
    module.global_variables.iter().filter(|(_, v)| matches!(v.space, AddressSpace::Storage { .. })).count()
}

fn policies(checks: bool) -> BoundsCheckPolicies {
    let policy = if checks { BoundsCheckPolicy::Restrict } else { BoundsCheckPolicy::Unchecked };
    BoundsCheckPolicies {
        index: policy,
        buffer: policy,
        image_load: policy,
        binding_array: BoundsCheckPolicy::Unchecked,
    }
}

/// Vulkan 1.1 has SPIR-V 1.3. The capabilities are those that wgpu lets a device with the tier's features use.
fn spir_v(module: &Module, info: &ModuleInfo, checks: bool) -> Result<(), String> {
    let options = spv::Options {
        lang_version: (1, 3),
        bounds_check_policies: policies(checks),
        force_loop_bounding: checks,
        ..Default::default()
    };
    let words = spv::write_vec(module, info, &options, None).map_err(|error| error.to_string())?;
    if words.len() > 100 { Ok(()) } else { Err("an empty module".into()) }
}

/// Every buffer and image at a slot of its own, and the buffers' sizes behind them, as wgpu lays them out.
fn metal(module: &Module, info: &ModuleInfo, checks: bool) -> Result<(), String> {
    let resources: msl::BindingMap = numbered(module)
        .map(|(slot, binding)| {
            (
                binding,
                msl::BindTarget {
                    buffer: Some(slot as msl::Slot),
                    texture: Some(slot as msl::Slot),
                    mutable: true,
                    ..Default::default()
                },
            )
        })
        .collect();
    let sizes_buffer = Some(resources.len() as msl::Slot);
    for entry in &module.entry_points {
        let entry_resources =
            msl::EntryPointResources { resources: resources.clone(), immediates_buffer: None, sizes_buffer };
        let options = msl::Options {
            lang_version: (2, 3),
            fake_missing_bindings: false,
            per_entry_point_map: BTreeMap::from([(entry.name.clone(), entry_resources)]),
            bounds_check_policies: policies(checks),
            force_loop_bounding: checks,
            ..Default::default()
        };
        let pipeline = msl::PipelineOptions {
            entry_point: Some((entry.stage, entry.name.clone())),
            ..Default::default()
        };
        let (_, translation) =
            msl::write_string(module, info, &options, &pipeline).map_err(|error| error.to_string())?;
        translation
            .entry_point_names
            .into_iter()
            .try_for_each(|name| name.map(|_| ()).map_err(|e| e.to_string()))?;
    }
    Ok(())
}

/// Shader model 6.0 where nothing native is used; 64-bit atomics came with 6.6.
fn hlsl(module: &Module, info: &ModuleInfo, native: bool, checks: bool) -> Result<(), String> {
    let binding_map = numbered(module)
        .map(|(register, binding)| {
            (binding, hlsl::BindTarget { register: register as u32, ..Default::default() })
        })
        .collect();
    let options = hlsl::Options {
        shader_model: if native { hlsl::ShaderModel::V6_6 } else { hlsl::ShaderModel::V6_0 },
        fake_missing_bindings: false,
        special_constants_binding: Some(hlsl::BindTarget { register: 99, ..Default::default() }),
        binding_map,
        restrict_indexing: checks,
        force_loop_bounding: checks,
        ..Default::default()
    };
    for entry in &module.entry_points {
        let pipeline = hlsl::PipelineOptions { entry_point: Some((entry.stage, entry.name.clone())) };
        let mut text = String::new();
        hlsl::Writer::new(&mut text, &options, &pipeline)
            .write(module, info, None)
            .map_err(|error| error.to_string())?;
    }
    Ok(())
}

/// What is written as WGSL reads back as a valid module with the same entry points.
fn round_trip(module: &Module, info: &ModuleInfo) -> Result<(), String> {
    let text =
        wgsl::write_string(module, info, wgsl::WriterFlags::empty()).map_err(|error| error.to_string())?;
    let again = naga::front::wgsl::parse_str(&text).map_err(|error| error.emit_to_string(&text))?;
    let names = |module: &Module| -> Vec<String> {
        module.entry_points.iter().map(|entry| entry.name.clone()).collect()
    };
    if names(&again) == names(module) { Ok(()) } else { Err("entry points are lost".into()) }
}

fn numbered(module: &Module) -> impl Iterator<Item = (usize, naga::ResourceBinding)> {
    module.global_variables.iter().filter_map(|(_, variable)| variable.binding).enumerate()
}

/// The shader between two dispatches, its workgroup size filled in.
pub fn check_advance() {
    let text = &nsq_gpu::program::wgsl::compose::advance();
    let module = naga::front::wgsl::parse_str(text).unwrap();
    let info = Validator::new(ValidationFlags::all(), Capabilities::empty()).validate(&module).unwrap();
    let constants = [("workgroup_size".to_string(), 128.0)].into_iter().collect();
    let (module, info) = pipeline_constants::process_overrides(&module, &info, None, &constants).unwrap();
    for target in [Target::SpirV, Target::Msl, Target::Hlsl, Target::Wgsl] {
        for checks in [true, false] {
            target
                .translate(&module, &info, false, checks)
                .unwrap_or_else(|error| panic!("{target:?}: {error}"));
        }
    }
}
