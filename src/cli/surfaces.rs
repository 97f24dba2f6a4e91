//! `nsq-gpu surfaces`: which surfaces are to blame for stray light.

use crate::cli::console::read_scene;
use crate::cli::stops::stop_on_interrupt;
use crate::cli::trace_args::{PathsArg, TraceArgs};
use crate::error::{Error, Result};
use crate::format::{pretty_json, shown};
use crate::gpu::{AdapterChoice, Native};
use crate::run::surfaces::{Blame, blame};
use crate::run::{Next, Session};
use serde_json::json;
use std::fmt::Write;
use std::path::PathBuf;
use std::sync::atomic::Ordering;

/// Arguments of `nsq-gpu surfaces`.
#[derive(clap::Args)]
#[command(after_help = "Example: nsq-gpu surfaces telescope.json --detector image -n 1e6")]
pub struct Args {
    /// The scene file.
    scene: PathBuf,
    /// The detector.
    #[arg(long, value_name = "NAME")]
    detector: String,
    #[command(flatten)]
    trace: TraceArgs,
    /// Part of the adapter's name (see `nsq-gpu adapters`).
    #[arg(long, value_name = "NAME")]
    adapter: Option<String>,
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
    args.trace.override_sampling(&mut model)?;
    let stop = stop_on_interrupt()?;
    let choice = AdapterChoice { name: args.adapter.clone(), native: Native::Allowed, ..Default::default() };
    let options = trace.options(&model)?;
    let next = |_: &_| if stop.load(Ordering::Relaxed) { Next::Cancel } else { Next::GoOn };
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

fn text(found: &[Blame]) -> String {
    let mut text = String::from(
        " lit by the   scatters to    error   seen by the\n sources [W]  detector [W]          detector  surface\n",
    );
    for Blame { name, receives, sends: [flux, error], seen } in found {
        let error = if *flux > 0.0 { format!("{:.1} %", 100.0 * error / flux) } else { "-".into() };
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
