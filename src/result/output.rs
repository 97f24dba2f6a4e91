//! The files of a result: `report.json`, one `.npz` and one `.png` per detector, `ray_paths.npz` if paths were recorded.
//!
//! Written whole or not at all. Everything is written to a hidden folder on the same file system first. A new folder
//! then appears in one rename. A folder that exists is exchanged for the new one in one step. What else it held stands
//! in the new folder as the same files, by links. A folder that cannot be exchanged ([`Target::is_exchangeable`]) has
//! its files renamed one by one. If a rename fails, all are undone. If this run is killed, the next run undoes them.
//! Files of an earlier result go with that result. Only files that this program has written are ever replaced.

use std::collections::{BTreeMap, HashMap, HashSet};
use std::fs::{self, File, OpenOptions};
use std::io::{self, Read as _, Write};
use std::path::{Component, Path, PathBuf};

use crate::error::{Error, Result};
use crate::format::hex;
use crate::placing::{self, Journal, Lock, Scratch, step};
use crate::result::file_names::OF_DETECTOR;
pub use crate::result::file_names::{GRADIENTS, PATHS, RAY_PATHS, REPORT, TALLY};
use crate::result::integrity::{self, FileHash, Meta, NO_HASH};
use crate::result::png::Style;
use crate::result::report::Files;
use crate::result::{Detector, Report, TraceResult, npz_files, png};
use rayon::prelude::*;
use serde_json::Value;
use sha2::{Digest, Sha256};

/// With which a file of raw sums begins.
pub const SUMS_MAGIC: &[u8; 8] = b"NSQTALLY";

/// True of a file that begins as files of raw sums do. Whose sums they are, and whether they are whole, is not known yet.
pub fn holds_sums(path: &Path) -> bool {
    let mut magic = [0; SUMS_MAGIC.len()];
    path.is_file()
        && File::open(path).and_then(|mut file| file.read_exact(&mut magic)).is_ok()
        && magic == *SUMS_MAGIC
}

/// Writes all files of `result` into `dir`, which is created if it does not exist, and returns their paths.
///
/// # Errors
/// [`Error::File`] with the file or folder that could not be written; `dir` is then as it was.
pub fn write_all(dir: &Path, result: &TraceResult) -> Result<Vec<PathBuf>> {
    write(dir, result, &Extras { pictures: Some(Style::default()), tally: None }).map(|written| written.files)
}

/// What stands beside the numbers of a result.
#[derive(Debug, Clone, Copy)]
pub struct Extras<'a> {
    /// A picture of each detector, in this style.
    pub pictures: Option<Style>,
    /// The contents of the file of raw sums.
    pub tally: Option<&'a [u8]>,
}

/// What was written.
#[derive(Debug, Clone, PartialEq)]
pub struct Written {
    /// Paths of the files, `report.json` last.
    pub files: Vec<PathBuf>,
    /// The text of `report.json`.
    pub report: String,
}

/// As [`write_all`], with these extras.
///
/// # Errors
/// The errors of [`write_all`].
pub fn write(dir: &Path, result: &TraceResult, extras: &Extras<'_>) -> Result<Written> {
    let (files, report) = write_by(dir, |folder| write_files(folder, result, extras))?;
    Ok(Written { files, report })
}

/// Puts files into `dir` in one step, and returns their paths. `fill` writes the files into a folder that it is given, and
/// returns their names, `report.json` last, and something of its own.
pub(crate) fn write_by<T>(
    dir: &Path,
    fill: impl FnOnce(&Path) -> Result<(Vec<String>, T)>,
) -> Result<(Vec<PathBuf>, T)> {
    let target = Target::of(dir)?;
    let scratch = target.scratch(dir)?;
    let staged = scratch.staged().join(&target.missing);
    fs::create_dir_all(&staged).map_err(|error| Error::file(dir, error))?;
    let filled = fill(&staged).and_then(|(names, more)| {
        names.iter().try_for_each(|name| sync_file(&staged.join(name)))?;
        Ok((names, more))
    });
    let (names, more) = filled.map_err(|error| relocate(error, &staged, dir))?;
    install(dir, &target, &scratch, &names)?;
    Ok((names.iter().map(|name| dir.join(name)).collect(), more))
}

/// Finds out before a long trace whether files could be written into `dir`.
///
/// # Errors
/// [`Error::File`] with the folder that cannot be written to.
pub fn check_writable(dir: &Path) -> Result<()> {
    Target::of(dir).and_then(|target| target.scratch(dir)).map(|_| ())
}

/// Finds out before a long trace whether [`write`] could put files of these names into `dir`.
///
/// # Errors
/// [`Error::File`] with the folder that cannot be written to, or the file that this program has not written.
pub fn check(dir: &Path, names: &[String]) -> Result<()> {
    let target = Target::of(dir)?;
    // What a killed run has left undone is undone first.
    target.scratch(dir)?;
    // No other run changes what the folder holds between the two looks at it.
    let _lock = Lock::of(target.guard());
    if target.exists() { Before::of(dir).check(dir, names) } else { Ok(()) }
}

/// The names of the files that [`write`] would write. `pictures` names the detectors that see colour, if pictures are drawn.
pub fn file_names<'a>(
    detectors: impl Iterator<Item = &'a str>,
    pictures: Option<&'a [String]>,
    ray_paths: bool,
    paths: bool,
    tally: bool,
) -> Vec<String> {
    let suffixes = if pictures.is_some() { &[".npz", ".png"][..] } else { &[".npz"] };
    let (stems, of_colors) = stems_with_colors(detectors, pictures.into_iter().flatten().map(String::as_str));
    let of_detectors =
        stems.iter().flat_map(|stem| suffixes.iter().map(move |suffix| format!("{stem}{suffix}")));
    let others = [(RAY_PATHS, ray_paths), (PATHS, paths), (TALLY, tally), (REPORT, true)];
    of_detectors
        .chain(of_colors.iter().map(|stem| format!("{stem}.png")))
        .chain(others.iter().filter(|(_, is_written)| *is_written).map(|(name, _)| name.to_string()))
        .collect()
}

/// The deepest folder on the way to `dir` that exists: where files lie on the file system of the results.
///
/// # Errors
/// [`Error::File`] if no such folder exists.
pub fn file_system_of(dir: &Path) -> Result<PathBuf> {
    Target::of(dir).map(|target| target.base)
}

/// Where a result goes.
#[derive(Debug, Clone, PartialEq)]
struct Target {
    /// The deepest folder on the way that exists, without links.
    base: PathBuf,
    /// What is missing below it; empty if nothing is.
    missing: PathBuf,
}

impl Target {
    fn of(dir: &Path) -> Result<Target> {
        if dir.as_os_str().is_empty() {
            return Err(Error::Usage("the folder for the results has no name".into()));
        }
        let (mut base, mut missing) = (PathBuf::new(), PathBuf::new());
        for component in dir.components() {
            match component {
                Component::Normal(name) if missing.as_os_str().is_empty() => {
                    let next = base.join(name);
                    match fs::metadata(&next) {
                        Ok(found) if found.is_dir() => base = next,
                        Ok(_) => return Err(Error::file(next, "is not a folder")),
                        // A link that leads nowhere is an error. A folder that another run makes after the look is none:
                        // `install` looks again.
                        Err(error)
                            if error.kind() == io::ErrorKind::NotFound && next.read_link().is_err() =>
                        {
                            missing.push(name);
                        }
                        Err(error) => return Err(Error::file(&next, link_problem(&next, &error))),
                    }
                }
                Component::Normal(name) => missing.push(name),
                Component::ParentDir if !missing.as_os_str().is_empty() => {
                    let problem = "is not there, so that `..` leads nowhere from it; make it first";
                    return Err(Error::file(base.join(missing), problem));
                }
                Component::Prefix(_) | Component::RootDir | Component::CurDir | Component::ParentDir => {
                    base.push(component);
                }
            }
        }
        let base = if base.as_os_str().is_empty() { Path::new(".") } else { &base };
        let base = base.canonicalize().map_err(|error| Error::file(base, error))?;
        Ok(Target { base, missing })
    }

    fn exists(&self) -> bool {
        self.missing.as_os_str().is_empty()
    }

    /// The folder whose lock runs hold that change the target.
    fn guard(&self) -> &Path {
        let parent = self.base.parent().filter(|_| self.exists());
        parent.unwrap_or(&self.base)
    }

    /// A hidden folder on the file system of the target.
    fn scratch(&self, dir: &Path) -> Result<Scratch> {
        let is_beside = self.exists() && self.is_exchangeable();
        let beside = if is_beside { Scratch::new_in(self.guard(), self.guard()).ok() } else { None };
        // Where nothing can be made beside it, the folder itself may still take it.
        let scratch = beside.map_or_else(|| Scratch::new_in(&self.base, self.guard()), Ok);
        scratch.map_err(|error| Error::file(dir, error))
    }

    /// True if the folder may be exchanged for another one. It holds no folders, which no link can keep, and only its
    /// owner writes it. No file system is mounted there, and this process does not stand in it.
    fn is_exchangeable(&self) -> bool {
        let stands_here = || std::env::current_dir().is_ok_and(|here| here.starts_with(&self.base));
        let has_folders = || {
            let mut entries = fs::read_dir(&self.base).into_iter().flatten().flatten();
            entries.any(|entry| entry.file_type().is_ok_and(|kind| kind.is_dir()))
        };
        self.base.parent().is_some_and(|parent| is_on_one_file_system(parent, &self.base))
            && !stands_here()
            && !has_folders()
    }
}

fn link_problem(path: &Path, error: &io::Error) -> String {
    match fs::read_link(path) {
        Ok(leads_to) => format!("is a link to {}, which leads nowhere: {error}", leads_to.display()),
        Err(_) => error.to_string(),
    }
}

#[cfg(unix)]
fn is_on_one_file_system(a: &Path, b: &Path) -> bool {
    use std::os::unix::fs::MetadataExt;
    let device = |path: &Path| path.metadata().ok().map(|found| found.dev());
    device(a).is_some() && device(a) == device(b)
}

#[cfg(not(unix))]
fn is_on_one_file_system(_: &Path, _: &Path) -> bool {
    false
}

/// The files of the result that a folder holds, and what is known of them.
#[derive(Debug, Default)]
struct Before {
    /// Names, with the hashes that the report has of them.
    files: BTreeMap<String, Option<FileHash>>,
}

impl Before {
    /// Empty if the folder has no report of this program.
    fn of(dir: &Path) -> Before {
        let mut files = BTreeMap::new();
        let is_file = |name: &str| dir.join(name).symlink_metadata().is_ok_and(|found| found.is_file());
        let text =
            is_file(REPORT).then(|| fs::read_to_string(dir.join(REPORT)).ok()).flatten().unwrap_or_default();
        let report: Value = serde_json::from_str(&text).unwrap_or_default();
        let meta: Option<Meta> = serde_json::from_value(report["meta"].clone()).ok();
        if report["program"] == env!("CARGO_PKG_NAME") {
            let detectors = report["detectors"].as_object().into_iter().flat_map(|all| all.values());
            let of_detectors = detectors.flat_map(|detector| OF_DETECTOR.map(|key| &detector[key]));
            let names =
                of_detectors.chain(["ray_paths", "paths_file", "gradients_file"].map(|key| &report[key]));
            let names = names.filter_map(Value::as_str);
            // A report that somebody has changed could name files elsewhere.
            let is_here = |name: &&str| Path::new(name).file_name() == Some(name.as_ref()) && is_file(name);
            let hash = |name: &str| meta.as_ref().and_then(|meta| meta.files.get(name).cloned());
            files.extend(names.filter(is_here).map(|name| (name.to_string(), hash(name))));
            let is_unchanged = |meta: &Meta| integrity::check_report(&dir.join(REPORT), &text, meta).is_ok();
            if meta.as_ref().is_none_or(is_unchanged) {
                files.insert(REPORT.into(), None);
            }
            // Sums without a report that knows them may be the work of days: a checkpoint that somebody has moved here.
            let is_known = hash(TALLY).is_some() || meta.is_none();
            if is_known && is_file(TALLY) && holds_sums(&dir.join(TALLY)) {
                files.insert(TALLY.into(), hash(TALLY));
            }
        }
        // What somebody has changed since is no longer this program's.
        let is_unchanged = |name: &str, hash: &FileHash| {
            integrity::hash_of(&dir.join(name)).is_ok_and(|found| found == *hash)
        };
        files.retain(|name, hash| hash.as_ref().is_none_or(|hash| is_unchanged(name, hash)));
        Before { files }
    }

    /// Refuses to replace what is not of this result.
    fn check(&self, dir: &Path, names: &[String]) -> Result<()> {
        // The report first: its hashes of the other files count only where the report itself is unchanged.
        for name in names.iter().rev() {
            let path = dir.join(name);
            match path.symlink_metadata() {
                Err(error) if error.kind() == io::ErrorKind::NotFound => {}
                Err(error) => return Err(Error::file(path, error)),
                Ok(found) if found.is_dir() => return Err(Error::file(path, "is a folder")),
                Ok(found) if found.is_file() && self.files.contains_key(name) => {}
                Ok(_) => {
                    let problem = "is not as this program wrote it, and would be replaced; move it away, or name another folder";
                    return Err(Error::file(path, problem));
                }
            }
        }
        Ok(())
    }
}

/// Puts the staged files into place, whatever other runs have put there meanwhile.
fn install(dir: &Path, staged_for: &Target, scratch: &Scratch, names: &[String]) -> Result<()> {
    // Each turn but the last finds that another run was faster.
    const MOST_TURNS: usize = 100;
    for _ in 0..MOST_TURNS {
        let target = Target::of(dir)?;
        let _lock = Lock::of(target.guard());
        if Target::of(dir)? != target {
            continue;
        }
        let Some(top) = target.missing.iter().next() else {
            return install_over(dir, &target.base, &staged_for.missing, scratch, names);
        };
        let staged = scratch.staged().join(&staged_for.missing);
        let num_missing = target.missing.iter().count();
        if num_missing > staged_for.missing.iter().count().max(1) {
            return Err(Error::file(dir, "was taken away while the trace ran"));
        }
        let from = staged.ancestors().nth(num_missing - 1).unwrap_or(&staged);
        match placing::rename_to_new(from, &target.base.join(top)) {
            Ok(()) => {
                placing::sync_folder(&target.base);
                return Ok(());
            }
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {}
            Err(error) => return Err(Error::file(dir, error)),
        }
    }
    Err(Error::file(dir, "other runs write there all the time"))
}

/// Puts the staged files into a folder that exists, in the place of the result that it holds.
fn install_over(dir: &Path, real: &Path, staged: &Path, scratch: &Scratch, names: &[String]) -> Result<()> {
    let before = Before::of(real);
    before.check(dir, names)?;
    let journal = |in_place| Journal {
        target: real.into(),
        staged: staged.into(),
        names: names.into(),
        retired: before.files.keys().filter(|name| !names.contains(name)).cloned().collect(),
        in_place,
    };
    let staged = scratch.staged().join(staged);
    let exchanged = journal(false);
    scratch.note(&exchanged).map_err(|error| Error::file(dir, error))?;
    if is_like(real, &staged)
        && keep_others(&exchanged, &staged).is_ok()
        && placing::exchange(&staged, real).is_ok()
    {
        exchanged.rescue(&staged);
    } else {
        let journal = journal(true);
        scratch.note(&journal).map_err(|error| Error::file(dir, error))?;
        scratch.move_in(&journal).map_err(|(path, error)| relocate(Error::file(path, error), real, dir))?;
    }
    placing::sync_folder(real);
    Ok(())
}

/// Links what else a folder holds into the one that takes its place. What cannot be linked, such as a folder, is an error.
fn keep_others(journal: &Journal, staged: &Path) -> io::Result<()> {
    for entry in fs::read_dir(&journal.target)? {
        let entry = entry?;
        let is_ours = |known: &String| entry.file_name() == known.as_str();
        if !journal.names.iter().any(is_ours) && !journal.retired.iter().any(is_ours) {
            step();
            fs::hard_link(entry.path(), staged.join(entry.file_name()))?;
        }
    }
    placing::sync_folder(staged);
    Ok(())
}

/// Makes a new folder like the one whose place it takes. False if that is impossible, because the old one has another
/// owner, or attributes such as access lists.
#[cfg(unix)]
fn is_like(real: &Path, staged: &Path) -> bool {
    use std::os::unix::fs::MetadataExt;
    let (Ok(old), Ok(new)) = (real.metadata(), staged.metadata()) else { return false };
    is_on_one_file_system(real, staged)
        && (old.uid(), old.gid()) == (new.uid(), new.gid())
        && attributes(real).is_some_and(|names| Some(names) == attributes(staged))
        && fs::set_permissions(staged, old.permissions()).is_ok()
}

#[cfg(not(unix))]
fn is_like(_: &Path, _: &Path) -> bool {
    false
}

/// Names of the extended attributes of a folder; `None` if they cannot be read.
#[cfg(unix)]
fn attributes(folder: &Path) -> Option<Vec<u8>> {
    #[cfg(any(target_os = "linux", target_os = "android", target_vendor = "apple"))]
    {
        let mut names = vec![0_u8; 1 << 16];
        match rustix::fs::listxattr(folder, names.as_mut_slice()) {
            Ok(length) => names.truncate(length),
            Err(rustix::io::Errno::NOTSUP) => names.clear(),
            Err(_) => return None,
        }
        Some(names)
    }
    #[cfg(not(any(target_os = "linux", target_os = "android", target_vendor = "apple")))]
    {
        let _ = folder;
        None
    }
}

/// Writes every file into `folder`; returns their names, `report.json` last, and its text.
fn write_files<'a>(
    folder: &Path,
    result: &'a TraceResult,
    extras: &Extras<'_>,
) -> Result<(Vec<String>, String)> {
    let mut names = Vec::new();
    let mut files = Files::default();
    let mut pictures = Vec::new();
    let sees_color = |detector: &&Detector| {
        let seen = detector.luminous.as_ref().filter(|_| extras.pictures.is_some());
        seen.is_some_and(|seen| seen.color.is_some())
    };
    let name = |detector: &'a Detector| detector.name.as_str();
    let (stems, of_colors) = stems_with_colors(
        result.detectors.iter().map(name),
        result.detectors.iter().filter(sees_color).map(name),
    );
    for (detector, stem) in result.detectors.iter().zip(stems) {
        let data = format!("{stem}.npz");
        step();
        npz_files::write_detector(&folder.join(&data), result, detector)?;
        files.detectors.insert(detector.name.clone(), data.clone());
        names.push(data);
        if let Some(style) = extras.pictures {
            let picture = format!("{stem}.png");
            let path = folder.join(&picture);
            files.pictures.insert(detector.name.clone(), picture.clone());
            names.push(picture);
            match detector.data.result().map() {
                Some(_) => pictures.push((detector, path, style, false)),
                // One at a time: it holds as many points as a picture shows.
                None => png::write_detector(&path, detector, style)?,
            }
        }
    }
    for (detector, stem) in result.detectors.iter().filter(sees_color).zip(of_colors) {
        let picture = format!("{stem}.png");
        pictures.push((detector, folder.join(&picture), extras.pictures.unwrap_or_default(), true));
        files.color_pictures.insert(detector.name.clone(), picture.clone());
        names.push(picture);
    }
    draw(&pictures)?;
    if let Some(paths) = &result.ray_paths {
        npz_files::write_ray_paths(&folder.join(RAY_PATHS), result, paths)?;
        files.ray_paths = Some(RAY_PATHS.into());
        names.push(RAY_PATHS.into());
    }
    if let Some(table) = &result.paths {
        write_bytes(&folder.join(PATHS), table.to_csv().as_bytes())?;
        files.paths = Some(PATHS.into());
        names.push(PATHS.into());
    }
    if !result.gradients.is_empty() {
        npz_files::write_gradients(&folder.join(GRADIENTS), result)?;
        files.gradients = Some(GRADIENTS.into());
        names.push(GRADIENTS.into());
    }
    if let Some(bytes) = extras.tally {
        write_bytes(&folder.join(TALLY), bytes)?;
        names.push(TALLY.into());
    }
    let hash = |name: &String| {
        let path = folder.join(name);
        integrity::hash_of(&path).map(|hash| (name.clone(), hash)).map_err(|error| Error::file(path, error))
    };
    let hashes = names.par_iter().map(hash).collect::<Result<_>>()?;
    let report = sealed(Report::new(result, &files), hashes);
    write_bytes(&folder.join(REPORT), report.as_bytes())?;
    names.push(REPORT.into());
    Ok((names, report))
}

/// Draws pictures of detectors, side by side; some in true colours.
fn draw(pictures: &[(&Detector, PathBuf, Style, bool)]) -> Result<()> {
    pictures.par_iter().try_for_each(|(detector, path, style, in_true_colors)| match in_true_colors {
        true => png::write_true_colors(path, detector, *style),
        false => png::write_detector(path, detector, *style),
    })
}

pub(crate) fn write_bytes(path: &Path, bytes: &[u8]) -> Result<()> {
    step();
    let write = || -> io::Result<()> { File::create(path)?.write_all(bytes) };
    write().map_err(|error| Error::file(path, error))
}

fn sync_file(path: &Path) -> Result<()> {
    step();
    // Windows syncs only what is open for writing.
    let file = OpenOptions::new().write(true).open(path);
    file.and_then(|file| file.sync_all()).map_err(|error| Error::file(path, error))
}

/// Names the place that the user asked for, not the one where the file was first written.
fn relocate(error: Error, staged: &Path, dir: &Path) -> Error {
    let Error::File { path, problem } = error else { return error };
    let path = path.strip_prefix(staged).map_or_else(|_| path.clone(), |name| dir.join(name));
    Error::File { path, problem }
}

/// A file name without extension per detector: its name where the file system can carry it. File names are distinct
/// even where upper and lower case are the same.
pub(crate) fn file_stems<'a>(names: impl Iterator<Item = &'a str>) -> Vec<String> {
    // Names are compared after upper- and then lower-casing, so that letters such as long s and s count as equal.
    let folded = |stem: &str| stem.to_uppercase().to_lowercase();
    let mut taken = HashSet::from(["ray_paths".to_string(), "gradients".to_string()]);
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
    names.map(&mut distinct).collect()
}

/// The stems of the files of detectors, and of the pictures in true colours of those that see colour.
fn stems_with_colors<'a>(
    names: impl Iterator<Item = &'a str>,
    colored: impl Iterator<Item = &'a str>,
) -> (Vec<String>, Vec<String>) {
    let names: Vec<&str> = names.collect();
    let colored: Vec<String> = colored.map(|name| format!("{name}.color")).collect();
    let mut stems = file_stems(names.iter().copied().chain(colored.iter().map(String::as_str)));
    let of_colors = stems.split_off(names.len());
    (stems, of_colors)
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

/// The text of a report that knows its files, and itself.
fn sealed(mut report: Report, files: BTreeMap<String, FileHash>) -> String {
    report.set_meta(&Meta { files, sha256: NO_HASH.into() });
    let text = report.to_json();
    // Names of files and scenes stand before it, and might be zeros as well.
    let Some(place) = text.rfind(NO_HASH) else { return text };
    let hash = hex(&Sha256::digest(text.as_bytes()));
    [&text[..place], &hash, &text[place + NO_HASH.len()..]].concat()
}
