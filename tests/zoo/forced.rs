//! Options of a trace, and what the CPU backend is forced to do in it.

use crate::zoo;
use nsq_gpu::cpu::{CpuOverrides, Override};
use nsq_gpu::gpu::Gpu;
use nsq_gpu::model::SceneIr;
use nsq_gpu::run::{ForAdapter, Shaders};
use nsq_gpu::{Result, TraceOptions, Tracer};
use std::ops::{Deref, DerefMut};

/// What users ask for, and what tests force.
#[derive(Debug, Clone, Default)]
pub struct Forced {
    /// What users can ask for.
    pub options: TraceOptions,
    /// What tests alone can.
    pub overrides: CpuOverrides,
}

/// Options of a trace, forced or not.
pub trait Asked {
    /// What users can ask for.
    fn trace_options(&self) -> &TraceOptions;

    /// What is forced.
    fn overrides(&self) -> CpuOverrides;

    /// A tracer with a change of its shader.
    fn tracer_with<'a>(
        &self,
        gpu: &'a Gpu,
        ir: &'a SceneIr,
        edit: impl Fn(String) -> String,
    ) -> Result<Tracer<'a>> {
        let shaders = Shaders { cache: None, edit: Some(&edit) };
        Tracer::with(gpu, ir, self.trace_options(), ForAdapter::Forced(&self.overrides()), shaders)
    }

    /// A tracer.
    fn tracer<'a>(&self, gpu: &'a Gpu, ir: &'a SceneIr) -> Result<Tracer<'a>> {
        Tracer::with(
            gpu,
            ir,
            self.trace_options(),
            ForAdapter::Forced(&self.overrides()),
            zoo::shaders_of(gpu),
        )
    }

    /// The same, with other overrides.
    fn with(&self, change: impl FnOnce(&mut CpuOverrides)) -> Forced {
        let mut forced = Forced { options: self.trace_options().clone(), overrides: self.overrides() };
        change(&mut forced.overrides);
        forced
    }

    /// The same, with sums on the device.
    fn on_device(&self) -> Forced {
        self.with(|overrides| overrides.deferred_splats = Override::Never)
    }
}

impl Asked for TraceOptions {
    fn trace_options(&self) -> &TraceOptions {
        self
    }

    fn overrides(&self) -> CpuOverrides {
        CpuOverrides::default()
    }
}

impl Asked for Forced {
    fn trace_options(&self) -> &TraceOptions {
        &self.options
    }

    fn overrides(&self) -> CpuOverrides {
        self.overrides.clone()
    }
}

impl Deref for Forced {
    type Target = TraceOptions;

    fn deref(&self) -> &TraceOptions {
        &self.options
    }
}

impl DerefMut for Forced {
    fn deref_mut(&mut self) -> &mut TraceOptions {
        &mut self.options
    }
}

impl From<TraceOptions> for Forced {
    fn from(options: TraceOptions) -> Self {
        Forced { options, overrides: CpuOverrides::default() }
    }
}
