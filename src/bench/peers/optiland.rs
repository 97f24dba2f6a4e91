//! Optiland's NumPy and Torch backends.

use crate::bench::accuracy::Estimate;
use crate::bench::cases::{Case, Kind};
use crate::bench::peers::child::{Files, PythonChild, Script};
use crate::bench::peers::{Peer, PeerRun};
use crate::error::Result;
use serde_json::json;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Optiland's backend.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Backend {
    /// NumPy, in float64.
    Numpy,
    /// Torch, in float64 on the processor. Torch is measured only where it is installed.
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

/// A request to trace a map: each ray lands in one pixel, with Optiland's default policy.
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
    files: Files,
    versions: BTreeMap<String, String>,
    child: PythonChild,
}

/// The scripts of the child. The second is a module of the Python package, which builds Optiland's scene from a file.
/// That module needs nothing else of the package, so Python need not have the package installed.
const SCRIPTS: [(&str, &str); 2] = [
    ("bench_peer.py", include_str!("../../../python/tools/bench_peer.py")),
    ("scene_file.py", include_str!("../../../python/nsq_gpu/scene_file.py")),
];
/// Rays of a first trace, which loads what is loaded at first use.
const WARM_UP_RAYS: u64 = 1000;

impl Optiland {
    /// Starts the peer with a Python that has Optiland installed. A trace in a warm process launches at most
    /// `max_rays`, because its rate does not depend on their number.
    ///
    /// # Errors
    /// [`crate::Error::Usage`] if this Python cannot run the peer.
    pub fn start(python: &Path, backend: Backend, max_rays: u64) -> Result<Self> {
        let files = Files::new(&SCRIPTS)?;
        let (child, versions) = start_child(python, backend, &files)?;
        Ok(Optiland { backend, python: python.into(), max_rays, files, versions, child })
    }

    /// True if the peer's Python has Torch installed.
    pub fn has_torch(&self) -> bool {
        self.versions.contains_key("torch")
    }

    /// The peer's name in charts.
    pub fn engine(&self) -> &'static str {
        match self.backend {
            Backend::Numpy => "optiland numpy",
            Backend::Torch => "optiland torch",
        }
    }

    /// Traces a map. Returns the time by Optiland's clock \[s\], and the map.
    ///
    /// # Errors
    /// As [`Peer::run`].
    pub fn map(&mut self, request: &MapRequest) -> Result<(f64, Estimate)> {
        let scene = self.files.write_scene(request.scene)?;
        let MapRequest { detector, num_rays, max_depth, seed, .. } = *request;
        let request = json!({"scene": scene, "num_rays": num_rays, "max_depth": max_depth, "seed": seed, "map": detector});
        let answer = self.child.launch(&request, num_rays)?;
        let total = answer.map.iter().sum();
        Ok((answer.seconds, Estimate { cells: answer.map, total }))
    }

    fn trace(&mut self, case: &Case, num_rays: u64) -> Result<f64> {
        let scene = self.files.write_scene(&case.scene)?;
        trace(&mut self.child, &scene, case, num_rays)
    }

    /// Times a whole process \[s\], from its start to its end.
    fn whole_command(&self, case: &Case) -> Result<f64> {
        let scene = self.files.write_scene(&case.scene)?;
        let start = Instant::now();
        let (mut child, _) = start_child(&self.python, self.backend, &self.files)?;
        trace(&mut child, &scene, case, case.num_rays)?;
        child.finish()?;
        Ok(start.elapsed().as_secs_f64())
    }
}

fn start_child(
    python: &Path,
    backend: Backend,
    files: &Files,
) -> Result<(PythonChild, BTreeMap<String, String>)> {
    let script = Script { python, name: SCRIPTS[0].0, argument: Some(backend.name()), package: "Optiland" };
    PythonChild::start(&script, files)
}

/// Times a trace \[s\], by Optiland's own clock.
fn trace(child: &mut PythonChild, scene: &Path, case: &Case, num_rays: u64) -> Result<f64> {
    let request = json!({"scene": scene, "num_rays": num_rays, "max_depth": case.max_depth});
    Ok(child.launch(&request, num_rays)?.seconds)
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
        Ok(vec![PeerRun { precision: "f64", num_rays, seconds, detected: None }])
    }
}
