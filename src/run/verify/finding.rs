//! What is wrong with a result, by file and place.

use crate::error::Error;
use crate::format::plain;
use crate::result::output::REPORT;
use serde::Serialize;
use std::path::Path;

/// Something that is wrong with a result.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Finding {
    /// The file.
    pub file: String,
    /// The place in it; empty if that is the whole file.
    pub place: String,
    /// What is wrong there.
    pub problem: String,
}

impl Finding {
    pub(super) fn at(file: &str, place: &str, problem: &str) -> Self {
        let [file, place, problem] = [file, place, problem].map(plain);
        Finding { file, place, problem }
    }

    pub(super) fn of_file(file: &str, problem: &str) -> Self {
        Finding::at(file, "", problem)
    }

    /// An error about a file in a folder.
    pub(super) fn of_error(dir: &Path, error: &Error) -> Self {
        match error {
            Error::File { path, problem } => {
                let name = path.strip_prefix(dir).unwrap_or(path);
                Finding::of_file(&name.display().to_string(), problem)
            }
            other => Finding::of_file(REPORT, &other.to_string()),
        }
    }
}
