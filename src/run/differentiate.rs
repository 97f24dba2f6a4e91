//! Runs that differentiate: what detectors record, or a loss.

use crate::error::{Error, Result};
use crate::result::{Gradient, RunInfo, StoppedBy, Tally, TraceResult};
use crate::run::gradients::{Differentiated, How, LossGradient, LossWithEdges};
use crate::run::{Next, Run, Settled, Status, TraceOptions};
use std::time::Instant;

/// How derivatives of what detectors record are found.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct DerivativeOptions {
    /// No standard errors, which short traces spend most of their time on.
    pub without_errors: bool,
    /// Each derivative is also found by a difference of two traces, which sees light that crosses edges.
    pub with_edges: bool,
}

/// Derivatives of what detectors record, before they are a result.
pub struct Differentiation<'d> {
    scene: &'d Differentiated,
    /// The derivatives.
    pub gradients: Vec<Gradient>,
    /// The options that the scene was traced with.
    pub options: TraceOptions,
    tally: Tally,
    /// How the scene was traced. Warnings may be added.
    pub info: RunInfo,
}

/// The gradient of a loss, and what light does that crosses edges.
#[derive(Debug, Clone, PartialEq)]
pub struct LossDerivatives {
    /// The gradient.
    pub gradient: LossGradient,
    /// By differences of two traces, parameter by parameter, where that was asked for.
    pub with_edges: Vec<LossWithEdges>,
    /// Parameters whose derivatives a short difference of two traces does not confirm, where that was asked for.
    pub not_confirmed: Vec<(usize, LossWithEdges)>,
}

impl Differentiation<'_> {
    /// The result.
    ///
    /// # Errors
    /// [`Error::Internal`] if the sums belong to another scene.
    pub fn into_result(self) -> Result<TraceResult> {
        let result = TraceResult::new(&self.scene.ir, &self.info, &self.tally)?;
        Ok(TraceResult { gradients: self.gradients, ..result })
    }
}

impl Run<'_> {
    /// Differentiates what detectors record. The run is one of the differentiated scene
    /// ([`Differentiated::run`]). `next` gets how far the trace has come, and says how to go on. After a
    /// stop there is what was found so far.
    ///
    /// # Errors
    /// As [`Run::go`] and [`Differentiated::gradients`]. [`Error::Interrupted`] if the trace was cancelled.
    pub fn differentiate<'d>(
        &self,
        scene: &'d Differentiated,
        DerivativeOptions { without_errors, with_edges }: DerivativeOptions,
        mut next: impl FnMut(&Status) -> Next,
    ) -> Result<Differentiation<'d>> {
        let gpu = self.device()?;
        let Settled { options, info } = self.settle_unguided(&gpu)?;
        let how = How { cache: self.cache, without_errors, with_edges, ..How::default() };
        let of_edges = if with_edges { 2 * scene.num_parameters() } else { 0 };
        let num_rays = (scene.num_passes() + of_edges) * options.num_rays;
        let start = Instant::now();
        let (mut last, mut is_first) = (Next::GoOn, true);
        let mut keep_going = |rays| {
            last = next(&Status::of_rays(rays, num_rays, start.elapsed()));
            // A stop while shaders are compiled still has rays to keep.
            let is_first = std::mem::take(&mut is_first);
            last == Next::GoOn || last == Next::Stop && is_first
        };
        let (mut gradients, tally) = scene.gradients(&gpu, &options, how, &mut keep_going)?;
        let has_all = gradients.len() as u64 == scene.num_parameters() * scene.ir.detectors.len() as u64;
        let mut is_whole = has_all && tally.launched.count == options.num_rays;
        if with_edges && is_whole {
            let done = scene.num_passes() * options.num_rays;
            let keep_going = |rays| keep_going(done + rays);
            match scene.add_edges(&gpu, &options, self.cache, &mut gradients, keep_going) {
                Err(Error::Interrupted) => is_whole = false,
                added => added?,
            }
        }
        if !is_whole && last == Next::Cancel {
            return Err(Error::Interrupted);
        }
        let info = RunInfo {
            partial: !is_whole,
            stopped_by: (!is_whole).then_some(StoppedBy::Interrupt),
            trace_time_sec: start.elapsed().as_secs_f64(),
            ..info
        };
        Ok(Differentiation { scene, gradients, options, tally, info })
    }

    /// Differentiates a loss. `adjoints` says for each detector what the loss gains by a watt in each cell \[1/W\]. With
    /// `check_edges`, a short difference of two traces checks each derivative. `next` as in [`Run::differentiate`]; a stop
    /// leaves nothing.
    ///
    /// # Errors
    /// As [`Run::go`] and [`Differentiated::loss_gradient`]. [`Error::Interrupted`] if the trace was ended.
    pub fn loss_gradient(
        &self,
        scene: &Differentiated,
        adjoints: &[Vec<f64>],
        with_edges: bool,
        check_edges: bool,
        mut next: impl FnMut(&Status) -> Next,
    ) -> Result<LossDerivatives> {
        let gpu = self.device()?;
        let options = self.settle_unguided(&gpu)?.options;
        let how = How { cache: self.cache, with_edges, ..How::default() };
        let of_edges = if with_edges { 2 * scene.num_parameters() } else { 0 };
        let num_rays = options.num_rays * (1 + of_edges);
        let start = Instant::now();
        let mut keep_going = |rays| next(&Status::of_rays(rays, num_rays, start.elapsed())) == Next::GoOn;
        let gradient = scene.loss_gradient(&gpu, &options, how, adjoints, &mut keep_going)?;
        let (mut edges, mut not_confirmed) = (Vec::new(), Vec::new());
        let (own, cache) = (options.num_rays, self.cache);
        if with_edges {
            edges = scene.loss_with_edges(&gpu, &options, cache, adjoints, |rays| keep_going(own + rays))?;
        } else if check_edges {
            let keep_going = |_| keep_going(own);
            not_confirmed = scene.not_confirmed(&gpu, &options, cache, adjoints, &gradient, keep_going)?;
        }
        Ok(LossDerivatives { gradient, with_edges: edges, not_confirmed })
    }
}

impl Differentiated {
    /// A run of the scene, for [`Run::differentiate`] and [`Run::loss_gradient`].
    pub fn run(&self) -> Run<'_> {
        Run::of(&self.scene, &self.ir)
    }
}
