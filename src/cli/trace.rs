//! `nsq-gpu trace`: a scene to maps, ledger and report.

use super::progress::{Mode, Progress};
use super::{count, read_scene, say};
use crate::error::{Error, Result};
use crate::gpu::{AdapterChoice, Gpu, Native};
use crate::ir::{ReflectProb, Sampling, SceneIr};
use crate::program::{Precision, Sampler};
use crate::result::{Recording, RunInfo, StageTime, TraceResult, output, report};
use crate::scene::Scene;
use crate::trace::{RecordPaths, TraceOptions, Tracer};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

/// Arguments of `nsq-gpu trace`.
#[derive(clap::Args)]
pub struct Args {
    /// The scene file: Optiland's NSQ JSON, with an optional "nsq_gpu" block.
    scene: PathBuf,
    /// Rays to launch: 250000, 1e7, 10M.
    #[arg(short = 'n', long, default_value = "1e6", value_parser = count::parse, value_name = "N")]
    num_rays: u64,
    /// Seed of every random draw.
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Largest number of events (surfaces and detectors) of a ray.
    #[arg(long, default_value_t = 16)]
    max_depth: u32,
    /// Russian roulette starts below this fraction of a new ray's flux, or the scene's rr_start_flux if that is larger.
    #[arg(long, default_value_t = 1e-6, value_name = "X")]
    min_flux_fraction: f64,
    /// Rays per dispatch; it changes memory and speed, never a result.
    #[arg(long, value_parser = count::parse, value_name = "N")]
    batch_size: Option<u64>,
    /// Arithmetic: auto takes f64 where the adapter runs it at a good rate.
    #[arg(long, value_enum, default_value_t = PrecisionArg::Auto)]
    precision: PrecisionArg,
    /// Draws: Optiland's random numbers, or Sobol points, with which a map's error falls faster.
    #[arg(long, value_enum, default_value_t = SamplerArg::Pcg)]
    sampler: SamplerArg,
    /// Part of the adapter's name (see `nsq-gpu adapters`).
    #[arg(long, value_name = "NAME")]
    adapter: Option<String>,
    /// Use no native 64-bit integers or atomics of the device: the same bits from plain WebGPU.
    #[arg(long)]
    portable: bool,
    /// Record the paths of about N rays, or of all, in ray_paths.npz.
    #[arg(long, value_name = "N|all", value_parser = parse_record_paths, requires = "output")]
    record_paths: Option<RecordPaths>,
    /// Override the scene's rr_start_flux.
    #[arg(long, value_name = "X")]
    rr_start_flux: Option<f64>,
    /// Override the scene's reflect_prob: fresnel, auto or a number in 0..=1.
    #[arg(long, value_name = "P", value_parser = parse_reflect_prob)]
    reflect_prob: Option<ReflectProb>,
    /// Override the scene's split_depth: rays of fewer events are split at refractive surfaces; 0 splits none.
    #[arg(long, value_name = "N")]
    split_depth: Option<u32>,
    /// Write report.json and, per detector, NAME.npz and NAME.png into this folder.
    #[arg(short, long, value_name = "DIR")]
    output: Option<PathBuf>,
    /// Write no pictures, the numbers alone.
    #[arg(long, requires = "output")]
    no_pictures: bool,
    /// Time the stages on the device: to stderr and into the report's diagnostics. The trace itself becomes slower.
    #[arg(long)]
    profile: bool,
    /// Print report.json instead of the text report.
    #[arg(long)]
    json: bool,
    /// Progress on stderr.
    #[arg(long, value_enum, default_value_t = Mode::Auto)]
    progress: Mode,
    /// End at once when stdin closes: a program that holds it leaves no trace running, however it ends itself.
    #[arg(long)]
    watch_stdin: bool,
}

/// The `--precision` argument.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum PrecisionArg {
    /// f64 on a processor; on a GPU by its measured rates.
    Auto,
    /// 32-bit floats.
    F32,
    /// 64-bit floats.
    F64,
}

/// The `--sampler` argument.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum SamplerArg {
    /// Optiland's keyed PCG32, bit for bit.
    Pcg,
    /// Owen-scrambled Sobol points, a ray a point.
    Sobol,
}

fn parse_record_paths(text: &str) -> std::result::Result<RecordPaths, String> {
    if text == "all" { Ok(RecordPaths::All) } else { count::parse(text).map(RecordPaths::About) }
}

fn parse_reflect_prob(text: &str) -> std::result::Result<ReflectProb, String> {
    match text {
        "fresnel" => Ok(ReflectProb::Fresnel),
        "auto" => Ok(ReflectProb::Auto),
        number => match number.parse::<f64>() {
            Ok(p) if (0.0..=1.0).contains(&p) => Ok(ReflectProb::Constant(p)),
            _ => Err(format!("`{text}` is neither fresnel, auto nor a number in 0..=1")),
        },
    }
}

/// Traces, writes the files, and gives what goes to stdout. An interrupted trace is written, then reported as such.
pub fn run(args: &Args) -> Result<String> {
    if args.watch_stdin {
        std::thread::spawn(end_with_stdin);
    }
    let scene = read_scene(&args.scene)?;
    let mut ir = scene.lower()?;
    override_sampling(&mut ir, args)?;
    if let Some(dir) = &args.output {
        output::check_writable(dir)?;
    }
    let gpu = Gpu::open(&adapter_choice(args))?;
    let options = options(args, &gpu)?;
    let (result, interrupted) = trace(args, &scene, &ir, &gpu, &options)?;
    if let Some(dir) = &args.output {
        let files = if args.no_pictures { output::write_numbers } else { output::write_all }(dir, &result)?;
        files.iter().filter(|_| !args.json).for_each(|file| say(&format!("written: {}", file.display())));
    }
    let printed = if args.json { json(&result, args.output.as_deref())? } else { result.report() };
    if interrupted {
        super::print(&printed)?;
        return Err(Error::Interrupted);
    }
    Ok(printed)
}

/// report.json as it was written, or as it would be without files.
fn json(result: &TraceResult, output: Option<&Path>) -> Result<String> {
    let Some(dir) = output else {
        return Ok(report::Report::new(result, &report::Files::default()).to_json());
    };
    let path = dir.join(output::REPORT);
    std::fs::read_to_string(&path).map_err(|e| Error::file(path, e))
}

fn override_sampling(ir: &mut SceneIr, args: &Args) -> Result<()> {
    if let Some(reflect_prob) = args.reflect_prob {
        ir.sampling.reflect_prob = reflect_prob;
    }
    if let Some(rr_start_flux) = args.rr_start_flux {
        if !(0.0..=1.0).contains(&rr_start_flux) {
            return Err(Error::Usage(format!("--rr-start-flux is {rr_start_flux}; it must lie in 0..=1")));
        }
        ir.sampling.rr_start_flux = rr_start_flux;
    }
    if let Some(split_depth) = args.split_depth {
        if split_depth > Sampling::MAX_SPLIT_DEPTH {
            let most = Sampling::MAX_SPLIT_DEPTH;
            return Err(Error::Usage(format!("--split-depth is {split_depth}; it must lie in 0..={most}")));
        }
        ir.sampling.split_depth = split_depth;
    }
    Ok(())
}

fn adapter_choice(args: &Args) -> AdapterChoice {
    let native = if args.portable { Native::Off } else { Native::Allowed };
    AdapterChoice { name: args.adapter.clone(), native, runtime_checks: false }
}

fn options(args: &Args, gpu: &Gpu) -> Result<TraceOptions> {
    let precision = match args.precision {
        PrecisionArg::F32 => Precision::F32,
        PrecisionArg::F64 => Precision::F64,
        PrecisionArg::Auto => gpu.preferred_precision()?,
    };
    Ok(TraceOptions {
        num_rays: args.num_rays,
        seed: args.seed,
        max_depth: args.max_depth,
        min_flux_fraction: args.min_flux_fraction,
        batch_size: args.batch_size.map(|n| n.min(u64::from(u32::MAX)) as u32),
        precision,
        sampler: match args.sampler {
            SamplerArg::Pcg => Sampler::Pcg,
            SamplerArg::Sobol => Sampler::Sobol,
        },
        paths: args.record_paths.unwrap_or(RecordPaths::None),
        ..Default::default()
    })
}

fn trace(
    args: &Args,
    scene: &Scene,
    ir: &SceneIr,
    gpu: &Gpu,
    options: &TraceOptions,
) -> Result<(TraceResult, bool)> {
    let mut tracer = Tracer::new(gpu, ir, options)?;
    tracer.record_to(match &args.output {
        Some(dir) => Recording::in_folder(ir, &output::file_system_of(dir)?),
        None => Recording::counted(ir),
    });
    if args.profile {
        tracer.enable_profile()?;
    }
    let stop = stop_on_interrupt()?;
    let mut progress = Progress::new(args.progress, options.num_rays);
    let start = Instant::now();
    let tally = tracer.trace(|rays| {
        progress.update(rays);
        !stop.load(Ordering::Relaxed)
    })?;
    let trace_time_sec = start.elapsed().as_secs_f64();
    progress.finish();
    let stage_times = tracer.stage_times();
    stage_times.iter().for_each(|time| say(&profile_line(time, trace_time_sec)));
    let run = RunInfo {
        scene: Some(args.scene.display().to_string()),
        num_rays: options.num_rays,
        seed: options.seed,
        max_depth: options.max_depth,
        min_flux_fraction: options.min_flux_fraction,
        precision: options.precision.name().into(),
        sampler: options.sampler.name().into(),
        adapter: gpu.info.name.clone(),
        driver: gpu.info.driver.clone(),
        trace_time_sec,
        stage_times,
        scene_warnings: scene.warnings.clone(),
        partial: tally.launched.count < options.num_rays,
        program: env!("CARGO_PKG_NAME").into(),
        version: env!("CARGO_PKG_VERSION").into(),
    };
    let interrupted = run.partial;
    let result = match tracer.take_recording() {
        Some(recording) => TraceResult::with_rows(ir, &run, &tally, &recording.finish())?,
        None => TraceResult::new(ir, &run, &tally)?,
    };
    Ok((result, interrupted))
}

fn profile_line(time: &StageTime, trace_time_sec: f64) -> String {
    let StageTime { stage, num_dispatches, time_sec } = time;
    let percent = 100.0 * time_sec / trace_time_sec;
    format!(
        "profile: {stage:<13}{num_dispatches:>8} dispatches{time_sec:>12.6} s{percent:>7.1} % of the trace"
    )
}

/// Waits until nobody holds the other end of stdin, and ends the process. Results appear whole or not at all, so that
/// there is nothing to tidy up.
fn end_with_stdin() {
    let _ = std::io::copy(&mut std::io::stdin(), &mut std::io::sink());
    std::process::exit(i32::from(Error::Interrupted.exit_code()));
}

/// A flag that Ctrl-C sets; a second Ctrl-C ends the process at once.
fn stop_on_interrupt() -> Result<Arc<AtomicBool>> {
    let stop = Arc::new(AtomicBool::new(false));
    let flag = stop.clone();
    ctrlc::set_handler(move || {
        if flag.swap(true, Ordering::Relaxed) {
            std::process::exit(i32::from(Error::Interrupted.exit_code()));
        }
    })
    .map_err(|e| Error::Internal(format!("no handler for Ctrl-C: {e}")))?;
    Ok(stop)
}
