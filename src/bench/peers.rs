//! Other programs that trace the same cases, as children.

use crate::bench::accuracy::Estimate;
use crate::bench::cases::{Case, Kind, LENS_AXIS};
use crate::error::{Error, Result};
use serde::Deserialize;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::io::{BufRead, BufReader, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};
use std::time::Instant;
use tempfile::TempDir;

/// A program to compare with.
pub trait Peer {
    /// Its name in tables.
    fn name(&self) -> &'static str;
    /// Versions of what it is made of.
    fn versions(&self) -> BTreeMap<String, String>;
    /// True if it can trace the case.
    fn takes(&self, case: &Case) -> bool;
    /// Whatever should be done before the first run of a case.
    ///
    /// # Errors
    /// As [`Peer::run`].
    fn warm_up(&mut self, case: &Case) -> Result<()>;
    /// Traces the case once: a timing for each precision that it computes in.
    ///
    /// # Errors
    /// [`Error::Usage`] if it cannot be run, [`Error::Internal`] if it launched another number of rays.
    fn run(&mut self, case: &Case) -> Result<Vec<PeerRun>>;
}

/// One timing of a peer.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PeerRun {
    /// `f32` or `f64`.
    pub precision: &'static str,
    /// Rays launched.
    pub num_rays: u64,
    /// Time that they took \[s\].
    pub seconds: f64,
}

/// What computes in Optiland.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Backend {
    /// NumPy, in float64.
    Numpy,
    /// Torch, in float64 on the processor; alone where it is installed.
    Torch,
}

impl Backend {
    fn name(self) -> &'static str {
        match self {
            Backend::Numpy => "numpy",
            Backend::Torch => "torch",
        }
    }
}

/// A map to be traced by a peer: each ray in one pixel, and Optiland's default policy.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct MapRequest<'a> {
    /// Text of the scene's file.
    pub scene: &'a str,
    /// A detector of the kind `irradiance`.
    pub detector: &'a str,
    /// Rays to launch.
    pub num_rays: u64,
    /// Largest number of events of a ray.
    pub max_depth: u32,
    /// Seed of every draw.
    pub seed: u64,
}

/// Optiland's NumPy or Torch backend.
pub struct Optiland {
    backend: Backend,
    python: PathBuf,
    max_rays: u64,
    files: TempDir,
    versions: BTreeMap<String, String>,
    child: OptilandChild,
}

/// A Python process that traces one scene after another.
struct OptilandChild {
    child: Child,
    requests: ChildStdin,
    answers: BufReader<ChildStdout>,
}

/// What the child says of a trace.
#[derive(Deserialize)]
struct OptilandAnswer {
    num_rays: u64,
    seconds: f64,
    /// Share of the launched flux in every pixel.
    #[serde(default)]
    map: Vec<f64>,
}

/// The scripts of the child. The second is the module of the Python package that builds Optiland's scene of a file, and
/// needs nothing else of the package, so that Python need not have it installed.
const OPTILAND_SCRIPTS: [(&str, &str); 2] = [
    ("bench_peer.py", include_str!("../../python/tools/bench_peer.py")),
    ("scene_file.py", include_str!("../../python/nsq_gpu/scene_file.py")),
];
/// Rays that wake what is loaded at first use.
const WARM_UP_RAYS: u64 = 1000;

impl Optiland {
    /// Starts it with a Python that has Optiland installed. A trace of a warm process launches at most `max_rays`: its
    /// rate does not depend on their number.
    ///
    /// # Errors
    /// [`Error::Usage`] if this Python cannot run it.
    pub fn start(python: &Path, backend: Backend, max_rays: u64) -> Result<Self> {
        let files = tempfile::tempdir().map_err(|error| Error::file(std::env::temp_dir(), error))?;
        for (name, text) in OPTILAND_SCRIPTS {
            let path = files.path().join(name);
            std::fs::write(&path, text).map_err(|error| Error::file(path, error))?;
        }
        let (child, versions) = OptilandChild::start(python, backend, files.path())?;
        Ok(Optiland { backend, python: python.into(), max_rays, files, versions, child })
    }

    /// True if its Python has Torch installed.
    pub fn has_torch(&self) -> bool {
        self.versions.contains_key("torch")
    }

    /// Its name in charts.
    pub fn engine(&self) -> &'static str {
        match self.backend {
            Backend::Numpy => "optiland numpy",
            Backend::Torch => "optiland torch",
        }
    }

    /// Traces a map: its own time \[s\], and the map.
    ///
    /// # Errors
    /// As [`Peer::run`].
    pub fn map(&mut self, request: &MapRequest) -> Result<(f64, Estimate)> {
        let scene = self.write_scene(request.scene)?;
        let MapRequest { detector, num_rays, max_depth, seed, .. } = *request;
        let request = json!({"scene": scene, "num_rays": num_rays, "max_depth": max_depth, "seed": seed, "map": detector});
        let answer = self.child.launch(&request, num_rays)?;
        let total = answer.map.iter().sum();
        Ok((answer.seconds, Estimate { cells: answer.map, total }))
    }

    fn write_scene(&self, text: &str) -> Result<PathBuf> {
        let path = self.files.path().join("scene.json");
        std::fs::write(&path, text).map_err(|error| Error::file(&path, error))?;
        Ok(path)
    }

    fn trace(&mut self, case: &Case, num_rays: u64) -> Result<f64> {
        let scene = self.write_scene(&case.scene)?;
        self.child.trace(&scene, num_rays, case.max_depth)
    }

    /// A process of its own, from its start to its end.
    fn whole_command(&self, case: &Case) -> Result<f64> {
        let scene = self.write_scene(&case.scene)?;
        let start = Instant::now();
        let (mut child, _) = OptilandChild::start(&self.python, self.backend, self.files.path())?;
        child.trace(&scene, case.num_rays, case.max_depth)?;
        child.finish()?;
        Ok(start.elapsed().as_secs_f64())
    }
}

impl Peer for Optiland {
    fn name(&self) -> &'static str {
        "optiland"
    }

    fn versions(&self) -> BTreeMap<String, String> {
        self.versions.clone()
    }

    fn takes(&self, _: &Case) -> bool {
        true
    }

    fn warm_up(&mut self, case: &Case) -> Result<()> {
        match case.kind {
            Kind::Trace => self.trace(case, case.num_rays.min(WARM_UP_RAYS)).map(|_| ()),
            Kind::Command | Kind::ColdCommand => Ok(()),
        }
    }

    fn run(&mut self, case: &Case) -> Result<Vec<PeerRun>> {
        let (num_rays, seconds) = match case.kind {
            Kind::Trace => {
                let num_rays = case.num_rays.min(self.max_rays);
                (num_rays, self.trace(case, num_rays)?)
            }
            Kind::Command | Kind::ColdCommand => (case.num_rays, self.whole_command(case)?),
        };
        Ok(vec![PeerRun { precision: "f64", num_rays, seconds }])
    }
}

impl OptilandChild {
    /// Starts Python, and waits until it says which versions it runs.
    fn start(python: &Path, backend: Backend, files: &Path) -> Result<(Self, BTreeMap<String, String>)> {
        let problem = |what: &str| {
            Error::Usage(format!(
                "{what} `{}`; --python names one that has Optiland installed",
                python.display()
            ))
        };
        let mut child = Command::new(python)
            .arg(files.join(OPTILAND_SCRIPTS[0].0))
            .arg(backend.name())
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .map_err(|error| problem(&format!("{error}: there is no Python")))?;
        let (Some(requests), Some(answers)) = (child.stdin.take(), child.stdout.take()) else {
            return Err(Error::Internal("a child without pipes".into()));
        };
        let mut child = OptilandChild { child, requests, answers: BufReader::new(answers) };
        let versions = child.answer().map_err(|_| problem("Optiland does not run in"))?;
        Ok((child, versions))
    }

    fn trace(&mut self, scene: &Path, num_rays: u64, max_depth: u32) -> Result<f64> {
        let request = json!({"scene": scene, "num_rays": num_rays, "max_depth": max_depth});
        Ok(self.launch(&request, num_rays)?.seconds)
    }

    fn launch(&mut self, request: &Value, num_rays: u64) -> Result<OptilandAnswer> {
        writeln!(self.requests, "{request}").map_err(gone)?;
        let answer: OptilandAnswer = self.answer()?;
        if answer.num_rays != num_rays {
            let launched = answer.num_rays;
            return Err(Error::Internal(format!("Optiland launched {launched} of {num_rays} rays")));
        }
        Ok(answer)
    }

    fn answer<T: serde::de::DeserializeOwned>(&mut self) -> Result<T> {
        let mut line = String::new();
        self.answers.read_line(&mut line).map_err(gone)?;
        serde_json::from_str(&line).map_err(gone)
    }

    /// Ends its input, and waits for its end.
    fn finish(mut self) -> Result<()> {
        drop(self.requests);
        self.child.wait().map_err(gone).map(|_| ())
    }
}

/// The child wrote its reason to stderr, which it shares with this program.
fn gone(error: impl std::fmt::Display) -> Error {
    Error::Usage(format!("the peer gave no answer: {error}"))
}

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
        Some(PeerRun { precision, num_rays, seconds: num_rays as f64 / rays_per_sec })
    };
    printed.lines().filter_map(run).collect()
}
