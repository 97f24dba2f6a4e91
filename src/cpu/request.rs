//! What the CPU backend is asked to add to the program of a scene, and what it adds.

use crate::cpu::log::format::DepositLog;
use crate::cpu::path::hot_path::{HotPath, ProfiledPath};
use crate::cpu::path::path_log::{self, LoggedScene, PathLog};
use crate::cpu::path::side_trace::SideTrace;
use crate::program::Program;
use crate::program::input::ProgramInput;
use std::sync::LazyLock;

/// What is asked for. No part of it changes a bit of a result.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct CpuRequest {
    /// Rays write down where they end, and the host adds it up. Without it, nothing is added.
    pub deferred_splats: bool,
    /// An invocation follows two rays of the hot path side by side, where it can.
    pub side_by_side: bool,
    /// The path that most rays take, for a stage of its own.
    pub hot_path: Option<ProfiledPath>,
    /// The paths that most other rays take, the most frequent first, for stages of their own.
    pub side_traces: Vec<ProfiledPath>,
}

/// What is added for a scene. Paths are there only where there is a log.
#[derive(Debug, Clone, Default)]
pub struct CpuShader {
    /// The deposit log, if the host adds it up.
    pub deposit_log: Option<DepositLog>,
    /// The hot path, if it has a stage of its own; the other stages then trace the rays that fail its guards.
    pub hot_path: Option<HotPath>,
    /// What that stage logs, where positions alone or with weights are enough.
    pub path_log: Option<PathLog>,
    /// The paths that `trace_side_a` and so on follow. Side traces log as the hot path does.
    pub side_traces: Vec<SideTrace>,
    /// Media take little from the rays of all these paths on each leg.
    pub(crate) media_absorb_weakly: bool,
    /// An invocation follows two rays of the hot path.
    pub(crate) has_pairs: bool,
    /// Rays that an invocation follows along a path, one after the other.
    pub(crate) rays_per_invocation: u32,
}

impl CpuShader {
    /// What is added for a scene, of all that is asked for.
    pub fn of(scene: &ProgramInput, request: &CpuRequest) -> Self {
        let ProgramInput { ir, options, features, cells, contacts, .. } = scene;
        let log = DepositLog::of(ir, features, cells, options, scene.constant_weights);
        let Some(log) = log.filter(|_| request.deferred_splats) else { return CpuShader::default() };
        let profile = request.hot_path.as_ref();
        let is_weak = profile.is_some_and(path_log::media_absorb_weakly);
        let alone =
            CpuShader { deposit_log: Some(log.clone()), media_absorb_weakly: is_weak, ..Default::default() };
        // Rays that fail a guard are listed, and those that the host uploads are uploaded by range.
        let Some(profile) = profile.filter(|_| !features.uploads_rays()) else { return alone };
        let Some(hot_path) = HotPath::of(ir, scene.centre, contacts, options, profile) else { return alone };
        let logged = LoggedScene { ir, cells, log: &log, options, features };
        let path_log = PathLog::of(&logged, &hot_path, profile);
        let side_traces = SideTrace::of(
            &logged,
            scene.centre,
            contacts,
            &hot_path,
            path_log.as_ref(),
            &request.side_traces,
        );
        CpuShader {
            media_absorb_weakly: is_weak && side_traces.iter().all(|side| side.media_absorb_weakly),
            // Where rays leave only what they log, and have no triangles to remember.
            has_pairs: request.side_by_side
                && path_log.as_ref().is_some_and(|log| log.tells_all)
                && !features.has_meshes(),
            rays_per_invocation: rays_per_invocation(scene, path_log.as_ref()),
            hot_path: Some(hot_path),
            path_log,
            side_traces,
            ..alone
        }
    }

    /// What was added to a program.
    pub fn of_program(program: &Program) -> &Self {
        static NOTHING: LazyLock<CpuShader> = LazyLock::new(CpuShader::default);
        program.additions.get().unwrap_or(&NOTHING)
    }

    /// Rays of the hot path log what they weigh.
    pub(crate) fn logs_weights(&self) -> bool {
        self.path_log.as_ref().is_some_and(|log| log.attenuating_legs.is_some())
    }

    /// Rays that an invocation of trace_hot_path follows, side by side or one after the other.
    pub fn rays_per_hot_path_invocation(&self) -> u32 {
        if self.has_pairs { 2 } else { self.rays_per_invocation }
    }

    /// Rays that an invocation follows along a side trace, one after the other.
    pub fn side_rays_per_invocation(&self) -> u32 {
        self.rays_per_invocation
    }
}

/// Rays that an invocation follows along a path one after the other. Their bins then go to memory once for all of them.
/// One ray, where the path takes nothing from its rays, or their weights report what the path takes. A loop would then
/// cost more than it saves. One ray, too, where a single ray already has long loops.
fn rays_per_invocation(scene: &ProgramInput, log: Option<&PathLog>) -> u32 {
    let [.., gaussian] = scene.features.splats;
    let deposits_nothing =
        scene.features.keeps_weight || log.is_some_and(|log| log.attenuating_legs.is_some());
    if deposits_nothing || gaussian { 1 } else { scene.options.most_rays_per_invocation.max(1) }
}
