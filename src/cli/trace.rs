//! `nsq-gpu trace`: traces a scene to maps, ledger and report.

use crate::cli::console::{ended, named, read_scene, say};
use crate::cli::pictures::PictureArgs;
use crate::cli::progress::{Mode, Progress, Status};
use crate::cli::quantity;
use crate::cli::stops::{end_with_caller, stop_on_interrupt};
use crate::cli::trace_args::{PathsArg, PrecisionArg, StandardErrorArg, TraceArgs, wanted};
use crate::count;
use crate::error::{Error, Result};
use crate::gpu::{AdapterChoice, Gpu};
use crate::model::SceneIr;
use crate::program::Precision;
use crate::result::StoppedBy;
use crate::result::png::Style;
use crate::result::{Recording, RunInfo, StageTime, Tally, TraceResult, output, report};
use crate::run::checkpoint::{self, Checkpoint, Identity};
use crate::run::gradients::{Differentiated, How};
use crate::run::precision::{self, Choice, Wanted};
use crate::run::stopping::Stopping;
use crate::run::{self, RecordPaths, TraceOptions, Tracer};
use crate::scene::Scene;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::{Scope, ScopedJoinHandle};
use std::time::{Duration, Instant};

/// Arguments of `nsq-gpu trace`.
#[derive(clap::Args)]
pub struct Args {
    /// The scene file: Optiland's NSQ JSON, with an optional "nsq_gpu" block.
    scene: PathBuf,
    #[command(flatten)]
    trace: TraceArgs,
    /// Write the sums so far to this file at intervals, and at the end. Sums of another trace are replaced only with
    /// --overwrite.
    #[arg(long, value_name = "FILE")]
    checkpoint: Option<PathBuf>,
    /// Let --checkpoint replace the sums of another trace.
    #[arg(long, requires = "checkpoint")]
    overwrite: bool,
    /// Time between two checkpoints.
    #[arg(long, default_value = "30s", value_name = "TIME", value_parser = quantity::parse_time, requires = "checkpoint")]
    checkpoint_interval: Duration,
    /// Go on from the sums in this file, which the same command with --checkpoint wrote. The result has the bits of an
    /// unbroken trace.
    #[arg(long, value_name = "FILE")]
    resume: Option<PathBuf>,
    /// Part of the adapter's name (see `nsq-gpu adapters`).
    #[arg(long, value_name = "NAME")]
    adapter: Option<String>,
    /// Use no native 64-bit integers or atomics of the device: the same bits from plain WebGPU.
    #[arg(long)]
    portable: bool,
    /// Record the paths of about N rays, or of all, in ray_paths.npz.
    #[arg(long, value_name = "N|all", value_parser = parse_record_paths, requires = "output")]
    record_paths: Option<RecordPaths>,
    /// Differentiate what detectors record by numbers of the scene: L1.r1,L2.z. With -o, maps of derivatives and their
    /// standard errors go to gradients.npz. Names with dots or commas are quoted: '"a.b".r1'.
    #[arg(long, value_name = "NAMES", value_parser = parse_names, conflicts_with_all = ["checkpoint", "overwrite",
        "checkpoint_interval", "resume",
        "record_paths", "profile", "target_error", "time_limit", "first_ray", "of_rays"])]
    gradient: Option<Names>,
    /// With --gradient: also find each derivative by a difference of two traces, which sees light that crosses edges, such as
    /// the rim of a lens. Takes two more traces for each number.
    #[arg(long, requires = "gradient")]
    gradient_edges: bool,
    /// Write report.json and, per detector, NAME.npz and NAME.png into this folder.
    #[arg(short, long, value_name = "DIR")]
    output: Option<PathBuf>,
    /// Write no pictures, only numbers.
    #[arg(long, requires = "output")]
    no_pictures: bool,
    #[command(flatten)]
    pictures: PictureArgs,
    /// Time the stages on the device. The times go to stderr and into the report's diagnostics. The trace becomes
    /// slower.
    #[arg(long)]
    profile: bool,
    /// Print report.json instead of the text report.
    #[arg(long)]
    json: bool,
    /// Progress on stderr.
    #[arg(long, value_enum, default_value_t = Mode::Auto)]
    progress: Mode,
    /// End at once when stdin closes, or when the process ends that started this one. So a program that holds stdin
    /// leaves no trace running, however that program ends.
    #[arg(long)]
    watch_stdin: bool,
}

impl Args {
    /// The style of pictures, if any are wanted.
    fn style(&self, ir: &SceneIr) -> Result<Option<Style>> {
        let style = self.pictures.style(ir)?;
        Ok(Some(style).filter(|_| !self.no_pictures))
    }
}

/// Names of numbers.
#[derive(Debug, Clone, PartialEq)]
struct Names(Vec<String>);

/// Names between commas that are not quoted.
fn parse_names(text: &str) -> std::result::Result<Names, String> {
    let names = between_commas(text);
    match names.iter().any(String::is_empty) {
        true => Err(format!("`{text}` has an empty name; write it as in L1.r1,L2.z")),
        false => Ok(Names(names)),
    }
}

/// The texts between commas that are not quoted.
pub(crate) fn between_commas(text: &str) -> Vec<String> {
    let mut parts = vec![String::new()];
    let mut is_quoted = false;
    for letter in text.chars() {
        is_quoted ^= letter == '"';
        match letter {
            ',' if !is_quoted => parts.push(String::new()),
            letter => parts.last_mut().into_iter().for_each(|part| part.push(letter)),
        }
    }
    parts.into_iter().map(|part| part.trim().to_string()).collect()
}

pub(crate) fn parse_record_paths(text: &str) -> std::result::Result<RecordPaths, String> {
    if text == "all" { Ok(RecordPaths::All) } else { count::parse(text).map(RecordPaths::About) }
}

/// Traces, writes the files, and returns the text for stdout. An interrupted trace is written, then reported as
/// interrupted. `start` is when the command began.
pub fn run(args: &Args, start: Instant) -> Result<String> {
    if let Some(Names(names)) = &args.gradient {
        return differentiate(args, names);
    }
    let scene = read_scene(&args.scene)?;
    let mut ir = scene.lower()?;
    // On lavapipe, `auto` means f64.
    let in_f64 = matches!(args.trace.precision, PrecisionArg::Auto | PrecisionArg::F64);
    crate::cli::console::choose_vectors(&ir, args.trace.num_rays, in_f64);
    if args.watch_stdin {
        end_with_caller();
    }
    args.trace.override_sampling(&mut ir)?;
    let pictures = args.style(&ir)?;
    if let Some(path) = &args.checkpoint {
        checkpoint::check_writable(path)?;
    }
    if let Some(dir) = &args.output {
        let names = ir.detectors.iter().map(|detector| detector.name.as_str());
        let ray_paths = args.record_paths.is_some();
        let names =
            output::file_names(names, !args.no_pictures, ray_paths, args.trace.paths == PathsArg::On, true);
        if let Some(path) = args.checkpoint.as_ref().filter(|path| is_one_of(path, dir, &names)) {
            let problem = "is the name of a file of the result; name another file for --checkpoint";
            return Err(Error::file(path, problem));
        }
        output::check(dir, &names)?;
    }
    let stop = stop_on_interrupt()?;
    let resumed = args.resume.as_deref().map(Checkpoint::read).transpose()?;
    let gpu = Gpu::open(&AdapterChoice::of_command(args.adapter.as_deref(), args.portable))?;
    let of_resumed = resumed.as_ref().map(|resumed| resumed.identity.max_depth);
    let max_depth = args.trace.max_depth.or(of_resumed).unwrap_or_else(|| crate::model::depth::of_scene(&ir));
    let options = TraceOptions {
        max_depth,
        paths: args.record_paths.unwrap_or(RecordPaths::None),
        ..args.trace.options(&ir)?
    }
    .tuned(&gpu.info);
    let (result, tally, identity, checkpointed) = std::thread::scope(|scope| {
        let choosing = Choosing::start(scope, &gpu, &ir, &options, wanted(args.trace.precision))?;
        let options = TraceOptions { precision: choosing.precision(), ..options.clone() };
        let identity = Identity::new(&ir, Some(args.scene.display().to_string()), &options, &gpu.info);
        let identity = if keeps_rows(args) { identity } else { identity.with_paths_apart() };
        let begun = resumed.map(|resumed| beginning(args, &ir, &identity, resumed)).transpose()?;
        let rays_there = match (&args.checkpoint, &begun) {
            (Some(path), Some(begun)) if args.resume.as_ref() == Some(path) => begun.launched.count,
            (Some(path), _) => checkpoint::rays_in(path, &identity, args.overwrite)?,
            (None, _) => 0,
        };
        let run = Run {
            args,
            start,
            scene: &scene,
            ir: &ir,
            gpu: &gpu,
            options: &options,
            identity: &identity,
            rays_there,
            stop: &stop,
        };
        let (result, tally, checkpointed) = trace(&run, choosing, begun)?;
        Ok::<_, Error>((result, tally, identity, checkpointed))
    })?;
    let extras = Printed { json: args.json, pictures };
    let sums = || Checkpoint { identity, tally }.to_bytes().map(Some);
    let printed = deliver(&result, sums, args.output.as_deref(), extras)?;
    ended(printed, checkpointed.err().or_else(|| failure(&result)))
}

/// True if a path is that of a file of one of these names in a folder.
fn is_one_of(path: &Path, dir: &Path, names: &[String]) -> bool {
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let is_there =
        folder.canonicalize().is_ok_and(|folder| dir.canonicalize().is_ok_and(|dir| dir == folder));
    is_there && names.iter().any(|name| path.file_name() == Some(name.as_ref()))
}

/// Traces with derivatives by numbers of these names, writes the files, and returns the text for stdout.
fn differentiate(args: &Args, names: &[String]) -> Result<String> {
    if args.trace.paths == PathsArg::On {
        return Err(Error::Usage("--gradient sums up no paths; leave out --paths on".into()));
    }
    if args.trace.standard_error == StandardErrorArg::On {
        return Err(Error::Usage(
            "--gradient gives errors of derivatives alone; leave out --standard-error on".into(),
        ));
    }
    let text = Scene::text(&args.scene)?;
    let folder = args.scene.parent().unwrap_or(Path::new(""));
    let change = |ir: &mut SceneIr| args.trace.override_sampling(ir);
    let differentiated = Differentiated::new(&text, folder, &[], names, change)
        .map_err(|error| named(error, &args.scene.display().to_string()))?;
    let ir = &differentiated.ir;
    let pictures = args.style(ir)?;
    let in_f64 = matches!(args.trace.precision, PrecisionArg::Auto | PrecisionArg::F64);
    crate::cli::console::choose_vectors(ir, args.trace.num_rays, in_f64);
    if args.watch_stdin {
        end_with_caller();
    }
    if let Some(dir) = &args.output {
        let names = ir.detectors.iter().map(|detector| detector.name.as_str());
        let mut files = output::file_names(names, !args.no_pictures, false, false, false);
        files.insert(0, output::GRADIENTS.into());
        output::check(dir, &files)?;
    }
    let stop = stop_on_interrupt()?;
    let gpu = Gpu::open(&AdapterChoice::of_command(args.adapter.as_deref(), args.portable))?;
    let max_depth = args.trace.max_depth.unwrap_or_else(|| crate::model::depth::of_scene(ir));
    let options = TraceOptions { max_depth, ..args.trace.options(ir)? }.tuned(&gpu.info);
    let choice = precision::choose(&gpu, ir, &options, args.trace.wanted())?;
    let options = TraceOptions { precision: choice.precision, ..options };
    let of_edges = if args.gradient_edges { 2 * names.len() as u64 } else { 0 };
    let num_rays = (differentiated.num_passes() + of_edges) * options.num_rays;
    let mut shown = Progress::new(args.progress, num_rays);
    let start = Instant::now();
    let mut is_first = true;
    let mut keep_going = |rays| {
        shown.update(&Status::of_rays(rays, num_rays, start.elapsed()));
        // A stop while shaders are compiled still has rays to keep.
        std::mem::take(&mut is_first) || !stop.load(Ordering::Relaxed)
    };
    let how = How { with_edges: args.gradient_edges, ..How::default() };
    let (mut gradients, tally) = differentiated.gradients(&gpu, &options, how, &mut keep_going)?;
    let missing: Vec<&String> =
        names.iter().filter(|name| gradients.iter().all(|row| row.parameter != **name)).collect();
    let mut is_stopped = tally.launched.count < options.num_rays || !missing.is_empty();
    if args.gradient_edges && !is_stopped {
        let done = differentiated.num_passes() * options.num_rays;
        match differentiated.add_edges(&gpu, &options, None, &mut gradients, |rays| keep_going(done + rays)) {
            Err(Error::Interrupted) => is_stopped = true,
            added => added?,
        }
    }
    shown.finish();
    let without_edges =
        gradients.iter().filter(|row| is_stopped && args.gradient_edges && row.with_edges.is_none());
    let without_edges: BTreeSet<&str> = without_edges.map(|row| row.parameter.as_str()).collect();
    let mut warnings = differentiated.scene.warnings_in(options.precision);
    warnings.extend(differentiated.notes(&options)?);
    let stopped =
        |what: &str, name: &str| format!("stopped before the {what} by `{}`", crate::format::shown(name));
    warnings.extend(missing.iter().map(|name| stopped("derivatives", name)));
    warnings.extend(without_edges.iter().map(|name| stopped("difference of two traces", name)));
    let run = RunInfo {
        scene: Some(args.scene.display().to_string()),
        precision_reason: choice.reason,
        precision_warning: choice.warning,
        trace_time_sec: start.elapsed().as_secs_f64(),
        scene_warnings: warnings,
        partial: is_stopped,
        stopped_by: is_stopped.then_some(StoppedBy::Interrupt),
        has_no_gpu: gpu.info.class.stands_in_for_gpu() && args.adapter.is_none(),
        ..options.run_info(&gpu.info)
    };
    let result = TraceResult { gradients, ..TraceResult::new(ir, &run, &tally)? };
    let printed = Printed { json: args.json, pictures };
    let printed = deliver(&result, || Ok(None), args.output.as_deref(), printed)?;
    ended(printed, failure(&result))
}

/// A choice of precision, or one that is still being predicted.
enum Choosing<'scope> {
    Chosen(Choice),
    /// The user asked for f32. The prediction is only reported, so it runs while the rays are traced.
    Predicting(ScopedJoinHandle<'scope, Result<Choice>>),
}

impl<'scope> Choosing<'scope> {
    fn start<'env>(
        scope: &'scope Scope<'scope, 'env>,
        gpu: &'env Gpu,
        ir: &'env SceneIr,
        options: &'env TraceOptions,
        wanted: Wanted,
    ) -> Result<Self> {
        if wanted != Wanted::Exactly(Precision::F32) {
            return precision::choose(gpu, ir, options, wanted).map(Choosing::Chosen);
        }
        let predict = move || precision::choose(&gpu.open_again()?, ir, options, wanted);
        Ok(Choosing::Predicting(scope.spawn(predict)))
    }

    fn precision(&self) -> Precision {
        match self {
            Choosing::Chosen(choice) => choice.precision,
            Choosing::Predicting(_) => Precision::F32,
        }
    }

    /// The choice. A failed prediction is no reason to lose the result.
    fn choice(self) -> Choice {
        match self {
            Choosing::Chosen(choice) => choice,
            Choosing::Predicting(thread) => {
                let predicted = thread.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic));
                predicted.unwrap_or_else(|error| Choice {
                    precision: Precision::F32,
                    reason: "asked for".into(),
                    warning: Some(format!("the error of f32 could not be predicted: {error}")),
                })
            }
        }
    }
}

/// The failure of a trace that gave a result, but missed a goal.
fn failure(result: &TraceResult) -> Option<Error> {
    if result.run.stopped_by == Some(StoppedBy::Interrupt) {
        return Some(Error::Interrupted);
    }
    missed_target(result).map(Error::Tolerance)
}

/// What to say where a target was asked for and missed, with the rays that would do.
pub(crate) fn missed_target(result: &TraceResult) -> Option<String> {
    let target = result.run.target_error?;
    let percent = |fraction: f64| format!("{:.3} %", 100.0 * fraction);
    match result.relative_error {
        Some(error) if error <= target => None,
        Some(error)
            if result
                .detectors
                .iter()
                .any(|detector| detector.few_rays.is_some_and(|few| few.rests_on > 0)) =>
        {
            Some(format!(
                "the relative error is {}, above the target of {}. The flux of a detector rests on fewer than 10 rays. So few \
                 rays do not say how many are needed",
                percent(error),
                percent(target),
            ))
        }
        Some(error) => Some(format!(
            "the relative error is {}, above the target of {}; it falls as 1 / sqrt(rays), so give about -n {:.1e}",
            percent(error),
            percent(target),
            result.num_rays_total as f64 * (error / target).powi(2)
        )),
        None => Some(format!(
            "the relative error is not known, and so not below the target of {}",
            percent(target)
        )),
    }
}

/// The sums from which the trace goes on.
fn beginning(args: &Args, ir: &SceneIr, identity: &Identity, resumed: Checkpoint) -> Result<Tally> {
    let differences = identity.differences_from_beginning(&resumed.identity);
    let file = args.resume.as_deref().unwrap_or(Path::new(""));
    resumed.check_rows(file, "--checkpoint")?;
    if !differences.is_empty() {
        let differences = differences.join("; ");
        return Err(Error::Usage(format!("{} is of another trace: {differences}", file.display())));
    }
    resumed.check(file, ir)?;
    let file = file.display();
    if !identity.same_device(&resumed.identity) {
        say(&format!(
            "{file} comes from another adapter or driver, {} ({}): the bits may differ from those of an unbroken trace",
            resumed.identity.adapter, resumed.identity.driver
        ));
    }
    Ok(resumed.tally)
}

/// How a result is printed, and whether it has pictures.
#[derive(Debug, Clone, Copy)]
pub struct Printed {
    /// True: report.json. False: the text report.
    pub json: bool,
    /// A picture of each detector, in this style.
    pub pictures: Option<Style>,
}

/// Writes the files of a result, and returns the text for stdout. Where they cannot be written, the result is printed
/// before the error is returned, because a trace may have taken days.
pub fn deliver(
    result: &TraceResult,
    sums: impl FnOnce() -> Result<Option<Vec<u8>>>,
    output: Option<&Path>,
    printed: Printed,
) -> Result<String> {
    let unwritten = || match printed.json {
        true => report::Report::new(result, &report::Files::default()).to_json(),
        false => result.report(),
    };
    let Some(dir) = output else { return Ok(unwritten()) };
    let written = sums().and_then(|tally| {
        let extras = output::Extras { pictures: printed.pictures, tally: tally.as_deref() };
        output::write(dir, result, &extras)
    });
    match written {
        Ok(written) if printed.json => Ok(written.report),
        Ok(written) => {
            written.files.iter().for_each(|file| say(&format!("written: {}", file.display())));
            Ok(result.report())
        }
        Err(error) => {
            crate::cli::console::print(&unwritten())?;
            Err(error)
        }
    }
}

/// A trace that is ready to start.
struct Run<'a> {
    args: &'a Args,
    /// When the command began.
    start: Instant,
    scene: &'a Scene,
    ir: &'a SceneIr,
    gpu: &'a Gpu,
    options: &'a TraceOptions,
    identity: &'a Identity,
    /// Rays of this trace that the file of `--checkpoint` holds already.
    rays_there: u64,
    /// Set by Ctrl-C.
    stop: &'a AtomicBool,
}

/// True if the sums must hold the rows of ray databases and paths. Another trace then goes on from the sums, or adds to
/// them.
fn keeps_rows(args: &Args) -> bool {
    let is_part = args.trace.first_ray.is_some() || args.trace.of_rays.is_some();
    is_part || args.checkpoint.is_some() || args.resume.is_some()
}

/// The destination of rows that are no part of the sums: disk, or nowhere if no files are written. `None` if the sums
/// must hold the rows.
fn recording<'a>(args: &Args, ir: &'a SceneIr) -> Result<Option<impl Fn() -> Recording + use<'a>>> {
    if keeps_rows(args) {
        return Ok(None);
    }
    let folder = args.output.as_deref().map(output::file_system_of).transpose()?;
    Ok(Some(move || match &folder {
        Some(folder) => Recording::in_folder(ir, folder),
        None => Recording::counted(ir),
    }))
}

/// Returns the result, its sums, and whether the sums could be written to the file of `--checkpoint`.
fn trace(
    run: &Run<'_>,
    choosing: Choosing<'_>,
    begun: Option<Tally>,
) -> Result<(TraceResult, Tally, Result<()>)> {
    let Run { args, start: command_start, scene, ir, gpu, options, identity, rays_there, stop } = run;
    let mut tracer = Tracer::new(gpu, ir, options)?;
    if let Some(recording) = recording(args, ir)? {
        tracer.record_to(recording);
    }
    if args.profile {
        tracer.enable_profile()?;
    }
    let begun = begun.unwrap_or_else(|| tracer.empty_tally());
    let num_rays_before = begun.launched.count;
    let mut session = Session {
        args,
        ir,
        identity,
        begun: num_rays_before,
        rays_there: *rays_there,
        stop,
        stopping: Stopping::new(ir, args.trace.target_error, args.trace.time_limit),
        progress: Progress::new(args.progress, tracer.num_rays()),
        last_checkpoint: Instant::now(),
        stopped_by: None,
    };
    session.stopping.prepare(&mut tracer, &begun)?;
    let start = Instant::now();
    let tally = tracer.go_on_checked(begun, |progress| session.after_pass(progress))?;
    let trace_time_sec = start.elapsed().as_secs_f64();
    session.progress.finish();
    let checkpointed = match &args.checkpoint {
        Some(path) if tally.launched.count < *rays_there => {
            say(&format!(
                "{} stays: it holds {rays_there} rays of this trace, and now there are {}; --resume goes on from it",
                path.display(),
                tally.launched.count
            ));
            Ok(())
        }
        Some(path) => checkpoint::write(path, identity, &tally),
        None => Ok(()),
    };
    let stage_times = tracer.stage_times();
    stage_times.iter().for_each(|time| say(&profile_line(time, trace_time_sec)));
    let partial = tally.launched.count < tracer.num_rays();
    let choice = choosing.choice();
    let run = RunInfo {
        scene: Some(args.scene.display().to_string()),
        num_rays: tracer.num_rays(),
        precision_reason: choice.reason,
        precision_warning: choice.warning,
        trace_time_sec,
        num_rays_before,
        first_rays_sec: tracer.first_end().map(|end| (end - *command_start).as_secs_f64()),
        stage_times,
        scene_warnings: scene.warnings_in(options.precision),
        partial,
        stopped_by: session.stopped_by.filter(|_| partial),
        target_error: args.trace.target_error,
        // Processors are chosen only if there is nothing else.
        has_no_gpu: gpu.info.class.stands_in_for_gpu() && args.adapter.is_none(),
        ..options.run_info(&gpu.info)
    };
    let result = match tracer.take_recorded()? {
        Some(recorded) => TraceResult::with_rows(ir, &run, &tally, &recorded)?,
        None => TraceResult::new(ir, &run, &tally)?,
    };
    Ok((result, tally, checkpointed))
}

/// What happens between two passes.
struct Session<'a> {
    args: &'a Args,
    ir: &'a SceneIr,
    identity: &'a Identity,
    /// Rays that the trace began with.
    begun: u64,
    /// Rays that the file of `--checkpoint` holds already. Fewer never take their place.
    rays_there: u64,
    stop: &'a AtomicBool,
    stopping: Stopping,
    progress: Progress,
    last_checkpoint: Instant,
    stopped_by: Option<StoppedBy>,
}

impl Session<'_> {
    /// Shows the progress, writes a checkpoint if one is due, and decides whether to go on.
    fn after_pass(&mut self, progress: &mut run::Progress) -> Result<bool> {
        self.stopped_by = self.stopping.after_pass(self.ir, progress)?;
        if self.stop.load(Ordering::Relaxed) {
            self.stopped_by = Some(StoppedBy::Interrupt);
        }
        self.progress.update(&Status::of(progress, &self.stopping, &self.args.trace, self.begun));
        if let Some(path) = &self.args.checkpoint
            && progress.done >= self.rays_there
            && self.last_checkpoint.elapsed() >= self.args.checkpoint_interval
        {
            // The disk may have room again at the next checkpoint, and no ray is lost. A failure at the end is an
            // error.
            if let Err(error) = checkpoint::write(path, self.identity, progress.tally()?) {
                say(&format!("no checkpoint now: {error}"));
            }
            self.last_checkpoint = Instant::now();
        }
        Ok(self.stopped_by.is_none())
    }
}

fn profile_line(time: &StageTime, trace_time_sec: f64) -> String {
    let StageTime { stage, num_dispatches, time_sec } = time;
    let percent = 100.0 * time_sec / trace_time_sec;
    format!(
        "profile: {stage:<13}{num_dispatches:>8} dispatches{time_sec:>12.6} s{percent:>7.1} % of the trace"
    )
}
