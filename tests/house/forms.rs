//! The ways in which a scene can be traced, as far as they change its module.

use nsq_gpu::derivatives::Derivatives;
use nsq_gpu::model::surface_optics::splits;
use nsq_gpu::model::{SceneIr, depth};
use nsq_gpu::paths::followed::FollowedPaths;
use nsq_gpu::paths::sums::PathSums;
use nsq_gpu::program::addition::ProgramAddition;
use nsq_gpu::program::rewrite::jvp::{Parameter, Tangents};
use nsq_gpu::program::{
    MAX_BAKED_PRIMITIVES, PathSampling, Precision, Program, ProgramOptions, Sampler, SecondMoments,
};
use nsq_gpu::{Error, Result};
use std::sync::Arc;

/// What a trace collects, or what else sets it apart from a plain trace of the scene.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Kind {
    /// As `nsq-gpu trace` composes it on a GPU.
    Light,
    /// In tables if the scene would be compiled in, and the other way round.
    OtherPlace,
    /// In tables that no tree searches.
    InTurn,
    /// With numbers in a table or in uniform buffers.
    Live,
    /// With squares for standard errors.
    Squares,
    /// With draws of Sobol, and the sums of their replicates.
    Sobol,
    /// Rays outlive a dispatch.
    Queue,
    /// With recorded paths.
    RecordedPaths,
    /// Light by its path, where rays end, too.
    PathTotals,
    /// Light by its path, on detectors alone.
    PathsOnDetectors,
    /// Maps of three paths.
    PathMaps,
    /// What happened to each ray.
    Events,
    /// Derivatives by two parameters.
    Tangents,
    /// The gradient of a loss.
    Adjoints,
}

/// A module of a scene.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Form {
    precision: Precision,
    native: bool,
    kind: Kind,
}

const NUM_TIERS: usize = 6;
const TIERS: [(Precision, bool); NUM_TIERS] = [
    (Precision::F32, false),
    (Precision::F32, true),
    (Precision::Df64, false),
    (Precision::Df64, true),
    (Precision::F64, false),
    (Precision::F64, true),
];

impl Form {
    /// Light in every tier; what is else collected in f64, as a processor and many a GPU would do it.
    pub fn all() -> Vec<Form> {
        let in_every_tier =
            [Kind::Light, Kind::OtherPlace].into_iter().flat_map(|kind| TIERS.map(|tier| (tier, kind)));
        let in_one = [
            Kind::InTurn,
            Kind::Live,
            Kind::Squares,
            Kind::Sobol,
            Kind::Queue,
            Kind::RecordedPaths,
            Kind::PathTotals,
            Kind::PathsOnDetectors,
            Kind::PathMaps,
            Kind::Events,
            Kind::Tangents,
            Kind::Adjoints,
        ];
        let in_one = in_one.into_iter().map(|kind| ((Precision::F64, true), kind));
        let in_f32 = [Kind::Live, Kind::PathTotals].into_iter().map(|kind| ((Precision::F32, false), kind));
        let forms = in_every_tier.chain(in_one).chain(in_f32);
        forms.map(|((precision, native), kind)| Form { precision, native, kind }).collect()
    }

    /// The name of the form.
    pub fn name(&self) -> String {
        let integers = if self.native { "native" } else { "portable" };
        format!("{} {integers} {:?}", self.precision.name(), self.kind)
    }

    /// True if the composed module is compared, and not the one that derivatives are written into. There a function that only
    /// hands on has derivatives of its own, and is no forwarder.
    pub fn is_rewritten(&self) -> bool {
        matches!(self.kind, Kind::Tangents | Kind::Adjoints)
    }

    /// The program of a scene.
    pub fn program(&self, ir: &SceneIr) -> Result<Program> {
        let num_primitives = ir.surfaces.len() + ir.detectors.len();
        let is_baked = num_primitives <= MAX_BAKED_PRIMITIVES;
        let has_derivatives = matches!(self.kind, Kind::Tangents | Kind::Adjoints);
        if has_derivatives && splits(ir) {
            return Err(Error::Usage("split rays have no derivatives".into()));
        }
        let max_depth = depth::of_scene(ir);
        let events_per_dispatch = match self.kind {
            Kind::Queue => 4,
            Kind::Squares | Kind::Tangents | Kind::Adjoints => max_depth,
            _ => 16,
        };
        let options = ProgramOptions {
            precision: self.precision,
            native: self.native,
            baked: match self.kind {
                Kind::OtherPlace => !is_baked,
                Kind::InTurn => false,
                _ => is_baked,
            },
            tree: self.kind != Kind::InTurn,
            uniform_bytes: if self.kind == Kind::Live { 1 << 16 } else { 0 },
            texel_bytes: 0,
            max_depth,
            roulette_threshold: ir.sampling.rr_start_flux.max(1e-6),
            events_per_dispatch: events_per_dispatch.min(max_depth),
            workgroup_size: 64,
            most_rays_per_invocation: 1,
            vector_lanes: 0,
            paths: match self.kind {
                Kind::RecordedPaths => PathSampling::Hashed { threshold: 1 << 20 },
                _ => PathSampling::None,
            },
            weights: (0..ir.sources.len()).map(|source| 1.0 + 0.25 * source as f64).collect(),
            sampler: if self.kind == Kind::Sobol { Sampler::Sobol } else { Sampler::Pcg },
            moments: match self.kind {
                Kind::Squares => SecondMoments::Squares,
                Kind::Sobol => SecondMoments::Replicates,
                _ => SecondMoments::None,
            },
            part_bytes: 1 << 27,
            live: self.kind == Kind::Live || has_derivatives,
            copies_numbers: false,
            fixed_rays_per_invocation: None,
            has_long_loops: false,
            counts_wrong_sides: true,
        };
        let paths = match self.kind {
            Kind::PathTotals => Some(PathSums::Totals { rows: 1 << 18, ends: true }),
            Kind::PathsOnDetectors => Some(PathSums::Totals { rows: 1 << 18, ends: false }),
            Kind::PathMaps => Some(PathSums::Maps(3)),
            Kind::Events => Some(PathSums::Events { ends: false }),
            _ => None,
        };
        let derivatives = match self.kind {
            Kind::Tangents => Some(Derivatives::Tangents(Arc::new(two_tangents()))),
            Kind::Adjoints => Some(Derivatives::Adjoints),
            _ => None,
        };
        let paths = paths.map(|sums| FollowedPaths::new(sums, None));
        let paths = paths.iter().map(|paths| paths as &dyn ProgramAddition);
        let derivatives = derivatives.iter().map(|derivatives| derivatives as &dyn ProgramAddition);
        Program::with(ir, options, &paths.chain(derivatives).collect::<Vec<_>>(), 0)
    }
}

fn two_tangents() -> Tangents {
    let parameter = |name: &str| Parameter { name: name.into(), stencil: Vec::new() };
    Tangents { parameters: ["a", "b"].map(parameter).to_vec() }
}
