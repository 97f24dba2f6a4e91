//! A Python process that answers requests, line by line, in JSON.

use nsq_gpu::{Error, Result};
use serde::Deserialize;
use serde::de::DeserializeOwned;
use serde_json::Value;
use std::collections::BTreeMap;
use std::io::{BufRead, BufReader, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};
use tempfile::TempDir;

/// Scripts and the present scene, in a folder that is removed with the peer.
pub(super) struct Files(TempDir);

/// How a peer's script is run.
pub(super) struct Script<'a> {
    /// The Python that runs it.
    pub python: &'a Path,
    /// The script's name among the files.
    pub name: &'static str,
    /// The package that this Python must have installed.
    pub package: &'static str,
}

/// The process. Its first message names the versions that it runs.
pub(super) struct PythonChild {
    child: Child,
    requests: ChildStdin,
    answers: BufReader<ChildStdout>,
    name: &'static str,
}

/// The answer about a trace.
#[derive(Deserialize)]
pub(super) struct Answer {
    pub num_rays: u64,
    pub seconds: f64,
    /// Rays that ended on detectors.
    #[serde(default)]
    pub detected: Option<u64>,
}

impl Files {
    /// Writes scripts by their names.
    pub fn new(scripts: &[(&str, &str)]) -> Result<Self> {
        let folder = tempfile::tempdir().map_err(|error| Error::file(std::env::temp_dir(), error))?;
        let files = Files(folder);
        scripts.iter().try_for_each(|(name, text)| files.write(name, text).map(|_| ()))?;
        Ok(files)
    }

    /// Writes the present scene, in place of the one before.
    pub fn write_scene(&self, text: &str) -> Result<PathBuf> {
        self.write("scene.json", text)
    }

    fn write(&self, name: &str, text: &str) -> Result<PathBuf> {
        let path = self.0.path().join(name);
        std::fs::write(&path, text).map_err(|error| Error::file(&path, error))?;
        Ok(path)
    }
}

impl PythonChild {
    /// Starts Python, and waits for the versions that it runs.
    pub fn start(script: &Script, files: &Files) -> Result<(Self, BTreeMap<String, String>)> {
        let Script { python, package, .. } = script;
        let problem = |what: &str| {
            Error::Usage(format!(
                "{what} `{}`; --python names one that has {package} installed",
                python.display()
            ))
        };
        let mut child = Command::new(python)
            .arg(files.0.path().join(script.name))
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .map_err(|error| problem(&format!("{error}: there is no Python")))?;
        let (Some(requests), Some(answers)) = (child.stdin.take(), child.stdout.take()) else {
            return Err(Error::Internal("a child without pipes".into()));
        };
        let mut child = PythonChild { child, requests, answers: BufReader::new(answers), name: package };
        let versions = child.answer().map_err(|_| problem(&format!("{package} does not run in")))?;
        Ok((child, versions))
    }

    /// Asks for a trace of `num_rays` rays.
    pub fn launch(&mut self, request: &Value, num_rays: u64) -> Result<Answer> {
        writeln!(self.requests, "{request}").map_err(gone)?;
        let answer: Answer = self.answer()?;
        if answer.num_rays != num_rays {
            let launched = answer.num_rays;
            return Err(Error::Internal(format!("{} launched {launched} of {num_rays} rays", self.name)));
        }
        Ok(answer)
    }

    fn answer<T: DeserializeOwned>(&mut self) -> Result<T> {
        let mut line = String::new();
        self.answers.read_line(&mut line).map_err(gone)?;
        serde_json::from_str(&line).map_err(gone)
    }

    /// Ends the child's input, and waits until the child ends.
    pub fn finish(mut self) -> Result<()> {
        drop(self.requests);
        self.child.wait().map_err(gone).map(|_| ())
    }
}

/// The error of a child that has ended. The child wrote its reason to stderr, which it shares with this program.
pub(super) fn gone(error: impl std::fmt::Display) -> Error {
    Error::Usage(format!("the peer gave no answer: {error}"))
}
