//! `nsq-gpu trace`: traces a scene to maps, ledger and report.

use crate::cli::console::{ended, read_scene, say};
use crate::cli::device_args::DeviceArgs;
use crate::cli::pictures::PictureArgs;
use crate::cli::progress::{self, Mode};
use crate::cli::quantity;
use crate::cli::rays_out::RaysOut;
use crate::cli::stops::{end_with_caller, stop_on_interrupt};
use crate::cli::trace_args::{PathsArg, PhotometricArg, StandardErrorArg, TraceArgs, write_guide};
use crate::count;
use crate::error::{Error, Result};
use crate::format::shown;
use crate::model::SceneIr;
use crate::result::figures::judge_all;
use crate::result::png::Style;
use crate::result::{Gradient, StageTime, StoppedBy, TraceResult, output, report};
use crate::run::gradients::Differentiated;
use crate::run::{DerivativeOptions, RecordPaths, RowStorage, Run, Saved, missed_target};
use crate::scene::Scene;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
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
    /// Keep a proof with the sums: the SHA-256 of the sums of each of 64 ranges of rays, which `nsq-gpu verify` traces again.
    /// Arithmetic is strict where the adapter allows it.
    #[arg(long)]
    proof: bool,
    #[command(flatten)]
    device: DeviceArgs,
    /// Record the paths of about N rays, or of all, in ray_paths.npz.
    #[arg(long, value_name = "N|all", value_parser = parse_record_paths, requires = "output")]
    record_paths: Option<RecordPaths>,
    #[command(flatten)]
    photometric: PhotometricArg,
    /// Also report how even, how wide and how strong the light of each map is: uniformity, FWHM, beam and field angle, each
    /// with its error. `nsq-gpu figures` finds them of a result, and of its regions.
    #[arg(long, conflicts_with = "gradient")]
    figures: bool,
    /// Differentiate what detectors record by numbers of the scene: L1.r1,L2.z. With -o, maps of derivatives and their
    /// standard errors go to gradients.npz. Names with dots or commas are quoted: '"a.b".r1'.
    #[arg(long, value_name = "NAMES", value_parser = parse_names, conflicts_with_all = ["checkpoint", "overwrite",
        "checkpoint_interval", "resume",
        "record_paths", "profile", "proof", "target_error", "time_limit", "first_ray", "of_rays"])]
    gradient: Option<Names>,
    /// With --gradient: also find each derivative by a difference of two traces, which sees light that crosses edges, such as
    /// the rim of a lens. Takes two more traces for each number.
    #[arg(long, requires = "gradient")]
    gradient_edges: bool,
    /// Write report.json and, per detector, NAME.npz and NAME.png into this folder.
    #[arg(short, long, value_name = "DIR")]
    output: Option<PathBuf>,
    /// Write the rays of the scene's ray database as an IES TM-25 file, which a source of another scene may name. A file that
    /// exists is kept, and refused before the first ray.
    #[arg(long, value_name = "FILE", conflicts_with = "gradient")]
    rays_out: Option<PathBuf>,
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
    if args.watch_stdin {
        end_with_caller();
    }
    args.trace.override_sampling(&mut ir)?;
    let pictures = args.pictures.style(&ir, args.photometric.is_on(scene.is_photometric()))?;
    let mut run = Run::of(&scene, &ir).named(args.scene.display()).messages(&say);
    run.start = start;
    run = args.photometric.set(run)?;
    if let Some(path) = &args.checkpoint {
        run = run.checkpoint(path, args.checkpoint_interval, args.overwrite)?;
    }
    if let Some(dir) = &args.output {
        let names = ir.detectors.iter().map(|detector| detector.name.as_str());
        let ray_paths = args.record_paths.is_some();
        let colored = scene.color_detectors();
        let names = output::file_names(
            names,
            pictures.map(|_| &colored[..]),
            ray_paths,
            args.trace.paths == PathsArg::On,
            true,
        );
        if let Some(path) = args.checkpoint.as_ref().filter(|path| is_one_of(path, dir, &names)) {
            let problem = "is the name of a file of the result; name another file for --checkpoint";
            return Err(Error::file(path, problem));
        }
        output::check(dir, &names)?;
    }
    if args.proof && args.output.is_none() && args.checkpoint.is_none() {
        return Err(Error::Usage("--proof is kept with the sums; give -o DIR, or --checkpoint FILE".into()));
    }
    let guide_file = args.trace.guide_file(&args.scene)?;
    let rays_out = args.rays_out.as_ref().map(|path| RaysOut::new(path, &ir, &args.scene)).transpose()?;
    let stop = stop_on_interrupt()?;
    if let Some(path) = &args.resume {
        run = run.resume(path)?;
    }
    let gpu = args.device.open()?;
    // The sums of a part have its rows, so that other parts can be added.
    let is_part = args.trace.first_ray.is_some() || args.trace.of_rays.is_some();
    let rows = match &args.output {
        _ if is_part || (rays_out.is_some() && args.output.is_none()) => RowStorage::Sums,
        Some(dir) => RowStorage::Disk(dir.clone()),
        None => RowStorage::Counted,
    };
    run = args.trace.set(run.on(&gpu).rows(rows))?;
    run = run.record_paths(args.record_paths.unwrap_or(RecordPaths::None));
    if args.profile {
        run = run.profile();
    }
    if args.proof {
        run = run.proof();
    }
    let mut shown = progress::shown(args.progress, &stop);
    let mut outcome = run.go_with(move |pass| Ok(shown(&pass.status)))?;
    let unwritten = write_guide(guide_file, &outcome.options).err();
    let path = args.checkpoint.as_deref().unwrap_or(Path::new(""));
    if let Saved::Kept(rays_there) = outcome.saved {
        say(&format!(
            "{} stays: it holds {rays_there} rays of this trace, and now there are {}; --resume goes on from it",
            path.display(),
            outcome.tally.launched.count
        ));
    }
    if args.figures {
        outcome.result.figures = judge_all(&outcome.result);
    }
    let result = &outcome.result;
    result.run.stage_times.iter().for_each(|time| say(&profile_line(time, result.run.trace_time_sec)));
    let printed = Printed { json: args.json, pictures };
    let printed = deliver(result, || outcome.sums().map(Some), args.output.as_deref(), printed)?;
    let unwritten = rays_out.and_then(|out| out.write(result).err()).or(unwritten);
    let unsaved = match &outcome.saved {
        Saved::Failed(error) => Some(error.clone()),
        Saved::NoFile | Saved::Written | Saved::Kept(_) => None,
    };
    ended(printed, unsaved.or(unwritten).or_else(|| failure(result)))
}

/// True if a path leads to a file of one of these names in a folder.
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
    if args.photometric.is_asked_for() {
        return Err(Error::Usage("--gradient gives derivatives in watts; leave out --photometric".into()));
    }
    let text = Scene::text(&args.scene)?;
    let folder = args.scene.parent().unwrap_or(Path::new(""));
    let change = |ir: &mut SceneIr| args.trace.override_sampling(ir);
    let differentiated = Differentiated::new(&text, folder, &[], names, change)
        .map_err(|error| error.in_scene(&args.scene.display().to_string()))?;
    let ir = &differentiated.ir;
    let pictures = args.pictures.style(ir, false)?;
    if args.watch_stdin {
        end_with_caller();
    }
    if let Some(dir) = &args.output {
        let names = ir.detectors.iter().map(|detector| detector.name.as_str());
        let mut files = output::file_names(names, pictures.map(|_| &[][..]), false, false, false);
        files.insert(0, output::GRADIENTS.into());
        output::check(dir, &files)?;
    }
    let stop = stop_on_interrupt()?;
    let gpu = args.device.open()?;
    let run = args.trace.set(differentiated.run().named(args.scene.display()).on(&gpu))?;
    let asked = DerivativeOptions { with_edges: args.gradient_edges, ..DerivativeOptions::default() };
    let mut found = run.differentiate(&differentiated, asked, progress::shown(args.progress, &stop))?;
    let is_missing = |name: &&String| found.gradients.iter().all(|row| row.parameter != **name);
    let has_no_edges =
        |row: &&Gradient| found.info.partial && args.gradient_edges && row.with_edges.is_none();
    let without_edges: BTreeSet<&str> =
        found.gradients.iter().filter(has_no_edges).map(|row| row.parameter.as_str()).collect();
    let stopped = |what: &str, name: &str| format!("stopped before the {what} by `{}`", shown(name));
    let mut warnings = differentiated.notes(&found.options)?;
    warnings.extend(names.iter().filter(is_missing).map(|name| stopped("derivatives", name)));
    warnings.extend(without_edges.iter().map(|name| stopped("difference of two traces", name)));
    found.info.scene_warnings.extend(warnings);
    let result = found.into_result()?;
    let printed = Printed { json: args.json, pictures };
    let printed = deliver(&result, || Ok(None), args.output.as_deref(), printed)?;
    ended(printed, failure(&result))
}

/// The failure of a trace that gave a result, but missed a goal.
fn failure(result: &TraceResult) -> Option<Error> {
    if result.run.stopped_by == Some(StoppedBy::Interrupt) {
        return Some(Error::Interrupted);
    }
    missed_target(result).map(Error::Tolerance)
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

fn profile_line(time: &StageTime, trace_time_sec: f64) -> String {
    let StageTime { stage, num_dispatches, time_sec } = time;
    let percent = 100.0 * time_sec / trace_time_sec;
    format!(
        "profile: {stage:<13}{num_dispatches:>8} dispatches{time_sec:>12.6} s{percent:>7.1} % of the trace"
    )
}
