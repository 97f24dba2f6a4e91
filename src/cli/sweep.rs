//! `nsq-gpu sweep`: traces a scene again and again, with some of its numbers changed. A compiled shader serves all
//! points.

use crate::cli::console::{choose_vectors, say};
use crate::cli::serve::requests::TraceRequest;
use crate::cli::serve::session::{Session, missed_target};
use crate::cli::trace_args::{PrecisionArg, TraceArgs};
use crate::error::{Error, Result};
use crate::gpu::{AdapterChoice, Native};
use crate::result::Report;
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
    report: Report,
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
    let ir = crate::cli::console::read_scene(&args.scene)?.lower()?;
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
            name: Some(args.scene.display().to_string()),
            folder: folder.clone(),
            set: numbers.clone(),
            args: trace,
            record_paths: RecordPaths::None,
            live: None,
            progress: false,
        };
        match session.trace(&request, |_| true) {
            Ok(answer) => {
                let warnings = answer.report.scene_warnings.iter().chain(&answer.report.diagnostics.grave);
                warnings
                    .filter(|warning| told.insert((*warning).clone()))
                    .for_each(|text| say(&format!("warning: {text}")));
                failure = failure.or_else(|| missed_target(&answer.report).map(Error::Tolerance));
                found.push(Point { numbers, report: answer.report });
            }
            // The points before it took their time, and are kept.
            Err(error) => {
                let set: Vec<String> =
                    numbers.iter().map(|(name, value)| format!("{name} = {value}")).collect();
                say(&format!("where {}:", set.join(", ")));
                failure = Some(error);
                break;
            }
        }
    }
    if let (Some(_), true) = (&failure, found.is_empty()) {
        return Err(failure.unwrap_or(Error::Interrupted));
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

/// The fluxes of a point: a name, the flux \[W\], and its standard error where that is known.
fn fluxes(report: &Report) -> Vec<(String, f64, Option<f64>)> {
    let of = |entry: &Value, key: &str| entry[key].as_f64();
    let detectors = report.detectors.iter().map(|(name, entry)| {
        (name.clone(), of(entry, "total_flux").unwrap_or_default(), of(entry, "total_flux_standard_error"))
    });
    let totals = [
        ("absorbed", report.total_flux_absorbed),
        ("bulk absorbed", report.total_flux_bulk_absorbed),
        ("escaped", report.total_flux_escaped),
        ("lost", report.total_flux_lost),
    ];
    // A detector may have the name of a total.
    let told = |name: &str| match report.detectors.contains_key(name) {
        true => format!("{name} (total)"),
        false => name.into(),
    };
    detectors.chain(totals.map(|(name, flux)| (told(name), flux, None))).collect()
}

/// The places of the fluxes of which some point has a standard error.
fn with_errors(points: &[Point]) -> BTreeSet<usize> {
    let of_point = |point: &Point| fluxes(&point.report).into_iter().enumerate().collect::<Vec<_>>();
    let all = points.iter().flat_map(of_point);
    all.filter(|(_, (_, _, error))| error.is_some()).map(|(place, _)| place).collect()
}

fn pretty(document: &Value) -> String {
    serde_json::to_string_pretty(document).unwrap_or_default() + "\n"
}

fn entry(point: &Point) -> Value {
    let numbers: Map<String, Value> =
        point.numbers.iter().map(|(name, value)| (name.clone(), json!(value))).collect();
    let fluxes: Map<String, Value> = fluxes(&point.report)
        .into_iter()
        .map(|(name, flux, error)| (name, json!({"flux": flux, "standard_error": error})))
        .collect();
    json!({"set": numbers, "seed": point.report.seed, "num_rays": point.report.num_rays_total, "fluxes": fluxes})
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

fn csv(points: &[Point]) -> String {
    let Some(first) = points.first() else { return String::new() };
    let quoted = |text: &str| {
        let needs = text.contains([',', '"', '\n']);
        if needs { format!("\"{}\"", text.replace('"', "\"\"")) } else { text.into() }
    };
    let mut columns: Vec<String> = first.numbers.iter().map(|(name, _)| quoted(name)).collect();
    let with_errors = with_errors(points);
    for (i, (name, _, _)) in fluxes(&first.report).into_iter().enumerate() {
        columns.push(quoted(&format!("{name} [W]")));
        columns.extend(with_errors.contains(&i).then(|| quoted(&format!("{name} standard error [W]"))));
    }
    let mut text = columns.join(",") + "\n";
    for point in points {
        let mut cells: Vec<String> = point.numbers.iter().map(|(_, value)| format!("{value:?}")).collect();
        for (i, (_, flux, error)) in fluxes(&point.report).into_iter().enumerate() {
            cells.push(format!("{flux:?}"));
            // An error that is not known is an empty cell.
            cells.extend(
                with_errors.contains(&i).then(|| error.map_or(String::new(), |error| format!("{error:?}"))),
            );
        }
        text += &(cells.join(",") + "\n");
    }
    text
}

fn table(points: &[Point]) -> String {
    let Some(first) = points.first() else { return String::new() };
    let mut text = String::new();
    first.numbers.iter().for_each(|(name, _)| {
        let _ = write!(text, "{name:>14}");
    });
    let with_errors = with_errors(points);
    for (i, (name, _, _)) in fluxes(&first.report).into_iter().enumerate() {
        let _ = write!(text, "{:>16}", format!("{name} [W]"));
        if with_errors.contains(&i) {
            let _ = write!(text, "{:>12}", "error");
        }
    }
    text.push('\n');
    for point in points {
        point.numbers.iter().for_each(|(_, value)| {
            let _ = write!(text, "{value:>14.7}");
        });
        for (i, (_, flux, error)) in fluxes(&point.report).into_iter().enumerate() {
            let _ = write!(text, "{flux:>16.7}");
            if with_errors.contains(&i) {
                let error = error.map_or("-".into(), |error| format!("{error:.1e}"));
                let _ = write!(text, "{error:>12}");
            }
        }
        text.push('\n');
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
    let rows = fluxes(&nominal.report).into_iter().enumerate().map(|(i, (name, flux, _))| {
        let mut values: Vec<f64> = points.iter().map(|point| fluxes(&point.report)[i].1).collect();
        values.sort_by(f64::total_cmp);
        // Between two samples the quantile is interpolated (Hyndman and Fan 1996, definition 7).
        let quantile = |share: f64| {
            let place = share * (values.len().saturating_sub(1)) as f64;
            let (low, high) = (place.floor() as usize, place.ceil() as usize);
            match (values.get(low), values.get(high)) {
                (Some(a), Some(b)) => a + (b - a) * place.fract(),
                _ => flux,
            }
        };
        Quantiles { name, nominal: flux, quantiles: [0.0, 0.05, 0.5, 0.95, 1.0].map(quantile) }
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
