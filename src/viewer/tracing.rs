//! Tracing in the background: the interface takes the latest result, and never waits.
//!
//! The tracer has a device of its own, beside the device that draws. On a shared device, the interface waits for the
//! lock of a queue that is busy with passes, and each frame queues behind a pass. A lost device would also take the
//! window with it.
//!
//! Medians of `nsq-bench --scenes viewer` on lavapipe, with two cores that others use too. A map of 2048 x 2048
//! cells is traced. A still window of this size takes 131 ms to draw there, by software.
//!
//! | device | program's part of a frame | whole frame | rays/s beside it |
//! |---|---|---|---|
//! | of its own | 15.8 ms | 268 ms | 2.7 M |
//! | shared | 35.8 ms | 256 ms | 0.2 M |

use crate::error::{Error, Result};
use crate::gpu::{AdapterChoice, Gpu};
use crate::guide::{self, Guide};
use crate::model::{PathFilter, SceneIr};
use crate::program::Precision;
use crate::result::{PathColumns, TraceResult};
use crate::run::precision::WantedPrecision;
use crate::run::{Next, Pass, RecordPaths, Run, StandardError, TraceOptions};
use crate::scene::Scene;
use crate::viewer::polar::{Diagram, of_lamps};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// A scene file, read and lowered.
pub struct LoadedScene {
    /// The file.
    pub path: PathBuf,
    /// The scene in the file.
    pub scene: Scene,
    /// The lowered scene, which is traced.
    pub ir: SceneIr,
    /// The polar diagrams of its lamps.
    pub(super) lamps: Vec<(Vec<String>, Diagram)>,
}

impl LoadedScene {
    /// Reads a scene file.
    ///
    /// # Errors
    /// [`Error::Scene`] or [`Error::File`] if it cannot be traced.
    pub fn read(path: &Path) -> Result<Self> {
        let scene = Scene::from_path(path)?;
        let ir = scene.lower()?;
        let lamps = of_lamps(&ir);
        Ok(LoadedScene { path: path.into(), scene, ir, lamps })
    }
}

/// The options of a trace.
#[derive(Debug, Clone, PartialEq)]
pub struct RunOptions {
    /// Rays to launch.
    pub num_rays: u64,
    /// Seed of the draws.
    pub seed: u64,
    /// Largest number of events of a ray.
    pub max_depth: u32,
    /// Precision; `None` for the better one of the adapter.
    pub precision: Option<Precision>,
    /// The trace stops when the largest relative error is as small as this.
    pub target_error: Option<f64>,
    /// The trace stops after this time, pauses included.
    pub time_limit: Option<Duration>,
    /// Detectors keep only the light whose path matches.
    pub filter: Option<Arc<PathFilter>>,
}

impl Default for RunOptions {
    fn default() -> Self {
        let TraceOptions { num_rays, seed, max_depth, .. } = TraceOptions::default();
        RunOptions {
            num_rays,
            seed,
            max_depth,
            precision: None,
            target_error: None,
            time_limit: None,
            filter: None,
        }
    }
}

impl RunOptions {
    /// The options that the command would use for this scene.
    pub fn of(ir: &SceneIr) -> Self {
        RunOptions { max_depth: crate::model::depth::of_scene(ir), ..RunOptions::default() }
    }
}

/// The state of a trace.
#[derive(Debug, Clone, PartialEq)]
pub enum State {
    /// The device is being opened, and the scene compiled.
    Starting,
    /// Rays are traced.
    Tracing,
    /// The user has paused the trace.
    Paused,
    /// All rays are traced, or the user stopped the trace.
    Finished,
    /// The trace failed.
    Failed(Error),
}

/// The latest state and result, from the tracing thread.
#[derive(Clone)]
struct Latest {
    state: State,
    rays: u64,
    seconds: f64,
    result: Option<Arc<TraceResult>>,
}

#[derive(Default)]
struct Control {
    paused: bool,
    stopped: bool,
}

struct Shared {
    control: Mutex<Control>,
    changed: Condvar,
    latest: Mutex<Latest>,
    notify: Notify,
}

/// Called by the tracing thread when there is something new to show.
pub type Notify = Arc<dyn Fn() + Send + Sync>;

/// A device for all traces of a window, opened by the first trace.
#[derive(Clone, Default)]
pub struct Device {
    gpu: Arc<Mutex<Option<Arc<Gpu>>>>,
    adapter: Option<String>,
}

impl Device {
    /// A device on the adapter whose name contains this text; `None` for the best adapter.
    pub fn on(adapter: Option<String>) -> Self {
        Device { adapter, ..Device::default() }
    }

    /// A device that is open already.
    pub fn sharing(gpu: Arc<Gpu>) -> Self {
        Device { gpu: Arc::new(Mutex::new(Some(gpu))), adapter: None }
    }

    /// The adapter that is asked for.
    pub(super) fn choice(&self) -> AdapterChoice {
        AdapterChoice { name: self.adapter.clone(), ..AdapterChoice::default() }
    }

    pub(super) fn open(&self) -> Result<Arc<Gpu>> {
        let mut gpu = lock(&self.gpu);
        // A device that has failed once stays failed.
        if let Some(gpu) = gpu.as_ref().filter(|gpu| gpu.check().is_ok()) {
            return Ok(gpu.clone());
        }
        Ok(gpu.insert(Arc::new(Gpu::open(&self.choice())?)).clone())
    }
}

/// A trace in a thread of its own. The trace stops when this value is dropped.
pub struct Job {
    shared: Arc<Shared>,
    thread: Option<JoinHandle<()>>,
    /// Rays that the trace will launch.
    pub num_rays: u64,
}

impl Job {
    /// Begins to trace.
    pub fn start(device: &Device, scene: &Arc<LoadedScene>, options: &RunOptions, notify: Notify) -> Self {
        let latest = Latest { state: State::Starting, rays: 0, seconds: 0.0, result: None };
        let shared = Arc::new(Shared {
            control: Mutex::default(),
            changed: Condvar::new(),
            latest: Mutex::new(latest),
            notify,
        });
        let (device, scene, options) = (device.clone(), scene.clone(), options.clone());
        let (num_rays, worker) = (options.num_rays, shared.clone());
        let thread = std::thread::spawn(move || {
            if let Err(error) = trace(&worker, &device, &scene, &options) {
                lock(&worker.latest).state = State::Failed(error);
            }
            (worker.notify)();
        });
        Job { shared, thread: Some(thread), num_rays }
    }

    /// Pauses the trace after the present pass, or lets it go on.
    pub fn pause(&self, paused: bool) {
        lock(&self.shared.control).paused = paused;
        self.shared.changed.notify_all();
    }

    /// Ends the trace after the present pass. The rays traced so far stay.
    pub fn stop(&self) {
        lock(&self.shared.control).stopped = true;
        self.shared.changed.notify_all();
    }

    /// Ends the trace, and waits until it has released the device.
    pub fn finish(mut self) {
        self.stop();
        if let Some(thread) = self.thread.take() {
            // Whatever a thread panicked with, it has ended.
            let _ = thread.join();
        }
    }

    /// The state of the trace.
    pub fn state(&self) -> State {
        lock(&self.shared.latest).state.clone()
    }

    /// Rays done, and the time without pauses \[s\].
    pub fn progress(&self) -> (u64, f64) {
        let latest = lock(&self.shared.latest);
        (latest.rays, latest.seconds)
    }

    /// The latest result, if it has not been taken yet.
    pub fn take_result(&self) -> Option<Arc<TraceResult>> {
        lock(&self.shared.latest).result.take()
    }

    /// True until the trace is finished or failed.
    pub fn is_running(&self) -> bool {
        !matches!(self.state(), State::Finished | State::Failed(_))
    }
}

impl Drop for Job {
    fn drop(&mut self) {
        self.stop();
    }
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Rays in one dispatch, and the time of a pass. Both are small, because some devices cannot interrupt a dispatch to
/// draw a frame.
const BATCH: u32 = 1 << 16;
const PASS_TIME: Duration = Duration::from_millis(15);

/// True if rays are guided. Where the user asks for some light alone, such as a ghost, every ray follows that light as
/// far as it can.
pub(super) fn is_guided(scene: &LoadedScene, options: &RunOptions) -> bool {
    options.filter.is_some() && guide::check(&scene.ir, &TraceOptions::default()).is_ok()
}

/// A run of the scene with the options of the window.
pub(super) fn run<'a>(scene: &'a LoadedScene, options: &RunOptions, gpu: &'a Gpu) -> Result<Run<'a>> {
    let traced = TraceOptions {
        num_rays: options.num_rays,
        seed: options.seed,
        path_filter: options.filter.clone(),
        // The user wants to see the noise, whatever it costs.
        standard_error: StandardError::On,
        batch_size: Some(BATCH),
        ..TraceOptions::default()
    };
    let run = Run::of(&scene.scene, &scene.ir);
    // As in `nsq-gpu trace`.
    let run = if scene.scene.is_photometric() { run.photometric()? } else { run };
    let mut run = run
        .named(scene.path.display())
        .on(gpu)
        .options(traced)
        .max_depth(options.max_depth)
        .precision(options.precision.map_or(WantedPrecision::Auto, WantedPrecision::Exactly))
        .pass_time(PASS_TIME);
    run.predicts_first = true;
    if is_guided(scene, options) {
        let guide = Guide::plain(run.model());
        run = run.guide_by(Arc::new(guide));
    }
    if let Some(limit) = options.time_limit {
        run = run.time_limit(limit);
    }
    match options.target_error {
        Some(target) => run.target_error(target),
        None => Ok(run),
    }
}

fn trace(shared: &Arc<Shared>, device: &Device, scene: &LoadedScene, wanted: &RunOptions) -> Result<()> {
    let gpu = device.open()?;
    let run = run(scene, wanted, &gpu)?;
    let mut observer = Observer { shared, waited: Duration::ZERO, due: Instant::now() };
    let mut result = run.go_with(|pass| observer.after_pass(pass))?.result;
    result.run.trace_time_sec -= observer.waited.as_secs_f64();
    let mut latest = lock(&shared.latest);
    latest.rays = result.num_rays_total;
    latest.seconds = result.run.trace_time_sec;
    latest.result = Some(Arc::new(result));
    latest.state = State::Finished;
    Ok(())
}

/// Observes the trace from the tracing thread.
struct Observer<'a> {
    shared: &'a Shared,
    /// Time of pauses.
    waited: Duration,
    /// The time at which the next result should be shown.
    due: Instant,
}

/// Least time between two results.
const INTERVAL: Duration = Duration::from_millis(120);
/// The time for showing results is at most 1/SHARE of the whole.
const SHARE: u32 = 8;

impl Observer<'_> {
    /// Shows a result if one is due, and waits while the trace is paused.
    fn after_pass(&mut self, pass: &mut Pass<'_, '_, '_>) -> Result<Next> {
        let asked = Instant::now();
        let seconds = pass.status.elapsed.saturating_sub(self.waited).as_secs_f64();
        if asked >= self.due || lock(&self.shared.control).paused {
            let mut result = pass.result()?;
            result.run.trace_time_sec = seconds;
            lock(&self.shared.latest).result = Some(Arc::new(result));
            self.due = Instant::now() + INTERVAL.max(asked.elapsed() * SHARE);
        }
        {
            let mut latest = lock(&self.shared.latest);
            (latest.rays, latest.seconds, latest.state) = (pass.status.rays, seconds, State::Tracing);
        }
        (self.shared.notify)();
        let mut control = lock(&self.shared.control);
        if control.paused && !control.stopped {
            let since = Instant::now();
            lock(&self.shared.latest).state = State::Paused;
            (self.shared.notify)();
            while control.paused && !control.stopped {
                control = self.shared.changed.wait(control).unwrap_or_else(PoisonError::into_inner);
            }
            lock(&self.shared.latest).state = State::Tracing;
            self.waited += since.elapsed();
        }
        Ok(Next::stop_if(control.stopped))
    }
}

/// Work in a thread of its own, whose outcome can be taken when it is ready.
pub struct Background<T> {
    thread: JoinHandle<()>,
    outcome: Arc<Mutex<Option<T>>>,
}

impl<T: Send + 'static> Background<T> {
    /// Begins the work.
    pub fn start(work: impl FnOnce() -> T + Send + 'static, notify: Notify) -> Self {
        let outcome = Arc::new(Mutex::new(None));
        let made_there = outcome.clone();
        let thread = std::thread::spawn(move || {
            let made = work();
            *lock(&made_there) = Some(made);
            notify();
        });
        Background { thread, outcome }
    }

    /// The outcome, once.
    pub fn take(&self) -> Option<T> {
        lock(&self.outcome).take()
    }

    /// Waits until the work has ended.
    pub fn finish(self) {
        // Whatever a thread panicked with, it has ended.
        let _ = self.thread.join();
    }
}

/// The paths of a few rays.
pub type PathsJob = Background<Result<Arc<PathColumns>>>;

/// Begins to record the paths of `num_rays` rays.
pub fn record_paths(
    device: &Device,
    scene: &Arc<LoadedScene>,
    options: &RunOptions,
    num_rays: u64,
    notify: Notify,
) -> PathsJob {
    let (device, scene) = (device.clone(), scene.clone());
    let options = RunOptions { num_rays, ..options.clone() };
    Background::start(move || record(&device, &scene, &options), notify)
}

fn record(device: &Device, scene: &LoadedScene, options: &RunOptions) -> Result<Arc<PathColumns>> {
    let gpu = device.open()?;
    let result = run(scene, options, &gpu)?.record_paths(RecordPaths::All).go()?.result;
    let none = || Error::Internal("no path was recorded".into());
    result.ray_paths.ok_or_else(none)?.columns().map(Arc::new)
}
