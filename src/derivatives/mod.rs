//! An addition to the plain loop: derivatives by numbers of the scene.
//!
//! [`Tangents`](Derivatives::Tangents) go beside every real, and their sums beside the sums of weights: what a few
//! parameters do to every pixel. [`Adjoints`](Derivatives::Adjoints) walk rays back ([`walk`]): what every number does to
//! one loss. Both need the parameter Jacobian ([`jacobian`]) of the program's numbers. The compilers that rewrite the
//! shader are in `program::rewrite`, and docs/methods/derivatives.md says why.

pub(crate) mod jacobian;
pub(crate) mod walk;
mod wgsl;

use crate::derivatives::jacobian::{add_tangents, composed_in_f64};
use crate::derivatives::wgsl::DerivativeShader;
use crate::engine::addition::Addition;
use crate::engine::options::{Collect, TraceOptions};
use crate::error::{Error, Result};
use crate::gpu::Gpu;
use crate::model::SceneIr;
use crate::program::addition::{ProgramAddition, ShaderAddition};
use crate::program::input::ProgramInput;
use crate::program::layout::tables::Cells;
use crate::program::rewrite::jvp::Tangents;
use crate::program::{Features, Program, ProgramOptions, SecondMoments};
use std::sync::Arc;

/// Most rays that an invocation walks back, one after the other, before it writes sums of adjoints. The number does not depend on
/// the adapter, because the bits of the sums depend on it.
const MOST_RAYS_WALKED_BACK: u64 = 64;
/// Iterations of loops that an invocation is to make at most on its ways forward and back. Where one ray is lost, all rays
/// are walked twice.
const MOST_ITERATIONS_WALKED_BACK: u64 = 1 << 14;

/// The addition.
#[derive(Debug, Clone)]
pub enum Derivatives {
    /// Derivatives of all sums by some parameters, in forward mode.
    Tangents(Arc<Tangents>),
    /// Derivatives of a loss by all numbers, in reverse mode.
    Adjoints,
}

impl Derivatives {
    /// The derivatives that options ask for, if they do.
    pub fn of(options: &TraceOptions) -> Option<Self> {
        match &options.collect {
            Collect::Tangents(tangents) => Some(Derivatives::Tangents(tangents.clone())),
            Collect::Adjoints => Some(Derivatives::Adjoints),
            Collect::Light | Collect::Paths { .. } | Collect::PathMaps(_) | Collect::Events { .. } => None,
        }
    }

    /// The number of tangents beside each real: 0 in reverse mode.
    fn num_tangents(&self) -> u32 {
        match self {
            Derivatives::Tangents(tangents) => tangents.num(),
            Derivatives::Adjoints => 0,
        }
    }
}

impl ProgramAddition for Derivatives {
    fn adapt_options(&self, features: &Features, options: &mut ProgramOptions) {
        // Rays that wait in a queue have no tangents.
        options.events_per_dispatch = options.max_depth;
        // Derivatives read all numbers at every event.
        options.copies_numbers = true;
        // The trace of the light has counted them already.
        options.counts_wrong_sides = false;
        match self {
            // The copies of cells hold tangents.
            Derivatives::Tangents(_) => options.moments = SecondMoments::None,
            Derivatives::Adjoints => {
                options.fixed_rays_per_invocation = Some(rays_walked_back(features, options));
                options.has_long_loops = true;
            }
        }
    }

    fn cells(&self, cells: Cells) -> Result<Cells> {
        match self {
            Derivatives::Tangents(tangents) => cells.with_tangents(tangents.num()),
            Derivatives::Adjoints => Ok(cells),
        }
    }

    fn sums_weights(&self) -> bool {
        true
    }

    fn shader(&self, scene: &ProgramInput) -> Arc<dyn ShaderAddition> {
        Arc::new(DerivativeShader::new(self.num_tangents(), scene))
    }
}

impl Addition for Derivatives {
    fn specialise(
        &mut self,
        _gpu: &Gpu,
        ir: &SceneIr,
        options: &TraceOptions,
        program: &mut ProgramOptions,
        _is_alone: bool,
    ) -> Result<()> {
        let no_way_back = |what: &str| Err(Error::NoWayBack(what.into()));
        match self {
            Derivatives::Tangents(_) => Ok(()),
            // The path of a ray is known at its end alone, and not where the ray passes a detector.
            Derivatives::Adjoints
                if options.path_filter.is_some() && ir.detectors.iter().any(|detector| !detector.absorb) =>
            {
                no_way_back("a filter of paths and detectors that light passes")
            }
            Derivatives::Adjoints if !program.baked => no_way_back("a table of many surfaces"),
            Derivatives::Adjoints => Ok(()),
        }
    }

    fn pack(
        &self,
        ir: &SceneIr,
        options: &TraceOptions,
        program: &mut Program,
        all: &[&dyn ProgramAddition],
    ) -> Result<()> {
        let Derivatives::Tangents(tangents) = self else { return Ok(()) };
        let base = composed_in_f64(ir, options, program, all)?;
        add_tangents(options, program, &base, &tangents.parameters, all)
    }
}

/// Rays that an invocation walks back, one after the other: fewer where loops make many iterations. A Gaussian splat is gone over
/// five times on the way back (program::rewrite::transpose::loops).
fn rays_walked_back(features: &Features, options: &ProgramOptions) -> u32 {
    let side = 2 * u64::from(features.splat_radius) + 1;
    let iterations_of_splat = side.saturating_mul(5 * (side + 2));
    let iterations_of_search = if features.has_sags() { 512 } else { 0 };
    let iterations =
        iterations_of_splat.saturating_add(u64::from(2 * options.max_depth + iterations_of_search));
    (MOST_ITERATIONS_WALKED_BACK / iterations).clamp(1, MOST_RAYS_WALKED_BACK) as u32
}
