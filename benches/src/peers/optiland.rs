//! Optiland's NumPy backend.

use crate::cases::{Case, Kind};
use crate::peers::child::{Files, PythonChild, Script};
use crate::peers::{Peer, PeerRun};
use nsq_gpu::Result;
use serde_json::json;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Optiland's NumPy backend, in float64.
pub struct Optiland {
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
    /// [`nsq_gpu::Error::Usage`] if this Python cannot run the peer.
    pub fn start(python: &Path, max_rays: u64) -> Result<Self> {
        let files = Files::new(&SCRIPTS)?;
        let (child, versions) = start_child(python, &files)?;
        Ok(Optiland { python: python.into(), max_rays, files, versions, child })
    }

    fn trace(&mut self, case: &Case, num_rays: u64) -> Result<f64> {
        let scene = self.files.write_scene(&case.scene)?;
        trace(&mut self.child, &scene, case, num_rays)
    }

    /// Times a whole process \[s\], from its start to its end.
    fn whole_command(&self, case: &Case) -> Result<f64> {
        let scene = self.files.write_scene(&case.scene)?;
        let start = Instant::now();
        let (mut child, _) = start_child(&self.python, &self.files)?;
        trace(&mut child, &scene, case, case.num_rays)?;
        child.finish()?;
        Ok(start.elapsed().as_secs_f64())
    }
}

fn start_child(python: &Path, files: &Files) -> Result<(PythonChild, BTreeMap<String, String>)> {
    let script = Script { python, name: SCRIPTS[0].0, package: "Optiland" };
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
