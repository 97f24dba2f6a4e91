//! Tables of CSV files: a header that names the columns, and a line for each combination of the angles.

use crate::model::bsdfs::measured::grid::{Grid, ScatterType};
use crate::model::key_path::quoted;
use crate::{Error, Result};
use std::collections::{BTreeMap, BTreeSet};

/// The columns, in any order.
const COLUMNS: [&str; 4] = ["angle_of_incidence_deg", "scatter_azimuth_deg", "scatter_radial_deg", "bsdf"];

/// A number by its bits, which are ordered as numbers from 0 on are.
type Ordered = u64;

/// Reads the text of a file; `place` is where the scene names it.
pub(super) fn parse(place: &str, text: &str) -> Result<Grid> {
    let mut scatter_type = ScatterType::Reflected;
    let mut columns: Option<[usize; 4]> = None;
    let mut values: BTreeMap<[Ordered; 3], f64> = BTreeMap::new();
    for (number, line) in (1..).zip(text.lines()) {
        let at = format!("{place}, line {number}");
        let (data, comment) = line.split_once('#').unwrap_or((line, ""));
        if let Some(stated) = comment.trim().strip_prefix("scatter_type:") {
            scatter_type = type_of(&at, stated.trim())?;
        }
        let words: Vec<&str> = data.split(',').map(str::trim).collect();
        match columns {
            _ if data.trim().is_empty() => {}
            None => columns = Some(columns_of(&at, &words)?),
            Some(columns) => {
                let [incidence, azimuth, radial, value] = numbers(&at, &words, columns)?;
                // Not -0, which would come last.
                let angles = [incidence, azimuth, radial].map(|angle| (angle + 0.0).to_bits());
                if values.insert(angles, value).is_some() {
                    let problem = format!("the angles {incidence}, {azimuth} and {radial} occur twice");
                    return Err(Error::scene(at, problem, "give each combination of angles once"));
                }
            }
        }
    }
    let [incidence, azimuth, radial] =
        [0, 1, 2].map(|which| values.keys().map(|angles| angles[which]).collect::<BTreeSet<_>>());
    let wanted = incidence.len() * azimuth.len() * radial.len();
    if values.is_empty() || values.len() != wanted {
        let problem = format!(
            "{} lines for {} x {} x {} angles of incidence, azimuths and radial angles",
            values.len(),
            incidence.len(),
            azimuth.len(),
            radial.len()
        );
        return Err(Error::scene(place, problem, "give a value for every combination of the angles"));
    }
    let degrees = |angles: &BTreeSet<Ordered>| angles.iter().map(|bits| f64::from_bits(*bits)).collect();
    // They are ordered by their angles.
    let mut ordered = values.into_values();
    let mut rows = || (0..azimuth.len()).map(|_| ordered.by_ref().take(radial.len()).collect()).collect();
    Ok(Grid {
        scatter_type,
        incidence: degrees(&incidence),
        azimuth: degrees(&azimuth),
        radial: degrees(&radial),
        values: (0..incidence.len()).map(|_| rows()).collect(),
        tis: None,
    })
}

/// `BRDF` or `BTDF`.
pub(super) fn type_of(place: &str, word: &str) -> Result<ScatterType> {
    match word.to_ascii_uppercase().as_str() {
        "BRDF" => Ok(ScatterType::Reflected),
        "BTDF" => Ok(ScatterType::Transmitted),
        _ => Err(Error::scene(place, format!("the scatter type is {}", quoted(word)), "write BRDF or BTDF")),
    }
}

fn columns_of(place: &str, words: &[&str]) -> Result<[usize; 4]> {
    let at = COLUMNS.map(|column| words.iter().position(|word| *word == column));
    match at {
        [Some(a), Some(b), Some(c), Some(d)] if words.len() == COLUMNS.len() => Ok([a, b, c, d]),
        _ => Err(Error::scene(
            place,
            format!("the columns are {}", quoted(&words.join(", "))),
            format!("begin the table with a line that names the columns: {}", COLUMNS.join(", ")),
        )),
    }
}

fn numbers(place: &str, words: &[&str], columns: [usize; 4]) -> Result<[f64; 4]> {
    let numbers: Option<Vec<f64>> = words.iter().map(|word| word.parse().ok()).collect();
    match numbers {
        Some(numbers)
            if numbers.len() == COLUMNS.len() && numbers[..].iter().all(|number| *number >= 0.0) =>
        {
            Ok(columns.map(|column| numbers[column]))
        }
        _ => Err(Error::scene(
            place,
            format!("{} is no row of the table", quoted(&words.join(", "))),
            format!("write {} numbers from 0 on, separated by commas; # starts a comment", COLUMNS.len()),
        )),
    }
}
