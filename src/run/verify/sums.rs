//! Whether the files of a result agree with each other: the report and all arrays are what the sums in `tally.bin` give.

use crate::error::{Error, Result};
use crate::model::SceneIr;
use crate::result::output::{PATHS, RAY_PATHS, REPORT, TALLY};
use crate::result::{Detector, Report, RunInfo, TraceResult, npz_files, report};
use crate::run::checkpoint::{Checkpoint, Identity};
use crate::run::verify::finding::Finding;
use ndarray::{ArrayD, ArrayViewD};
use ndarray_npy::ReadNpyExt;
use serde_json::Value;
use std::fmt::Display;
use std::io::Read;
use std::path::Path;

/// Largest relative difference of two numbers that are computed in the same way: sines and logarithms of two machines
/// differ in their last bits.
const ROUNDING: f64 = 1e-12;
/// The same of a sum of rounded numbers.
const ROUNDING_OF_SUMS: f64 = 1e-9;

/// Keys of the report that do not follow from the sums.
const APART: [&str; 11] = [
    "file",
    "picture",
    "color_picture",
    "paths_file",
    "gradients_file",
    "ray_paths",
    "meta",
    "gradients",
    "warnings",
    "grave",
    "num_rays_stored",
];

/// Keys of a report whose ray databases keep a part of their rows, of which the sums know only the whole.
const OF_KEPT_ROWS: [&str; 7] = [
    "total_flux",
    "total_flux_standard_error",
    "rests_on",
    "upper_bound_95",
    "total_flux_detected",
    "total_flux_tapped",
    "flux_conservation_error",
];

/// What the report says of the trace must be what the sums are of.
pub(super) fn check_identity(run: &RunInfo, identity: &Identity, findings: &mut Vec<Finding>) {
    let mut compare = |key: &str, report: &dyn Display, sums: &dyn Display| {
        let (report, sums) = (report.to_string(), sums.to_string());
        if report != sums {
            findings.push(Finding::at(REPORT, key, &format!("is {report}; {TALLY} has {sums}")));
        }
    };
    compare("version", &run.version, &identity.version);
    // Sources share the rays of a part in whole numbers, which may be one more or less.
    if run.of_rays.is_none() {
        compare("num_rays_requested", &run.num_rays, &identity.num_rays);
    }
    compare("seed", &run.seed, &identity.seed);
    compare("max_depth", &run.max_depth, &identity.max_depth);
    compare("min_flux_fraction", &run.min_flux_fraction, &identity.min_flux_fraction);
    compare("precision", &run.precision, &identity.precision);
    compare("sampler", &run.sampler, &identity.sampler);
    compare("first_ray", &run.first_ray, &identity.first_ray);
    compare("of_rays", &format!("{:?}", run.of_rays), &format!("{:?}", identity.of_rays));
    compare("adapter", &run.adapter, &identity.adapter);
    compare("driver", &run.driver, &identity.driver);
    compare("where", &run.filter.as_deref().unwrap_or("none"), &identity.path_filter);
}

/// Computes the result anew from its sums, and compares every number.
///
/// # Errors
/// [`Error::File`] if a file cannot be read.
pub(super) fn check(
    dir: &Path,
    ir: &SceneIr,
    stored: &TraceResult,
    report: &Value,
    sums: &Checkpoint,
    findings: &mut Vec<Finding>,
) -> Result<()> {
    if let Err(problem) = sums.tally.check(ir) {
        findings.push(Finding::of_file(TALLY, &problem));
        return Ok(());
    }
    let expected = TraceResult::new(ir, &stored.run, &sums.tally)?;
    let lacks_rows = |index: usize| {
        let sums = &sums.tally.detectors[index];
        (sums.rows.len() as u64) < sums.recorded.count
    };
    let keeps_few = stored.detectors.iter().any(|detector| detector.data.result().kept_flux().is_some());
    let is_apart = |key: &str| APART.contains(&key) || keeps_few && OF_KEPT_ROWS.contains(&key);
    let text = Report::new(&expected, &report::Files::default()).to_json();
    let expected_report: Value =
        serde_json::from_str(&text).map_err(|error| Error::Internal(error.to_string()))?;
    compare_json(report, &expected_report, "", &is_apart, findings);
    for (index, detector) in expected.detectors.iter().enumerate().filter(|(index, _)| !lacks_rows(*index)) {
        let file = report["detectors"][&detector.name]["file"].as_str().unwrap_or_default();
        let arrays = npz_files::detector_arrays(&expected, detector)?;
        // Which rows a capped database keeps, its own rows say.
        if stored.detectors[index].data.result().kept_flux().is_none() {
            compare_arrays(dir, file, &arrays, findings)?;
        }
    }
    if let Some(paths) = expected.ray_paths.as_ref().filter(|_| !sums.tally.paths.is_empty()) {
        compare_arrays(dir, RAY_PATHS, &npz_files::ray_path_arrays(&expected, paths)?, findings)?;
    }
    if let (Some(table), Some(file)) = (&expected.paths, report["paths_file"].as_str()) {
        let found = std::fs::read(dir.join(file)).map_err(|error| Error::file(dir.join(file), error))?;
        if found != table.to_csv().as_bytes() {
            findings.push(Finding::of_file(PATHS, &format!("does not hold the rows that {TALLY} gives")));
        }
    }
    Ok(())
}

/// What needs neither sums nor scene: the ledger closes, and the maps hold the flux and the hits that the report names.
pub(super) fn check_alone(stored: &TraceResult, findings: &mut Vec<Finding>) {
    if !stored.ledger.closes() || stored.ledger.recomputed_imbalance() != 0 {
        let imbalance = stored.ledger.recomputed_imbalance();
        let problem = format!("does not close: {imbalance} quanta are unaccounted for");
        findings.push(Finding::at(REPORT, "ledger", &problem));
    }
    for detector in &stored.detectors {
        check_total(detector, findings);
    }
}

fn check_total(detector: &Detector, findings: &mut Vec<Finding>) {
    let Some(map) = detector.data.result().map() else { return };
    let cells_per_row = map.values.len() / map.sizes.len().max(1);
    let flux: f64 = map
        .values
        .iter()
        .enumerate()
        .map(|(cell, value)| value * map.sizes[cell / cells_per_row.max(1)])
        .sum();
    let place = format!("detectors.{}", detector.name);
    if !are_equal(flux, detector.total_flux, ROUNDING_OF_SUMS) {
        let problem = format!("is {} W; its map sums up to {flux} W", detector.total_flux);
        findings.push(Finding::at(REPORT, &format!("{place}.total_flux"), &problem));
    }
    // The map of a path has no hits.
    let hits: u64 = map.hits.iter().sum();
    if hits != detector.num_rays_hit && detector.title.is_none() {
        let problem = format!("is {}; its map has {hits} hits", detector.num_rays_hit);
        findings.push(Finding::at(REPORT, &format!("{place}.num_rays_hit"), &problem));
    }
}

fn are_equal(a: f64, b: f64, relative: f64) -> bool {
    a == b || (a - b).abs() <= relative * a.abs().max(b.abs()) || a.is_nan() && b.is_nan()
}

fn compare_json(
    stored: &Value,
    expected: &Value,
    place: &str,
    is_apart: &impl Fn(&str) -> bool,
    findings: &mut Vec<Finding>,
) {
    let at = |key: &dyn Display| if place.is_empty() { key.to_string() } else { format!("{place}.{key}") };
    match (stored, expected) {
        (Value::Object(stored), Value::Object(expected)) => {
            let keys = expected.keys().chain(stored.keys().filter(|key| !expected.contains_key(*key)));
            for key in keys.filter(|key| !is_apart(key)) {
                let (one, other) = (stored.get(key), expected.get(key));
                let [one, other] = [one, other].map(|value| value.unwrap_or(&Value::Null));
                compare_json(one, other, &at(key), is_apart, findings);
            }
        }
        (Value::Array(stored), Value::Array(expected)) if stored.len() == expected.len() => {
            for (index, (one, other)) in stored.iter().zip(expected).enumerate() {
                compare_json(one, other, &at(&index), is_apart, findings);
            }
        }
        (Value::Number(one), Value::Number(other)) if one.is_f64() || other.is_f64() => {
            let [one, other] = [one, other].map(|number| number.as_f64().unwrap_or(f64::NAN));
            if !are_equal(one, other, ROUNDING) {
                findings.push(Finding::at(REPORT, place, &format!("is {one}; {TALLY} gives {other}")));
            }
        }
        (one, other) if one == other => {}
        (one, other) => {
            findings.push(Finding::at(REPORT, place, &format!("is {one}; {TALLY} gives {other}")));
        }
    }
}

/// Compares the arrays of a file, each in the format `.npy`, with those that the sums give.
fn compare_arrays(
    dir: &Path,
    file: &str,
    expected: &[(String, Vec<u8>)],
    findings: &mut Vec<Finding>,
) -> Result<()> {
    let path = dir.join(file);
    let unread = |error: &dyn Display| Error::file(&path, error);
    let opened = std::fs::File::open(&path).map_err(|error| unread(&error))?;
    let mut archive =
        zip::ZipArchive::new(std::io::BufReader::new(opened)).map_err(|error| unread(&error))?;
    for (name, expected) in expected {
        let mut found = Vec::new();
        match archive.by_name(&format!("{name}.npy")) {
            Ok(member) => {
                // A member may claim any length; what is longer than it should be is wrong whatever it holds.
                let most = expected.len() as u64 + 1;
                member.take(most).read_to_end(&mut found).map_err(|error| unread(&error))?;
            }
            Err(error) => {
                findings.push(Finding::at(file, name, &format!("is missing: {error}")));
                continue;
            }
        }
        if let Some(problem) = difference(&found, expected) {
            findings.push(Finding::at(file, name, &problem));
        }
    }
    Ok(())
}

/// The first difference of two arrays in the format `.npy`, if there is one.
fn difference(found: &[u8], expected: &[u8]) -> Option<String> {
    if found == expected {
        return None;
    }
    let reals = [found, expected].map(|bytes| ArrayD::<f64>::read_npy(bytes).ok());
    if let [Some(found), Some(expected)] = &reals {
        return first_difference(found.view(), expected.view(), |a, b| are_equal(*a, *b, ROUNDING));
    }
    let counts = [found, expected].map(|bytes| ArrayD::<i64>::read_npy(bytes).ok());
    if let [Some(found), Some(expected)] = &counts {
        return first_difference(found.view(), expected.view(), |a, b| a == b);
    }
    Some(format!("is not what {TALLY} gives"))
}

fn first_difference<T: Display>(
    found: ArrayViewD<T>,
    expected: ArrayViewD<T>,
    are_equal: impl Fn(&T, &T) -> bool,
) -> Option<String> {
    if found.shape() != expected.shape() {
        return Some(format!("has the shape {:?}; {TALLY} gives {:?}", found.shape(), expected.shape()));
    }
    let mut pairs = found.indexed_iter().zip(expected.iter());
    let ((place, found), expected) = pairs.find(|((_, found), expected)| !are_equal(found, expected))?;
    let place = ndarray::Dimension::slice(&place);
    Some(format!("is {found} at {place:?}; {TALLY} gives {expected}"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn every_number_of_a_report_is_compared_and_named() {
        let expected =
            json!({"ledger": {"quanta": "12"}, "detectors": {"a": {"hits": 3, "flux": 0.1}}, "file": "x"});
        let found = |change: &dyn Fn(&mut Value)| {
            let (mut stored, mut findings) = (expected.clone(), Vec::new());
            change(&mut stored);
            compare_json(&stored, &expected, "", &|key| key == "file", &mut findings);
            findings.into_iter().map(|finding| finding.place).collect::<Vec<_>>()
        };
        assert!(found(&|_| {}).is_empty());
        assert!(found(&|value| value["file"] = json!("y")).is_empty());
        assert!(found(&|value| value["detectors"]["a"]["flux"] = json!(0.1 * (1.0 + 1e-15))).is_empty());
        assert_eq!(found(&|value| value["detectors"]["a"]["flux"] = json!(0.100_001)), ["detectors.a.flux"]);
        assert_eq!(found(&|value| value["detectors"]["a"]["hits"] = json!(4)), ["detectors.a.hits"]);
        assert_eq!(found(&|value| value["ledger"]["quanta"] = json!("13")), ["ledger.quanta"]);
        assert_eq!(found(&|value| value["ledger"] = json!(1)), ["ledger"]);
        assert_eq!(found(&|value| value["more"] = json!(1)), ["more"]);
    }
}
