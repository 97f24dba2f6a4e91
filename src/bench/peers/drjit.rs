//! A hand-written Dr.Jit kernel of one scene.

use super::child::gone;
use super::{Peer, PeerRun};
use crate::bench::cases::{Case, LENS_AXIS};
use crate::error::{Error, Result};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::Command;

/// A hand-written Dr.Jit kernel of the scene `lens_scene`: a script that takes the number of rays, traces them in both
/// precisions, and prints for each a line with `f32` or `f64`, `N=<rays>` and `Mpaths/s=<millions of rays a second>`.
pub struct DrJit {
    python: PathBuf,
    script: PathBuf,
}

impl DrJit {
    /// The script, and a Python that has Dr.Jit installed.
    ///
    /// # Errors
    /// [`Error::File`] if there is no such script.
    pub fn new(python: &Path, script: &Path) -> Result<Self> {
        std::fs::metadata(script).map_err(|error| Error::file(script, error))?;
        Ok(DrJit { python: python.into(), script: script.into() })
    }
}

impl Peer for DrJit {
    fn name(&self) -> &'static str {
        "drjit"
    }

    fn versions(&self) -> BTreeMap<String, String> {
        let ask = "from importlib.metadata import version; print(version('drjit'))";
        let output = Command::new(&self.python).args(["-c", ask]).output();
        let version = output.map_or(String::new(), |o| String::from_utf8_lossy(&o.stdout).trim().to_string());
        BTreeMap::from([("drjit".to_string(), version)])
    }

    fn takes(&self, case: &Case) -> bool {
        case.axis == LENS_AXIS
    }

    /// Its script compiles and warms up before it measures.
    fn warm_up(&mut self, _: &Case) -> Result<()> {
        Ok(())
    }

    fn run(&mut self, case: &Case) -> Result<Vec<PeerRun>> {
        let output = Command::new(&self.python).arg(&self.script).arg(case.num_rays.to_string()).output();
        let output = output.map_err(gone)?;
        let runs = drjit_runs(&String::from_utf8_lossy(&output.stdout));
        if runs.is_empty() {
            let said = String::from_utf8_lossy(&output.stderr);
            let last = said.lines().last().unwrap_or("it printed no timing").to_string();
            return Err(Error::Usage(format!("{}: {last}", self.script.display())));
        }
        match runs.iter().find(|run| run.num_rays != case.num_rays) {
            Some(run) => {
                Err(Error::Internal(format!("Dr.Jit launched {} of {} rays", run.num_rays, case.num_rays)))
            }
            None => Ok(runs),
        }
    }
}

/// The timings in what the script printed.
pub fn drjit_runs(printed: &str) -> Vec<PeerRun> {
    let run = |line: &str| {
        let words = || line.split_whitespace();
        let value = |key: &str| words().find_map(|word| word.strip_prefix(key));
        let precision =
            ["f32", "f64"].into_iter().find(|precision| words().any(|word| word == *precision))?;
        let num_rays: u64 = value("N=")?.parse().ok()?;
        let rays_per_sec = 1e6 * value("Mpaths/s=")?.parse::<f64>().ok()?;
        Some(PeerRun { precision, num_rays, seconds: num_rays as f64 / rays_per_sec, detected: None })
    };
    printed.lines().filter_map(run).collect()
}
