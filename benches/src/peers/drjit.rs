//! A hand-written Dr.Jit kernel of one scene.

use crate::cases::{Case, LENS_AXIS};
use crate::peers::child::{Files, PythonChild, Script};
use crate::peers::{Peer, PeerRun};
use nsq_gpu::Result;
use serde_json::json;
use std::collections::BTreeMap;
use std::path::Path;

/// A hand-written Dr.Jit kernel of the scene `lens_scene` (`drjit_peer.py`), in both precisions.
pub struct DrJit {
    files: Files,
    versions: BTreeMap<String, String>,
    child: PythonChild,
}

const SCRIPTS: [(&str, &str); 1] = [("drjit_peer.py", include_str!("../../../python/tools/drjit_peer.py"))];

impl DrJit {
    /// Starts the peer with a Python that has Mitsuba installed, which brings Dr.Jit.
    ///
    /// # Errors
    /// [`nsq_gpu::Error::Usage`] if this Python cannot run the peer.
    pub fn start(python: &Path) -> Result<Self> {
        let files = Files::new(&SCRIPTS)?;
        let script = Script { python, name: SCRIPTS[0].0, package: "Mitsuba (for Dr.Jit)" };
        let (child, versions) = PythonChild::start(&script, &files)?;
        Ok(DrJit { files, versions, child })
    }
}

impl Peer for DrJit {
    fn name(&self) -> &'static str {
        "drjit"
    }

    fn versions(&self) -> BTreeMap<String, String> {
        self.versions.clone()
    }

    fn takes(&self, case: &Case) -> bool {
        case.axis == LENS_AXIS
    }

    /// The first run compiles.
    fn warm_up(&mut self, case: &Case) -> Result<()> {
        self.run(case).map(|_| ())
    }

    fn run(&mut self, case: &Case) -> Result<Vec<PeerRun>> {
        let num_rays = case.num_rays;
        let scene = self.files.write_scene(&case.scene)?;
        let mut run = |precision| {
            let request = json!({"scene": scene, "num_rays": num_rays, "precision": precision});
            let answer = self.child.launch(&request, num_rays)?;
            Ok(PeerRun { precision, num_rays, seconds: answer.seconds, detected: answer.detected })
        };
        Ok(vec![run("f32")?, run("f64")?])
    }
}
