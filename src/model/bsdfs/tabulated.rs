//! Measured scattering: values over the angles of incidence and of scatter.

use crate::model::bsdfs::{Bsdf, BsdfContext, BsdfKind, BsdfWgsl, Labelled, Scattering, WrittenBsdf};
use crate::model::key_path::{key_of, quoted};
use crate::model::{checks, whole_files};
use crate::shaders::shader;
use crate::{Error, Result};
use schemars::JsonSchema;
use serde::Deserialize;
use std::collections::{BTreeMap, BTreeSet};
use std::f64::consts::PI;
use std::path::Path;

/// The table.
pub const TABULATED: BsdfWgsl = BsdfWgsl {
    name: "tabulated",
    file: shader!("bsdfs/tabulated.wgsl"),
    shared: None,
    has_table: true,
    toward: &[shader!("scatter_to/tabulated.wgsl")],
};

/// Largest file of a table \[bytes\].
const MAX_FILE_BYTES: u64 = 64 << 20;
/// Most values of a table.
const MAX_VALUES: usize = 1 << 20;
/// Largest value of a table \[1/sr\].
const MAX_VALUE: f64 = 1e12;

/// Values over polar angles of incidence and scatter, 0 beyond them.
#[derive(Debug, Clone, PartialEq)]
pub struct Tabulated {
    /// The values.
    pub table: BsdfTable,
    /// The probability that a scattered ray leaves on the far side.
    pub transmissive_fraction: f64,
}

/// Values of a BSDF over two angles from the normal, the same for every azimuth.
#[derive(Debug, Clone, PartialEq)]
pub struct BsdfTable {
    /// Angles of incidence, ascending, at least two \[deg\].
    pub theta_i: Vec<f64>,
    /// Angles of scatter, ascending, at least two \[deg\].
    pub theta_s: Vec<f64>,
    /// One row of values per angle of incidence \[1/sr\].
    pub values: Vec<f64>,
}

impl BsdfTable {
    /// The fraction of the flux that is scattered at an angle of incidence: the integral of value cos(theta_s) over
    /// the hemisphere. The value is linear in theta_s between its angles, and 0 beyond them.
    pub fn albedo(&self, row: usize) -> f64 {
        let count = self.theta_s.len();
        let values = &self.values[row * count..(row + 1) * count];
        let intervals = self.theta_s.windows(2).zip(values.windows(2));
        intervals.map(|(theta, value)| scattered_between([theta[0], theta[1]], [value[0], value[1]])).sum()
    }
}

/// The integral of pi f sin(2 theta) d(theta) over an interval where f is linear in theta: by parts, exactly.
fn scattered_between(theta: [f64; 2], value: [f64; 2]) -> f64 {
    let [a, b] = theta.map(f64::to_radians);
    let slope = (value[1] - value[0]) / (b - a);
    let boundary = value[0] * (2.0 * a).cos() - value[1] * (2.0 * b).cos();
    let interior = slope * ((2.0 * b).sin() - (2.0 * a).sin()) / 2.0;
    PI / 2.0 * (boundary + interior)
}

/// A table in a scene file: from a file of three columns, or inline.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Written {
    /// CSV file of theta_i \[deg\], theta_s \[deg\], bsdf \[1/sr\], relative to the scene file.
    #[serde(default)]
    pub path: Option<String>,
    /// Angles of incidence \[deg\].
    #[serde(default)]
    pub theta_i: Option<Vec<f64>>,
    /// Angles of scatter \[deg\].
    #[serde(default)]
    pub theta_s: Option<Vec<f64>>,
    /// One row per angle of incidence \[1/sr\].
    #[serde(default)]
    pub bsdf: Option<Vec<Vec<f64>>>,
    /// Fraction of the scattered rays that are transmitted.
    #[serde(default)]
    pub transmissive_fraction: f64,
}

impl WrittenBsdf for Written {
    /// The table is checked where it is read.
    fn check(&self, at: &dyn Fn(&str) -> String) -> Result<()> {
        checks::fraction(at("transmissive_fraction"), self.transmissive_fraction)
    }

    fn bsdf(&self, surface: &Labelled<'_>, reading: &mut BsdfContext<'_>) -> Result<Bsdf> {
        let place = surface.place;
        let table = match (&self.path, &self.theta_i, &self.theta_s, &self.bsdf) {
            (Some(path), None, None, None) => from_file(&key_of(place, "path"), path, reading.folder)?,
            (None, Some(theta_i), Some(theta_s), Some(rows)) => inline(place, theta_i, theta_s, rows)?,
            _ => {
                return Err(Error::scene(
                    place,
                    "a table needs either `path` or all of `theta_i`, `theta_s` and `bsdf`",
                    "name a file, or write the table here",
                ));
            }
        };
        reading.warnings.extend(warnings(surface.name, &table));
        Ok(Bsdf::Tabulated(Tabulated { table, transmissive_fraction: self.transmissive_fraction }))
    }
}

impl Scattering for Tabulated {
    fn kind(&self) -> BsdfKind {
        BsdfKind::Tabulated
    }

    fn transmissive_fraction(&self) -> f64 {
        self.transmissive_fraction
    }

    fn counts(&self) -> Vec<(&'static str, u32)> {
        let BsdfTable { theta_i, theta_s, .. } = &self.table;
        vec![("num_theta_i", theta_i.len() as u32), ("num_theta_s", theta_s.len() as u32)]
    }

    /// See shaders/bsdfs/tabulated.wgsl.
    fn table(&self) -> Vec<f64> {
        let BsdfTable { theta_i, theta_s, values } = &self.table;
        let weights = values.iter().map(|value| PI * value);
        theta_i.iter().chain(theta_s).copied().chain(weights).collect()
    }

    fn is_about_normal(&self) -> bool {
        true
    }

    fn keeps_level(&self) -> bool {
        true
    }

    fn by_tis(&self) -> Option<(f64, Bsdf)> {
        let tis = if self.table.theta_i[0] == 0.0 { self.table.albedo(0) } else { 0.0 };
        let values = self.table.values.iter().map(|value| value / tis).collect();
        let table = BsdfTable { values, ..self.table.clone() };
        Some((tis, Bsdf::Tabulated(Tabulated { table, ..self.clone() })))
    }

    /// Beyond its angles a table is 0.
    fn takes_whole_weights(&self) -> bool {
        true
    }
}

// Reading

fn inline(place: &str, theta_i: &[f64], theta_s: &[f64], rows: &[Vec<f64>]) -> Result<BsdfTable> {
    let at = |key: &str| key_of(place, key);
    check_angles(&at("theta_i"), theta_i)?;
    check_angles(&at("theta_s"), theta_s)?;
    if rows.len() != theta_i.len() {
        let problem = format!("{} rows for {} angles of incidence", rows.len(), theta_i.len());
        return Err(Error::scene(at("bsdf"), problem, "give one row per angle of incidence"));
    }
    for (i, row) in rows.iter().enumerate() {
        let place = format!("{place}.bsdf[{i}]");
        if row.len() != theta_s.len() {
            let problem = format!("{} values for {} angles of scatter", row.len(), theta_s.len());
            return Err(Error::scene(place, problem, "give one value per angle of scatter"));
        }
        row.iter().enumerate().try_for_each(|(j, value)| check_value(&format!("{place}[{j}]"), *value))?;
    }
    check_size(place, theta_i.len(), theta_s.len())?;
    Ok(BsdfTable { theta_i: theta_i.to_vec(), theta_s: theta_s.to_vec(), values: rows.concat() })
}

fn check_size(place: &str, num_i: usize, num_s: usize) -> Result<()> {
    if num_i.saturating_mul(num_s) <= MAX_VALUES {
        return Ok(());
    }
    Err(Error::scene(
        place,
        format!("the table has {num_i} x {num_s} values"),
        format!("give at most {MAX_VALUES}"),
    ))
}

fn check_angles(place: &str, angles: &[f64]) -> Result<()> {
    if angles.len() < 2 {
        return Err(Error::scene(
            place,
            format!("{} angles are too few to interpolate between", angles.len()),
            "give at least two, such as 0 and 90",
        ));
    }
    for (i, angle) in angles.iter().enumerate() {
        check_angle(&format!("{place}[{i}]"), *angle)?;
        if i > 0 && *angle <= angles[i - 1] {
            return Err(Error::scene(
                format!("{place}[{i}]"),
                format!("{angle} does not exceed the angle before it"),
                "give the angles in ascending order, each once",
            ));
        }
    }
    Ok(())
}

fn check_angle(place: &str, angle: f64) -> Result<()> {
    if (0.0..=90.0).contains(&angle) {
        return Ok(());
    }
    Err(Error::scene(
        place,
        format!("the angle {angle} is out of range"),
        "angles are measured from the normal in degrees, from 0 to 90",
    ))
}

fn check_value(place: &str, value: f64) -> Result<()> {
    if (0.0..=MAX_VALUE).contains(&value) {
        return Ok(());
    }
    Err(Error::scene(
        place,
        format!("a BSDF of {value} is out of range"),
        format!("give a number from 0 to {MAX_VALUE:e} [1/sr]"),
    ))
}

fn from_file(place: &str, path: &str, folder: &Path) -> Result<BsdfTable> {
    let path = folder.join(path);
    let text = text_of(&path).map_err(|err| {
        Error::scene(
            place,
            format!("{}: {err}", quoted(&path.display().to_string())),
            "give the path of a CSV file, relative to the scene file",
        )
    })?;
    parse(place, &text)
}

/// Spreadsheets begin what they call UTF-8 with a byte order mark.
fn text_of(path: &Path) -> std::io::Result<String> {
    let text = String::from_utf8(whole_files::read(path, MAX_FILE_BYTES)?)
        .map_err(|_| std::io::Error::other("it is not UTF-8 text; save it as UTF-8"))?;
    Ok(text.trim_start_matches(whole_files::MARK).to_owned())
}

/// Lines `theta_i, theta_s, bsdf` in any order, with `#` before comments: every pair of two angles once.
fn parse(place: &str, text: &str) -> Result<BsdfTable> {
    let mut values: BTreeMap<(Angle, Angle), f64> = BTreeMap::new();
    for (number, line) in (1..).zip(text.lines()) {
        let data = line.split('#').next().unwrap_or("").trim();
        if data.is_empty() {
            continue;
        }
        let at = format!("{place}, line {number}");
        let [theta_i, theta_s, value] = numbers(&at, data)?;
        check_angle(&at, theta_i)?;
        check_angle(&at, theta_s)?;
        check_value(&at, value)?;
        if values.insert((Angle::of(theta_i), Angle::of(theta_s)), value).is_some() {
            let problem = format!("the angles {theta_i} and {theta_s} occur twice");
            return Err(Error::scene(at, problem, "give each pair of angles once"));
        }
        check_size(place, 1, values.len())?;
    }
    gridded(place, &values)
}

/// An angle from 0 to 90 degrees by its bits, which are ordered as the angles are.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
struct Angle(u64);

impl Angle {
    fn of(degrees: f64) -> Self {
        // Not -0, which would come last.
        Angle((degrees + 0.0).to_bits())
    }

    fn degrees(self) -> f64 {
        f64::from_bits(self.0)
    }
}

fn numbers(place: &str, line: &str) -> Result<[f64; 3]> {
    let words: Vec<&str> = line.split(',').map(str::trim).collect();
    let numbers: Vec<f64> = words.iter().filter_map(|word| word.parse().ok()).collect();
    match (words.len(), numbers.as_slice()) {
        (3, [theta_i, theta_s, value]) => Ok([*theta_i, *theta_s, *value]),
        _ => Err(Error::scene(
            place,
            format!("{} is no row of the table", quoted(line)),
            "write theta_i [deg], theta_s [deg], bsdf [1/sr], separated by commas; # starts a comment",
        )),
    }
}

fn gridded(place: &str, values: &BTreeMap<(Angle, Angle), f64>) -> Result<BsdfTable> {
    let theta_i: BTreeSet<Angle> = values.keys().map(|(i, _)| *i).collect();
    let theta_s: BTreeSet<Angle> = values.keys().map(|(_, s)| *s).collect();
    if values.len() != theta_i.len() * theta_s.len() {
        return Err(Error::scene(
            place,
            format!("{} rows for {} x {} angles", values.len(), theta_i.len(), theta_s.len()),
            "give a value for every pair of an angle of incidence and an angle of scatter",
        ));
    }
    let degrees =
        |angles: &BTreeSet<Angle>| -> Vec<f64> { angles.iter().map(|angle| angle.degrees()).collect() };
    let table = BsdfTable {
        theta_i: degrees(&theta_i),
        theta_s: degrees(&theta_s),
        values: values.values().copied().collect(),
    };
    check_angles(place, &table.theta_i)?;
    check_angles(place, &table.theta_s)?;
    Ok(table)
}

/// What the user should know of a table: angles at which it is dark, and rows that give more light than they get.
fn warnings(name: &str, table: &BsdfTable) -> Vec<String> {
    /// Measured tables exceed 1 by their own errors.
    const TOLERANCE: f64 = 1e-3;
    let name = quoted(name);
    let mut warnings = Vec::new();
    for (what, angles) in [("incidence", &table.theta_i), ("scatter", &table.theta_s)] {
        let (first, last) = (angles[0], angles[angles.len() - 1]);
        if first > 0.0 || last < 90.0 {
            warnings.push(format!(
                "the BSDF of {name} covers angles of {what} from {first} to {last} degrees; beyond them it is 0"
            ));
        }
    }
    let brightest = (0..table.theta_i.len())
        .map(|i| (table.albedo(i), table.theta_i[i]))
        .max_by(|a, b| a.0.total_cmp(&b.0));
    if let Some((albedo, theta_i)) = brightest.filter(|(albedo, _)| *albedo > 1.0 + TOLERANCE) {
        warnings.push(format!(
            "the BSDF of {name} scatters {albedo:.4} times what it gets at an incidence of {theta_i} degrees"
        ));
    }
    warnings
}
