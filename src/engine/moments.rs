//! Decides where the second moments of a trace come from. Standard errors follow from second moments.

use crate::engine::options::{StandardError, TraceOptions};
use crate::model::surface_optics::splits;
use crate::model::{Detector, SceneIr, Splat};
use crate::program::layout::{bsdf, tables};
use crate::program::{Features, Sampler, SecondMoments};

/// Where second moments come from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum MomentSource {
    /// There are none: nobody asked for them.
    Nowhere,
    /// The hits determine them: every ray keeps the same weight, and ends in one cell.
    Hits,
    /// The device sums them.
    Device,
    /// The device keeps a sum for each of several scrambles of the Sobol points.
    Replicates,
}

impl MomentSource {
    pub(crate) fn of(
        ir: &SceneIr,
        options: &TraceOptions,
        weights: &[f64],
        roulette_threshold: f64,
        draws_branches: bool,
    ) -> Self {
        let features = || Features::of(ir, weights, roulette_threshold, options.max_depth);
        let keeps_weight = || features().with_branches_drawn(draws_branches).keeps_weight;
        let is_cheap = !splits(ir) && ir.detectors.iter().all(tables::takes_rays_whole);
        let is_needed = hits_do_not_give_errors(ir);
        match options.standard_error {
            StandardError::Off => MomentSource::Nowhere,
            asked if options.sampler == Sampler::Sobol => match asked {
                StandardError::On => MomentSource::Replicates,
                StandardError::Auto | StandardError::Off => MomentSource::Nowhere,
            },
            _ if tables::cells_hold_totals(ir) && keeps_weight() => MomentSource::Hits,
            StandardError::Auto if !is_cheap && !is_needed => MomentSource::Nowhere,
            StandardError::Auto | StandardError::On => MomentSource::Device,
        }
    }

    /// What the device has to sum.
    pub(crate) fn on_device(self) -> SecondMoments {
        match self {
            MomentSource::Nowhere | MomentSource::Hits => SecondMoments::None,
            MomentSource::Device => SecondMoments::Squares,
            MomentSource::Replicates => SecondMoments::Replicates,
        }
    }
}

/// True where a table or a Harvey-Shack lobe leaves rays without weight, which hit detectors, or where rays that scatter on
/// purpose weigh little. The number of hits then says nothing about the error. False where squares would be many or expensive.
fn hits_do_not_give_errors(ir: &SceneIr) -> bool {
    const MOST_CELLS: usize = 1 << 22;
    let is_near = |detector: &Detector| {
        detector.absorb
            && detector.kind.grid().is_none_or(|grid| !matches!(grid.splat, Splat::Gaussian { .. }))
    };
    let takes_whole_weights = || bsdf::scatters(ir).any(|scatter| scatter.bsdf.takes_whole_weights());
    (!ir.scatter_sampling.is_empty() || takes_whole_weights())
        && !splits(ir)
        && ir.detectors.iter().all(is_near)
        && ir.detectors.iter().map(Detector::num_cells).sum::<usize>() <= MOST_CELLS
}
