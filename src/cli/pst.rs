//! `nsq-gpu pst`: point source transmittance, angle by angle.

use crate::cli::console::{ended, read_scene, say};
use crate::cli::output_file::{OutputFile, check_places};
use crate::cli::progress::{self, Mode};
use crate::cli::stops::{end_with_caller, stop_on_interrupt};
use crate::cli::trace_args::{PathsArg, TraceArgs};
use crate::error::{Error, Result};
use crate::format::{csv_text, pretty_json, shown};
use crate::gpu::{AdapterChoice, Native};
use crate::run::Session;
use crate::run::pst::{Direction, Part, Pst, PstPoint, Transmittances};
use glam::DVec3;
use serde_json::{Map, Value, json};
use std::fmt::Write;
use std::path::{Path, PathBuf};

/// Arguments of `nsq-gpu pst`.
#[derive(clap::Args)]
#[command(
    after_help = "Example: nsq-gpu pst telescope.json --angles 0:60:2 --detector image --target-error 10% -n 1e7"
)]
#[command(mut_args(|arg| TraceArgs::in_help(arg, &["target-error"], &["where"])))]
pub struct Args {
    /// The scene file.
    scene: PathBuf,
    /// Angles of the source off its axis [deg]: 0:80:2 (first, last, step) or 0,1,2,5.
    #[arg(long, value_name = "ANGLES", value_parser = parse_angles, allow_hyphen_values = true)]
    angles: Angles,
    /// Azimuths of the source [deg], from the x of its frame towards its y.
    #[arg(long, value_name = "ANGLES", value_parser = parse_angles, default_value = "0", allow_hyphen_values = true)]
    azimuths: Angles,
    /// The detector.
    #[arg(long, value_name = "NAME")]
    detector: String,
    /// The collimated source that is turned. Without it, a beam that overfills the scene takes the place of all sources, along
    /// the axis and with the spectrum of the first.
    #[arg(long, value_name = "NAME")]
    source: Option<String>,
    /// The point about which the source is turned [mm]; the middle of the scene unless given.
    #[arg(long, value_name = "X,Y,Z", value_parser = parse_point, allow_hyphen_values = true)]
    pivot: Option<DVec3>,
    #[command(flatten)]
    trace: TraceArgs,
    /// Part of the adapter's name (see `nsq-gpu adapters`).
    #[arg(long, value_name = "NAME")]
    adapter: Option<String>,
    /// Progress of each direction on stderr.
    #[arg(long, value_enum, default_value_t = Mode::Auto)]
    progress: Mode,
    /// End at once when stdin closes, or when the process ends that started this one.
    #[arg(long)]
    watch_stdin: bool,
    /// Print JSON instead of a table.
    #[arg(long)]
    json: bool,
    /// Write pst.csv and pst.json into this folder as well. Files that exist are kept, and refused before the first ray.
    #[arg(short, long, value_name = "DIR")]
    output: Option<PathBuf>,
    /// Let -o replace files that exist.
    #[arg(long, requires = "output")]
    overwrite: bool,
}

/// Angles \[deg\].
#[derive(Debug, Clone)]
struct Angles(Vec<f64>);

/// Most directions.
const MOST_ANGLES: f64 = 1e5;

fn parse_angles(text: &str) -> std::result::Result<Angles, String> {
    let number = |text: &str| {
        let number =
            text.trim().parse().ok().filter(|number: &f64| number.is_finite() && number.abs() <= 360.0);
        number.ok_or_else(|| format!("`{text}` is no angle from -360 to 360 degrees"))
    };
    let parts: Vec<&str> = text.split(':').collect();
    match parts[..] {
        [list] => list.split(',').map(number).collect::<std::result::Result<_, _>>().map(Angles),
        [first, last, step] => {
            if text.contains(',') {
                return Err(format!("`{text}` mixes a list and a range; write 0,5,40 or 0:40:5"));
            }
            let (first, last, step) = (number(first)?, number(last)?, number(step)?);
            if step == 0.0 || (last - first) * step < 0.0 {
                let problem = if step == 0.0 { "has a step of 0" } else { "steps away from its last angle" };
                return Err(format!("`{text}` {problem}; write first:last:step, such as 0:80:2"));
            }
            // The last one counts although sums round.
            let count = ((last - first) / step + 1e-9).floor();
            if !(0.0..MOST_ANGLES).contains(&count) {
                return Err(format!("`{text}` has too many angles; write first:last:step, such as 0:80:2"));
            }
            Ok(Angles((0..=count as u32).map(|i| first + step * f64::from(i)).collect()))
        }
        _ => Err(format!("`{text}` is no list of angles; write 0:80:2 (first, last, step) or 0,1,2,5")),
    }
}

pub(super) fn parse_point(text: &str) -> std::result::Result<DVec3, String> {
    let numbers: Option<Vec<f64>> = text
        .split(',')
        .map(|part| part.trim().parse().ok().filter(|number: &f64| number.is_finite()))
        .collect();
    match numbers.as_deref() {
        Some([x, y, z]) => Ok(DVec3::new(*x, *y, *z)),
        _ => Err(format!("`{text}` is no point; write three numbers, such as 0,0,-100 [mm]")),
    }
}

const CSV: &str = "pst.csv";
const JSON: &str = "pst.json";

/// Traces every direction, writes the files, and returns the text for stdout.
pub fn run(args: &Args) -> Result<String> {
    args.check()?;
    let scene = read_scene(&args.scene)?;
    let mut model = scene.lower()?;
    if args.watch_stdin {
        end_with_caller();
    }
    args.trace.override_sampling(&mut model)?;
    if let Some(folder) = &args.output {
        check_places(folder, &[CSV, JSON], args.overwrite)?;
    }
    let directions = args
        .azimuths
        .0
        .iter()
        .flat_map(|&azimuth| args.angles.0.iter().map(move |&angle| Direction { angle, azimuth }));
    // Rounds end when all their rays are done. The error of a direction comes from its rounds.
    let of_round = TraceArgs { target_error: None, ..args.trace.clone() };
    let pst = Pst {
        scene: &scene,
        model: &model,
        options: of_round.options(&model)?,
        directions: directions.collect(),
        detector: args.detector.clone(),
        source: args.source.clone(),
        pivot: args.pivot,
        target_error: args.trace.target_error,
        path_rows: args.trace.path_rows()?,
    };
    let stop = stop_on_interrupt()?;
    let choice = AdapterChoice { name: args.adapter.clone(), native: Native::Allowed, ..Default::default() };
    let next = progress::shown(args.progress, &stop);
    let detector = model.detectors.iter().position(|detector| detector.name == args.detector);
    let found = pst.go(&mut Session::new(choice), |run| of_round.set_others(run, detector), next)?;
    found.warnings.iter().for_each(|text| say(&format!("warning: {text}")));
    if found.points.is_empty() {
        return Err(found.failure.unwrap_or(Error::Interrupted));
    }
    let printed = if args.json { args.document(&found) } else { found.text() };
    let written = args.output.as_ref().map_or(Ok(()), |folder| args.write(folder, &found));
    let missed = found.points.iter().filter(|point| !point.is_reached).count();
    let missed = (missed > 0).then(|| {
        Error::Tolerance(format!(
            "{missed} of {} directions have not reached the error that was asked for; give more rays by -n, or send more of them to \
             the detector by --scatter-to and --scatter-prob",
            found.points.len()
        ))
    });
    ended(printed, written.err().or(found.failure).or(missed))
}

impl Args {
    fn check(&self) -> Result<()> {
        let trace = TraceArgs { target_error: None, paths: PathsArg::Off, ..self.trace.clone() };
        let given = trace.of_one_trace().or(self.trace.filter.is_some().then_some("where"));
        match given {
            Some(name) => Err(Error::Usage(format!(
                "--{name} belongs to a trace; a point source transmittance takes -n and --target-error, leave it out"
            ))),
            None => self.trace.refuse_guide_to("a point source transmittance"),
        }
    }

    /// What was asked for, and what was found.
    fn document(&self, found: &Transmittances) -> String {
        let points: Vec<Value> = found.points.iter().map(PstPoint::entry).collect();
        let document = json!({
            "version": env!("CARGO_PKG_VERSION"),
            "scene": self.scene.display().to_string(),
            "detector": self.detector,
            "source": self.source,
            "pivot_mm": self.pivot.map(|pivot| pivot.to_array()),
            "angles_deg": self.angles.0,
            "azimuths_deg": self.azimuths.0,
            "seed": self.trace.seed,
            "target_error": self.trace.target_error,
            "num_directions": found.num_directions,
            "partial": found.is_partial(),
            "points": points,
        });
        pretty_json(&document).unwrap_or_default()
    }

    fn write(&self, folder: &Path, found: &Transmittances) -> Result<()> {
        std::fs::create_dir_all(folder).map_err(|error| Error::file(folder, error))?;
        for (name, contents) in [(CSV, found.csv()), (JSON, self.document(found))] {
            let file = OutputFile::new(&folder.join(name), self.overwrite, &self.scene, |_| false)?;
            let path = file.write(contents.as_bytes())?;
            say(&format!("written: {}", path.display()));
        }
        Ok(())
    }
}

impl Part {
    fn entry(&self) -> Value {
        json!({"pst": self.pst, "standard_error": self.standard_error})
    }
}

impl PstPoint {
    fn entry(&self) -> Value {
        let first: Map<String, Value> =
            self.by_first_scatterer.iter().map(|(name, part)| (name.clone(), part.entry())).collect();
        json!({
            "angle_deg": self.direction.angle,
            "azimuth_deg": self.direction.azimuth,
            "pst": self.all.pst,
            "standard_error": self.all.standard_error,
            "num_rays": self.num_rays,
            "num_hits": self.num_hits,
            "reached": self.is_reached,
            "by_order": self.by_order.iter().map(Part::entry).collect::<Vec<_>>(),
            "by_first_scatterer": first,
            "unknown_path": self.unknown.entry(),
        })
    }

    /// The strongest of what scattered first, or that nothing did.
    fn strongest(&self) -> String {
        let unscattered = self.by_order.first().map_or(0.0, |part| part.pst);
        match self.by_first_scatterer.first() {
            Some((name, part)) if part.pst > unscattered => {
                format!("{} {:.0} %", shown(name), 100.0 * part.pst / self.all.pst)
            }
            _ if unscattered > 0.0 => format!("unscattered {:.0} %", 100.0 * unscattered / self.all.pst),
            _ => "-".into(),
        }
    }
}

impl Transmittances {
    /// The names of surfaces that scattered first in some direction, those that did most first.
    fn scatterers(&self) -> Vec<&str> {
        let mut names: Vec<(&str, f64)> = Vec::new();
        for (name, part) in self.points.iter().flat_map(|point| &point.by_first_scatterer) {
            match names.iter_mut().find(|(known, _)| known == name) {
                Some((_, most)) => *most = most.max(part.pst),
                None => names.push((name, part.pst)),
            }
        }
        names.sort_by(|one, other| other.1.total_cmp(&one.1));
        names.into_iter().map(|(name, _)| name).collect()
    }

    /// A line of titles, then a line a direction.
    fn csv(&self) -> String {
        let scatterers = self.scatterers();
        let orders = self.points.first().map_or(0, |point| point.by_order.len());
        let mut titles: Vec<String> =
            ["angle [deg]", "azimuth [deg]", "pst", "standard error", "rays", "hits"]
                .map(Into::into)
                .to_vec();
        titles.extend((0..orders).map(|order| match order + 1 < orders {
            true => format!("{order} scatterings"),
            false => format!("{order} scatterings and more"),
        }));
        titles.extend(scatterers.iter().map(|name| csv_text(&format!("first scattered by {name}"))));
        let mut text = titles.join(",") + "\n";
        for point in &self.points {
            let PstPoint { direction, all, .. } = point;
            let mut cells: Vec<String> = [direction.angle, direction.azimuth, all.pst, all.standard_error]
                .map(|number| format!("{number:?}"))
                .to_vec();
            cells.extend([point.num_rays, point.num_hits].map(|count| count.to_string()));
            cells.extend(point.by_order.iter().map(|part| format!("{:?}", part.pst)));
            let of = |name: &&str| point.by_first_scatterer.iter().find(|(known, _)| known == name);
            cells.extend(
                scatterers
                    .iter()
                    .map(|name| of(name).map_or("0.0".into(), |(_, part)| format!("{:?}", part.pst))),
            );
            text += &(cells.join(",") + "\n");
        }
        text
    }

    /// The table for people.
    fn text(&self) -> String {
        let mut text = String::from(
            "   angle  azimuth         PST    error        rays  most of it\n     deg      deg\n",
        );
        for point in &self.points {
            let Direction { angle, azimuth } = point.direction;
            let error = match point.all.pst > 0.0 {
                true => format!("{:.1} %", 100.0 * point.all.standard_error / point.all.pst),
                false => "-".into(),
            };
            let mark = if point.is_reached { "" } else { "  (error not reached)" };
            let _ = writeln!(
                text,
                "{angle:>8} {azimuth:>8} {:>11.3e} {error:>8} {:>11}  {}{mark}",
                point.all.pst,
                point.num_rays,
                point.strongest(),
            );
        }
        if self.is_partial() {
            let _ = writeln!(text, "partial: {} of {} directions", self.points.len(), self.num_directions);
        }
        text
    }
}
