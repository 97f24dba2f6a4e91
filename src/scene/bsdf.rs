//! Scatter models and coatings of the file -> those of the tracer: tables read and proven, contradictions refused.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use crate::model::{self, BsdfTable, HARVEY_SHACK_STEP, harvey_shack_table};
use crate::scene::files;
use crate::scene::json::{Bsdf, Coating};
use crate::scene::place::{key_of, quoted};
use crate::{Error, Result};

/// Largest file of a table \[bytes\].
const MAX_FILE_BYTES: u64 = 64 << 20;
/// Most values of a table.
const MAX_VALUES: usize = 1 << 20;
/// Largest value of a table \[1/sr\].
const MAX_VALUE: f64 = 1e12;

/// What a scatter model in a file needs beside itself.
pub(super) struct Reading<'a> {
    /// Folder that paths start from.
    pub folder: &'a Path,
    /// Where to say what the user should know.
    pub warnings: &'a mut Vec<String>,
}

/// The scattering of the surface `name`, whose model stands at `place`.
pub(super) fn scatter(
    name: &str,
    place: &str,
    bsdf: &Bsdf,
    fraction: f64,
    reading: &mut Reading<'_>,
) -> Result<model::Scatter> {
    Ok(model::Scatter { fraction, bsdf: lowered(name, place, bsdf, reading)? })
}

fn lowered(name: &str, place: &str, bsdf: &Bsdf, reading: &mut Reading<'_>) -> Result<model::Bsdf> {
    Ok(match bsdf {
        Bsdf::Specular {} => model::Bsdf::Specular,
        &Bsdf::Lambertian { reflectance_value, transmissive_fraction } => {
            model::Bsdf::Lambertian { reflectance_value, transmissive_fraction }
        }
        &Bsdf::HarveyShack { b0, l0, s, transmissive_fraction } => {
            check_lobe(name, place, [b0, l0, s], reading.warnings)?;
            model::Bsdf::HarveyShack { b0, l0, s, transmissive_fraction }
        }
        Bsdf::Tabulated { path, theta_i, theta_s, bsdf, transmissive_fraction } => {
            let table = match (path, theta_i, theta_s, bsdf) {
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
            reading.warnings.extend(warnings(name, &table));
            model::Bsdf::Tabulated { table, transmissive_fraction: *transmissive_fraction }
        }
    })
}

/// A lobe that Optiland's table cannot resolve becomes wider than it is; one that falls through it has no shape at all. One
/// about the normal that reaches beyond the unit disk of direction cosines has no direction there, and what is drawn is lost.
fn check_lobe(name: &str, place: &str, [b0, l0, s]: [f64; 3], warnings: &mut Vec<String>) -> Result<()> {
    const NOTICED: f64 = 0.01;
    let (cumulative, total) = harvey_shack_table(b0, l0, s);
    if !(total.is_finite() && total > 0.0) {
        let remedy = if b0 == 0.0 { "give b0 > 0, or remove the bsdf" } else { "give a larger l0" };
        return Err(Error::scene(place, "the lobe scatters nothing", remedy));
    }
    if l0 < 2.0 * HARVEY_SHACK_STEP {
        warnings.push(format!(
            "the lobe of {} is too narrow (l0 = {l0}) for the steps of {HARVEY_SHACK_STEP:.1e} in which it is tabulated: it \
             is traced wider",
            quoted(name)
        ));
    }
    let lost = 1.0 - cumulative[(1.0 / HARVEY_SHACK_STEP).round() as usize];
    if lost > NOTICED {
        warnings.push(format!(
            "the lobe of {} is so wide that {:.1} % of what it scatters at normal incidence has no direction and is lost, more \
             at a slant, as in Optiland; a smaller l0 or a larger s narrows it",
            quoted(name),
            100.0 * lost
        ));
    }
    Ok(())
}

/// Coatings of refractive surfaces at the wavelengths of the scene \[um\].
pub(super) fn coating(place: &str, coating: &Coating, wavelengths: &[f64]) -> Result<model::Coating> {
    /// R + T may exceed 1 by the rounding of decimal fractions.
    const ROUNDING: f64 = 1e-12;
    let Coating::Simple { reflectance, transmittance } = coating;
    let reflectance = reflectance.at(wavelengths, &key_of(place, "reflectance"))?;
    let transmittance = transmittance.at(wavelengths, &key_of(place, "transmittance"))?;
    let excess = reflectance.iter().zip(&transmittance).position(|(r, t)| r + t > 1.0 + ROUNDING);
    if let Some(i) = excess {
        let (r, t) = (reflectance[i], transmittance[i]);
        return Err(Error::scene(
            key_of(place, "transmittance"),
            format!(
                "the coating gives more light than it gets: R = {r} and T = {t} at {} um",
                wavelengths[i]
            ),
            "give R + T <= 1; what is left of 1 is absorbed",
        ));
    }
    Ok(model::Coating { reflectance, transmittance })
}

// Tables

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
    let text = String::from_utf8(files::read(path, MAX_FILE_BYTES)?)
        .map_err(|_| std::io::Error::other("it is not UTF-8 text; save it as UTF-8"))?;
    Ok(text.trim_start_matches(files::MARK).to_owned())
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

/// An angle from 0 to 90 degrees by its bits, whose order is that of the numbers.
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
