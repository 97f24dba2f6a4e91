//! `nsq-gpu sweep`: traces a scene again and again, with some of its numbers changed. A compiled shader serves all
//! points.
//!
//! A point that cannot be, such as a lens of negative thickness, is named, and the others are traced. A stop keeps the
//! points that are done.

mod points;
mod values;

use crate::cli::console::{choose_vectors, ended, named, say};
use crate::cli::output_file::OutputFile;
use crate::cli::progress::Status;
use crate::cli::serve::requests::TraceRequest;
use crate::cli::serve::session::{Next, Session};
use crate::cli::stops::stop_on_interrupt;
use crate::cli::sweep::points::{Point, Points, Traced};
use crate::cli::sweep::values::{
    Distribution, Tolerances, Values, combinations, parse_tolerances, parse_values, samples,
};
use crate::cli::trace::missed_target;
use crate::cli::trace_args::{PathsArg, PrecisionArg, TraceArgs};
use crate::error::{Error, Result};
use crate::format::shown;
use crate::gpu::{AdapterChoice, Native};
use crate::run::RecordPaths;
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
    set: Vec<Values>,
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
    #[arg(long, value_enum, default_value_t = Distribution::Normal, requires = "tolerance")]
    distribution: Distribution,
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
    let text = Scene::text(&args.scene)?;
    let folder = args.scene.parent().unwrap_or(Path::new("")).to_owned();
    let name = args.scene.display().to_string();
    let ir = Scene::with_numbers(&text, &folder, &[]).map_err(|error| named(error, &name))?.lower()?;
    let in_f64 = matches!(args.trace.precision, PrecisionArg::Auto | PrecisionArg::F64);
    choose_vectors(&ir, args.trace.num_rays, in_f64);
    let is_of_tolerances = !args.tolerance.is_empty();
    let points = match is_of_tolerances {
        false => combinations(&args.set, args.zip)?,
        true => {
            let tolerances: Vec<_> = args.tolerance.iter().flat_map(|some| some.0.iter().cloned()).collect();
            samples(&text, &tolerances, args.distribution, args.trace.seed, args.samples)?
        }
    };
    let new_file = |path: &PathBuf| OutputFile::new(path, args.overwrite, &args.scene, |_| false);
    let file = args.output.as_ref().map(new_file).transpose()?;
    let stop = stop_on_interrupt()?;
    let choice = AdapterChoice { name: args.adapter.clone(), native: Native::Allowed, ..Default::default() };
    let mut session = Session::new(choice);
    let (mut found, mut warned, mut failure) = (Vec::new(), BTreeSet::new(), None);
    let num_points = points.len() - usize::from(is_of_tolerances);
    for (i, numbers) in points.into_iter().enumerate() {
        let mut trace = args.trace.clone();
        if args.draws == Draws::Own {
            trace.seed = trace.seed.wrapping_add(i as u64);
        }
        let request = TraceRequest {
            scene: text.clone(),
            name: Some(name.clone()),
            folder: folder.clone(),
            set: numbers.clone(),
            args: trace,
            record_paths: RecordPaths::None,
            live: None,
            gradient: Vec::new(),
            gradient_errors: false,
            gradient_edges: false,
            check_edges: false,
            adjoints: None,
            progress: false,
        };
        // A point that is stopped midway is left out.
        let next = |_: &Status| if stop.load(Ordering::Relaxed) { Next::Cancel } else { Next::GoOn };
        let not_finite = request.set.iter().find(|(_, value)| !value.is_finite());
        let traced = match not_finite {
            Some((name, value)) => {
                Err(Error::scene(shown(name), format!("is {value}"), "give a finite number"))
            }
            None => session.trace(&request, next),
        };
        let outcome = match traced {
            Ok(result) => {
                let warnings = result.run.scene_warnings.iter().chain(&result.diagnostics.grave);
                warnings
                    .filter(|warning| warned.insert((*warning).clone()))
                    .for_each(|text| say(&format!("warning: {text}")));
                failure = failure.or_else(|| missed_target(&result).map(Error::Tolerance));
                Ok(Traced::of(&result))
            }
            Err(Error::Scene { place, problem, remedy }) => Err(format!("{place}: {problem}; {remedy}")),
            // The points before it took their time, and are kept.
            Err(error) => {
                failure = Some(error);
                break;
            }
        };
        // Samples are counted without the scene as it is, which comes first.
        let index = i.saturating_sub(usize::from(is_of_tolerances));
        found.push(Point { index, numbers, outcome });
    }
    let nominal = (is_of_tolerances && !found.is_empty()).then(|| found.remove(0));
    let found = Points { num_points, nominal, points: found };
    for point in found.refused().take(MOST_NAMED) {
        let problem = point.outcome.as_ref().err().map_or("", String::as_str);
        say(&format!("{}: {problem}", found.label(point)));
    }
    let failure = failure.or_else(|| refusal(&found));
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
fn refusal(found: &Points) -> Option<Error> {
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
