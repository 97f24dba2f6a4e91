//! `nsq-gpu bench`: measures how fast this machine traces, alone or against its peers.

use crate::bench::accuracy::curves::Effort;
use crate::bench::accuracy::{self, AccuracyReport};
use crate::bench::peers::optiland::Backend;
use crate::bench::peers::{DrJit, Mitsuba, Optiland};
#[cfg(feature = "viewer")]
use crate::bench::report::ViewerResult;
use crate::bench::runner::measure;
use crate::bench::{
    BenchReport, Case, CaseResult, Peer, Session, cases, gradients, growth, machine, paths, stability, tuning,
};
use crate::cli::console::say;
use crate::cli::output_file::OutputFile;
use crate::count;
use crate::cpu::vector_width::{self, Width};
use crate::engine::tuning::Tuning;
use crate::error::{Error, Result};
use crate::gpu::{AdapterChoice, Gpu};
use crate::program::Precision;
use crate::result::output;
use crate::scene::Scene;
use clap::ValueEnum;
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::Command;

/// Arguments of `nsq-gpu bench`.
#[derive(clap::Args)]
pub struct Args {
    /// Instead of speed: scenes where tracers fail, against their exact answers (exit code 6 where one is missed).
    #[arg(long, conflicts_with_all = ["quick", "scenes", "runs", "max_rays", "against", "note", "output", "json"])]
    stability: bool,
    /// Instead of speed: finds out how to cut work for the adapter, and keeps it in the user's cache for later traces.
    /// No result changes.
    #[arg(long, conflicts_with_all = ["stability", "accuracy", "quick", "scenes", "runs", "max_rays", "against", "note", "output", "json"])]
    tune: bool,
    /// Instead of speed: what the table of paths costs, against the plain loop and the usual trace.
    #[arg(long, conflicts_with_all = ["stability", "tune", "accuracy", "against", "note", "output", "json"])]
    paths: bool,
    /// Instead of speed: what maps of derivatives cost, against the plain loop.
    #[arg(long, conflicts_with_all = ["stability", "tune", "accuracy", "paths", "against", "note", "output", "json"])]
    gradients: bool,
    /// Instead of speed: how the cost of a trace grows with surfaces, depth and rays; -o writes growth.txt and growth.png.
    #[arg(long, conflicts_with_all = ["stability", "tune", "accuracy", "paths", "gradients", "scenes", "against", "note", "json"])]
    growth: bool,
    /// Instead of speed alone: error against time of every tier, sampler and setting, and what Sobol points are worth.
    /// Exit code 6 where that is less than claimed.
    #[arg(long, conflicts_with_all = ["stability", "runs", "max_rays", "json"])]
    accuracy: bool,
    /// With --accuracy: only what Sobol points are worth.
    #[arg(long, requires = "accuracy", conflicts_with = "against")]
    claims: bool,
    /// At most 1e5 rays a case, and 3 runs.
    #[arg(long)]
    quick: bool,
    /// Measure only these: names of cases or of sweeps (rays, surfaces, depth, short, lenses, spheres, meshes, splats,
    /// commands, cold_start, viewer); with --accuracy, names of scenes.
    #[arg(long, value_delimiter = ',', value_name = "NAMES")]
    scenes: Vec<String>,
    /// Precision to measure; by default both, with --stability and --accuracy all.
    #[arg(long, value_enum)]
    precision: Option<PrecisionsArg>,
    /// Measured runs of each case, after one to warm up; 5, or 3 with --quick.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..))]
    runs: Option<u16>,
    /// Most rays of a case.
    #[arg(long, value_name = "N", value_parser = count::parse)]
    max_rays: Option<u64>,
    /// Part of the adapter's name (see `nsq-gpu adapters`).
    #[arg(long, value_name = "NAME")]
    adapter: Option<String>,
    /// Run a peer in turns with this program: optiland, drjit, mitsuba.
    #[arg(long, value_enum, value_delimiter = ',', value_name = "PEER")]
    against: Vec<PeerArg>,
    /// Python that has the peers installed.
    #[arg(long, value_name = "PYTHON", default_value = "python3")]
    python: PathBuf,
    /// Most rays for Optiland in a warm process, whose rate does not depend on their number.
    #[arg(long, value_name = "N", default_value_t = PEER_RAYS, value_parser = count::parse)]
    peer_rays: u64,
    /// A note for readers of the files, such as who else uses the machine.
    #[arg(long, value_name = "TEXT")]
    note: Option<String>,
    /// Write bench.json, bench.csv and bench.png into this folder. Files of these names that exist are kept, and refused
    /// before the first ray.
    #[arg(short, long, value_name = "DIR")]
    output: Option<PathBuf>,
    /// Let -o replace files that exist.
    #[arg(long, requires = "output")]
    overwrite: bool,
    /// Print bench.json instead of the table.
    #[arg(long)]
    json: bool,
}

/// The `--precision` argument.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum PrecisionsArg {
    /// 32-bit floats.
    F32,
    /// Pairs of 32-bit floats.
    Df64,
    /// 64-bit floats.
    F64,
    /// F32 and f64, as far as the adapter has them.
    Both,
    /// All three, as far as the adapter has them.
    All,
}

/// The `--against` argument.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum PeerArg {
    /// Optiland's NumPy backend.
    Optiland,
    /// A hand-written Dr.Jit kernel of the sweep over rays.
    Drjit,
    /// Mitsuba 3 with Embree: random rays on spheres and a mesh, and the sweep over surfaces.
    Mitsuba,
}

/// The name of an argument's value on the command line.
fn name_of(argument: &impl ValueEnum) -> String {
    argument.to_possible_value().map_or(String::new(), |value| value.get_name().into())
}

/// The name of the viewer's frames among the cases.
const VIEWER: &str = "viewer";

/// Rays for Optiland, unless the user asks for another number.
const PEER_RAYS: u64 = 100_000;

/// The limit of --quick.
const QUICK_RAYS: u64 = 100_000;

impl Args {
    /// Measured runs of each case.
    fn num_runs(&self) -> usize {
        usize::from(self.runs.unwrap_or(if self.quick { 3 } else { 5 }))
    }

    /// Most rays of a case.
    fn most_rays(&self) -> u64 {
        self.max_rays.unwrap_or(if self.quick { QUICK_RAYS } else { u64::MAX })
    }
}

/// Measures, writes the files, and returns the text for stdout.
pub fn run(args: &Args) -> Result<String> {
    if args.stability {
        return run_stability(args);
    }
    if args.tune {
        return run_tuning(args);
    }
    if args.accuracy {
        return run_accuracy(args);
    }
    if args.growth {
        return run_growth(args);
    }
    let cases = chosen_cases(args)?;
    if args.paths {
        return run_paths(args, cases);
    }
    if args.gradients {
        return run_gradients(args, cases);
    }
    check_output(args, RATES)?;
    let widths = widths(&cases)?;
    let widest = widest(&widths);
    crate::cli::console::choose_width(widest);
    let gpu = open(args)?;
    let session = Session {
        gpu: &gpu,
        program: std::env::current_exe().map_err(|error| Error::Internal(error.to_string()))?,
        num_runs: args.num_runs(),
        precisions: precisions(args.precision.unwrap_or(PrecisionsArg::Both), &gpu),
    };
    let mut peers = args.against.iter().map(|peer| start(*peer, args)).collect::<Result<Vec<_>>>()?;
    let mut report = BenchReport::new(&gpu.info, session.num_runs, args.note.clone());
    report.command = command_line(args);
    report.peers = peers.iter().map(|peer| (peer.name().to_string(), peer.versions())).collect();
    // Measurements before a failed case took long, and are kept.
    let mut failure = None;
    for (case, width) in cases.iter().zip(widths) {
        let result =
            if width == widest || !vector_width::are_chosen() || !gpu.info.class.may_be_told_vector_width() {
                measure(case, &session, &mut peers)
            } else {
                measure_apart(case, &session, args)
            };
        match result {
            Ok(result) => {
                say(&progress(&result));
                report.cases.push(result);
            }
            Err(error) if report.cases.is_empty() => return Err(error),
            Err(error) => {
                say(&format!("{} failed; the cases before it are kept", case.name));
                failure = Some(error);
                break;
            }
        }
    }
    #[cfg(feature = "viewer")]
    if failure.is_none() && (args.scenes.is_empty() || args.scenes.iter().any(|name| name == VIEWER)) {
        // Fragment shaders in vectors of 512 bits crash Mesa 22.3.
        let is_apart = widest == Width::Wide && gpu.info.class.may_be_told_vector_width();
        report.viewer = if is_apart { viewer_apart(&session)? } else { viewer(args, session.num_runs)? };
        for state in &report.viewer {
            let [host, frame] = [state.host_sec, state.frame_sec].map(|seconds| 1e3 * seconds.median);
            say(&format!("{}: {host:.1} ms a frame, {frame:.1} ms with its drawing", state.name));
        }
    }
    report.machine.load_average_end = machine::load_average();
    if let Some(dir) = &args.output {
        let files = report.write_all(dir)?;
        files.iter().for_each(|file| say(&format!("written: {}", file.display())));
    }
    let told = if args.json { report.to_json() } else { report.table() };
    let Some(error) = failure else { return Ok(told) };
    crate::cli::console::print(&told)?;
    Err(error)
}

/// The command that repeats the measurement, without what belongs to one machine: its adapter, its Python, its folders.
fn command_line(args: &Args) -> String {
    let list = |name: &str, values: &[String]| {
        (!values.is_empty()).then(|| format!(" --{name} {}", values.join(",")))
    };
    let value = |name: &str, value: Option<String>| value.map(|value| format!(" --{name} {value}"));
    let against: Vec<String> = args.against.iter().map(name_of).collect();
    let options = [
        args.quick.then(|| " --quick".to_string()),
        list("scenes", &args.scenes),
        value("precision", args.precision.as_ref().map(name_of)),
        value("runs", args.runs.map(|runs| runs.to_string())),
        value("max-rays", args.max_rays.map(|rays| rays.to_string())),
        list("against", &against),
        value(
            "peer-rays",
            Some(args.peer_rays).filter(|rays| *rays != PEER_RAYS).map(|rays| rays.to_string()),
        ),
    ];
    options.into_iter().flatten().fold("nsq-gpu bench".into(), |line, option| line + &option)
}

/// The width of vectors that suits each case. A timed trace is compiled before. Whole commands choose their own width.
fn widths(cases: &[Case]) -> Result<Vec<Width>> {
    let width = |case: &Case| Ok(Width::of_trace(&Scene::from_json(&case.scene)?.lower()?, case.num_rays));
    cases.iter().map(width).collect()
}

fn widest(widths: &[Width]) -> Width {
    widths.iter().copied().max().unwrap_or(Width::Usual)
}

/// The viewer's frames.
#[cfg(feature = "viewer")]
fn viewer(args: &Args, num_runs: usize) -> Result<Vec<ViewerResult>> {
    const FRAMES_PER_RUN: usize = 12;
    crate::bench::viewer::measure(args.adapter.as_deref(), FRAMES_PER_RUN * num_runs)
}

/// The viewer's frames, drawn by a process of its own.
#[cfg(feature = "viewer")]
fn viewer_apart(session: &Session) -> Result<Vec<ViewerResult>> {
    let report = report_of(VIEWER, session, Vec::new())?;
    serde_json::from_value(report["viewer"].clone()).map_err(|error| Error::Internal(error.to_string()))
}

/// Measures a case in a process of its own, because the width of vectors belongs to a process.
fn measure_apart(case: &Case, session: &Session, args: &Args) -> Result<CaseResult> {
    let mut options = vec!["--max-rays".into(), case.num_rays.to_string()];
    options.extend(["--peer-rays".into(), args.peer_rays.to_string()]);
    options.extend(["--precision".into(), name_of(&args.precision.unwrap_or(PrecisionsArg::Both))]);
    options.extend(["--python".into(), args.python.display().to_string()]);
    options.extend(args.against.iter().flat_map(|peer| ["--against".to_string(), name_of(peer)]));
    let report = report_of(&case.name, session, options)?;
    serde_json::from_value(report["cases"][0].clone()).map_err(|error| Error::Internal(error.to_string()))
}

/// The report of this program about one case, measured in a process of its own.
fn report_of(case: &str, session: &Session, options: Vec<String>) -> Result<Value> {
    let mut command = Command::new(&session.program);
    vector_width::leave_to(&mut command);
    command.args(["bench", "--json", "--scenes", case, "--runs", &session.num_runs.to_string()]);
    command.args(["--adapter", &session.gpu.info.name]).args(options);
    let output = command.output().map_err(|error| Error::Internal(format!("no command: {error}")))?;
    if !output.status.success() {
        let said = String::from_utf8_lossy(&output.stderr);
        return Err(Error::Internal(format!("{case} by itself: {}", said.trim())));
    }
    serde_json::from_slice(&output.stdout).map_err(|error| Error::Internal(error.to_string()))
}

fn open(args: &Args) -> Result<Gpu> {
    Gpu::open(&AdapterChoice { name: args.adapter.clone(), ..Default::default() })
}

/// Traces the cases of [`stability`], and prints their table.
fn run_stability(args: &Args) -> Result<String> {
    let gpu = open(args)?;
    let precisions = precisions(args.precision.unwrap_or(PrecisionsArg::All), &gpu);
    let mut rows = Vec::new();
    for case in stability::cases()? {
        let outcome = |precision: &Precision| Ok((*precision, case.measure(&gpu, *precision)?));
        let outcomes = precisions.iter().map(outcome).collect::<Result<Vec<_>>>()?;
        rows.push(stability::Row { case, outcomes });
    }
    let table = stability::table(&rows);
    let faults = stability::faults(&rows);
    if faults.is_empty() {
        return Ok(table);
    }
    crate::cli::console::print(&table)?;
    Err(Error::Tolerance(faults.join("\n")))
}

/// Measures what the table of paths costs.
fn run_paths(args: &Args, cases: Vec<Case>) -> Result<String> {
    let cases = paths::cases(cases)?;
    crate::cli::console::choose_width(widest(&widths(&cases)?));
    cost_table(args, &cases, paths::PathCost::heading(), |gpu, case, precision, num_runs| {
        paths::measure(gpu, case, precision, num_runs).map(|cost| cost.line())
    })
}

/// Measures what derivatives cost.
fn run_gradients(args: &Args, cases: Vec<Case>) -> Result<String> {
    let cases = gradients::cases(cases)?;
    cost_table(args, &cases, gradients::GradientCost::heading(), |gpu, case, precision, num_runs| {
        gradients::measure(gpu, case, precision, num_runs).map(|cost| cost.line())
    })
}

/// Measures each case in each precision, and returns the lines below a heading.
fn cost_table(
    args: &Args,
    cases: &[Case],
    heading: String,
    measure: impl Fn(&Gpu, &Case, Precision, usize) -> Result<String>,
) -> Result<String> {
    let gpu = open(args)?;
    let num_runs = args.num_runs();
    let mut table = heading;
    for case in cases {
        for precision in precisions(args.precision.unwrap_or(PrecisionsArg::Both), &gpu) {
            let line = measure(&gpu, case, precision, num_runs)?;
            say(line.trim_end());
            table += &line;
        }
    }
    Ok(table)
}

/// Measures how the cost grows, and writes the table and the chart.
fn run_growth(args: &Args) -> Result<String> {
    check_output(args, growth::FILES)?;
    let gpu = open(args)?;
    let precision = default_precision(args, &gpu);
    let growth = growth::measure(&gpu, precision, args.most_rays(), args.num_runs(), say)?;
    if let Some(dir) = &args.output {
        growth.write_all(dir)?.iter().for_each(|file| say(&format!("written: {}", file.display())));
    }
    Ok(growth.table())
}

/// The precision that is asked for, or the one in which the adapter traces by default.
fn default_precision(args: &Args, gpu: &Gpu) -> Precision {
    let default = if gpu.info.class.computes_f64_as_fast_as_f32() && gpu.f64 {
        PrecisionsArg::F64
    } else {
        PrecisionsArg::F32
    };
    precisions(args.precision.unwrap_or(default), gpu).first().copied().unwrap_or(Precision::F32)
}

/// Measures in the precision that the adapter traces in by default.
fn run_tuning(args: &Args) -> Result<String> {
    crate::cli::console::choose_width(widest(&widths(&tuning::cases())?));
    let gpu = open(args)?;
    let precision = default_precision(args, &gpu);
    let trials = tuning::measure(&gpu, precision)?;
    let best = tuning::best(&trials, Tuning::untuned(&gpu.info));
    let path = best.keep(&gpu.info)?;
    Ok(format!(
        "{}`{}` traces in workgroups of {}, {} events a dispatch; kept in {}\n",
        tuning::table(&trials),
        gpu.info.name,
        best.workgroup_size,
        best.events_per_dispatch,
        path.display()
    ))
}

/// The effort of `--accuracy`: some minutes on two cores.
const FULL: Effort = Effort { num_seeds: 4, trace_sec: 1.0, answer_sec: 6.0, most_rays: 1 << 22 };
/// The effort with --quick: seconds. Claims are shown but not judged.
const QUICK: Effort = Effort { num_seeds: 2, trace_sec: 0.1, answer_sec: 0.2, most_rays: 1 << 14 };
/// Rays whose paths are compared between tiers.
const PATHS: u64 = 1 << 14;

/// Files that `-o` writes: of rates, and of error against time.
const RATES: &[&str] = &["bench.json", "bench.csv", "bench.png"];
const ACCURACY: &[&str] = &[
    "accuracy.txt",
    "accuracy.csv",
    "accuracy.png",
    "accuracy_flux.png",
    "numerical.csv",
    "numerical.png",
    "sobol.csv",
];

/// Refuses a folder that cannot be written, or in which one of these files would be lost.
fn check_output(args: &Args, names: &[&str]) -> Result<()> {
    let Some(dir) = &args.output else { return Ok(()) };
    output::check_writable(dir)?;
    let mut there = names.iter().map(|name| dir.join(name)).filter(|path| crate::placing::exists(path));
    there.try_for_each(|path| OutputFile::new(&path, args.overwrite, Path::new(""), |_| false).map(drop))
}

/// Measures error against time, and what Sobol points are worth.
fn run_accuracy(args: &Args) -> Result<String> {
    check_output(args, ACCURACY)?;
    let is_chosen = |name: &str| args.scenes.is_empty() || args.scenes.iter().any(|scene| scene == name);
    check_scenes(args)?;
    let gpu = open(args)?;
    let precisions = precisions(args.precision.unwrap_or(PrecisionsArg::All), &gpu);
    let mut peers = map_peers(args)?;
    let effort = if args.quick { QUICK } else { FULL };
    let mut report = AccuracyReport::new(&gpu.info, args.note.clone());
    for scene in accuracy::SCENES.iter().filter(|scene| !args.claims && is_chosen(scene.name)) {
        say(&format!("{}: error against time", scene.name));
        report.scenes.push(accuracy::curves::measure(&gpu, scene, &precisions, &mut peers, &effort)?);
        let num_rays = PATHS.min(effort.most_rays / 4);
        report.numerical.extend(accuracy::numerical::measure(&gpu, scene, &precisions, num_rays)?);
    }
    let precision = *precisions.last().unwrap_or(&Precision::F32);
    for claim in accuracy::CLAIMS.iter().filter(|claim| is_chosen(claim.scene.name)) {
        let claim = if args.quick { claim.quick() } else { *claim };
        let verdict = claim.measure(&gpu, precision)?;
        say(verdict.to_string().trim_end());
        report.verdicts.push(verdict);
    }
    if let Some(dir) = &args.output {
        let files = report.write_all(dir)?;
        files.iter().for_each(|file| say(&format!("written: {}", file.display())));
    }
    let faults = report.faults();
    if args.quick || faults.is_empty() {
        return Ok(report.table());
    }
    crate::cli::console::print(&report.table())?;
    Err(Error::Tolerance(faults.join("\n")))
}

fn check_scenes(args: &Args) -> Result<()> {
    let claims = accuracy::CLAIMS.iter().map(|claim| claim.scene.name);
    let mut names: Vec<&str> = accuracy::SCENES.iter().map(|scene| scene.name).chain(claims).collect();
    names.sort_unstable();
    names.dedup();
    match args.scenes.iter().find(|scene| !names.contains(&scene.as_str())) {
        Some(unknown) => {
            Err(Error::Usage(format!("no scene is named `{unknown}`; there are {}", names.join(", "))))
        }
        None => Ok(()),
    }
}

/// Optiland's NumPy backend, and its Torch backend where that Python has it.
fn map_peers(args: &Args) -> Result<Vec<Optiland>> {
    if args.against.iter().any(|peer| *peer != PeerArg::Optiland) {
        return Err(Error::Usage("--accuracy compares with optiland alone".into()));
    }
    if args.against.is_empty() {
        return Ok(Vec::new());
    }
    let numpy = Optiland::start(&args.python, Backend::Numpy, args.peer_rays)?;
    if !numpy.has_torch() {
        say(&format!("`{}` has no Torch: NumPy alone is compared", args.python.display()));
        return Ok(vec![numpy]);
    }
    Ok(vec![numpy, Optiland::start(&args.python, Backend::Torch, args.peer_rays)?])
}

fn chosen_cases(args: &Args) -> Result<Vec<Case>> {
    let mut cases = cases::all(args.most_rays());
    let is = |case: &Case, name: &String| case.name == *name || case.axis == name;
    let is_viewer = |name: &str| cfg!(feature = "viewer") && name == VIEWER;
    let is_known = |name: &String| is_viewer(name) || cases.iter().any(|case| is(case, name));
    if let Some(unknown) = args.scenes.iter().find(|name| !is_known(name)) {
        let mut names: Vec<&str> = cases.iter().map(|case| case.name.as_str()).collect();
        names.extend(Some(VIEWER).filter(|name| is_viewer(name)));
        return Err(Error::Usage(format!("no case is named `{unknown}`; there are {}", names.join(", "))));
    }
    cases.retain(|case| args.scenes.is_empty() || args.scenes.iter().any(|name| is(case, name)));
    Ok(cases)
}

fn precisions(wanted: PrecisionsArg, gpu: &Gpu) -> Vec<Precision> {
    let pairs = || gpu.check_df64().is_ok().then_some(Precision::Df64);
    let doubles = gpu.f64.then_some(Precision::F64);
    match wanted {
        PrecisionsArg::F32 => vec![Precision::F32],
        PrecisionsArg::Df64 => vec![Precision::Df64],
        PrecisionsArg::F64 => vec![Precision::F64],
        PrecisionsArg::Both => [Some(Precision::F32), doubles].into_iter().flatten().collect(),
        PrecisionsArg::All => [Some(Precision::F32), pairs(), doubles].into_iter().flatten().collect(),
    }
}

fn start(peer: PeerArg, args: &Args) -> Result<Box<dyn Peer>> {
    Ok(match peer {
        PeerArg::Optiland => Box::new(Optiland::start(&args.python, Backend::Numpy, args.peer_rays.max(1))?),
        PeerArg::Drjit => Box::new(DrJit::start(&args.python)?),
        PeerArg::Mitsuba => Box::new(Mitsuba::start(&args.python)?),
    })
}

fn progress(result: &CaseResult) -> String {
    let ours = result
        .measurements
        .iter()
        .map(|m| (env!("CARGO_PKG_NAME"), m.precision.as_str(), m.rays_per_sec.median));
    let peers = result.peers.iter().map(|m| (m.name.as_str(), m.precision.as_str(), m.rays_per_sec.median));
    let rate = |(name, precision, rate): (&str, &str, f64)| format!("{name} {precision} {:.3}", 1e-6 * rate);
    let rates: Vec<String> = ours.chain(peers).map(rate).collect();
    format!("{}: {} M rays/s", result.name, rates.join(", "))
}
