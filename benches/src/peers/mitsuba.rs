//! Mitsuba 3 with Embree.

use crate::cases::Case;
use crate::peers::child::{Files, PythonChild, Script};
use crate::peers::{Peer, PeerRun};
use nsq_gpu::Result;
use serde_json::json;
use std::collections::BTreeMap;
use std::path::Path;

/// Mitsuba 3 with Embree, in f32. `mitsuba_peer.py` wraps its search in a kernel of one search a ray.
pub struct Mitsuba {
    files: Files,
    versions: BTreeMap<String, String>,
    child: PythonChild,
}

const SCRIPTS: [(&str, &str); 1] =
    [("mitsuba_peer.py", include_str!("../../../python/tools/mitsuba_peer.py"))];
/// Sweeps whose rays end at the first surface that they meet.
const AXES: [&str; 3] = ["surfaces", "spheres", "meshes"];

impl Mitsuba {
    /// Starts the peer with a Python that has Mitsuba installed.
    ///
    /// # Errors
    /// [`nsq_gpu::Error::Usage`] if this Python cannot run the peer.
    pub fn start(python: &Path) -> Result<Self> {
        let files = Files::new(&SCRIPTS)?;
        let script = Script { python, name: SCRIPTS[0].0, package: "Mitsuba" };
        let (child, versions) = PythonChild::start(&script, &files)?;
        Ok(Mitsuba { files, versions, child })
    }
}

impl Peer for Mitsuba {
    fn name(&self) -> &'static str {
        "mitsuba"
    }

    fn versions(&self) -> BTreeMap<String, String> {
        self.versions.clone()
    }

    fn takes(&self, case: &Case) -> bool {
        AXES.contains(&case.axis)
    }

    /// The first run builds the scene and compiles.
    fn warm_up(&mut self, case: &Case) -> Result<()> {
        self.run(case).map(|_| ())
    }

    fn run(&mut self, case: &Case) -> Result<Vec<PeerRun>> {
        let num_rays = case.num_rays;
        let request = json!({"scene": self.files.write_scene(&case.scene)?, "num_rays": num_rays});
        let answer = self.child.launch(&request, num_rays)?;
        let detected = answer.detected;
        Ok(vec![PeerRun { precision: "f32", num_rays, seconds: answer.seconds, detected }])
    }
}
