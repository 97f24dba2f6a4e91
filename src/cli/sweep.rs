//! `nsq-gpu sweep`: traces a scene again and again, with some of its numbers changed. A compiled shader serves all
//! points.

use crate::cli::console::{choose_vectors, named, say};
use crate::cli::serve::requests::TraceRequest;
use crate::cli::serve::session::Session;
use crate::cli::trace::missed_target;
use crate::cli::trace_args::{PrecisionArg, TraceArgs};
use crate::error::{Error, Result};
use crate::gpu::{AdapterChoice, Native};
use crate::result::TraceResult;
use crate::scene::Scene;
use crate::trace::RecordPaths;
use serde_json::{Map, Value, json};
use std::collections::BTreeSet;
use std::fmt::Write;
use std::path::{Path, PathBuf};

/// Arguments of `nsq-gpu sweep`.
#[derive(clap::Args)]
pub struct Args {
    /// The scene file.
    scene: PathBuf,
    /// A number of the scene and its values: L1.r1=50:60:11 (eleven from 50 to 60), L2.z=1,2,5 or L2.z=3. Several of
    /// these give every combination. Names with dots are quoted: '"a.b".r1=50,60'.
    #[arg(long, value_name = "NAME=VALUES", value_parser = parse_values)]
    set: Vec<Values>,
    /// The values of several --set belong together: the first of each, then the second, and so on.
    #[arg(long)]
    zip: bool,
    /// A number of the scene and its tolerance, absolute or in percent: L1.r1=0.1%, L2.z=0.05. Each sample draws all of
    /// them.
    #[arg(long, value_name = "NAME=SIZE", value_parser = parse_tolerance, conflicts_with = "set")]
    tolerance: Vec<Tolerance>,
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
    /// Write the points to this file as well: JSON if its name ends in .json, else CSV.
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,
}

/// The distribution of a tolerance of size s.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Distribution {
    /// Normal, of standard deviation s.
    Normal,
    /// Uniform, from -s to s.
    Uniform,
}

/// Whether points share their random numbers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Draws {
    /// All points have the seed.
    Common,
    /// Point i has the seed plus i.
    Own,
}

/// A number's name and its values.
#[derive(Debug, Clone, PartialEq)]
struct Values {
    name: String,
    values: Vec<f64>,
}

/// A number's name and the size of its tolerance.
#[derive(Debug, Clone, PartialEq)]
struct Tolerance {
    name: String,
    size: f64,
    /// True: the size is a fraction of the number.
    relative: bool,
}

fn name_and_rest(text: &str) -> std::result::Result<(String, &str), String> {
    let (name, rest) =
        text.rsplit_once('=').ok_or(format!("`{text}` has no `=`; write it as in L1.r1=50:60:11"))?;
    Ok((name.trim().into(), rest.trim()))
}

fn number(text: &str) -> std::result::Result<f64, String> {
    text.trim().parse().map_err(|_| format!("`{}` is no number", text.trim()))
}

/// A number's name and its value: L1.r1=50.5.
pub(crate) fn parse_number(text: &str) -> std::result::Result<(String, f64), String> {
    let (name, rest) = name_and_rest(text)?;
    Ok((name, number(rest)?))
}

fn parse_values(text: &str) -> std::result::Result<Values, String> {
    const MOST_VALUES: f64 = 1e6;
    let (name, rest) = name_and_rest(text)?;
    let values = match rest.split(':').collect::<Vec<_>>()[..] {
        [first, last, count] => {
            let (first, last, count) = (number(first)?, number(last)?, number(count)?);
            if !(1.0..=MOST_VALUES).contains(&count) || count.fract() != 0.0 {
                return Err(format!("`{rest}` has {count} values; give a whole number from 1 to 1e6"));
            }
            let step = |i: f64| if count == 1.0 { first } else { first + (last - first) * i / (count - 1.0) };
            (0..count as u32).map(|i| step(i.into())).collect()
        }
        [list] => list.split(',').map(number).collect::<std::result::Result<Vec<_>, _>>()?,
        _ => {
            return Err(format!(
                "`{rest}` is no list of values; write 50:60:11 (first, last, how many) or 50,55,60"
            ));
        }
    };
    Ok(Values { name, values })
}

fn parse_tolerance(text: &str) -> std::result::Result<Tolerance, String> {
    let (name, rest) = name_and_rest(text)?;
    let (digits, relative) = rest.strip_suffix('%').map_or((rest, false), |digits| (digits, true));
    let size = number(digits)? * if relative { 0.01 } else { 1.0 };
    if size.is_finite() && size > 0.0 {
        Ok(Tolerance { name, size, relative })
    } else {
        Err(format!("`{rest}` is no tolerance above 0; write 0.1% or 0.05"))
    }
}

/// What is set, and what was found.
struct Point {
    numbers: Vec<(String, f64)>,
    seed: u64,
    num_rays: u64,
    fluxes: Vec<Flux>,
}

/// A flux of a point.
struct Flux {
    /// That of a detector, or of a total.
    name: String,
    /// \[W\]
    flux: f64,
    /// Its standard error \[W\], where that is known.
    error: Option<f64>,
}

impl Point {
    fn of(numbers: Vec<(String, f64)>, result: &TraceResult) -> Self {
        let detectors = result.detectors.iter().map(|detector| Flux {
            name: detector.name.clone(),
            flux: detector.total_flux,
            error: detector.total_flux_standard_error,
        });
        let totals = [
            ("absorbed", result.total_flux_absorbed),
            ("bulk absorbed", result.total_flux_bulk_absorbed),
            ("escaped", result.total_flux_escaped),
            ("lost", result.total_flux_lost),
        ];
        // A detector may have the name of a total.
        let told = |name: &str| match result.detector(name) {
            Some(_) => format!("{name} (total)"),
            None => name.into(),
        };
        let totals = totals.map(|(name, flux)| Flux { name: told(name), flux, error: None });
        Point {
            numbers,
            seed: result.run.seed,
            num_rays: result.num_rays_total,
            fluxes: detectors.chain(totals).collect(),
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
    let text = std::fs::read_to_string(&args.scene).map_err(|error| Error::file(&args.scene, error))?;
    let folder = args.scene.parent().unwrap_or(Path::new("")).to_owned();
    let name = args.scene.display().to_string();
    let ir = Scene::with_numbers(&text, &folder, &[]).map_err(|error| named(error, &name))?.lower()?;
    let in_f64 = matches!(args.trace.precision, PrecisionArg::Auto | PrecisionArg::F64);
    choose_vectors(&ir, args.trace.num_rays, in_f64);
    let points = match args.tolerance.is_empty() {
        true => combinations(&args.set, args.zip)?,
        false => samples(&text, args)?,
    };
    let choice = AdapterChoice { name: args.adapter.clone(), native: Native::Allowed, ..Default::default() };
    let mut session = Session::new(choice);
    let (mut found, mut told, mut failure) = (Vec::new(), BTreeSet::new(), None);
    for (i, numbers) in (0..).zip(points) {
        let mut trace = args.trace.clone();
        if args.draws == Draws::Own {
            trace.seed = trace.seed.wrapping_add(i);
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
            adjoints: None,
            progress: false,
        };
        match session.trace(&request, |_| true) {
            Ok(result) => {
                let warnings = result.run.scene_warnings.iter().chain(&result.diagnostics.grave);
                warnings
                    .filter(|warning| told.insert((*warning).clone()))
                    .for_each(|text| say(&format!("warning: {text}")));
                failure = failure.or_else(|| missed_target(&result).map(Error::Tolerance));
                found.push(Point::of(numbers, &result));
            }
            // The points before it took their time, and are kept.
            Err(error) => {
                let set: Vec<String> =
                    numbers.iter().map(|(name, value)| format!("{name} = {value}")).collect();
                say(&format!("where {}:", set.join(", ")));
                if found.is_empty() {
                    return Err(error);
                }
                failure = Some(error);
                break;
            }
        }
    }
    let (nominal, found) = match args.tolerance.is_empty() {
        true => (None, found),
        false => {
            let mut found = found.into_iter();
            (found.next(), found.collect())
        }
    };
    let document = document(nominal.as_ref(), &found);
    if let Some(path) = &args.output {
        let is_json = path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("json"));
        let contents = if is_json { pretty(&document) } else { csv(&found) };
        std::fs::write(path, contents).map_err(|error| Error::file(path, error))?;
        say(&format!("written: {}", path.display()));
    }
    let printed = match (args.json, &nominal) {
        (true, _) => pretty(&document),
        (false, None) => table(&found),
        (false, Some(nominal)) => quantile_table(nominal, &found),
    };
    let Some(failure) = failure else { return Ok(printed) };
    crate::cli::console::print(&printed)?;
    Err(failure)
}

/// Every combination of the values, the last name's changing fastest; or the values of one place in each list.
fn combinations(set: &[Values], zip: bool) -> Result<Vec<Vec<(String, f64)>>> {
    if zip {
        let lengths: Vec<usize> = set.iter().map(|values| values.values.len()).collect();
        if lengths.iter().any(|length| *length != lengths[0]) {
            return Err(Error::Usage(format!(
                "--zip needs as many values for each name; there are {lengths:?}"
            )));
        }
        let point = |i: usize| set.iter().map(|one| (one.name.clone(), one.values[i])).collect();
        return Ok((0..lengths[0]).map(point).collect());
    }
    let mut points: Vec<Vec<(String, f64)>> = vec![Vec::new()];
    for Values { name, values } in set {
        let with = |point: &Vec<(String, f64)>, value: &f64| [&point[..], &[(name.clone(), *value)]].concat();
        points = points.iter().flat_map(|point| values.iter().map(move |value| with(point, value))).collect();
    }
    Ok(points)
}

/// The scene as it is, then its samples.
fn samples(text: &str, args: &Args) -> Result<Vec<Vec<(String, f64)>>> {
    let names: Vec<String> = args.tolerance.iter().map(|tolerance| tolerance.name.clone()).collect();
    let nominal = Scene::numbers(text, &names)?;
    let mut draws = Draw(args.trace.seed);
    let mut sample = || {
        let numbers = args.tolerance.iter().zip(&nominal).map(|(tolerance, nominal)| {
            let size = tolerance.size * if tolerance.relative { nominal.abs() } else { 1.0 };
            let unit = match args.distribution {
                Distribution::Uniform => 2.0 * draws.uniform() - 1.0,
                Distribution::Normal => draws.normal(),
            };
            (tolerance.name.clone(), nominal + size * unit)
        });
        numbers.collect::<Vec<_>>()
    };
    let samples: Vec<_> = (0..args.samples).map(|_| sample()).collect();
    Ok(std::iter::once(names.into_iter().zip(nominal).collect()).chain(samples).collect())
}

/// Random numbers for tolerances: SplitMix64 (Steele, Lea, Flood: Fast splittable pseudorandom number generators, 2014).
struct Draw(u64);

impl Draw {
    fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let bits = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        let bits = (bits ^ (bits >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        bits ^ (bits >> 31)
    }

    /// In (0, 1).
    fn uniform(&mut self) -> f64 {
        ((self.bits() >> 11) as f64 + 0.5) / (1_u64 << 53) as f64
    }

    /// Of mean 0 and variance 1 (Box and Muller).
    fn normal(&mut self) -> f64 {
        let radius = (-2.0 * self.uniform().ln()).sqrt();
        radius * (std::f64::consts::TAU * self.uniform()).cos()
    }
}

fn pretty(document: &Value) -> String {
    serde_json::to_string_pretty(document).unwrap_or_default() + "\n"
}

fn entry(point: &Point) -> Value {
    let numbers: Map<String, Value> =
        point.numbers.iter().map(|(name, value)| (name.clone(), json!(value))).collect();
    let flux = |flux: &Flux| (flux.name.clone(), json!({"flux": flux.flux, "standard_error": flux.error}));
    let fluxes: Map<String, Value> = point.fluxes.iter().map(flux).collect();
    json!({"set": numbers, "seed": point.seed, "num_rays": point.num_rays, "fluxes": fluxes})
}

/// All points; of tolerances also the scene as it is, and quantiles of each flux. Fluxes are in W.
fn document(nominal: Option<&Point>, points: &[Point]) -> Value {
    let mut document = json!({"points": points.iter().map(entry).collect::<Vec<_>>()});
    if let Some(nominal) = nominal {
        document["nominal"] = entry(nominal);
        let of_each = quantiles(nominal, points).into_iter().map(|row| {
            let [least, low, middle, high, most] = row.quantiles;
            (row.name, json!({"minimum": least, "5%": low, "50%": middle, "95%": high, "maximum": most}))
        });
        document["quantiles"] = Value::Object(of_each.collect());
    }
    document
}

/// A column of the points: a number, a flux, or a flux's standard error where some point has one.
struct Column {
    kind: ColumnKind,
    name: String,
    values: Vec<Option<f64>>,
}

#[derive(Clone, Copy, PartialEq)]
enum ColumnKind {
    Number,
    Flux,
    Error,
}

fn columns(points: &[Point]) -> Vec<Column> {
    let Some(first) = points.first() else { return Vec::new() };
    let column = |kind, name: &str, value: &dyn Fn(&Point) -> Option<f64>| Column {
        kind,
        name: name.into(),
        values: points.iter().map(value).collect(),
    };
    let numbers = (0..).zip(&first.numbers);
    let mut columns: Vec<Column> = numbers
        .map(|(i, (name, _)): (usize, _)| column(ColumnKind::Number, name, &|point| Some(point.numbers[i].1)))
        .collect();
    for (i, Flux { name, .. }) in first.fluxes.iter().enumerate() {
        columns.push(column(ColumnKind::Flux, name, &|point| Some(point.fluxes[i].flux)));
        let errors = column(ColumnKind::Error, name, &|point| point.fluxes[i].error);
        columns.extend(errors.values.iter().any(Option::is_some).then_some(errors));
    }
    columns
}

/// A line of a title each, then a line a point. An error that is not known is an empty cell.
fn csv(points: &[Point]) -> String {
    let columns = columns(points);
    let title = |Column { kind, name, .. }: &Column| match kind {
        ColumnKind::Number => name.clone(),
        ColumnKind::Flux => format!("{name} [W]"),
        ColumnKind::Error => format!("{name} standard error [W]"),
    };
    let quoted = |text: String| {
        let needs = text.contains([',', '"', '\n']);
        if needs { format!("\"{}\"", text.replace('"', "\"\"")) } else { text }
    };
    let line = |cells: Vec<String>| cells.join(",") + "\n";
    let mut text = line(columns.iter().map(|column| quoted(title(column))).collect());
    for i in 0..points.len() {
        let cell = |column: &Column| column.values[i].map_or(String::new(), |value| format!("{value:?}"));
        text += &line(columns.iter().map(cell).collect());
    }
    text
}

fn table(points: &[Point]) -> String {
    let columns = columns(points);
    let title = |Column { kind, name, .. }: &Column| match kind {
        ColumnKind::Number => format!("{name:>14}"),
        ColumnKind::Flux => format!("{:>18}", format!("{name} [W]")),
        ColumnKind::Error => format!("{:>12}", "error"),
    };
    let mut text = columns.iter().map(title).collect::<String>() + "\n";
    for i in 0..points.len() {
        let cell = |column: &Column| match (column.kind, column.values[i]) {
            (ColumnKind::Number, Some(value)) => format!("{value:>14.7}"),
            (ColumnKind::Flux, Some(value)) => format!("{value:>18.7}"),
            (ColumnKind::Error, Some(value)) => format!("{:>12}", format!("{value:.1e}")),
            (_, None) => format!("{:>12}", "-"),
        };
        text += &(columns.iter().map(cell).collect::<String>() + "\n");
    }
    text
}

/// A flux over the samples of tolerances.
struct Quantiles {
    name: String,
    nominal: f64,
    /// The least, those of 5, 50 and 95 %, and the most \[W\].
    quantiles: [f64; 5],
}

fn quantiles(nominal: &Point, points: &[Point]) -> Vec<Quantiles> {
    let rows = nominal.fluxes.iter().enumerate().map(|(i, Flux { name, flux, .. })| {
        let mut values: Vec<f64> = points.iter().map(|point| point.fluxes[i].flux).collect();
        values.sort_by(f64::total_cmp);
        // Between two samples the quantile is interpolated (Hyndman and Fan 1996, definition 7).
        let quantile = |share: f64| {
            let place = share * (values.len().saturating_sub(1)) as f64;
            let (low, high) = (place.floor() as usize, place.ceil() as usize);
            match (values.get(low), values.get(high)) {
                (Some(a), Some(b)) => a + (b - a) * place.fract(),
                _ => *flux,
            }
        };
        Quantiles { name: name.clone(), nominal: *flux, quantiles: [0.0, 0.05, 0.5, 0.95, 1.0].map(quantile) }
    });
    rows.collect()
}

fn quantile_table(nominal: &Point, points: &[Point]) -> String {
    let mut text = format!(
        "{} samples\n{:<18}{:>14}{:>14}{:>14}{:>14}{:>14}{:>14}\n",
        points.len(),
        "flux [W]",
        "as it is",
        "minimum",
        "5 %",
        "50 %",
        "95 %",
        "maximum"
    );
    for row in quantiles(nominal, points) {
        let _ = write!(text, "{:<18}{:>14.7}", row.name, row.nominal);
        row.quantiles.iter().for_each(|value| {
            let _ = write!(text, "{value:>14.7}");
        });
        text.push('\n');
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_are_read_as_people_write_them() {
        let values = |text| parse_values(text).map(|values| values.values);
        assert_eq!(values("L1.r1=50:60:3"), Ok(vec![50.0, 55.0, 60.0]));
        assert_eq!(values("L1.r1=1,-2e1"), Ok(vec![1.0, -20.0]));
        assert_eq!(values("L1.r1=7:9:1"), Ok(vec![7.0]));
        assert_eq!(parse_values("\"a=b\".r1=3").map(|values| values.name), Ok("\"a=b\".r1".into()));
        for wrong in
            ["L1.r1", "L1.r1=", "L1.r1=1:2", "L1.r1=1:2:0", "L1.r1=1:2:1.5", "L1.r1=a,b", "L1.r1=1:2:1e9"]
        {
            assert!(parse_values(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn tolerances_are_absolute_or_in_percent() {
        let tolerance = |text| parse_tolerance(text).map(|t| (t.size, t.relative));
        assert_eq!(tolerance("L1.r1=0.5%"), Ok((0.005, true)));
        assert_eq!(tolerance("L1.r1=0.5"), Ok((0.5, false)));
        for wrong in ["L1.r1=0", "L1.r1=-1%", "L1.r1=x", "L1.r1"] {
            assert!(parse_tolerance(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn points_are_all_combinations_or_pairs() {
        let set = [("a", vec![1.0, 2.0]), ("b", vec![3.0, 4.0])]
            .map(|(name, values)| Values { name: name.into(), values });
        let numbers = |points: Vec<Vec<(String, f64)>>| -> Vec<Vec<f64>> {
            points.into_iter().map(|point| point.into_iter().map(|(_, value)| value).collect()).collect()
        };
        let all = numbers(combinations(&set, false).unwrap());
        assert_eq!(all, [[1.0, 3.0], [1.0, 4.0], [2.0, 3.0], [2.0, 4.0]]);
        assert_eq!(numbers(combinations(&set, true).unwrap()), [[1.0, 3.0], [2.0, 4.0]]);
        let other = [set[0].clone(), Values { name: "b".into(), values: vec![1.0] }];
        assert!(combinations(&other, true).is_err());
    }

    #[test]
    fn normal_draws_have_mean_0_and_variance_1() {
        let mut draws = Draw(7);
        let values: Vec<f64> = (0..20_000).map(|_| draws.normal()).collect();
        let mean = values.iter().sum::<f64>() / values.len() as f64;
        let variance = values.iter().map(|value| value * value).sum::<f64>() / values.len() as f64;
        // Four and a half standard errors.
        assert!(
            mean.abs() < 4.5 / 20_000_f64.sqrt() && (variance - 1.0).abs() < 4.5 * (2.0 / 20_000_f64).sqrt()
        );
    }
}
