//! `nsq-gpu surfaces`: which surfaces are to blame for stray light.

use crate::cli::console::read_scene;
use crate::cli::progress::{self, Mode};
use crate::cli::pst::parse_point;
use crate::cli::stops::{end_with_caller, stop_on_interrupt};
use crate::cli::trace_args::{PathsArg, TraceArgs};
use crate::error::{Error, Result};
use crate::format::{pretty_json, shown};
use crate::gpu::{AdapterChoice, Native};
use crate::run::pst::{Direction, turned};
use crate::run::surfaces::{Blame, blame};
use crate::run::{Next, Session};
use glam::DVec3;
use serde_json::json;
use std::fmt::Write;
use std::path::PathBuf;

/// Arguments of `nsq-gpu surfaces`.
#[derive(clap::Args)]
#[command(after_help = "Example: nsq-gpu surfaces telescope.json --detector image -n 1e6")]
#[command(mut_args(|arg| TraceArgs::in_help(arg, &[], &["where"])))]
pub struct Args {
    /// The scene file.
    scene: PathBuf,
    /// The detector.
    #[arg(long, value_name = "NAME")]
    detector: String,
    /// Turn the source to this angle off its axis [deg], as `nsq-gpu pst` does.
    #[arg(long, value_name = "ANGLE", allow_hyphen_values = true)]
    angle: Option<f64>,
    /// Azimuth of the turned source [deg].
    #[arg(long, value_name = "ANGLE", requires = "angle", default_value_t = 0.0, allow_hyphen_values = true)]
    azimuth: f64,
    /// The collimated source that is turned, as of `nsq-gpu pst`.
    #[arg(long, value_name = "NAME", requires = "angle")]
    source: Option<String>,
    /// The point about which the source is turned [mm], as of `nsq-gpu pst`.
    #[arg(long, value_name = "X,Y,Z", requires = "angle", value_parser = parse_point, allow_hyphen_values = true)]
    pivot: Option<DVec3>,
    #[command(flatten)]
    trace: TraceArgs,
    /// Part of the adapter's name (see `nsq-gpu adapters`).
    #[arg(long, value_name = "NAME")]
    adapter: Option<String>,
    /// Progress of each trace on stderr.
    #[arg(long, value_enum, default_value_t = Mode::Auto)]
    progress: Mode,
    /// End at once when stdin closes, or when the process ends that started this one.
    #[arg(long)]
    watch_stdin: bool,
    /// Print JSON instead of a table.
    #[arg(long)]
    json: bool,
}

/// Traces, and returns the text for stdout.
pub fn run(args: &Args) -> Result<String> {
    let trace = TraceArgs { paths: PathsArg::Off, ..args.trace.clone() };
    if let Some(name) = trace.of_one_trace().or(trace.filter.is_some().then_some("where")) {
        return Err(Error::Usage(format!(
            "--{name} belongs to a trace; a list of surfaces takes -n, leave it out"
        )));
    }
    trace.refuse_guide_to("a list of surfaces")?;
    let scene = read_scene(&args.scene)?;
    let mut model = scene.lower()?;
    if args.watch_stdin {
        end_with_caller();
    }
    args.trace.override_sampling(&mut model)?;
    let options = trace.options(&model)?;
    if let Some(direction) = args.direction()? {
        model = turned(&model, &args.detector, (args.source.as_deref(), args.pivot), direction)?;
    }
    let stop = stop_on_interrupt()?;
    let choice = AdapterChoice { name: args.adapter.clone(), native: Native::Allowed, ..Default::default() };
    let mut shown = progress::shown(args.progress, &stop);
    // A list of some of the rays would pass for a whole one.
    let next = |status: &_| if shown(status) == Next::GoOn { Next::GoOn } else { Next::Cancel };
    let how = (&options, trace.path_rows()?);
    let mut session = Session::new(choice);
    let found =
        blame((&scene, &model), &args.detector, &mut session, how, |run| trace.set_others(run, None), next)?;
    if args.json {
        let entry = |Blame { name, receives, sends: [flux, error], seen }: &Blame| json!({"name": name, "receives": receives, "sends": flux, "sends_standard_error": error, "seen": seen});
        let document =
            json!({"detector": args.detector, "surfaces": found.iter().map(entry).collect::<Vec<_>>()});
        return pretty_json(&document).map_err(|error| Error::internal("surfaces as JSON", &error));
    }
    Ok(text(&found))
}

impl Args {
    /// Where the source is turned to.
    fn direction(&self) -> Result<Option<Direction>> {
        match self.angle {
            Some(angle) if !(angle.abs() <= 360.0 && self.azimuth.abs() <= 360.0) => Err(Error::Usage(
                format!("--angle {angle} --azimuth {}: give angles from -360 to 360 degrees", self.azimuth),
            )),
            angle => Ok(angle.map(|angle| Direction { angle, azimuth: self.azimuth })),
        }
    }
}

fn text(found: &[Blame]) -> String {
    let mut text = String::from(
        " lit by the   scatters to    error   seen by the\n sources [W]  detector [W]          detector  surface\n",
    );
    for Blame { name, receives, sends: [flux, error], seen } in found {
        let error = match error / flux {
            error if error <= 1.0 => format!("{:.1} %", 100.0 * error),
            _ if *flux > 0.0 => "> 100 %".into(),
            _ => "-".into(),
        };
        let mark = if *receives > 0.0 && *seen > 0.0 { "  (lit and seen)" } else { "" };
        let _ = writeln!(
            text,
            "{receives:>12.3e}  {flux:>12.3e} {error:>8}  {:>8.3} %  {}{mark}",
            100.0 * seen,
            shown(name)
        );
    }
    text
}
