//! A run: a scene, options and a device, from the choice of a precision to the report.
//!
//! [`Run`] is the whole of it. [`Run::go`] traces; [`Run::differentiate`], [`Run::loss_gradient`] and [`Run::difference`]
//! trace for derivatives and differences. A [`Session`] keeps a device and compiled shaders from run to run, and
//! [`sweep`] makes runs of one scene with other numbers. Python's `Session` is a process of `nsq-gpu serve`, which
//! holds one [`Session`].
//!
//! A run is made of these: [`Tracer`] is a scene ready to trace. [`precision`] chooses the tier, [`stopping`] ends a trace
//! early, and [`checkpoint`] keeps sums in a file. [`proof`] keeps
//! hashes of them, and [`verify`] says what of a result is proven. [`difference`] and [`gradients`] trace in blocks of rays.

pub mod additions;
mod blocks;
pub mod checkpoint;
pub mod difference;
mod differentiate;
mod go;
pub mod gradients;
mod guiding;
mod outcome;
pub mod precision;
pub mod proof;
pub mod pst;
mod rounds;
mod session;
mod status;
pub mod stopping;
pub mod surfaces;
pub mod sweep;
mod tracer;
pub mod verify;

pub use crate::engine::options::{Collect, RecordPaths, StandardError, Strict, TraceOptions};
pub use crate::engine::pass_loop::Progress;
pub use crate::engine::pipeline_cache::{PipelineCache, Shaders};
pub use crate::run::additions::ForAdapter;
pub use crate::run::differentiate::{DerivativeOptions, Differentiation, LossDerivatives};
pub use crate::run::go::{Pass, Settled};
pub use crate::run::outcome::{Outcome, Saved, missed_target};
pub use crate::run::session::Session;
pub use crate::run::status::{Next, Status};
pub use crate::run::tracer::Tracer;

use crate::count;
use crate::error::{Error, Result};
use crate::gpu::{AdapterChoice, Gpu};
use crate::guide::Guide;
use crate::guide::learn::Wanted;
use crate::model::{SceneIr, depth};
use crate::result::{photometry, wavelengths_apart};
use crate::run::checkpoint::Checkpoint;
use crate::run::precision::WantedPrecision;
use crate::scene::Scene;
use std::borrow::Cow;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

/// One trace of a scene, from what is asked for to the report: what `nsq-gpu trace` does.
///
/// ```
/// use nsq_gpu::Run;
///
/// # fn main() -> nsq_gpu::Result<()> {
/// # if nsq_gpu::gpu::list_adapters().is_empty() { return Ok(()); }
/// let outcome = Run::open("docs/example.json")?.rays(1e5)?.seed(7).go()?;
/// println!("{}", outcome.result.report());
/// # Ok(())
/// # }
/// ```
///
/// Unless something else is asked for, a million rays are launched on the best adapter. A ray has as many events as the scene
/// needs ([`crate::model::depth::of_scene`]), in the least expensive precision that is good enough
/// ([`precision::choose`]).
pub struct Run<'a> {
    scene: Cow<'a, Scene>,
    model: Cow<'a, SceneIr>,
    /// What the report calls the scene.
    name: Option<String>,
    /// What was asked for. The run's own `max_depth` and `precision` override these two fields of the options.
    options: TraceOptions,
    /// Overrides the depth of `options`. `None`: the depth of the file that the run resumes, or the scene's.
    max_depth: Option<u32>,
    follows_ghosts: bool,
    /// Overrides the precision of `options`, by [`precision::choose`].
    precision: WantedPrecision,
    /// The error of f32 is predicted before the rays are traced, also where it is only reported. Otherwise a second device
    /// predicts it meanwhile.
    pub(crate) predicts_first: bool,
    device: Device<'a>,
    /// Compiled shaders of earlier runs, for scenes whose numbers are live: in short traces, or as `live` says.
    cache: Option<&'a PipelineCache>,
    live: Option<bool>,
    target_error: Option<f64>,
    time_limit: Option<Duration>,
    rows: RowStorage,
    saves: Option<Saves>,
    has_proof: bool,
    guiding: Option<Guiding>,
    resumed: Option<(PathBuf, Checkpoint)>,
    has_profile: bool,
    photometric: bool,
    pass_time: Option<Duration>,
    /// From when the report counts the time to the first rays.
    pub(crate) start: Instant,
    say: &'a dyn Fn(&str),
}

/// What a run traces on.
enum Device<'a> {
    /// A device that is opened when the run begins.
    Choice(AdapterChoice),
    /// A device that is open.
    Open(&'a Gpu),
}

/// Where the rows of ray databases and recorded paths go.
#[derive(Debug, Clone, Default, PartialEq)]
pub enum RowStorage {
    /// Among the sums, in memory, so that sums can be merged and resumed. So they go wherever a run has a checkpoint.
    #[default]
    Sums,
    /// Into hidden files, on the file system where this folder is or will be. The result reads them from there.
    Disk(PathBuf),
    /// Nowhere: they are only counted.
    Counted,
}

/// How the rays of a run are guided.
#[derive(Debug, Clone)]
pub enum Guiding {
    /// By what a pilot learns.
    Learned(Wanted),
    /// By a guide that was learned before.
    Given(Arc<Guide>),
}

/// The file in which a run saves its sums.
struct Saves {
    path: PathBuf,
    /// Time between two checkpoints.
    interval: Duration,
    /// Sums of another trace are replaced.
    overwrite: bool,
}

impl Run<'static> {
    /// A run of a scene.
    ///
    /// # Errors
    /// [`Error::Scene`] with the place if the scene cannot be traced.
    pub fn new(scene: Scene) -> Result<Self> {
        let model = Cow::Owned(scene.lower()?);
        Ok(Run::made(Cow::Owned(scene), model))
    }

    /// A run of a scene file, whose path the report has.
    ///
    /// # Errors
    /// [`Error::File`] if the file cannot be read. [`Error::Scene`] with the place if the scene cannot be traced.
    pub fn open(path: impl AsRef<Path>) -> Result<Self> {
        let path = path.as_ref();
        Ok(Run::new(Scene::from_path(path)?)?.named(path.display()))
    }
}

impl<'a> Run<'a> {
    /// A run of a scene and of what [`Scene::lower`] made of it, which may have been changed since.
    pub fn of(scene: &'a Scene, model: &'a SceneIr) -> Self {
        Run::made(Cow::Borrowed(scene), Cow::Borrowed(model))
    }

    fn made(scene: Cow<'a, Scene>, model: Cow<'a, SceneIr>) -> Self {
        Run {
            scene,
            model,
            name: None,
            options: TraceOptions::default(),
            max_depth: None,
            follows_ghosts: false,
            precision: WantedPrecision::Auto,
            predicts_first: false,
            device: Device::Choice(AdapterChoice::default()),
            cache: None,
            live: None,
            target_error: None,
            time_limit: None,
            rows: RowStorage::default(),
            saves: None,
            has_proof: false,
            guiding: None,
            resumed: None,
            has_profile: false,
            photometric: false,
            pass_time: None,
            start: Instant::now(),
            say: &|_| {},
        }
    }

    /// The scene that the user wrote.
    pub fn scene(&self) -> &Scene {
        &self.scene
    }

    /// The scene as it is traced.
    pub fn model(&self) -> &SceneIr {
        &self.model
    }

    /// The options as they were asked for so far.
    pub fn options_so_far(&self) -> &TraceOptions {
        &self.options
    }

    /// Changes the scene that is traced, such as its sampling.
    ///
    /// # Errors
    /// The errors of `change`.
    pub fn change_model(mut self, change: impl FnOnce(&mut SceneIr) -> Result<()>) -> Result<Self> {
        change(self.model.to_mut())?;
        Ok(self)
    }

    /// Gives results in lumens, lux and candela beside watts. The scene that is traced then keeps light of each wavelength
    /// apart, so other options come after this one.
    ///
    /// # Errors
    /// [`Error::Usage`] if nobody sees light of the scene's wavelengths, or if they are too many to be kept apart.
    pub fn photometric(mut self) -> Result<Self> {
        if !photometry::is_visible(&self.model) {
            return Err(Error::Usage(
                "photometry: nobody sees light of the scene's wavelengths; give sources light of 0.38 to 0.78 um".into(),
            ));
        }
        self.model = Cow::Owned(wavelengths_apart::keep_apart(&self.model)?);
        self.photometric = true;
        Ok(self)
    }

    /// What the report calls the scene.
    #[must_use]
    pub fn named(self, name: impl std::fmt::Display) -> Self {
        Run { name: Some(name.to_string()), ..self }
    }

    /// Launches so many rays: 1e7. The default is a million.
    ///
    /// # Errors
    /// [`Error::Usage`] if that is no count.
    pub fn rays(mut self, count: f64) -> Result<Self> {
        self.options.num_rays = count::of_number(count).map_err(Error::Usage)?;
        Ok(self)
    }

    /// The seed of all draws. The default is 0.
    #[must_use]
    pub fn seed(mut self, seed: u64) -> Self {
        self.options.seed = seed;
        self
    }

    /// The largest number of events of a ray.
    #[must_use]
    pub fn max_depth(self, max_depth: u32) -> Self {
        Run { max_depth: Some(max_depth), ..self }
    }

    /// Where nobody says the largest number of events, rays are followed as far as guided ones
    /// ([`crate::model::depth::of_ghosts`]).
    #[must_use]
    pub fn follow_ghosts(self) -> Self {
        Run { follows_ghosts: true, ..self }
    }

    /// The largest number of events of a ray of a scene, where nobody says it.
    fn depth_of(&self, ir: &SceneIr) -> u32 {
        match self.follows_ghosts || self.guiding.is_some() || self.scene.is_guided() {
            true => depth::of_ghosts(ir),
            false => depth::of_scene(ir),
        }
    }

    /// The precision.
    #[must_use]
    pub fn precision(self, precision: WantedPrecision) -> Self {
        Run { precision, ..self }
    }

    /// Other options, in the place of those asked for before. Of these, [`Run::precision`] and [`Run::max_depth`] decide
    /// about the precision and the largest number of events.
    #[must_use]
    pub fn options(self, options: TraceOptions) -> Self {
        Run { options, ..self }
    }

    /// Changes some of the options.
    #[must_use]
    pub fn change_options(mut self, change: impl FnOnce(&mut TraceOptions)) -> Self {
        change(&mut self.options);
        self
    }

    /// Stops when the largest relative error of all detectors is at most this fraction. Standard errors are then summed
    /// ([`StandardError::On`]).
    ///
    /// # Errors
    /// [`Error::Usage`] if that is no fraction above 0, up to 1.
    pub fn target_error(self, fraction: f64) -> Result<Self> {
        if !(fraction > 0.0 && fraction <= 1.0) {
            return Err(Error::Usage(format!(
                "the target error is {fraction}; give a fraction, such as 0.01"
            )));
        }
        Ok(Run { target_error: Some(fraction), ..self })
    }

    /// Stops after this time.
    #[must_use]
    pub fn time_limit(self, limit: Duration) -> Self {
        Run { time_limit: Some(limit), ..self }
    }

    /// Opens the device on this adapter. The default is the best one.
    #[must_use]
    pub fn adapter(self, choice: AdapterChoice) -> Self {
        Run { device: Device::Choice(choice), ..self }
    }

    /// Traces on a device that is open.
    #[must_use]
    pub fn on(self, gpu: &'a Gpu) -> Self {
        Run { device: Device::Open(gpu), ..self }
    }

    /// Records paths of rays.
    #[must_use]
    pub fn record_paths(mut self, paths: RecordPaths) -> Self {
        self.options.paths = paths;
        self
    }

    /// Says where rows of ray databases and recorded paths go.
    #[must_use]
    pub fn rows(self, rows: RowStorage) -> Self {
        Run { rows, ..self }
    }

    /// Saves the sums so far in this file at intervals, and at the end. Sums of another trace are replaced only with
    /// `overwrite`.
    ///
    /// # Errors
    /// [`Error::File`] if the file could not be written, or if anything but a file of sums would be lost.
    pub fn checkpoint(self, path: &Path, interval: Duration, overwrite: bool) -> Result<Self> {
        checkpoint::check_writable(path)?;
        Ok(Run { saves: Some(Saves { path: path.into(), interval, overwrite }), ..self })
    }

    /// Goes on from the sums in a file that [`Run::checkpoint`] wrote. The result has the bits of an unbroken trace.
    ///
    /// # Errors
    /// [`Error::File`] if the file cannot be read, or is damaged.
    pub fn resume(self, path: &Path) -> Result<Self> {
        Ok(Run { resumed: Some((path.into(), Checkpoint::read(path)?)), ..self })
    }

    /// Keeps a proof with the sums: a hash of the sums of each of 64 ranges of rays. A trace that goes on from sums with a
    /// proof keeps it without being asked.
    #[must_use]
    pub fn proof(self) -> Self {
        Run { has_proof: true, ..self }
    }

    /// Times the stages on the device. The trace becomes slower.
    #[must_use]
    pub fn profile(self) -> Self {
        Run { has_profile: true, ..self }
    }

    /// How long passes should take, in the place of some 40 ms. No result changes.
    #[must_use]
    pub fn pass_time(self, time: Duration) -> Self {
        Run { pass_time: Some(time), ..self }
    }

    /// Where messages for people go while the run lasts, such as that a checkpoint could not be written. The default is
    /// nowhere.
    #[must_use]
    pub fn messages(self, say: &'a dyn Fn(&str)) -> Self {
        Run { say, ..self }
    }
}
