//! Traces scenes with shaders as they are, or with one mutant.

use crate::devices::Devices;
use crate::table::Mutant;
use nsq_gpu::gpu::{AdapterChoice, Gpu, Native};
use nsq_gpu::ir::{SceneIr, SensorKind};
use nsq_gpu::program::{Precision, df64};
use nsq_gpu::result::{RunInfo, Tally, TraceResult};
use nsq_gpu::{Error, Scene, TraceOptions, Tracer};
use std::cell::Cell;
use std::path::{Path, PathBuf};

/// Devices, and the mutant that shaders suffer.
pub struct Bench {
    gpus: &'static Gpus,
    mutant: Option<&'static Mutant>,
    mutated: Cell<bool>,
}

struct Gpus {
    native: Gpu,
    portable: Gpu,
    /// Without 64-bit integers, but with the host's memory: logs where rays end.
    portable_logged: Gpu,
}

/// How a check traces.
#[derive(Debug, Clone)]
pub struct Setting {
    /// 64-bit integers of the device, or pairs of 32-bit ones.
    pub native: bool,
    /// Options of the trace.
    pub options: TraceOptions,
}

impl Default for Setting {
    /// As the oracle traced; with atomics, as on a GPU.
    fn default() -> Self {
        let options = TraceOptions { num_rays: 100_000, host_sums: Some(false), ..Default::default() };
        Setting { native: true, options }
    }
}

impl Gpus {
    fn open() -> Option<Self> {
        let open = |native| Gpu::open(&AdapterChoice { name: None, native, runtime_checks: true }).ok();
        let (native, portable, mut portable_logged) =
            (open(Native::Allowed)?, open(Native::Off)?, open(Native::Allowed)?);
        portable_logged.int64 = false;
        (native.f64 && native.int64).then_some(Gpus { native, portable, portable_logged })
    }

    fn of(&self, setting: &Setting) -> &Gpu {
        match (setting.native, setting.options.host_sums) {
            (true, _) => &self.native,
            (false, Some(true)) => &self.portable_logged,
            (false, _) => &self.portable,
        }
    }
}

impl Bench {
    /// The shaders as they are; `None` where no adapter has what the checks need.
    pub fn of_originals() -> Option<Self> {
        static GPUS: Devices<Option<Gpus>> = Devices::new();
        let gpus = GPUS.mine(Gpus::open).as_ref()?;
        Some(Bench { gpus, mutant: None, mutated: Cell::new(false) })
    }

    /// The same devices, their shaders changed.
    pub fn with_mutant(&self, mutant: &'static Mutant) -> Self {
        Bench { gpus: self.gpus, mutant: Some(mutant), mutated: Cell::new(false) }
    }

    /// True if some trace so far contained the mutant's file.
    pub fn was_mutated(&self) -> bool {
        self.mutated.get()
    }

    /// The sums of a trace. A device may refuse a mutant for no other reason than that it is no valid shader.
    pub fn tally(&self, ir: &SceneIr, setting: &Setting) -> Tally {
        let gpu = self.gpus.of(setting);
        Tracer::with_wgsl_edit(gpu, ir, &setting.options, |wgsl| self.edit(wgsl))
            .and_then(|mut tracer| tracer.trace(|_| true))
            .unwrap_or_else(|error: Error| panic!("{}: {error}", self.name()))
    }

    /// The sums before the first ray, and after each.
    pub fn ray_by_ray(&self, ir: &SceneIr, setting: &Setting) -> Vec<Tally> {
        let gpu = self.gpus.of(setting);
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
        Tracer::with_wgsl_edit(gpu, ir, &setting.options, |wgsl| self.edit(wgsl))
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
        match self.gpus.native.test_df64(&library) {
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
        let (original, mutated) = (mutant.original(), mutant.mutated());
        if wgsl.contains(&original) {
            self.mutated.set(true);
        }
        wgsl.replace(&original, &mutated)
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
    for sensor in &mut ir.sensors {
        if let SensorKind::RayDatabase { max_rays, .. } = &mut sensor.kind {
            *max_rays = None;
        }
    }
    ir
}

/// A precision by its name.
pub fn precision(name: &str) -> Option<Precision> {
    [Precision::F32, Precision::Df64, Precision::F64].into_iter().find(|precision| precision.name() == name)
}
