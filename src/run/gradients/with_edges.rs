//! Derivatives of a scene with what crosses edges: by differences of two traces.

use crate::engine::options::TraceOptions;
use crate::error::Result;
use crate::gpu::Gpu;
use crate::result::Gradient;
use crate::run::PipelineCache;
use crate::run::gradients::edges::{self, LossWithEdges, MOST_CHECK_RAYS};
use crate::run::gradients::scaled::Scaled;
use crate::run::gradients::{Differentiated, LossGradient};

impl Differentiated {
    /// Adds to derivatives what a difference of two traces gives in their place, which sees what moves across edges, too.
    /// `keep_going` gets the rays done of both traces for all parameters.
    ///
    /// # Errors
    /// [`crate::Error::Interrupted`] if a trace was ended. [`crate::Error::Device`] if the device fails.
    pub fn add_edges(
        &self,
        gpu: &Gpu,
        options: &TraceOptions,
        cache: Option<&PipelineCache>,
        gradients: &mut [Gradient],
        keep_going: impl FnMut(u64) -> bool,
    ) -> Result<()> {
        edges::add(&self.parameters, gpu, &self.edge_options(options, cache), cache, gradients, keep_going)
    }

    /// The derivatives of a loss by differences of two traces, as [`Differentiated::add_edges`] finds them. `adjoints`
    /// are as in [`Differentiated::loss_gradient`].
    ///
    /// # Errors
    /// As [`Differentiated::add_edges`].
    pub fn loss_with_edges(
        &self,
        gpu: &Gpu,
        options: &TraceOptions,
        cache: Option<&PipelineCache>,
        adjoints: &[Vec<f64>],
        keep_going: impl FnMut(u64) -> bool,
    ) -> Result<Vec<LossWithEdges>> {
        self.check_adjoints(adjoints)?;
        let options = self.edge_options(options, cache);
        edges::of_loss(&self.parameters, gpu, &options, cache, adjoints, false, keep_going)
    }

    /// Derivatives of a loss that a short difference of two traces does not confirm, by the numbers of their parameters: light
    /// crosses edges. `found` is what [`Differentiated::loss_gradient`] has found. The rays are the first of its own.
    ///
    /// # Errors
    /// As [`Differentiated::add_edges`].
    pub fn not_confirmed(
        &self,
        gpu: &Gpu,
        options: &TraceOptions,
        cache: Option<&PipelineCache>,
        adjoints: &[Vec<f64>],
        found: &LossGradient,
        keep_going: impl FnMut(u64) -> bool,
    ) -> Result<Vec<(usize, LossWithEdges)>> {
        let num_rays = options.num_rays.min(MOST_CHECK_RAYS);
        let few =
            TraceOptions { num_rays, of_rays: Some(options.budget()), ..self.edge_options(options, cache) };
        let with_edges = edges::of_loss(&self.parameters, gpu, &few, cache, adjoints, true, keep_going)?;
        let least = self.least(options.precision, adjoints);
        let all = with_edges.into_iter().zip(&found.values).zip(&self.parameters).enumerate();
        let is_apart = |(number, ((edges, value), scaled)): (usize, ((LossWithEdges, &f64), &Scaled))| {
            let is_seen = (edges.value - value).abs() * scaled.size > least;
            (is_seen && edges.differs_from(*value)).then_some((number, edges))
        };
        Ok(all.filter_map(is_apart).collect())
    }

    /// Options of two traces that are compared: with live numbers where compiled shaders are kept.
    fn edge_options(&self, options: &TraceOptions, cache: Option<&PipelineCache>) -> TraceOptions {
        TraceOptions { live: cache.is_some(), ..self.traced_options(options) }
    }
}
