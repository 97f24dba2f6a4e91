//! The one error type of this crate: where in the user's file, what is wrong, and what would be right.

use std::path::PathBuf;

use crate::format::path_text;

/// Everything that can go wrong between a scene file and its results.
///
/// Each variant has one exit code ([`Error::exit_code`]), the same for the command and for programs that run it.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Error {
    /// The scene file is malformed, incomplete, absurd or unsupported.
    #[error("{place}: {problem}; {remedy}")]
    Scene {
        /// Path in the file, such as `components[2].config.thickness`, or `line 4, column 7` for a syntax error.
        place: String,
        /// What is wrong there.
        problem: String,
        /// What would be right.
        remedy: String,
    },
    /// The options given to the command or the library contradict each other or the scene.
    #[error("{0}")]
    Usage(String),
    /// No adapter was found, or none that fits the request.
    #[error("{0}")]
    NoAdapter(String),
    /// The device was lost or ran out of memory during the trace.
    #[error("{0}")]
    Device(String),
    /// A tolerance that the user asked for was not met.
    #[error("{0}")]
    Tolerance(String),
    /// A file could not be read or written.
    #[error("{}: {problem}", path_text(path))]
    File {
        /// The file or folder.
        path: PathBuf,
        /// What the operating system said.
        problem: String,
    },
    /// There is no result where one was named.
    #[error("{}: {problem}; name a folder that `nsq-gpu trace -o` wrote", path_text(path))]
    NoResult {
        /// What was named.
        path: PathBuf,
        /// What is there instead.
        problem: String,
    },
    /// What has no reverse pass, such as a function of the shader. Forward derivatives take its place.
    #[error("there is no reverse pass through {0}")]
    NoWayBack(String),
    /// The trace was interrupted; partial results were kept.
    #[error("interrupted")]
    Interrupted,
    /// A defect of this program: the message says what to report.
    #[error("internal error: {0} (please report this with the scene)")]
    Internal(String),
}

/// Shorthand for results of this crate.
pub type Result<T> = std::result::Result<T, Error>;

impl Error {
    /// An error at a place of the scene file.
    pub fn scene(place: impl Into<String>, problem: impl Into<String>, remedy: impl Into<String>) -> Self {
        Error::Scene { place: place.into(), problem: problem.into(), remedy: remedy.into() }
    }

    /// The same error. If it is about a scene's contents, the scene's name stands before the place.
    #[must_use]
    pub fn in_scene(self, name: &str) -> Self {
        match self {
            Error::Scene { place, problem, remedy } => {
                Error::Scene { place: format!("{name}: {place}"), problem, remedy }
            }
            other => other,
        }
    }

    /// An internal error that wraps another error with the causes of that error: naga names the faulty expression
    /// there.
    pub fn internal(what: &str, error: &dyn std::error::Error) -> Self {
        let causes = std::iter::successors(Some(error), |error| error.source()).map(ToString::to_string);
        Error::Internal(format!("{what}: {}", causes.collect::<Vec<_>>().join(": ")))
    }

    /// An error at a file or folder.
    pub fn file(path: impl Into<PathBuf>, problem: impl std::fmt::Display) -> Self {
        Error::File { path: path.into(), problem: problem.to_string() }
    }

    /// The process exit code: 1 internal, 2 usage, 3 scene, or no result, 4 no adapter, 5 device lost or out of memory. Further
    /// codes: 6 tolerance not met, 130 interrupted. An unreadable scene or unwritable output is a usage error.
    pub fn exit_code(&self) -> u8 {
        match self {
            Error::Internal(_) | Error::NoWayBack(_) => 1,
            Error::Usage(_) | Error::File { .. } => 2,
            Error::Scene { .. } | Error::NoResult { .. } => 3,
            Error::NoAdapter(_) => 4,
            Error::Device(_) => 5,
            Error::Tolerance(_) => 6,
            Error::Interrupted => 130,
        }
    }
}
