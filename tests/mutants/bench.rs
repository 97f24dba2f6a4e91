//! Traces scenes with shaders as they are, or with one mutant.

use crate::table::Mutant;
use crate::zoo;
use nsq_gpu::cpu::{CpuOverrides, Override};
use nsq_gpu::gpu::{Gpu, list_adapters};
use nsq_gpu::model::{DetectorKind, RayDatabase, SceneIr};
use nsq_gpu::paths::maps::{PathMaps, WantedMaps, Watched, trace_maps};
use nsq_gpu::program::Precision;
use nsq_gpu::program::rewrite::df64;
use nsq_gpu::result::{RunInfo, Tally, TraceResult};
use nsq_gpu::run::{ForAdapter, Shaders};
use nsq_gpu::{Error, Scene, TraceOptions, Tracer};
use std::cell::Cell;
use std::path::{Path, PathBuf};

/// The mutant that shaders suffer, if any.
pub struct Bench {
    mutant: Option<&'static Mutant>,
    mutated: Cell<bool>,
}

/// How a check traces.
#[derive(Debug, Clone)]
pub struct Setting {
    /// 64-bit integers of the device, or pairs of 32-bit ones.
    pub native: bool,
    /// Options of the trace.
    pub options: TraceOptions,
    /// What the CPU backend is forced to do in it.
    pub overrides: CpuOverrides,
}

impl Default for Setting {
    /// As the oracle traced; with atomics, as on a GPU.
    fn default() -> Self {
        let options = TraceOptions { num_rays: 100_000, ..Default::default() };
        Setting {
            native: true,
            options,
            overrides: CpuOverrides { deferred_splats: Override::Never, ..Default::default() },
        }
    }
}

impl Setting {
    fn gpu(&self) -> &'static Gpu {
        if self.native { zoo::gpu() } else { zoo::portable_gpu() }
    }
}

/// True if an adapter has what the checks need.
pub fn is_possible() -> bool {
    !list_adapters().is_empty() && zoo::gpu().f64 && zoo::gpu().int64
}

impl Bench {
    /// The shaders as they are.
    pub fn of_originals() -> Self {
        Bench { mutant: None, mutated: Cell::new(false) }
    }

    /// The shaders with a mutant.
    pub fn of_mutant(mutant: &'static Mutant) -> Self {
        Bench { mutant: Some(mutant), mutated: Cell::new(false) }
    }

    /// True if some trace so far contained the mutant's file.
    pub fn was_mutated(&self) -> bool {
        self.mutated.get()
    }

    fn tracer<'a>(&self, gpu: &'a Gpu, ir: &'a SceneIr, setting: &Setting) -> nsq_gpu::Result<Tracer<'a>> {
        let edit = |wgsl| self.edit(wgsl);
        let shaders = Shaders { cache: None, edit: Some(&edit) };
        Tracer::with(gpu, ir, &setting.options, ForAdapter::Forced(&setting.overrides), shaders)
    }

    /// The sums of a trace. A device may refuse a mutant for no other reason than that it is no valid shader.
    pub fn tally(&self, ir: &SceneIr, setting: &Setting) -> Tally {
        let gpu = setting.gpu();
        self.tracer(gpu, ir, setting)
            .and_then(|mut tracer| tracer.trace(|_| true))
            .unwrap_or_else(|error: Error| panic!("{}: {error}", self.name()))
    }

    /// The sums of a trace with a table of paths, or why there are none: the sequences of its rows are told by shaders as
    /// they are, and so not found for rows that a mutant made up.
    pub fn path_tally(&self, ir: &SceneIr, setting: &Setting) -> Result<Tally, String> {
        let gpu = setting.gpu();
        self.tracer(gpu, ir, setting)
            .and_then(|mut tracer| tracer.trace(|_| true))
            .map_err(|error| error.to_string())
    }

    /// Maps of paths, by a second trace of the same rays.
    pub fn path_maps(&self, ir: &SceneIr, setting: &Setting, tally: &Tally, watched: &[Watched]) -> PathMaps {
        let edit = |wgsl| self.edit(wgsl);
        let num_maps = watched.iter().filter_map(|path| path.map).max().map_or(1, |last| last + 1);
        let wanted = WantedMaps { rays: &tally.rays, watched, num_maps };
        trace_maps(setting.gpu(), ir, &setting.options, &wanted, Some(&edit), || true)
            .unwrap_or_else(|error| panic!("{}: {error}", self.name()))
    }

    /// The sums before the first ray, and after each.
    pub fn ray_by_ray(&self, ir: &SceneIr, setting: &Setting) -> Vec<Tally> {
        let gpu = setting.gpu();
        let trace = |mut tracer: Tracer| {
            let mut snapshots = vec![tracer.empty_tally()];
            tracer.pause_at(1);
            tracer.go_on(tracer.empty_tally(), |progress| {
                progress.pause_at(progress.position() + 1);
                snapshots.push(progress.tally()?.clone());
                Ok(true)
            })?;
            Ok(snapshots)
        };
        self.tracer(gpu, ir, setting)
            .and_then(trace)
            .unwrap_or_else(|error: Error| panic!("{}: {error}", self.name()))
    }

    /// The result of a trace.
    pub fn result(&self, ir: &SceneIr, setting: &Setting) -> TraceResult {
        let run = RunInfo { num_rays: setting.options.num_rays, ..RunInfo::default() };
        TraceResult::new(ir, &run, &self.tally(ir, setting)).unwrap()
    }

    /// What the device makes of double-word arithmetic.
    pub fn double_words(&self) -> Result<(), String> {
        let library = self.edit(df64::LIBRARY.to_string());
        match zoo::gpu().test_df64(&library) {
            Ok(()) => Ok(()),
            Err(Error::Usage(message)) => Err(message),
            Err(error) => panic!("{}: {error}", self.name()),
        }
    }

    fn name(&self) -> &str {
        self.mutant.map_or("original", |mutant| mutant.name)
    }

    fn edit(&self, wgsl: String) -> String {
        let Some(mutant) = self.mutant else { return wgsl };
        let original = mutant.original();
        if !wgsl.contains(&original) {
            return wgsl;
        }
        self.mutated.set(true);
        wgsl.replace(&original, &mutant.mutated())
    }
}

/// The folder of the project.
pub fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).to_path_buf()
}

/// A scene of scenes/, its ray databases without caps, as the oracle has them.
pub fn scene(name: &str) -> SceneIr {
    let path = root().join("scenes").join(format!("{name}.json"));
    let lowered = Scene::from_path(&path).and_then(|scene| scene.lower());
    let mut ir = lowered.unwrap_or_else(|error| panic!("{name}: {error}"));
    for detector in &mut ir.detectors {
        if let DetectorKind::RayDatabase(RayDatabase { max_rays, .. }) = &mut detector.kind {
            *max_rays = None;
        }
    }
    ir
}

/// A precision by its name.
pub fn precision(name: &str) -> Option<Precision> {
    [Precision::F32, Precision::Df64, Precision::F64].into_iter().find(|precision| precision.name() == name)
}
