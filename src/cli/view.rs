//! `nsq-gpu view`: opens a window on a trace or on results, or draws a picture of it.

use crate::cli::output_file::OutputFile;
use crate::cli::stops::stop_on_interrupt;
use crate::count;
use crate::error::{Error, Result};
use crate::format::path_text;
use crate::model::{PathFilter, SceneIr};
use crate::result::picture::scale::ScaleKind;
use crate::viewer::light::ShownLight;
use crate::viewer::model::Subject;
use crate::viewer::plot::View;
use crate::viewer::settings::{Plane, Settings};
use crate::viewer::silhouettes::{fit, home, silhouettes};
use crate::viewer::tracing::{Device, Notify};
use crate::viewer::two_results::ComparisonMode;
use crate::viewer::{App, Model, Waker, open, screenshot};
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::Ordering;

/// Arguments of `nsq-gpu view`.
#[derive(Debug, Clone, clap::Args)]
#[command(after_help = "Examples: nsq-gpu view lamp.json --fit lens --screenshot lens.png\n          \
                        nsq-gpu view lamp.json --zoom z=-5:30,y=-12:12 --screenshot lens.png")]
pub struct Args {
    /// A scene file, which is traced while you look on, or a folder that `trace -o` wrote.
    path: PathBuf,
    /// Rays to launch: 250000, 1e7, 10M.
    #[arg(short = 'n', long, value_parser = count::parse, value_name = "N")]
    num_rays: Option<u64>,
    /// Seed of every random draw.
    #[arg(long)]
    seed: Option<u64>,
    /// Largest number of events (surfaces and detectors) of a ray; by default as in `nsq-gpu trace`.
    #[arg(long, value_name = "N")]
    max_depth: Option<u32>,
    /// Keep only the light whose path matches, as in `nsq-gpu trace`: "reflections == 2 and not scattered(mount)".
    #[arg(long = "where", value_name = "EXPR")]
    filter: Option<String>,
    /// Part of the adapter's name (see `nsq-gpu adapters`).
    #[arg(long, value_name = "NAME")]
    adapter: Option<String>,
    /// Compare with the results in this folder: A is what is opened, B is this folder.
    #[arg(long, value_name = "DIR")]
    compare: Option<PathBuf>,
    /// Show this detector first.
    #[arg(long, value_name = "NAME", conflicts_with = "side_view")]
    detector: Option<String>,
    /// Show the scene from the side first, with a few hundred rays.
    #[arg(long)]
    side_view: bool,
    /// Show this part of the scene from the side, in mm: z=-5:30,y=-12:12. The axes are z and y, z and x, or x and y. All
    /// of both ranges is shown: one of them grows, until a millimetre is as long along both axes.
    #[arg(long, value_name = "AXIS=LOW:HIGH,AXIS=LOW:HIGH", value_parser = parse_zoom, allow_hyphen_values = true)]
    #[arg(conflicts_with = "detector")]
    zoom: Option<(Plane, View)>,
    /// Show the scene from the side, and of it what is called so: an element, a face, a source or a detector; "L*" is all
    /// that begins so. Given several times, all of them.
    #[arg(long, value_name = "NAME", conflicts_with_all = ["detector", "zoom"])]
    fit: Vec<String>,
    /// Open the table of paths: light by what happened to it.
    #[arg(long)]
    paths: bool,
    /// Open the table of paths, and show the light of the row of this rank.
    #[arg(long = "path", id = "rank", value_name = "RANK", value_parser = clap::value_parser!(u32).range(1..))]
    path_rank: Option<u32>,
    /// Draw the window into a PNG file once everything is traced; no display is needed. A picture that
    /// was drawn so before is replaced. Any other file is kept, and refused before the first ray.
    #[arg(long, value_name = "FILE", value_parser = parse_picture)]
    screenshot: Option<PathBuf>,
    /// Let --screenshot replace a file that exists.
    #[arg(long, requires = "screenshot")]
    overwrite: bool,
    /// Size of the picture in points.
    #[arg(long, value_name = "WxH", default_value = "1440x900", value_parser = parse_size)]
    size: (f32, f32),
    /// Pixels of the picture per point.
    #[arg(long, value_name = "X", default_value_t = 1.0, value_parser = parse_pixels_per_point)]
    pixels_per_point: f32,
    /// Scale of the picture.
    #[arg(long, value_enum, requires = "screenshot")]
    scale: Option<ScaleArg>,
    /// Draw dark on white, as for print.
    #[arg(long, requires = "screenshot")]
    light: bool,
    /// What the picture shows of two results.
    #[arg(long, value_enum, requires = "compare")]
    show: Option<ShowArg>,
    /// Close the window after this many frames, once everything is traced.
    #[arg(long, hide = true)]
    frames: Option<u32>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum ScaleArg {
    Linear,
    Log,
    Percentile,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum ShowArg {
    A,
    B,
    Difference,
    Significance,
}

fn parse_size(text: &str) -> std::result::Result<(f32, f32), String> {
    let side = |side: &str| side.parse::<f32>().ok().filter(|side| (320.0..=8192.0).contains(side));
    let sides = text.split_once('x').and_then(|(width, height)| Some((side(width)?, side(height)?)));
    sides.ok_or_else(|| format!("`{text}` is not a size; write 1440x900, each side in 320..=8192"))
}

/// Two ranges of the side view: their axes and bounds \[mm\].
fn parse_zoom(text: &str) -> std::result::Result<(Plane, View), String> {
    let example = "write z=-5:30,y=-12:12, in mm";
    let mut ranges = Vec::new();
    for part in text.split(',') {
        let (axis, range) =
            part.split_once('=').ok_or_else(|| format!("`{part}` names no axis; {example}"))?;
        let (low, high) = range.split_once(':').ok_or_else(|| format!("`{part}` has no `:`; {example}"))?;
        let number = |text: &str| {
            let number = text.trim().parse::<f64>().ok().filter(|number| number.is_finite());
            number.ok_or_else(|| format!("`{text}` in `{part}` is not a number; {example}"))
        };
        let (low, high) = (number(low)?, number(high)?);
        match low.partial_cmp(&high) {
            Some(std::cmp::Ordering::Less) => ranges.push((axis.trim(), (low, high))),
            Some(std::cmp::Ordering::Equal) => return Err(format!("`{part}` is empty; {example}")),
            _ => return Err(format!("`{part}` is reversed; write {axis}={high}:{low}")),
        }
    }
    let [(first, _), (second, _)] = ranges[..] else {
        return Err(format!(
            "a part of the side view has two ranges, and `{text}` has {}; {example}",
            ranges.len()
        ));
    };
    let range = |wanted: &str| ranges.iter().find(|(axis, _)| *axis == wanted).map(|(_, range)| *range);
    let mut views = Plane::ALL.into_iter().filter_map(|(plane, _)| {
        let (across, up) = plane.axes();
        Some((plane, View::new(range(across)?, range(up)?)))
    });
    let none = || {
        format!(
            "`{first}` and `{second}` are not the axes of a side view; they are z and y, z and x, or x and y"
        )
    };
    views.next_back().ok_or_else(none)
}

fn parse_picture(text: &str) -> std::result::Result<PathBuf, String> {
    let path = PathBuf::from(text);
    let is_png = path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("png"));
    if is_png { Ok(path) } else { Err(format!("`{text}` does not end in .png; the picture is a PNG file")) }
}

fn parse_pixels_per_point(text: &str) -> std::result::Result<f32, String> {
    let number = text.parse::<f32>().ok().filter(|number| (0.5..=4.0).contains(number));
    number.ok_or_else(|| format!("`{text}` is not a number in 0.5..=4"))
}

/// Opens the window, or draws it into a file. Nothing goes to stdout.
pub fn run(args: &Args) -> Result<String> {
    if let Some(path) = &args.screenshot {
        let file = OutputFile::new(path, args.overwrite, &args.path, screenshot::is_own)?;
        let stop = stop_on_interrupt()?;
        // The picture does not depend on what the user chose in the window before.
        let settings = Settings { dark: !args.light, ..Settings::default() };
        let mut app = app(args, settings, Arc::new(|| {}))?;
        let is_stopped = || stop.load(Ordering::Relaxed);
        let picture = screenshot::draw(&mut app, args.size, args.pixels_per_point, is_stopped)?;
        if app.model.a().is_none() {
            if is_stopped() {
                return Err(Error::Interrupted);
            }
            let failure = app.model.failure.take();
            return Err(failure.unwrap_or_else(|| Error::Usage("nothing was traced".into())));
        }
        if args.path_rank.is_some() && !matches!(app.model.light.shown(), ShownLight::Row(_)) {
            let problem = app.model.light.problem().unwrap_or("the table of paths is not ready");
            return Err(Error::Usage(format!("--path: {problem}")));
        }
        let written = file.write(&picture.to_png()?)?;
        crate::cli::console::say(&format!("written: {}", written.display()));
        return if is_stopped() { Err(Error::Interrupted) } else { Ok(String::new()) };
    }
    let settings = Settings::load();
    let title = format!("{} – nsq-gpu", args.path.display());
    let (window, waker) = (settings.window, Waker::default());
    let app = app(args, settings, waker.notify())?;
    open(&title, window, &waker, app)?;
    Ok(String::new())
}

/// Refuses options of a trace for a folder, whose results were traced before.
fn refuse_options_of_traces(args: &Args) -> Result<()> {
    let given = [
        ("-n", args.num_rays.is_some()),
        ("--seed", args.seed.is_some()),
        ("--max-depth", args.max_depth.is_some()),
        ("--where", args.filter.is_some()),
    ];
    match given.into_iter().find(|(_, is_given)| *is_given) {
        None => Ok(()),
        Some((option, _)) => Err(Error::Usage(format!(
            "{option} is for traces, and {} holds the results of one; name the scene file to trace anew",
            args.path.display()
        ))),
    }
}

fn app(args: &Args, settings: Settings, notify: Notify) -> Result<App> {
    let device = Device::on(args.adapter.clone());
    let mut model = Model::open(&args.path, settings, device, notify)
        .map_err(|error| error.in_scene(&path_text(&args.path)))?;
    if model.a().is_some() {
        refuse_options_of_traces(args)?;
    }
    let run = &mut model.run;
    run.num_rays = args.num_rays.unwrap_or(run.num_rays);
    run.seed = args.seed.unwrap_or(run.seed);
    run.max_depth = args.max_depth.unwrap_or(run.max_depth);
    let filter = args.filter.as_ref().zip(model.scene());
    model.run.filter =
        filter.map(|(text, scene)| PathFilter::parse(text, &scene.ir)).transpose()?.map(Arc::new);
    if let Some(dir) = &args.compare {
        model.compare_with(dir)?;
    }
    if let Some(scale) = args.scale {
        model.settings.scale = match scale {
            ScaleArg::Linear => ScaleKind::Linear,
            ScaleArg::Log => ScaleKind::Log,
            ScaleArg::Percentile => ScaleKind::Percentile,
        };
    }
    if let Some(show) = args.show {
        model.settings.comparison = match show {
            ShowArg::A => ComparisonMode::A,
            ShowArg::B => ComparisonMode::B,
            ShowArg::Difference => ComparisonMode::Difference,
            ShowArg::Significance => ComparisonMode::Significance,
        };
    }
    if let Some(name) = &args.detector {
        let names = model.detector_names();
        if !names.contains(name) {
            let known = names.join(", ");
            return Err(Error::Usage(format!("there is no detector '{name}'; there are {known}")));
        }
        model.subject = Subject::Detector(name.clone());
    } else if args.side_view {
        model.subject = Subject::Scene;
    }
    let part = part_of_side_view(args, &model)?;
    if model.a().is_none() {
        model.trace();
    }
    if args.paths || args.path_rank.is_some() {
        if model.scene().is_none() {
            let problem = "the table of paths needs the scene file of these results, which was not found";
            return Err(Error::Usage(problem.into()));
        }
        model.light.is_open = true;
        model.follow_light();
    }
    if let Some(rank) = args.path_rank {
        model.light.ask_for(rank);
    }
    let mut app = App::new(model);
    if let Some((plane, view)) = part {
        app.show_side_view(plane, view);
    }
    app.frames_left = args.frames;
    Ok(app)
}

/// The part of the side view that --zoom or --fit asks for.
fn part_of_side_view(args: &Args, model: &Model) -> Result<Option<(Plane, View)>> {
    if args.zoom.is_none() && args.fit.is_empty() {
        return Ok(None);
    }
    let problem = "--zoom and --fit need the scene file of these results, which was not found";
    let ir = &model.scene().ok_or_else(|| Error::Usage(problem.into()))?.ir;
    let plane = model.settings.plane;
    match args.zoom {
        None => Ok(Some((plane, fit(ir, plane, &args.fit)?))),
        Some((plane, view)) => checked(ir, plane, view).map(|view| Some((plane, view))),
    }
}

/// Refuses a view in which nothing can be drawn.
fn checked(ir: &SceneIr, plane: Plane, view: View) -> Result<View> {
    let home = home(&silhouettes(ir, plane));
    if view.is_sensible(&home) {
        return Ok(view);
    }
    let ((across, up), View { x, y }) = (plane.axes(), home);
    Err(Error::Usage(format!(
        "--zoom: the part is more than a million times smaller, or a thousand times larger, than the scene, which has \
         {across}={:.4}:{:.4},{up}={:.4}:{:.4} mm",
        x.0, x.1, y.0, y.1
    )))
}
