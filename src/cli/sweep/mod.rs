//! `nsq-gpu sweep`: traces a scene again and again, with some of its numbers changed. A compiled shader serves all
//! points.
//!
//! A point that cannot be, such as a lens of negative thickness, is named, and the others are traced. A stop keeps the
//! points that are done.

mod points;
mod values;

use crate::cli::console::{ended, say};
use crate::cli::output_file::OutputFile;
use crate::cli::stops::stop_on_interrupt;
use crate::cli::sweep::values::{Tolerances, parse_tolerances, parse_values};
use crate::cli::trace_args::{PathsArg, TraceArgs};
use crate::error::{Error, Result};
use crate::gpu::{AdapterChoice, Native};
use crate::run::sweep::{Axis, Distribution, Sweep, Swept, combinations, samples};
use crate::run::{Next, Session, missed_target};
use crate::scene::Scene;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;

pub(crate) use crate::cli::sweep::values::parse_number;

/// Most points that are named on stderr because they cannot be. Files name all.
const MOST_NAMED: usize = 10;

/// Arguments of `nsq-gpu sweep`.
#[derive(clap::Args)]
pub struct Args {
    /// The scene file.
    scene: PathBuf,
    /// A number of the scene and its values: L1.r1=50:60:11 (eleven from 50 to 60), L2.z=1,2,5 or L2.rx=-1:1deg:3 (the
    /// last unit counts for numbers without one). Several of these give every combination. Names with dots are quoted:
    /// '"a.b".r1=50,60'.
    #[arg(long, value_name = "NAME=VALUES", value_parser = parse_values)]
    set: Vec<Axis>,
    /// The values of several --set belong together: the first of each, then the second, and so on.
    #[arg(long)]
    zip: bool,
    /// Numbers of the scene and their tolerances, absolute or in percent: L1.r1=0.1%, or L4.y=50um,L4.rx=0.1deg,gap_3=0.02.
    /// Each sample draws all of them.
    #[arg(long, value_name = "NAME=SIZE", value_parser = parse_tolerances, conflicts_with = "set")]
    tolerance: Vec<Tolerances>,
    /// Samples of the tolerances.
    #[arg(long, default_value_t = 100, requires = "tolerance", value_name = "N")]
    samples: u32,
    /// The distribution of the tolerances.
    #[arg(long, value_enum, default_value_t = DistributionArg::Normal, requires = "tolerance")]
    distribution: DistributionArg,
    /// The rays of the points: the same random numbers, so that differences between points have less noise, or each its
    /// own.
    #[arg(long, value_enum, default_value_t = Draws::Common)]
    draws: Draws,
    #[command(flatten)]
    trace: TraceArgs,
    /// Part of the adapter's name (see `nsq-gpu adapters`).
    #[arg(long, value_name = "NAME")]
    adapter: Option<String>,
    /// Print JSON instead of a table.
    #[arg(long)]
    json: bool,
    /// Write the points to this file as well: JSON if its name ends in .json, else CSV. A file that exists is kept, and
    /// refused before the first ray.
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,
    /// Let -o replace a file that exists.
    #[arg(long, requires = "output")]
    overwrite: bool,
}

/// Whether points share their random numbers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Draws {
    /// All points have the seed.
    Common,
    /// Point i has the seed plus i.
    Own,
}

/// The distribution of a tolerance of size s.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum DistributionArg {
    /// Normal, of standard deviation s.
    Normal,
    /// Uniform, from -s to s.
    Uniform,
}

impl From<DistributionArg> for Distribution {
    fn from(argument: DistributionArg) -> Self {
        match argument {
            DistributionArg::Normal => Distribution::Normal,
            DistributionArg::Uniform => Distribution::Uniform,
        }
    }
}

/// Traces every point, writes the file, and returns the text for stdout.
pub fn run(args: &Args) -> Result<String> {
    if args.set.is_empty() && args.tolerance.is_empty() {
        return Err(Error::Usage(
            "give what changes: --set L1.r1=50:60:11, or --tolerance L1.r1=0.1%".into(),
        ));
    }
    if args.trace.paths == PathsArg::On {
        return Err(Error::Usage(
            "a sweep lists no paths; leave out --paths on, or keep the light of some paths by --where".into(),
        ));
    }
    args.trace.refuse_guide_to("a sweep")?;
    let text = Scene::text(&args.scene)?;
    let folder = args.scene.parent().unwrap_or(Path::new("")).to_owned();
    let name = args.scene.display().to_string();
    // The scene as it stands is checked before the device is opened.
    Scene::with_numbers(&text, &folder, &[]).map_err(|error| error.in_scene(&name))?.lower()?;
    let has_nominal = !args.tolerance.is_empty();
    let points = match has_nominal {
        false => combinations(&args.set, args.zip)?,
        true => {
            let tolerances: Vec<_> = args.tolerance.iter().flat_map(|some| some.0.iter().cloned()).collect();
            samples(&text, &tolerances, args.distribution.into(), args.trace.seed, args.samples)?
        }
    };
    let new_file = |path: &PathBuf| OutputFile::new(path, args.overwrite, &args.scene, |_| false);
    let file = args.output.as_ref().map(new_file).transpose()?;
    let stop = stop_on_interrupt()?;
    let choice = AdapterChoice { name: args.adapter.clone(), native: Native::Allowed, ..Default::default() };
    let (mut warned, mut missed) = (BTreeSet::new(), None);
    let found = Sweep { text, folder, name, points, has_nominal }.go(
        &mut Session::new(choice),
        |point, run| {
            let own = if args.draws == Draws::Own { point as u64 } else { 0 };
            let trace = TraceArgs { seed: args.trace.seed.wrapping_add(own), ..args.trace.clone() };
            trace.set(run.change_model(|ir| trace.override_sampling(ir))?)
        },
        // A point that is stopped midway is left out.
        |_| if stop.load(Ordering::Relaxed) { Next::Cancel } else { Next::GoOn },
        |result| {
            let warnings = result.run.scene_warnings.iter().chain(&result.diagnostics.grave);
            warnings
                .filter(|warning| warned.insert((*warning).clone()))
                .for_each(|text| say(&format!("warning: {text}")));
            missed = missed.take().or_else(|| missed_target(result).map(Error::Tolerance));
        },
    );
    for point in found.refused().take(MOST_NAMED) {
        let problem = point.outcome.as_ref().err().map_or("", String::as_str);
        say(&format!("{}: {problem}", found.label(point)));
    }
    let failure = found.failure.clone().or(missed).or_else(|| refusal(&found));
    if found.nominal.is_none() && found.points.iter().all(|point| point.outcome.is_err()) {
        return Err(failure.unwrap_or(Error::Interrupted));
    }
    let printed = if args.json { found.document() } else { found.text() };
    let written = file.map(|file| {
        let is_json = args.output.as_ref().is_some_and(|path| is_json(path));
        let contents = if is_json { found.document() } else { found.csv() };
        file.write(contents.as_bytes()).map(|path| say(&format!("written: {}", path.display())))
    });
    let failure = written.and_then(Result::err).or(failure);
    ended(printed, failure)
}

fn is_json(path: &Path) -> bool {
    path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("json"))
}

/// The error of points that cannot be, of which the others are returned.
fn refusal(found: &Swept) -> Option<Error> {
    let first = found.refused().next()?;
    let (num_refused, num_points) = (found.refused().count(), found.points.len());
    let remedy = match found.is_of_tolerances() {
        _ if num_refused == num_points => "give other values",
        true => {
            "quantiles are of the other samples; a smaller tolerance, or --distribution uniform, may leave none out"
        }
        false => "the other points are returned",
    };
    let place = format!("{num_refused} of {num_points} {}s cannot be traced", found.kind());
    Some(Error::scene(place, format!("the first is {}", found.label(first)), remedy))
}
