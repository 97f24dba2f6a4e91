//! `nsq-gpu paths`: which paths light took, the strongest first.

use crate::cli::console::{choose_vectors, ended, read_scene, say};
use crate::cli::pictures::PictureArgs;
use crate::cli::progress::{Mode, Progress, Status};
use crate::cli::stops::stop_on_interrupt;
use crate::cli::trace_args::{PrecisionArg, SamplerArg, StandardErrorArg, TraceArgs};
use crate::count;
use crate::error::{Error, Result};
use crate::format::pretty_json;
use crate::gpu::{AdapterChoice, Gpu};
use crate::model::SceneIr;
use crate::paths::rows::{PathMap, TableOptions, detector_of, flux_unit, table_with_maps};
use crate::result::output::Extras;
use crate::result::{
    Detector, FluxUnit, Grouping, LightPath, PathTable, RunInfo, Sorting, StoppedBy, Tally, TraceResult,
    output,
};
use crate::run::stopping::Stopping;
use crate::run::{Collect, StandardError, TraceOptions, Tracer, precision};
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
    /// So many rows, those of most flux, have a map and with it a peak irradiance.
    #[arg(long, value_parser = count::parse, default_value = "50", value_name = "N")]
    maps: u64,
    /// Part of the adapter's name (see `nsq-gpu adapters`).
    #[arg(long, value_name = "NAME")]
    adapter: Option<String>,
    /// Use no native 64-bit integers or atomics of the device.
    #[arg(long)]
    portable: bool,
    /// Print JSON instead of a table.
    #[arg(long)]
    json: bool,
    /// Write the result into this folder: report.json, paths.csv, and maps of the first rows as .npz and .png.
    #[arg(short, long, value_name = "DIR")]
    output: Option<PathBuf>,
    /// Write no pictures, only numbers.
    #[arg(long, requires = "output")]
    no_pictures: bool,
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

/// Rows that have files of their own where a result is written.
const MOST_WRITTEN: usize = 50;

impl Args {
    fn table_options(&self, ir: &SceneIr) -> Result<TableOptions> {
        let number = |name: &String| {
            let place = ir.detectors.iter().position(|detector| detector.name == *name);
            place.ok_or_else(|| {
                let names = ir.detectors.iter().map(|detector| detector.name.as_str());
                let advice = crate::model::place::did_you_mean(name, names);
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
        })
    }
}

/// Traces twice, writes the files, and returns the text for stdout. `start` is when the command began.
pub fn run(args: &Args, start: Instant) -> Result<String> {
    let scene = read_scene(&args.scene)?;
    let mut ir = scene.lower()?;
    let in_f64 = matches!(args.trace.precision, PrecisionArg::Auto | PrecisionArg::F64);
    choose_vectors(&ir, args.trace.num_rays, in_f64);
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
    let listing = args.table_options(&ir)?;
    let style = args.pictures.style(&ir)?;
    if let Some(dir) = &args.output {
        let names = ir.detectors.iter().map(|detector| detector.name.clone());
        let rows = (1..=listing.num_maps.min(MOST_WRITTEN)).map(|rank| format!("path_{rank}"));
        let names: Vec<String> = names.chain(rows).collect();
        let names = names.iter().map(String::as_str);
        output::check(dir, &output::file_names(names, !args.no_pictures, false, true, false))?;
    }
    let stop = stop_on_interrupt()?;
    let gpu = Gpu::open(&AdapterChoice::of_command(args.adapter.as_deref(), args.portable))?;
    let options = TraceOptions {
        max_depth: args.trace.max_depth.unwrap_or_else(|| crate::model::depth::of_scene(&ir)),
        ..args.trace.options(&ir)?
    };
    let options = TraceOptions {
        collect: Collect::Paths { rows: args.trace.path_rows()?, ends: args.ends },
        // Rows have errors of their own.
        standard_error: if has_errors.is_some() { StandardError::On } else { StandardError::Off },
        ..options
    }
    .tuned(&gpu.info);
    let choice = precision::choose(&gpu, &ir, &options, args.trace.wanted())?;
    let options = TraceOptions { precision: choice.precision, ..options };
    let mut tracer = Tracer::new(&gpu, &ir, &options)?;
    let mut stopping = Stopping::new(&ir, args.trace.target_error, args.trace.time_limit);
    let begun = tracer.empty_tally();
    stopping.prepare(&mut tracer, &begun)?;
    let mut shown = Progress::new(args.progress, tracer.num_rays());
    let mut stopped_by = None;
    let trace_start = Instant::now();
    let tally = tracer.go_on_checked(begun, |progress| {
        stopped_by = stopping.after_pass(&ir, progress)?;
        if stop.load(Ordering::Relaxed) {
            stopped_by = Some(StoppedBy::Interrupt);
        }
        shown.update(&Status::of(progress, &stopping, &args.trace, 0));
        Ok(stopped_by.is_none())
    })?;
    shown.finish();
    let trace_time_sec = trace_start.elapsed().as_secs_f64();
    let partial = tally.launched.count < tracer.num_rays();
    let run = RunInfo {
        scene: Some(args.scene.display().to_string()),
        num_rays: tracer.num_rays(),
        precision_reason: choice.reason,
        precision_warning: choice.warning,
        trace_time_sec,
        first_rays_sec: tracer.first_end().map(|end| (end - start).as_secs_f64()),
        scene_warnings: scene.warnings_in(options.precision),
        partial,
        stopped_by: stopped_by.filter(|_| partial),
        target_error: args.trace.target_error,
        has_no_gpu: gpu.info.class.stands_in_for_gpu() && args.adapter.is_none(),
        ..options.run_info(&gpu.info)
    };
    let found = tracer.found_paths();
    let traced =
        table_with_maps(&gpu, &ir, &options, &tally, &found, &listing, || !stop.load(Ordering::Relaxed))?;
    if !traced.is_whole {
        say("the second trace was interrupted: there are no centroids and no peaks");
    }
    let mut result = TraceResult::new(&ir, &run, &tally)?;
    let is_stopped = result.run.stopped_by == Some(StoppedBy::Interrupt) || !traced.is_whole;
    let mut failure = is_stopped.then_some(Error::Interrupted);
    if let Some(dir) = &args.output {
        let unit = flux_unit(&ir, &tally, tracer.num_rays());
        let rows = traced.table.paths.iter().zip(&traced.maps).take(MOST_WRITTEN);
        let mut written = result.clone();
        written.paths = Some(traced.table.clone());
        written.detectors.extend(path_detectors(&ir, &tally, unit, rows)?);
        let extras = Extras { pictures: Some(style).filter(|_| !args.no_pictures), tally: None };
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
            result.header() + "\n" + &traced.table.text(top) + "\n" + &result.warning_list()
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
