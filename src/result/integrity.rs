//! How a damaged or edited file of a result is noticed: by its hash in `report.json`, which has one of itself, too.

use std::collections::BTreeMap;
use std::fs::File;
use std::io;
use std::path::Path;

use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use crate::error::{Error, Result};
use crate::format::hex;
use crate::result::file_names::REPORT;

/// Stands in the place of the report's own hash while that is computed.
pub(crate) const NO_HASH: &str = "0000000000000000000000000000000000000000000000000000000000000000";

/// What a report knows of the files of its result.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Meta {
    /// The files beside the report, by their names.
    pub files: BTreeMap<String, FileHash>,
    /// SHA-256 of the bytes of the report, with 64 zeros in the place of this hash.
    pub sha256: String,
}

/// What a file holds.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct FileHash {
    /// Length \[bytes\].
    pub bytes: u64,
    /// SHA-256 of its bytes.
    pub sha256: String,
}

/// What a file holds now.
///
/// # Errors
/// The system's error. Anything but a file has no hash.
pub fn hash_of(path: &Path) -> io::Result<FileHash> {
    if !path.metadata()?.is_file() {
        return Err(io::Error::other("is no file"));
    }
    let mut hasher = Sha256::new();
    let bytes = io::copy(&mut File::open(path)?, &mut hasher)?;
    Ok(FileHash { bytes, sha256: hex(&hasher.finalize()) })
}

/// Refuses the text of a report that is not as it was written.
///
/// # Errors
/// [`Error::File`] with the path.
pub fn check_report(path: &Path, text: &str, meta: &Meta) -> Result<()> {
    let blank = text
        .rfind(&meta.sha256)
        .filter(|_| meta.sha256.len() == NO_HASH.len())
        .map(|place| [&text[..place], NO_HASH, &text[place + NO_HASH.len()..]].concat());
    match blank {
        Some(blank) if hex(&Sha256::digest(blank.as_bytes())) == meta.sha256 => Ok(()),
        _ => Err(Error::file(path, "is damaged, or was edited: its hash is another one")),
    }
}

/// Refuses a file beside a report that is not as it was written.
///
/// # Errors
/// [`Error::File`] with the path.
pub fn check_file(dir: &Path, name: &str, meta: &Meta) -> Result<()> {
    let path = dir.join(name);
    let Some(hash) = meta.files.get(name) else {
        return Err(Error::file(path, format!("{REPORT} has no hash of it")));
    };
    let found = hash_of(&path).map_err(|error| Error::file(&path, error))?;
    if found == *hash {
        return Ok(());
    }
    Err(Error::file(
        path,
        format!("is damaged, was edited, or belongs to another trace: {REPORT} has another hash of it"),
    ))
}

/// Refuses a folder of which any file but pictures is not as it was written; false if it is too old to know.
///
/// # Errors
/// [`Error::File`] with the file.
pub fn check_folder(dir: &Path) -> Result<bool> {
    let path = dir.join(REPORT);
    let text = std::fs::read_to_string(&path).map_err(|error| Error::file(&path, error))?;
    let damaged = |error: serde_json::Error| Error::file(&path, format!("is damaged: {error}"));
    let report: serde_json::Value = serde_json::from_str(&text).map_err(damaged)?;
    let Some(meta) = report.get("meta") else { return Ok(false) };
    let meta = Meta::deserialize(meta).map_err(damaged)?;
    check_report(&path, &text, &meta)?;
    let is_read = |name: &&String| !name.ends_with(".png");
    meta.files.keys().filter(is_read).try_for_each(|name| check_file(dir, name, &meta))?;
    Ok(true)
}
