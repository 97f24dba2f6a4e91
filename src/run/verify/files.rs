//! Whether the files of a result are as they were written: by their hashes in `report.json`.

use crate::error::{Error, Result};
use crate::format::hex;
use crate::result::Report;
use crate::result::file_names::OF_DETECTOR;
use crate::result::integrity::{self, Meta};
use crate::result::output::{REPORT, TALLY};
use crate::run::verify::finding::Finding;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use sha2::{Digest, Sha256};
use std::collections::BTreeSet;
use std::path::Path;

/// The files of a result.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct Files {
    /// How many were compared with their hashes.
    pub num_checked: usize,
    /// False: the result is of an older version, and damage would not be noticed.
    pub has_hashes: bool,
    /// Files that lie beside, and are not of the result.
    pub others: Vec<String>,
    /// SHA-256 of `report.json`, from which draws follow.
    pub sha256: String,
    #[serde(skip)]
    pub(super) report: Value,
}

impl Files {
    /// True if the report has a hash of a file of this name.
    pub(super) fn is_known(&self, name: &str) -> bool {
        self.report["meta"]["files"].get(name).is_some()
    }

    /// True if the result has a file of this name.
    pub(super) fn has(&self, name: &str) -> bool {
        !self.others.iter().any(|other| other == name)
    }
}

/// Compares every file with its hash. What is wrong is added to `findings`.
///
/// # Errors
/// [`Error::NoResult`] if there is no report. [`Error::File`] if it cannot be read.
pub(super) fn check(dir: &Path, findings: &mut Vec<Finding>) -> Result<Files> {
    let bytes = report_of(dir)?;
    let mut damaged = |problem: &str| findings.push(Finding::of_file(REPORT, problem));
    let mut files = Files { sha256: hex(&Sha256::digest(&bytes)), ..Files::default() };
    let report = match std::str::from_utf8(&bytes) {
        Ok(text) => serde_json::from_str::<Value>(text).map_err(|error| error.to_string()),
        Err(error) => Err(error.to_string()),
    };
    match report {
        Ok(report) => files.report = report,
        Err(problem) => {
            damaged(&format!("is damaged: {problem}"));
            return Ok(files);
        }
    }
    let text = String::from_utf8_lossy(&bytes);
    let Some(meta) = files.report.get("meta") else {
        check_keys(&files.report, &mut damaged);
        files.others = others(dir, &named(&files.report))?;
        return Ok(files);
    };
    let meta = match Meta::deserialize(meta) {
        Ok(meta) => meta,
        Err(error) => {
            damaged(&format!("is damaged: {error}"));
            return Ok(files);
        }
    };
    files.has_hashes = true;
    if let Err(error) = integrity::check_report(&dir.join(REPORT), &text, &meta) {
        // Its hashes of other files are worth nothing.
        findings.push(Finding::of_error(dir, &error));
        return Ok(files);
    }
    files.num_checked = 1 + meta.files.len();
    for name in meta.files.keys() {
        let checked = match Path::new(name).file_name() == Some(name.as_ref()) {
            true => integrity::check_file(dir, name, &meta),
            false => {
                Err(Error::file(dir.join(REPORT), format!("has a hash of `{name}`, which lies elsewhere")))
            }
        };
        findings.extend(checked.err().map(|error| Finding::of_error(dir, &error)));
    }
    let known = meta.files.keys().cloned().chain([REPORT.to_string()]).collect();
    files.others = others(dir, &known)?;
    Ok(files)
}

fn report_of(dir: &Path) -> Result<Vec<u8>> {
    let no_result = |problem: &str| Error::NoResult { path: dir.into(), problem: problem.into() };
    let path = dir.join(REPORT);
    match dir.metadata() {
        Err(error) => return Err(no_result(&format!("is no result: {error}"))),
        Ok(found) if !found.is_dir() => return Err(no_result("is no folder")),
        Ok(_) if !path.is_file() => return Err(no_result(&format!("holds no {REPORT}"))),
        Ok(_) => {}
    }
    std::fs::read(&path).map_err(|error| Error::file(path, error))
}

/// Without hashes, an unknown key is a sign of damage: that key may have been `meta`.
fn check_keys(report: &Value, damaged: &mut impl FnMut(&str)) {
    let Some(keys) = report.as_object() else { return damaged("is damaged: it holds no object") };
    let unknown = keys.keys().filter(|key| !Report::has_key(key));
    unknown.for_each(|key| damaged(&format!("is damaged: no report has a key `{key}`")));
}

/// The names of files that a report without hashes has, the sums among them.
fn named(report: &Value) -> BTreeSet<String> {
    let detectors = report["detectors"].as_object().into_iter().flat_map(|all| all.values());
    let of_detectors = detectors.flat_map(|detector| OF_DETECTOR.map(|key| &detector[key]));
    let others = ["ray_paths", "paths_file", "gradients_file"].map(|key| &report[key]);
    let names = of_detectors.chain(others).filter_map(Value::as_str).map(String::from);
    names.chain([REPORT, TALLY].map(String::from)).collect()
}

/// What a folder holds beside files of these names.
fn others(dir: &Path, known: &BTreeSet<String>) -> Result<Vec<String>> {
    let entries = std::fs::read_dir(dir).map_err(|error| Error::file(dir, error))?;
    let names = entries.flatten().map(|entry| entry.file_name().to_string_lossy().into_owned());
    let names: BTreeSet<String> = names.filter(|name| !known.contains(name)).collect();
    Ok(names.into_iter().collect())
}
