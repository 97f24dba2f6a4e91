//! An addition to the plain loop: rays are guided to rare light, such as the ghosts of coated lenses.
//!
//! A pilot learns from tables of paths with which probability a ray should reflect at each face ([`learn`]). What was learned is
//! a table ([`Guide`]), which a trace only reads: so parts of a trace, workers and resumed traces draw the same rays.

pub mod learn;
pub mod wgsl;

pub use crate::model::guide::{self as table, Guide};

use crate::engine::addition::Addition;
use crate::engine::options::{Collect, TraceOptions};
use crate::engine::plan::TracePlan;
use crate::engine::stages::ExtraBindings;
use crate::error::{Error, Result};
use crate::gpu::Gpu;
use crate::guide::learn::MOST_EXPLORED;
use crate::guide::wgsl::GuideShader;
use crate::model::guide::fits;
use crate::model::surface_optics::splits;
use crate::model::{ReflectProb, SceneIr};
use crate::program::ProgramOptions;
use crate::program::addition::{ProgramAddition, ShaderAddition};
use crate::program::input::ProgramInput;
use crate::program::layout::bindings;
use std::sync::Arc;

/// The addition.
#[derive(Debug, Clone)]
pub struct Guided {
    guide: Arc<Guide>,
    is_filtered: bool,
}

impl Guided {
    /// What options ask for; `None` if rays are not guided.
    pub fn of(options: &TraceOptions) -> Option<Self> {
        let guide = options.guide.clone()?;
        Some(Guided { guide, is_filtered: options.path_filter.is_some() })
    }
}

impl ProgramAddition for Guided {
    fn draws_branches(&self) -> bool {
        true
    }

    fn shader(&self, _scene: &ProgramInput) -> Arc<dyn ShaderAddition> {
        Arc::new(GuideShader { is_filtered: self.is_filtered })
    }
}

impl Addition for Guided {
    fn specialise(
        &mut self,
        _gpu: &Gpu,
        ir: &SceneIr,
        options: &TraceOptions,
        _program: &mut ProgramOptions,
        _is_alone: bool,
    ) -> Result<()> {
        check(ir, options)?;
        self.guide.check(ir)
    }

    fn open(&mut self, gpu: &Gpu, _plan: &TracePlan) -> Result<ExtraBindings> {
        let words = self.guide.words();
        let buffer = gpu.buffer("the guide", 4 * words.len() as u64)?;
        gpu.queue.write_buffer(&buffer, 0, bytemuck::cast_slice(words));
        Ok(ExtraBindings::of([(bindings::GUIDE, buffer)]))
    }
}

/// Refuses what cannot be guided.
///
/// # Errors
/// [`Error::Usage`] with what to leave out.
pub fn check(ir: &SceneIr, options: &TraceOptions) -> Result<()> {
    let usage = |text: &str| Err(Error::Usage(text.into()));
    if ir.sampling.reflect_prob != ReflectProb::Fresnel {
        return usage(
            "a guide chooses the probability of each reflection, and so does reflect_prob; leave one of them out (--reflect-prob fresnel)",
        );
    }
    if ir.scatter_sampling.iter().any(|sampling| sampling.prob.is_some()) {
        return usage(
            "a guide chooses the probability of scattering, and so does scatter_prob; leave one of them out (of the scene, or --scatter-prob)",
        );
    }
    if splits(ir) {
        return usage(
            "a guide chooses one branch of two, and split_depth follows both; leave one of them out (--split-depth 0)",
        );
    }
    if !fits(1 + ir.sources.len() + MOST_EXPLORED, ir) {
        return usage(
            "the scene has so many sources and faces that a guide for them would be larger than 64 MiB; leave out the guide",
        );
    }
    if matches!(options.collect, Collect::Tangents(_) | Collect::Adjoints) {
        return usage("derivatives take rays that are not guided; leave out the guide");
    }
    Ok(())
}
