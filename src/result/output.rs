//! The files of a result: `report.json`, one `.npz` and one `.png` per detector, `ray_paths.npz` if paths were recorded.
//!
//! Written whole or not at all. Everything is written to a hidden folder on the same file system first; a new folder
//! then appears in one rename, and in an existing one the files are renamed one by one, `report.json` last, with the
//! old ones put back if any rename fails. Files of the result that was there before go with it: no file is left that the
//! report does not know.

use std::collections::{HashMap, HashSet};
use std::fs::{self, File, OpenOptions};
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use crate::error::{Error, Result};
use crate::result::report::Files;
use crate::result::{Detector, DetectorData, Report, TraceResult, npz, png};
use rayon::prelude::*;
use serde_json::Value;

/// Name of the document in the folder.
pub const REPORT: &str = "report.json";
/// Name of the file of recorded paths.
pub const RAY_PATHS: &str = "ray_paths.npz";
/// Name of the file of raw sums.
pub const TALLY: &str = "tally.bin";

/// Writes all files of `result` into `dir`, which is created if it does not exist, and returns their paths.
///
/// # Errors
/// [`Error::File`] with the file or folder that could not be written; `dir` is then as it was.
pub fn write_all(dir: &Path, result: &TraceResult) -> Result<Vec<PathBuf>> {
    write(dir, result, &Extras { pictures: true, tally: None })
}

/// What stands beside the numbers of a result.
#[derive(Debug, Clone, Copy)]
pub struct Extras<'a> {
    /// A picture of each detector.
    pub pictures: bool,
    /// The contents of the file of raw sums.
    pub tally: Option<&'a [u8]>,
}

/// As [`write_all`], with these extras.
///
/// # Errors
/// Those of [`write_all`].
pub fn write(dir: &Path, result: &TraceResult, extras: &Extras<'_>) -> Result<Vec<PathBuf>> {
    let (staging, base, missing) = stage(dir)?;
    let new = staging.path().join("new");
    let staged = new.join(&missing);
    fs::create_dir_all(&staged).map_err(|error| Error::file(dir, error))?;
    let names = write_files(&staged, result, extras).map_err(|error| relocate(error, &staged, dir))?;
    match missing.iter().next() {
        Some(top) => fs::rename(new.join(top), base.join(top)).map_err(|error| Error::file(dir, error))?,
        None => install(&staged, &staging.path().join("old"), dir, &names)?,
    }
    sync_folder(&base);
    Ok(names.iter().map(|name| dir.join(name)).collect())
}

/// Finds out before a long trace whether [`write_all`] could write into `dir`.
///
/// # Errors
/// [`Error::File`] with the folder that cannot be written to.
pub fn check_writable(dir: &Path) -> Result<()> {
    stage(dir).map(|_| ())
}

/// The deepest folder on the way to `dir` that exists: where files lie on the file system of the results.
///
/// # Errors
/// [`Error::File`] if no such folder exists.
pub fn file_system_of(dir: &Path) -> Result<PathBuf> {
    split_existing(dir).map(|(base, _)| base)
}

/// A hidden folder on the file system of `dir`, with what [`split_existing`] says.
fn stage(dir: &Path) -> Result<(tempfile::TempDir, PathBuf, PathBuf)> {
    let (base, missing) = split_existing(dir)?;
    let staging = tempfile::Builder::new().prefix(".nsq-gpu-").tempdir_in(&base);
    // The operating system's word alone: tempfile's adds the hidden folder, which nobody asked for.
    let problem = |error: io::Error| io::Error::from(error.kind());
    Ok((staging.map_err(|error| Error::file(dir, problem(error)))?, base, missing))
}

/// The deepest existing ancestor of `dir`, and what is missing below it.
fn split_existing(dir: &Path) -> Result<(PathBuf, PathBuf)> {
    for ancestor in dir.ancestors() {
        let base = if ancestor.as_os_str().is_empty() { Path::new(".") } else { ancestor };
        if base.is_dir() {
            let missing = dir.strip_prefix(ancestor).unwrap_or(Path::new(""));
            return Ok((base.into(), missing.into()));
        }
        if base.exists() {
            return Err(Error::file(base, "is not a folder"));
        }
    }
    Err(Error::file(dir, "no folder to write to"))
}

/// Writes every file into `folder`; returns their names, `report.json` last.
fn write_files(folder: &Path, result: &TraceResult, extras: &Extras<'_>) -> Result<Vec<String>> {
    let mut names = Vec::new();
    let mut files = Files::default();
    let mut pictures = Vec::new();
    for (detector, stem) in result.detectors.iter().zip(file_stems(result)) {
        let data = format!("{stem}.npz");
        npz::write_detector(&folder.join(&data), result, detector)?;
        files.detectors.insert(detector.name.clone(), data.clone());
        names.push(data);
        if extras.pictures {
            let picture = format!("{stem}.png");
            let path = folder.join(&picture);
            files.pictures.insert(detector.name.clone(), picture.clone());
            names.push(picture);
            match &detector.data {
                // One at a time: it holds as many points as a picture shows.
                DetectorData::RayDatabase(_) => png::write_detector(&path, detector)?,
                DetectorData::Irradiance(_) | DetectorData::Spectral(_) | DetectorData::FarField(_) => {
                    pictures.push((detector, path));
                }
            }
        }
    }
    draw(&pictures)?;
    if let Some(paths) = &result.ray_paths {
        npz::write_ray_paths(&folder.join(RAY_PATHS), result, paths)?;
        files.ray_paths = Some(RAY_PATHS.into());
        names.push(RAY_PATHS.into());
    }
    if let Some(bytes) = extras.tally {
        write_bytes(&folder.join(TALLY), bytes)?;
        names.push(TALLY.into());
    }
    write_bytes(&folder.join(REPORT), Report::new(result, &files).to_json().as_bytes())?;
    names.push(REPORT.into());
    for name in &names {
        sync_file(&folder.join(name))?;
    }
    Ok(names)
}

/// Draws pictures of detectors, side by side.
fn draw(pictures: &[(&Detector, PathBuf)]) -> Result<()> {
    pictures.par_iter().try_for_each(|(detector, path)| png::write_detector(path, detector))
}

fn write_bytes(path: &Path, bytes: &[u8]) -> Result<()> {
    let write = || -> io::Result<()> { File::create(path)?.write_all(bytes) };
    write().map_err(|error| Error::file(path, error))
}

/// Moves `names` from `staged` to `dir`; the files of the result before go to `old`, and back if something fails.
fn install(staged: &Path, old: &Path, dir: &Path, names: &[String]) -> Result<()> {
    fs::create_dir(old).map_err(|error| Error::file(dir, error))?;
    if let Some(name) = names.iter().find(|name| dir.join(name).is_dir()) {
        return Err(Error::file(dir.join(name), "is a folder"));
    }
    let stale: Vec<String> = files_before(dir).into_iter().filter(|name| !names.contains(name)).collect();
    let moved = retire(dir, old, names)
        .and_then(|()| retire(dir, old, &stale))
        .and_then(|()| names.iter().try_for_each(|name| rename(&staged.join(name), &dir.join(name))));
    if moved.is_err() {
        remove_new(staged, dir, names);
        put_back(old, dir, names.iter().chain(&stale));
    }
    moved
}

/// The files of the result that a folder holds, as its report names them; none where there is no such report.
fn files_before(dir: &Path) -> Vec<String> {
    let text = fs::read_to_string(dir.join(REPORT)).unwrap_or_default();
    let report: Value = serde_json::from_str(&text).unwrap_or_default();
    if report["program"] != env!("CARGO_PKG_NAME") {
        return Vec::new();
    }
    let detectors = report["detectors"].as_object().into_iter().flat_map(|detectors| detectors.values());
    let of_detectors = detectors.flat_map(|detector| [&detector["file"], &detector["picture"]]);
    let names = of_detectors.chain([&report["ray_paths"]]).filter_map(Value::as_str).chain([TALLY]);
    // A report that somebody has changed could name files elsewhere.
    let is_here =
        |name: &&str| Path::new(name).file_name() == Some(name.as_ref()) && dir.join(name).is_file();
    names.filter(is_here).map(String::from).collect()
}

/// Takes the old files away, `report.json` first: whoever finds a report finds the files that it describes.
fn retire(dir: &Path, old: &Path, names: &[String]) -> Result<()> {
    let existing = names.iter().rev().filter(|name| dir.join(name).symlink_metadata().is_ok());
    existing
        .map(|name| (dir.join(name), old.join(name)))
        .try_for_each(|(from, to)| fs::rename(&from, to).map_err(|error| Error::file(from, error)))
}

/// Undoes the moves of new files as far as they went.
fn remove_new(staged: &Path, dir: &Path, names: &[String]) {
    for name in names.iter().filter(|name| !staged.join(name).exists()) {
        let _ = fs::remove_file(dir.join(name));
    }
}

/// Undoes [`retire`] as far as it went. What cannot be undone has no better place to go.
fn put_back<'a>(old: &Path, dir: &Path, names: impl Iterator<Item = &'a String>) {
    for name in names.filter(|name| old.join(name).symlink_metadata().is_ok()) {
        let _ = fs::rename(old.join(name), dir.join(name));
    }
}

fn rename(from: &Path, to: &Path) -> Result<()> {
    fs::rename(from, to).map_err(|error| Error::file(to, error))
}

fn sync_file(path: &Path) -> Result<()> {
    // Windows syncs only what is open for writing.
    let file = OpenOptions::new().write(true).open(path);
    file.and_then(|file| file.sync_all()).map_err(|error| Error::file(path, error))
}

/// Makes the renames durable where folders can be synced; elsewhere the file system does what it does.
fn sync_folder(folder: &Path) {
    let _ = File::open(folder).and_then(|folder| folder.sync_all());
}

/// Names the place that the user asked for, not the one where the file was first written.
fn relocate(error: Error, staged: &Path, dir: &Path) -> Error {
    let Error::File { path, problem } = error else { return error };
    let path = path.strip_prefix(staged).map_or_else(|_| path.clone(), |name| dir.join(name));
    Error::File { path, problem }
}

/// A file name without extension per detector: its name where the file system can carry it, distinct even where upper
/// and lower case are the same.
fn file_stems(result: &TraceResult) -> Vec<String> {
    // Where case is no difference, neither is that of letters that only one case of has a letter of its own.
    let folded = |stem: &str| stem.to_uppercase().to_lowercase();
    let mut taken = HashSet::from(["ray_paths".to_string()]);
    let mut next_numbers: HashMap<String, u64> = HashMap::new();
    let mut distinct = |name: &str| {
        let stem = safe_stem(name);
        let mut free = stem.clone();
        let next = next_numbers.entry(folded(&stem)).or_insert(2);
        while !taken.insert(folded(&free)) {
            free = format!("{stem}_{next}");
            *next += 1;
        }
        free
    };
    result.detectors.iter().map(|detector| distinct(&detector.name)).collect()
}

fn safe_stem(name: &str) -> String {
    const MAX_CHARS: usize = 60;
    let safe = |c: char| if c.is_alphanumeric() || "-_.".contains(c) { c } else { '_' };
    let stem: String = name.trim().chars().map(safe).take(MAX_CHARS).collect();
    let reserved = |stem: &str| {
        let base = stem.split('.').next().unwrap_or("").to_uppercase();
        let numbered = base.len() == 4 && (base.starts_with("COM") || base.starts_with("LPT"));
        ["CON", "PRN", "AUX", "NUL"].contains(&base.as_str()) || numbered
    };
    match stem {
        stem if stem.is_empty() => "detector".into(),
        // A leading dot hides a file, a leading dash reads as an option, and Windows keeps a few names for devices.
        stem if stem.starts_with(['.', '-']) || reserved(&stem) => format!("_{stem}"),
        stem => stem,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_move_that_fails_halfway_is_undone() {
        let (staging, folder) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
        let staged = staging.path().join("new");
        fs::create_dir(&staged).unwrap();
        // The second file was never staged, so that its move fails after the first has replaced an old file.
        fs::write(staged.join("a.npz"), "new").unwrap();
        fs::write(staged.join(REPORT), "new").unwrap();
        fs::write(folder.path().join("a.npz"), "old").unwrap();
        fs::write(folder.path().join("stale.npz"), "old").unwrap();
        let report = r#"{"program": "nsq-gpu", "detectors": {"stale": {"file": "stale.npz"}}}"#;
        fs::write(folder.path().join(REPORT), report).unwrap();
        assert_eq!(files_before(folder.path()), ["stale.npz"]);
        let names = ["a.npz", "b.npz", REPORT].map(String::from);
        let error = install(&staged, &staging.path().join("old"), folder.path(), &names).unwrap_err();
        assert!(matches!(error, Error::File { path, .. } if path == folder.path().join("b.npz")));
        for (name, text) in [("a.npz", "old"), ("stale.npz", "old"), (REPORT, report)] {
            assert_eq!(fs::read_to_string(folder.path().join(name)).unwrap(), text);
        }
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 3);
    }
}
