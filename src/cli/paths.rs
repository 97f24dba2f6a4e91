//! `nsq-gpu paths`: which paths light took, the strongest first.

use crate::cli::console::{ended, read_scene, say};
use crate::cli::device_args::DeviceArgs;
use crate::cli::pictures::PictureArgs;
use crate::cli::progress::{self, Mode};
use crate::cli::stops::stop_on_interrupt;
use crate::cli::trace_args::{SamplerArg, StandardErrorArg, TraceArgs, write_guide};
use crate::count;
use crate::error::{Error, Result};
use crate::format::pretty_json;
use crate::model::SceneIr;
use crate::paths::rows::{PathMap, TableOptions, detector_of, flux_unit, table_with_maps};
use crate::paths::what_if;
use crate::result::output::Extras;
use crate::result::{
    Detector, FluxUnit, Grouping, LightPath, NewCoating, PathTable, Recoating, Sorting, StoppedBy, Tally,
    coating_rank, output,
};
use crate::run::{Collect, Outcome, Run, StandardError};
use std::path::PathBuf;
use std::sync::atomic::Ordering;
use std::time::Instant;

/// Arguments of `nsq-gpu paths`.
#[derive(clap::Args)]
pub struct Args {
    /// The scene file: Optiland's NSQ JSON, with an optional "nsq_gpu" block.
    scene: PathBuf,
    /// List the light of this detector alone.
    #[arg(long, value_name = "NAME")]
    detector: Option<String>,
    /// Which paths are one row: each sequence of events; those that the same faces reflect and scatter; or those with
    /// equally many reflections and scatterings.
    #[arg(long, value_enum, default_value_t = GroupArg::Sequence)]
    group: GroupArg,
    /// What comes first: the most flux, or the highest peak of irradiance among the rows that have a map.
    #[arg(long, value_enum, default_value_t = SortArg::Flux)]
    sort: SortArg,
    /// Print so many rows.
    #[arg(long, value_parser = count::parse, default_value = "50", value_name = "N")]
    top: u64,
    /// Also list light that came to no detector: absorbed, missed, and ended by the depth limit or by roulette.
    #[arg(long, conflicts_with = "detector")]
    ends: bool,
    /// So many rows, the ones of most flux, have a map and with it a peak irradiance.
    #[arg(long, value_parser = count::parse, default_value = "50", value_name = "N")]
    maps: u64,
    /// Say what another coating would do, without another trace: the rows with R and T of this face in the place of its own.
    /// Without T the face absorbs as before, and T = 1 - R - A. May be given for several faces. A coating has to be there,
    /// the same at every angle and wavelength. Maps are not changed.
    #[arg(long, value_name = "FACE=R[,T]", value_parser = parse_recoat)]
    recoat: Vec<NewCoating>,
    /// Also list the faces whose coatings matter most: dF/dR, by how much the flux F of all ghosts changes with the
    /// reflectance R of each face. Ghosts are paths of at least two reflections to the listed detector, or to any.
    #[arg(long)]
    rank_coatings: bool,
    #[command(flatten)]
    device: DeviceArgs,
    /// Print JSON instead of a table.
    #[arg(long)]
    json: bool,
    /// Write the result into this folder: report.json, paths.csv, and maps of the first rows as .npz and .png.
    #[arg(short, long, value_name = "DIR")]
    output: Option<PathBuf>,
    #[command(flatten)]
    pictures: PictureArgs,
    /// Progress on stderr.
    #[arg(long, value_enum, default_value_t = Mode::Auto)]
    progress: Mode,
    #[command(flatten)]
    trace: TraceArgs,
}

/// The `--group` argument.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum GroupArg {
    /// Each sequence of events is a row.
    Sequence,
    /// Sequences with the same reflections and scatterings, by face and order, are a row: a ghost.
    Faces,
    /// Sequences with equally many reflections and scatterings are a row.
    Order,
}

/// The `--sort` argument.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum SortArg {
    /// The most flux first.
    Flux,
    /// The highest peak first.
    Peak,
}

fn parse_recoat(text: &str) -> std::result::Result<NewCoating, String> {
    text.parse().map_err(|error: Error| error.to_string())
}

/// Rows that have files of their own where a result is written.
const MOST_WRITTEN: usize = 50;

impl Args {
    fn table_options(&self, ir: &SceneIr) -> Result<TableOptions> {
        let number = |name: &String| {
            let place = ir.detectors.iter().position(|detector| detector.name == *name);
            place.ok_or_else(|| {
                let names = ir.detectors.iter().map(|detector| detector.name.as_str());
                let advice = crate::model::key_path::did_you_mean(name, names);
                Error::Usage(format!("--detector {name:?} is no detector of the scene; {advice}"))
            })
        };
        Ok(TableOptions {
            group: match self.group {
                GroupArg::Sequence => Grouping::Sequence,
                GroupArg::Faces => Grouping::Faces,
                GroupArg::Order => Grouping::Order,
            },
            sort: match self.sort {
                SortArg::Flux => Sorting::Flux,
                SortArg::Peak => Sorting::Peak,
            },
            detector: self.detector.as_ref().map(number).transpose()?,
            num_maps: self.maps.min(1 << 16) as usize,
            is_guided: false,
            recoating: Recoating::new(ir, &self.recoat)?,
        })
    }
}

/// Traces twice, writes the files, and returns the text for stdout. `start` is when the command began.
pub fn run(args: &Args, start: Instant) -> Result<String> {
    let scene = read_scene(&args.scene)?;
    let mut ir = scene.lower()?;
    args.trace.override_sampling(&mut ir)?;
    let has_errors = match (args.trace.target_error, args.trace.standard_error) {
        (Some(_), _) => Some("--target-error"),
        (None, StandardErrorArg::On) => Some("--standard-error on"),
        _ => None,
    };
    if let Some(option) = has_errors.filter(|_| args.trace.sampler == SamplerArg::Sobol) {
        return Err(Error::Usage(format!(
            "{option} with --sampler sobol needs scrambles of the points, for which paths have no maps; leave one of them out"
        )));
    }
    let mut listing = args.table_options(&ir)?;
    let pictures = args.pictures.style(&ir, false)?;
    // A map has the coatings of the trace.
    let num_written = if listing.recoating.is_empty() { MOST_WRITTEN } else { 0 };
    if let Some(dir) = &args.output {
        let names = ir.detectors.iter().map(|detector| detector.name.clone());
        let rows = (1..=listing.num_maps.min(num_written)).map(|rank| format!("path_{rank}"));
        let names: Vec<String> = names.chain(rows).collect();
        let names = names.iter().map(String::as_str);
        output::check(dir, &output::file_names(names, pictures.map(|_| &[][..]), false, true, false))?;
    }
    let guide_file = args.trace.guide_file(&args.scene)?;
    let stop = stop_on_interrupt()?;
    let gpu = args.device.open()?;
    let run = Run::of(&scene, &ir).named(args.scene.display()).on(&gpu).follow_ghosts();
    let (run, rows) = (args.trace.set(run)?, args.trace.path_rows()?);
    let mut run = run.change_options(|options| {
        options.collect = Collect::Paths { rows, ends: args.ends };
        // Rows have errors of their own.
        options.standard_error = if has_errors.is_some() { StandardError::On } else { StandardError::Off };
    });
    run = run.change_guide(|wanted| {
        (wanted.detector, wanted.group) = (listing.detector, listing.group);
        wanted.top = args.top.clamp(1, 1 << 20) as usize;
    });
    run.start = start;
    let mut shown = progress::shown(args.progress, &stop);
    let outcome = run.go_with(move |pass| Ok(shown(&pass.status)))?;
    let Outcome { mut result, tally, options, found_paths, .. } = outcome;
    let mut failure = write_guide(guide_file, &options).err();
    listing.is_guided = options.guide.is_some();
    let found = found_paths.iter().map(|(path, at)| (path, *at)).collect();
    let coating_warnings =
        what_if::check_recoating(&ir, &options, &tally, &listing).unwrap_or_else(|error| {
            // The table is printed all the same, as it was traced.
            (listing.recoating, failure) = (Recoating::default(), Some(error));
            Vec::new()
        });
    let mut traced =
        table_with_maps(&gpu, &ir, &options, &tally, &found, &listing, || !stop.load(Ordering::Relaxed))?;
    traced.table.coating_warnings = coating_warnings;
    if args.rank_coatings {
        what_if::rank_coatings(&ir, &options, &tally, &listing, &mut traced);
    }
    if !traced.is_whole {
        say("the second trace was interrupted: there are no centroids and no peaks");
    }
    let is_stopped = result.run.stopped_by == Some(StoppedBy::Interrupt) || !traced.is_whole;
    failure = failure.or(is_stopped.then_some(Error::Interrupted));
    if let Some(dir) = &args.output {
        let unit = flux_unit(&ir, &tally, result.run.num_rays);
        let rows = traced.table.paths.iter().zip(&traced.maps).take(num_written);
        let mut written = result.clone();
        written.paths = Some(traced.table.clone());
        written.detectors.extend(path_detectors(&ir, &tally, unit, rows)?);
        let extras = Extras { pictures, tally: None };
        match output::write(dir, &written, &extras) {
            Ok(written) => written.files.iter().for_each(|file| say(&format!("written: {}", file.display()))),
            // The table is printed all the same: the trace may have taken hours.
            Err(error) => failure = Some(error),
        }
    }
    let top = args.top.min(1 << 24) as usize;
    let printed = match args.json {
        true => {
            let paths = traced.table.paths.iter().take(top).cloned().collect();
            let table = PathTable { paths, ..traced.table };
            let mut document = serde_json::to_value(&table).map_err(|e| Error::Internal(e.to_string()))?;
            document["partial"] = (result.run.partial || is_stopped).into();
            pretty_json(&document).map_err(|e| Error::Internal(e.to_string()))?
        }
        false => {
            result.paths = None;
            result.diagnostics.warnings.extend(traced.table.coating_warnings.iter().cloned());
            let ranks = traced.table.coatings.as_deref();
            let ranks = ranks.map_or(String::new(), |ranks| format!("\n{}", coating_rank::text(ranks)));
            result.header() + "\n" + &traced.table.text(top) + &ranks + "\n" + &result.warning_list()
        }
    };
    ended(printed, failure)
}

/// The maps of rows, as detectors that are named by the rows' ranks.
fn path_detectors<'a>(
    ir: &SceneIr,
    tally: &Tally,
    unit: FluxUnit,
    rows: impl Iterator<Item = (&'a LightPath, &'a Option<PathMap>)>,
) -> Result<Vec<Detector>> {
    rows.filter_map(|(row, map)| Some((row, map.as_ref()?)))
        .map(|(row, map)| detector_of(ir, tally, unit, map, row, format!("path_{}", row.rank)))
        .collect()
}
