//! Options of a trace, and what the software wing is forced to do in it.

use nsq_gpu::cpu::{Choices, When};
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
    pub choices: Choices,
}

/// Options of a trace, forced or not.
pub trait Asked {
    /// What users can ask for.
    fn trace_options(&self) -> &TraceOptions;

    /// What is forced.
    fn choices(&self) -> Choices;

    /// A tracer with a change of its shader.
    fn tracer_with<'a>(
        &self,
        gpu: &'a Gpu,
        ir: &'a SceneIr,
        edit: impl Fn(String) -> String,
    ) -> Result<Tracer<'a>> {
        let shaders = Shaders { cache: None, edit: Some(&edit) };
        Tracer::with(gpu, ir, self.trace_options(), ForAdapter::Forced(&self.choices()), shaders)
    }

    /// A tracer.
    fn tracer<'a>(&self, gpu: &'a Gpu, ir: &'a SceneIr) -> Result<Tracer<'a>> {
        self.tracer_with(gpu, ir, |wgsl| wgsl)
    }

    /// The same, with other choices.
    fn with(&self, change: impl FnOnce(&mut Choices)) -> Forced {
        let mut forced = Forced { options: self.trace_options().clone(), choices: self.choices() };
        change(&mut forced.choices);
        forced
    }

    /// The same, with sums on the device.
    fn on_device(&self) -> Forced {
        self.with(|choices| choices.host_sums = When::Never)
    }
}

impl Asked for TraceOptions {
    fn trace_options(&self) -> &TraceOptions {
        self
    }

    fn choices(&self) -> Choices {
        Choices::default()
    }
}

impl Asked for Forced {
    fn trace_options(&self) -> &TraceOptions {
        &self.options
    }

    fn choices(&self) -> Choices {
        self.choices.clone()
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
        Forced { options, choices: Choices::default() }
    }
}
