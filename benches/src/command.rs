//! `nsq-bench`: measures how fast this machine traces, alone or against its peers.

use crate::peers::{DrJit, Mitsuba, Optiland};
use crate::report::ViewerResult;
use crate::runner::measure;
use crate::{
    BenchReport, Case, CaseResult, Peer, Session, cases, gradients, growth, machine, parts, paths, stability,
    tuning,
};
use clap::ValueEnum;
use nsq_gpu::gpu::{AdapterChoice, Gpu};
use nsq_gpu::internals::{PROGRAM, Tuning, check_places, count, print, say};
use nsq_gpu::program::Precision;
use nsq_gpu::{Error, Result};
use std::path::PathBuf;

/// Measures how fast scenes are traced by nsq-gpu, alone or against other programs.
#[derive(clap::Parser)]
#[command(
    name = "nsq-bench",
    version,
    after_help = "Exit codes: 0 done, 1 internal error or a lost ray, 2 usage, 4 no adapter, 5 device lost or out of memory, \
                  6 a claim or an exact answer is missed."
)]
pub struct Args {
    /// Instead of speed: scenes where tracers fail, against their exact answers (exit code 6 where one is missed).
    #[arg(long, conflicts_with_all = ["quick", "scenes", "runs", "max_rays", "against", "note", "output", "json"])]
    stability: bool,
    /// Instead of speed: finds out how to cut work for the adapter, and keeps it in the user's cache for later traces.
    /// No result changes.
    #[arg(long, conflicts_with_all = ["stability", "quick", "scenes", "runs", "max_rays", "against", "note", "output", "json"])]
    tune: bool,
    /// Instead of speed: what the table of paths costs, against the plain loop and the usual trace.
    #[arg(long, conflicts_with_all = ["stability", "tune", "against", "note", "output", "json"])]
    paths: bool,
    /// Instead of speed: what maps of derivatives cost, against the plain loop.
    #[arg(long, conflicts_with_all = ["stability", "tune", "paths", "against", "note", "output", "json"])]
    gradients: bool,
    /// Instead of speed: what each part of the CPU backend is worth, as the time without it over the time with it.
    #[arg(long, conflicts_with_all = ["stability", "tune", "paths", "gradients", "against", "note", "output", "json"])]
    parts: bool,
    /// Instead of speed: how the cost of a trace grows with surfaces, depth and rays; -o writes growth.txt.
    #[arg(long, conflicts_with_all = ["stability", "tune", "paths", "gradients", "parts", "scenes", "against", "note", "json"])]
    growth: bool,
    /// At most 1e5 rays a case, and 3 runs.
    #[arg(long)]
    quick: bool,
    /// Measure only these: names of cases or of sweeps (rays, surfaces, depth, short, lenses, spheres, meshes, splats,
    /// commands, cold_start, viewer).
    #[arg(long, value_delimiter = ',', value_name = "NAMES")]
    scenes: Vec<String>,
    /// Precision to measure; by default both, with --stability all.
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
    /// Write bench.json and bench.csv into this folder. Files of these names that exist are kept, and refused before the
    /// first ray. `benches/draw.py` draws them.
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
pub fn run(args: Args) -> Result<String> {
    let args = &args;
    if args.stability {
        return run_stability(args);
    }
    if args.tune {
        return run_tuning(args);
    }
    if args.growth {
        return run_growth(args);
    }
    let cases = chosen_cases(args)?;
    if args.paths {
        return run_paths(args, cases);
    }
    if args.parts {
        return run_parts(args, cases);
    }
    if args.gradients {
        return run_gradients(args, cases);
    }
    check_output(args, RATES)?;
    let gpu = open(args)?;
    let session = Session {
        gpu: &gpu,
        program: product()?,
        num_runs: args.num_runs(),
        precisions: precisions(args.precision.unwrap_or(PrecisionsArg::Both), &gpu),
    };
    let mut peers = args.against.iter().map(|peer| start(*peer, args)).collect::<Result<Vec<_>>>()?;
    let mut report = BenchReport::new(&gpu.info, session.num_runs, args.note.clone());
    report.command = command_line(args);
    report.peers = peers.iter().map(|peer| (peer.name().to_string(), peer.versions())).collect();
    // Measurements before a failed case took long, and are kept.
    let mut failure = None;
    for case in &cases {
        match measure(case, &session, &mut peers) {
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
    if failure.is_none() && (args.scenes.is_empty() || args.scenes.iter().any(|name| name == VIEWER)) {
        report.viewer = viewer(args, session.num_runs)?;
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
    print(&told)?;
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
    options.into_iter().flatten().fold("nsq-bench".into(), |line, option| line + &option)
}

/// The viewer's frames.
fn viewer(args: &Args, num_runs: usize) -> Result<Vec<ViewerResult>> {
    const FRAMES_PER_RUN: usize = 12;
    crate::viewer::measure(args.adapter.as_deref(), FRAMES_PER_RUN * num_runs)
}

/// The program whose whole commands are timed: the one that `NSQ_GPU_BINARY` names, or the one beside this program.
fn product() -> Result<PathBuf> {
    let named = std::env::var_os("NSQ_GPU_BINARY").filter(|path| !path.is_empty());
    let beside = || {
        let own = std::env::current_exe().map_err(|error| Error::Internal(error.to_string()))?;
        Ok(own.with_file_name(format!("{PROGRAM}{}", std::env::consts::EXE_SUFFIX)))
    };
    named.map_or_else(beside, |path| Ok(path.into()))
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
    print(&table)?;
    Err(Error::Tolerance(faults.join("\n")))
}

/// Measures what the table of paths costs.
fn run_paths(args: &Args, cases: Vec<Case>) -> Result<String> {
    let cases = cases::of_traces(cases, "--paths")?;
    cost_table(args, &cases, paths::PathCost::heading(), |gpu, case, precision, num_runs| {
        paths::measure(gpu, case, precision, num_runs).map(|cost| cost.line())
    })
}

/// Measures what parts of the CPU backend are worth.
fn run_parts(args: &Args, cases: Vec<Case>) -> Result<String> {
    let cases = cases::of_traces(cases, "--parts")?;
    cost_table(args, &cases, parts::PartGains::heading(), |gpu, case, precision, num_runs| {
        parts::measure(gpu, case, precision, num_runs).map(|gains| gains.line())
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

/// Measures how the cost grows, and writes the table.
fn run_growth(args: &Args) -> Result<String> {
    check_output(args, growth::FILES)?;
    let gpu = open(args)?;
    let precision = default_precision(args, &gpu);
    let growth = growth::measure(&gpu, precision, args.most_rays(), args.num_runs(), say)?;
    if let Some(dir) = &args.output {
        say(&format!("written: {}", growth.write(dir)?.display()));
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

/// Files that `-o` writes.
const RATES: &[&str] = &["bench.json", "bench.csv"];

/// Refuses a folder that cannot be written, or in which one of these files would be lost.
fn check_output(args: &Args, names: &[&str]) -> Result<()> {
    args.output.as_ref().map_or(Ok(()), |folder| check_places(folder, names, args.overwrite))
}

fn chosen_cases(args: &Args) -> Result<Vec<Case>> {
    let mut cases = cases::all(args.most_rays());
    let is = |case: &Case, name: &String| case.name == *name || case.axis == name;
    let is_viewer = |name: &str| name == VIEWER;
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
        PeerArg::Optiland => Box::new(Optiland::start(&args.python, args.peer_rays.max(1))?),
        PeerArg::Drjit => Box::new(DrJit::start(&args.python)?),
        PeerArg::Mitsuba => Box::new(Mitsuba::start(&args.python)?),
    })
}

fn progress(result: &CaseResult) -> String {
    let ours = result.measurements.iter().map(|m| (PROGRAM, m.precision.as_str(), m.rays_per_sec.median));
    let peers = result.peers.iter().map(|m| (m.name.as_str(), m.precision.as_str(), m.rays_per_sec.median));
    let rate = |(name, precision, rate): (&str, &str, f64)| format!("{name} {precision} {:.3}", 1e-6 * rate);
    let rates: Vec<String> = ours.chain(peers).map(rate).collect();
    format!("{}: {} M rays/s", result.name, rates.join(", "))
}
