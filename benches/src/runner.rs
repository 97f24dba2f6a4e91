//! Runs a case: this program and its peers take turns, after a warm-up.

use crate::cases::{Case, Kind, in_midst};
use crate::machine;
use crate::peers::{Peer, PeerRun};
use crate::statistics::Summary;
use nsq_gpu::gpu::Gpu;
use nsq_gpu::internals::{AdapterTraits, REPORT};
use nsq_gpu::model::SceneIr;
use nsq_gpu::program::Precision;
use nsq_gpu::result::{FluxUnit, Ledger, PathEventKind};
use nsq_gpu::run::{ForAdapter, RecordPaths, Shaders, TraceOptions, Tracer};
use nsq_gpu::scene::Scene;
use nsq_gpu::{Error, Result};
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::process::{Command, Stdio};
use std::time::Instant;
use tempfile::TempDir;

/// What all cases share.
pub struct Session<'a> {
    /// The device.
    pub gpu: &'a Gpu,
    /// The path of `nsq-gpu`, for whole commands.
    pub program: PathBuf,
    /// Measured runs of each case.
    pub num_runs: usize,
    /// Precisions to measure.
    pub precisions: Vec<Precision>,
}

/// All measurements of one case.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CaseResult {
    /// Name of the case.
    pub name: String,
    /// The sweep of which the case is one point.
    pub axis: String,
    /// The timed work: `trace`, `command` or `cold_command`.
    pub kind: String,
    /// Rays launched in each run of this program.
    pub num_rays: u64,
    /// Largest number of events of a ray.
    pub max_depth: u32,
    /// Surfaces and detectors of the scene.
    pub num_primitives: usize,
    /// Load average before the first run; null if the system does not report it.
    pub load_average: Option<f64>,
    /// The measurements of this program, by precision.
    pub measurements: Vec<Measurement>,
    /// The measurements of the peers.
    pub peers: Vec<PeerMeasurement>,
}

/// This program in one precision.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Measurement {
    /// `f32` or `f64`.
    pub precision: String,
    /// Rays launched and counted, which must be equal, and the same in every run.
    pub counts: Counts,
    /// Wall-clock times of the runs, in their order \[s\].
    pub runs_sec: Vec<f64>,
    /// Rays per second of the runs.
    pub rays_per_sec: Summary,
    /// Casts per second of the runs.
    pub casts_per_sec: Summary,
    /// Mean casts and interactions of a ray.
    pub per_ray: PerRay,
    /// Time from the scene's text to the compiled program \[s\]; null for whole commands.
    pub ready_sec: Option<f64>,
    /// Time until the first rays are traced \[s\]: from the scene's text, on an open device. For a whole command: from
    /// the start of the process.
    pub first_rays_sec: Option<f64>,
    /// Median rays per second over the peer's, by peer.
    pub ratios: BTreeMap<String, f64>,
}

/// A peer in one precision.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PeerMeasurement {
    /// The peer's name.
    pub name: String,
    /// `f32` or `f64`.
    pub precision: String,
    /// Rays launched in each run.
    pub num_rays: u64,
    /// Wall-clock times of the runs, in their order \[s\].
    pub runs_sec: Vec<f64>,
    /// Rays per second of the runs.
    pub rays_per_sec: Summary,
}

/// Numbers of rays, by where they went.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Counts {
    /// Rays asked for.
    pub requested: u64,
    /// Rays launched.
    pub launched: u64,
    /// Rays that ended: detected, absorbed, escaped, at the depth limit or by roulette.
    pub counted: u64,
    /// Counted rays that ended on detectors.
    pub detected: u64,
    /// True if the ledger closes to the last quantum.
    pub closed: bool,
}

/// Means over some thousands of recorded paths.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct PerRay {
    /// Searches for the nearest surface: one for each interaction, and a last one that finds nothing.
    pub casts: f64,
    /// Surfaces hit and detectors crossed.
    pub interactions: f64,
}

/// Standard errors by which the shares of two draws of one scene may differ. A fair run in a thousand million exceeds
/// this.
const STANDARD_ERRORS: f64 = 6.0;
/// Rays whose paths are recorded for [`PerRay`].
const RECORDED_RAYS: u64 = 4096;

impl Counts {
    /// The counts of a ledger.
    pub fn of_ledger(requested: u64, ledger: &Ledger) -> Self {
        let ends = [ledger.detected, ledger.absorbed, ledger.escaped, ledger.depth, ledger.roulette_loss];
        Counts {
            requested,
            launched: ledger.launched.count,
            counted: ends.iter().map(|entry| entry.count).sum(),
            detected: ledger.detected.count,
            closed: ledger.closes(),
        }
    }

    /// The counts of a report.json.
    pub fn of_report(requested: u64, report: &Value) -> Self {
        let ledger = &report["ledger"];
        let count = |entry: &str| ledger[entry]["count"].as_u64().unwrap_or(0);
        let ends = ["detected", "absorbed", "escaped", "depth", "roulette_loss"];
        Counts {
            requested,
            launched: count("launched"),
            counted: ends.into_iter().map(count).sum(),
            detected: count("detected"),
            closed: ledger["imbalance_quanta"] == "0" && ledger["invalid_deposits"] == 0,
        }
    }

    /// Fails unless launched = counted = requested and the ledger closes: no speed is worth a lost ray.
    ///
    /// # Errors
    /// [`Error::Internal`] with the numbers.
    pub fn check(self, case: &str) -> Result<()> {
        let Counts { requested, launched, counted, closed, .. } = self;
        if launched != requested || counted != launched {
            let message =
                format!("{case}: {requested} rays requested, {launched} launched, {counted} counted");
            return Err(Error::Internal(message));
        }
        if !closed {
            return Err(Error::Internal(format!("{case}: the ledger does not close")));
        }
        Ok(())
    }

    /// Fails unless a peer detects the same share of its rays, within [`STANDARD_ERRORS`], if the peer reports the
    /// share. A program that traces another scene is no peer.
    ///
    /// # Errors
    /// [`Error::Internal`] with the shares.
    pub fn check_peer(self, case: &str, peer: &str, run: &PeerRun) -> Result<()> {
        let Some(detected) = run.detected else { return Ok(()) };
        let [ours, theirs] = [self.launched as f64, run.num_rays as f64];
        let [our_share, their_share] = [self.detected as f64 / ours, detected as f64 / theirs];
        let share = (self.detected + detected) as f64 / (ours + theirs);
        let variance = share * (1.0 - share) * (1.0 / ours + 1.0 / theirs);
        if (our_share - their_share).abs() > STANDARD_ERRORS * variance.sqrt() {
            let message =
                format!("{case}: {peer} detects {their_share} of its rays, this program {our_share}");
            return Err(Error::Internal(message));
        }
        Ok(())
    }
}

/// Measures one case. Runs take turns, so that other work on the machine affects all alike.
///
/// # Errors
/// [`Error::Internal`] if a run lost rays, and any error of the scene, the device or a peer.
pub fn measure(case: &Case, session: &Session, peers: &mut [Box<dyn Peer>]) -> Result<CaseResult> {
    let start = Instant::now();
    let ir = Scene::from_json(&case.scene)?.lower()?;
    let read_sec = start.elapsed().as_secs_f64();
    let mut subjects = Vec::new();
    for &precision in &session.precisions {
        subjects.push(Subject::warm(case, session, &ir, precision, read_sec)?);
    }
    let mut peers: Vec<PeerRuns> = peers.iter_mut().filter(|p| p.takes(case)).map(PeerRuns::new).collect();
    peers.iter_mut().try_for_each(|runs| runs.peer.warm_up(case))?;
    let load_average = machine::load_average();
    for _ in 0..session.num_runs {
        subjects.iter_mut().try_for_each(Subject::run)?;
        peers.iter_mut().try_for_each(|runs| runs.run(case))?;
    }
    for (subject, runs) in subjects.iter().flat_map(|subject| peers.iter().map(move |runs| (subject, runs))) {
        runs.check(case, subject.counts)?;
    }
    let mut result = CaseResult {
        name: case.name.clone(),
        axis: case.axis.into(),
        kind: case.kind.name().into(),
        num_rays: case.num_rays,
        max_depth: case.max_depth,
        num_primitives: ir.surfaces.len() + ir.detectors.len(),
        load_average,
        measurements: subjects.into_iter().map(Subject::measurement).collect::<Result<_>>()?,
        peers: peers.into_iter().flat_map(PeerRuns::measurements).collect(),
    };
    result.fill_ratios();
    Ok(result)
}

impl CaseResult {
    /// Compares every measurement with every peer, in the same precision, or in the only one that the peer has.
    pub fn fill_ratios(&mut self) {
        for ours in &mut self.measurements {
            for peer in &self.peers {
                let twin =
                    |other: &&PeerMeasurement| other.name == peer.name && other.precision == ours.precision;
                let fair = self.peers.iter().find(twin).unwrap_or(peer);
                ours.ratios.insert(peer.name.clone(), ours.rays_per_sec.ratio_to(fair.rays_per_sec));
            }
        }
    }
}

/// This program in one precision, ready to run a case.
struct Subject<'a> {
    case: &'a Case,
    precision: Precision,
    engine: Engine<'a>,
    per_ray: PerRay,
    counts: Counts,
    ready_sec: Option<f64>,
    first_rays_sec: Option<f64>,
    runs_sec: Vec<f64>,
}

enum Engine<'a> {
    Tracer { tracer: Box<Tracer<'a>>, ir: &'a SceneIr },
    Command(Box<WholeCommand>),
}

impl<'a> Subject<'a> {
    /// Prepares everything and runs once, because drivers compile at the first dispatch.
    fn warm(
        case: &'a Case,
        session: &Session<'a>,
        ir: &'a SceneIr,
        precision: Precision,
        read_sec: f64,
    ) -> Result<Self> {
        let per_ray = per_ray(case, session.gpu, ir, precision)?;
        let start = Instant::now();
        let before = |now: Instant| read_sec + (now - start).as_secs_f64();
        let (engine, ready_sec) = match case.kind {
            Kind::Trace => {
                // The case stands for a long trace, so it is measured as if in the midst of one.
                let overrides =
                    in_midst(case.is_long() && AdapterTraits::of(session.gpu).processors.is_some());
                let options = case.options(precision).tuned(&session.gpu.info);
                let tracer = Tracer::with(
                    session.gpu,
                    ir,
                    &options,
                    ForAdapter::Forced(&overrides),
                    Shaders::default(),
                )?;
                let ready_sec = before(Instant::now());
                (Engine::Tracer { tracer: Box::new(tracer), ir }, Some(ready_sec))
            }
            Kind::Command | Kind::ColdCommand => {
                (Engine::Command(Box::new(WholeCommand::new(case, session, precision)?)), None)
            }
        };
        let counts = Counts { requested: case.num_rays, launched: 0, counted: 0, detected: 0, closed: false };
        let mut subject = Subject {
            case,
            precision,
            engine,
            per_ray,
            counts,
            ready_sec,
            first_rays_sec: None,
            runs_sec: vec![],
        };
        let report = subject.run_once()?.report;
        subject.first_rays_sec = match &subject.engine {
            Engine::Tracer { tracer, .. } => tracer.first_end().map(before),
            Engine::Command(_) => report["first_rays_sec"].as_f64(),
        };
        Ok(subject)
    }

    fn run(&mut self) -> Result<()> {
        let seconds = self.run_once()?.seconds;
        self.runs_sec.push(seconds);
        Ok(())
    }

    fn run_once(&mut self) -> Result<Run> {
        let (run, counts) = match &mut self.engine {
            Engine::Tracer { tracer, ir } => {
                let start = Instant::now();
                let tally = tracer.trace(|_| true)?;
                let run = Run { seconds: start.elapsed().as_secs_f64(), report: Value::Null };
                let ledger = Ledger::new(ir, &tally, FluxUnit::new(1.0, self.case.num_rays));
                (run, Counts::of_ledger(self.case.num_rays, &ledger))
            }
            Engine::Command(command) => command.run(self.case.num_rays)?,
        };
        counts.check(&self.case.name)?;
        self.counts = counts;
        Ok(run)
    }

    fn measurement(self) -> Result<Measurement> {
        let rays_per_sec = Summary::of_rates(self.case.num_rays as f64, &self.runs_sec)
            .ok_or_else(|| Error::Usage("the number of runs is 0; at least one is needed".into()))?;
        Ok(Measurement {
            precision: self.precision.name().into(),
            counts: self.counts,
            rays_per_sec,
            casts_per_sec: rays_per_sec.times(self.per_ray.casts),
            per_ray: self.per_ray,
            runs_sec: self.runs_sec,
            ready_sec: self.ready_sec,
            first_rays_sec: self.first_rays_sec,
            ratios: BTreeMap::new(),
        })
    }
}

/// One run.
struct Run {
    /// Duration of the run \[s\].
    seconds: f64,
    /// The report.json of a whole command.
    report: Value,
}

/// Counts on recorded paths, so that the trace itself needs no counter of casts.
fn per_ray(case: &Case, gpu: &Gpu, ir: &SceneIr, precision: Precision) -> Result<PerRay> {
    let num_rays = case.num_rays.min(RECORDED_RAYS);
    let options = TraceOptions { num_rays, paths: RecordPaths::All, ..case.options(precision) };
    let paths = Tracer::new(gpu, ir, &options)?.trace(|_| true)?.paths;
    let count = |wanted: fn(&PathEventKind) -> bool| {
        paths.iter().filter(|event| wanted(&event.kind)).count() as f64 / num_rays as f64
    };
    let interactions = count(|kind| matches!(kind, PathEventKind::Surface(_) | PathEventKind::Detector(_)));
    let casts = interactions + count(|kind| *kind == PathEventKind::Escaped);
    Ok(PerRay { casts, interactions })
}

/// `nsq-gpu trace` on a scene file, with its files written.
struct WholeCommand {
    files: TempDir,
    command: Command,
}

impl WholeCommand {
    fn new(case: &Case, session: &Session, precision: Precision) -> Result<Self> {
        let files = tempfile::tempdir().map_err(|error| Error::file(std::env::temp_dir(), error))?;
        let scene = files.path().join("scene.json");
        if !session.program.is_file() {
            let path = session.program.display();
            return Err(Error::Usage(format!(
                "whole commands are of `{path}`, which is missing; build it, or name another in NSQ_GPU_BINARY"
            )));
        }
        std::fs::write(&scene, &case.scene).map_err(|error| Error::file(&scene, error))?;
        let mut command = Command::new(&session.program);
        command.arg("trace").arg(scene).arg("-o").arg(files.path().join("out"));
        command.args(["-n", &case.num_rays.to_string(), "--max-depth", &case.max_depth.to_string()]);
        command.args(["--precision", precision.name(), "--adapter", &session.gpu.info.name]);
        command.args(["--progress", "never"]).stdout(Stdio::null()).stderr(Stdio::piped());
        if case.kind == Kind::ColdCommand {
            // The switches of Mesa and NVIDIA.
            command.env("MESA_SHADER_CACHE_DISABLE", "true").env("__GL_SHADER_DISK_CACHE", "0");
        }
        Ok(WholeCommand { files, command })
    }

    fn run(&mut self, num_rays: u64) -> Result<(Run, Counts)> {
        let start = Instant::now();
        let output =
            self.command.output().map_err(|error| Error::Internal(format!("no command: {error}")))?;
        let seconds = start.elapsed().as_secs_f64();
        if !output.status.success() {
            return Err(Error::Internal(String::from_utf8_lossy(&output.stderr).trim().to_string()));
        }
        let path = self.files.path().join("out").join(REPORT);
        let text = std::fs::read_to_string(&path).map_err(|error| Error::file(&path, error))?;
        let report: Value =
            serde_json::from_str(&text).map_err(|error| Error::Internal(error.to_string()))?;
        let counts = Counts::of_report(num_rays, &report);
        Ok((Run { seconds, report }, counts))
    }
}

/// A peer and its runs of one case.
struct PeerRuns<'a> {
    peer: &'a mut Box<dyn Peer>,
    runs: Vec<PeerRun>,
}

impl<'a> PeerRuns<'a> {
    fn new(peer: &'a mut Box<dyn Peer>) -> Self {
        PeerRuns { peer, runs: Vec::new() }
    }

    fn run(&mut self, case: &Case) -> Result<()> {
        self.runs.extend(self.peer.run(case)?);
        Ok(())
    }

    fn check(&self, case: &Case, ours: Counts) -> Result<()> {
        self.runs.iter().try_for_each(|run| ours.check_peer(&case.name, self.peer.name(), run))
    }

    fn measurements(self) -> impl Iterator<Item = PeerMeasurement> {
        let name = self.peer.name();
        PRECISIONS.into_iter().filter_map(move |precision| PeerMeasurement::of(name, precision, &self.runs))
    }
}

const PRECISIONS: [&str; 2] = ["f32", "f64"];

impl PeerMeasurement {
    /// The runs of a peer in one precision; `None` if there are no runs. All launch the same number of rays.
    pub fn of(name: &str, precision: &str, runs: &[PeerRun]) -> Option<Self> {
        let runs: Vec<&PeerRun> = runs.iter().filter(|run| run.precision == precision).collect();
        let num_rays = runs.first()?.num_rays;
        let runs_sec: Vec<f64> = runs.iter().map(|run| run.seconds).collect();
        let rays_per_sec = Summary::of_rates(num_rays as f64, &runs_sec)?;
        Some(PeerMeasurement {
            name: name.into(),
            precision: precision.into(),
            num_rays,
            runs_sec,
            rays_per_sec,
        })
    }
}
