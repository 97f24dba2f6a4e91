//! `nsq-gpu diff`: what a change does, with standard errors of its own.

use crate::cli::console::{ended, read_scene, say};
use crate::cli::device_args::DeviceArgs;
use crate::cli::pictures::PictureArgs;
use crate::cli::progress::{self, Mode};
use crate::cli::stops::{end_with_caller, stop_on_interrupt};
use crate::cli::sweep::parse_number;
use crate::cli::trace_args::{StandardErrorArg, TraceArgs};
use crate::error::{Error, Result};
use crate::result::{SceneDifference, difference, output};
use crate::run::Run;
use crate::run::difference::Pair;
use crate::scene::Scene;
use std::path::{Path, PathBuf};

/// Arguments of `nsq-gpu diff`.
#[derive(clap::Args)]
#[command(after_help = "Example: nsq-gpu diff lens.json --set L1.r1=50.5 -n 1e7 -o change")]
#[command(mut_args(|arg| TraceArgs::in_help(arg, &[], &[])))]
pub struct Args {
    /// Scene A.
    a: PathBuf,
    /// Scene B; by default A with what --set changes.
    b: Option<PathBuf>,
    /// A number of scene B and its value: L1.r1=50.5, L4.rx=0.1deg. Names with dots are quoted: '"a.b".r1=50'.
    #[arg(long, value_name = "NAME=VALUE", value_parser = parse_number)]
    set: Vec<(String, f64)>,
    #[command(flatten)]
    device: DeviceArgs,
    /// Print JSON instead of a table.
    #[arg(long)]
    json: bool,
    /// Write the result into this folder: report.json and, per detector, NAME.npz and NAME.png.
    #[arg(short, long, value_name = "DIR")]
    output: Option<PathBuf>,
    #[command(flatten)]
    pictures: PictureArgs,
    /// Progress on stderr.
    #[arg(long, value_enum, default_value_t = Mode::Auto)]
    progress: Mode,
    /// End at once when stdin closes, or when the process ends that started this one.
    #[arg(long)]
    watch_stdin: bool,
    #[command(flatten)]
    trace: TraceArgs,
}

impl Args {
    /// Refuses what a difference has no use for.
    fn check(&self) -> Result<()> {
        if self.b.is_none() && self.set.is_empty() {
            return Err(Error::Usage(
                "a difference needs two scenes: name a second file, or change the first by --set L1.r1=50.5"
                    .into(),
            ));
        }
        if self.pictures.is_log() {
            let problem = "--scale log: a difference has both signs, and no logarithm; leave --scale out";
            return Err(Error::Usage(problem.into()));
        }
        self.trace.refuse_guide_to("a difference")?;
        let is_off = self.trace.standard_error == StandardErrorArg::Off;
        match self.trace.of_one_trace().or(is_off.then_some("standard-error")) {
            Some(name) => Err(Error::Usage(format!(
                "--{name} belongs to a trace; a difference takes -n alone, leave it out"
            ))),
            None => Ok(()),
        }
    }

    /// Scene B, and what it is called.
    fn scene_b(&self) -> Result<(Scene, String)> {
        let path = self.b.as_ref().unwrap_or(&self.a);
        let mut name = path.display().to_string();
        if self.set.is_empty() {
            return Ok((read_scene(path)?, name));
        }
        let text = Scene::text(path)?;
        let folder = path.parent().unwrap_or(Path::new(""));
        let scene = Scene::with_numbers(&text, folder, &self.set).map_err(|error| error.in_scene(&name))?;
        let set: Vec<String> = self.set.iter().map(|(name, value)| format!("{name} = {value}")).collect();
        name += &format!(" with {}", set.join(", "));
        Ok((scene, name))
    }
}

/// Traces both scenes, writes the files, and returns the text for stdout.
pub fn run(args: &Args) -> Result<String> {
    args.check()?;
    let (a, (b, name_of_b)) = (read_scene(&args.a)?, args.scene_b()?);
    let [mut ir_a, mut ir_b] = [a.lower()?, b.lower()?];
    for ir in [&mut ir_a, &mut ir_b] {
        args.trace.override_sampling(ir)?;
    }
    if args.watch_stdin {
        end_with_caller();
    }
    let pictures = args.pictures.style(&ir_a, false)?;
    let pair = Pair::new(&ir_a, ir_b)?;
    if let Some(dir) = &args.output {
        let names = ir_a.detectors.iter().map(|detector| detector.name.as_str());
        output::check(dir, &difference::file_names(names, pictures.is_some()))?;
    }
    let stop = stop_on_interrupt()?;
    let gpu = args.device.open()?;
    let run = args.trace.set(Run::of(&a, &ir_a).on(&gpu))?;
    let found = run.difference(&pair, &b, progress::shown(args.progress, &stop))?;
    let found = SceneDifference { names: [args.a.display().to_string(), name_of_b], ..found };
    let warnings = found.run.scene_warnings.iter().chain(&found.run.precision_warning);
    warnings.for_each(|warning| say(&format!("warning: {warning}")));
    let written = args.output.as_ref().map(|dir| difference::write(dir, &found, pictures)).transpose();
    let printed = if args.json { found.report()? } else { found.text() };
    let failure = match written {
        Ok(files) => {
            files.iter().flatten().for_each(|file| say(&format!("written: {}", file.display())));
            found.run.partial.then_some(Error::Interrupted)
        }
        Err(error) => Some(error),
    };
    ended(printed, failure)
}
