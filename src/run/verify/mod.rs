//! What of a result is proven: somebody is handed a folder, and asks.
//!
//! ```text
//! folder -> files    every file has its hash                            else: damaged
//!        -> sums     report and arrays are what tally.bin gives         else: damaged
//!        -> scene    the scene is the one that was traced               else: different
//!        -> ranges   ranges of the proof, traced again, have its bits    proven, else: different
//!        -> rays     without a proof: other rays agree within errors    consistent, else: different
//! ```
//!
//! Each step looks at everything, and the next one is taken only where nothing was found.

mod files;
mod finding;
mod like;
mod ranges;
mod rays;
mod sums;

pub use crate::run::proof::NUM_RANGES;
pub use crate::run::verify::files::Files;
pub use crate::run::verify::finding::Finding;
pub use crate::run::verify::ranges::{Proven, SampledRange};
pub use crate::run::verify::rays::{OtherRays, Quantity};

use crate::error::{Error, Result};
use crate::format::path_text;
use crate::gpu::AdapterChoice;
use crate::model::SceneIr;
use crate::result::TraceResult;
use crate::result::output::TALLY;
use crate::result::wavelengths_apart;
use crate::run::checkpoint::{self, Checkpoint, Identity};
use crate::scene::Scene;
use serde::Serialize;
use std::path::{Path, PathBuf};

/// Ranges of rays that are traced again, of the [`NUM_RANGES`] of a proof.
pub const DEFAULT_SAMPLE: u32 = 3;

/// The scene of a result that Python saved.
const SCENE: &str = "scene.json";

/// What of a result is proven.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Verdict {
    /// The files are whole, and ranges of the proof, traced again, have its bits.
    Proven,
    /// The files are whole, and other rays of the scene give the same within chance.
    Consistent,
    /// The files are whole, and nothing more is known.
    Whole,
    /// A file is not as it was written, or files contradict each other.
    Damaged,
    /// The files are whole, and the scene does not give this result.
    Different,
}

/// What was found out about a result.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Verification {
    /// The folder.
    pub result: PathBuf,
    /// What of it is proven.
    pub verdict: Verdict,
    /// What is wrong.
    pub findings: Vec<Finding>,
    /// What could not be looked at, and why.
    pub notes: Vec<String>,
    /// Its files.
    pub files: Files,
    /// True if report and arrays were computed anew from the sums.
    pub has_sums: bool,
    /// The scene that was traced.
    pub scene: Option<PathBuf>,
    /// What the ranges of the proof say; null without a proof.
    pub proof: Option<Proven>,
    /// How other rays agree with the result; null where the proof holds.
    pub other_rays: Option<OtherRays>,
}

impl Verification {
    fn end(mut self, verdict: Verdict, findings: Vec<Finding>) -> Self {
        (self.verdict, self.findings) = (verdict, findings);
        self
    }
}

/// Why no further step is taken.
enum Halt {
    /// The question cannot be answered.
    Error(Error),
    /// Something is wrong.
    Wrong(Verdict, Vec<Finding>),
}

type Step<T> = std::result::Result<T, Halt>;

impl From<Error> for Halt {
    fn from(error: Error) -> Self {
        Halt::Error(error)
    }
}

fn halt_if(verdict: Verdict, findings: Vec<Finding>) -> Step<()> {
    if findings.is_empty() { Ok(()) } else { Err(Halt::Wrong(verdict, findings)) }
}

/// A question about a result.
#[derive(Debug, Clone)]
pub struct Verify {
    dir: PathBuf,
    scene: Option<PathBuf>,
    sample: u32,
    adapter: AdapterChoice,
}

impl Verify {
    /// Asks about the result in a folder.
    pub fn of(dir: impl Into<PathBuf>) -> Self {
        let adapter = AdapterChoice::default();
        Verify { dir: dir.into(), scene: None, sample: DEFAULT_SAMPLE, adapter }
    }

    /// The scene that was traced. Otherwise the path that the result has of it is taken.
    #[must_use]
    pub fn scene(self, scene: Option<PathBuf>) -> Self {
        Verify { scene, ..self }
    }

    /// How much is traced again, in 64ths of the result's rays.
    #[must_use]
    pub fn sample(self, sample: u32) -> Self {
        Verify { sample, ..self }
    }

    /// The adapter that traces.
    #[must_use]
    pub fn adapter(self, adapter: AdapterChoice) -> Self {
        Verify { adapter, ..self }
    }

    /// Looks at the files alone, and traces nothing: [`Verdict::Whole`] where nothing is wrong with them.
    ///
    /// # Errors
    /// [`Error::NoResult`] if there is no result. [`Error::File`] if the folder cannot be read.
    pub fn files(&self) -> Result<Verification> {
        let mut findings = Vec::new();
        let files = files::check(&self.dir, &mut findings)?;
        let notes = match files.has_hashes {
            true => Vec::new(),
            false => {
                vec!["the result is of an older version, without hashes: damage may go unnoticed".into()]
            }
        };
        let found = Verification {
            result: self.dir.clone(),
            verdict: Verdict::Whole,
            findings: Vec::new(),
            notes,
            files,
            has_sums: false,
            scene: None,
            proof: None,
            other_rays: None,
        };
        let verdict = if findings.is_empty() { Verdict::Whole } else { Verdict::Damaged };
        Ok(found.end(verdict, findings))
    }

    /// Looks at everything.
    ///
    /// # Errors
    /// [`Error::NoResult`] if there is no result. [`Error::NoAdapter`] and [`Error::Device`] as a trace has them.
    pub fn go(&self) -> Result<Verification> {
        let mut found = self.files()?;
        if found.verdict == Verdict::Damaged {
            return Ok(found);
        }
        match self.steps(&mut found) {
            Ok(verdict) => Ok(found.end(verdict, Vec::new())),
            Err(Halt::Wrong(verdict, findings)) => Ok(found.end(verdict, findings)),
            Err(Halt::Error(error)) => Err(error),
        }
    }

    /// What comes after the files.
    fn steps(&self, found: &mut Verification) -> Step<Verdict> {
        if found.files.report.get("ledger").is_none() {
            let why =
                "the result is none of a trace, so that its files were compared with their hashes alone";
            found.notes.push(why.into());
            return Ok(Verdict::Whole);
        }
        let (stored, sums) = self.read(found)?;
        let Some((path, scene, mut ir)) = self.scene_of(&stored, found)? else {
            return Ok(Verdict::Whole);
        };
        found.scene = Some(path.clone());
        match &sums {
            Some(sums) => {
                sums.identity.set_sampling(&mut ir);
                self.compare_sums(found, &stored, sums, &path, &ir)?;
            }
            None => found.notes.push(format!("there is no {TALLY}: the arrays cannot be computed anew")),
        }
        if let Some(sums) = sums.as_ref().filter(|sums| sums.proof.is_some())
            && self.prove(found, &stored, sums, &scene, &ir)?
        {
            return Ok(Verdict::Proven);
        }
        if let Some(why) = rays::why_not(&stored, &found.files.report) {
            found.notes.push(why);
            return Ok(Verdict::Whole);
        }
        let other_rays = rays::trace(&stored, &scene, &ir, &found.files.sha256, self.sample, &self.adapter)?;
        let findings = other_rays.findings();
        found.other_rays = Some(other_rays);
        halt_if(Verdict::Different, findings)?;
        Ok(Verdict::Consistent)
    }

    /// The result and its sums, which agree about what was traced.
    fn read(&self, found: &Verification) -> Step<(TraceResult, Option<Checkpoint>)> {
        let mut findings = Vec::new();
        let path = self.dir.join(TALLY);
        let has_sums = path.exists() && found.files.has(TALLY);
        let sums = has_sums.then(|| Checkpoint::read(&path)).transpose();
        let (stored, sums) = (self.unless_damaged(TraceResult::read(&self.dir))?, self.unless_damaged(sums)?);
        sums::check_alone(&stored, &mut findings);
        if let Some(sums) = &sums {
            sums::check_identity(&stored.run, &sums.identity, &mut findings);
        }
        halt_if(Verdict::Damaged, findings)?;
        Ok((stored, sums))
    }

    /// A file that cannot be read as what it should be is damaged.
    fn unless_damaged<T>(&self, read: Result<T>) -> Step<T> {
        read.map_err(|error| match error {
            Error::File { .. } => Halt::Wrong(Verdict::Damaged, vec![Finding::of_error(&self.dir, &error)]),
            other => Halt::Error(other),
        })
    }

    fn compare_sums(
        &self,
        found: &mut Verification,
        stored: &TraceResult,
        sums: &Checkpoint,
        path: &Path,
        ir: &SceneIr,
    ) -> Step<()> {
        let Identity { scene_hash, version, .. } = &sums.identity;
        let hash = checkpoint::scene_hash(ir);
        if hash != *scene_hash {
            let problem = format!(
                "is not the scene that was traced: its hash is {hash:032x}, and the traced one's {scene_hash:032x}; \
                 --scene names another file"
            );
            return Err(Halt::Wrong(Verdict::Different, vec![Finding::of_file(&path_text(path), &problem)]));
        }
        if version != env!("CARGO_PKG_VERSION") {
            found.notes.push(format!("version {version} traced it: the arrays were not computed anew"));
            return Ok(());
        }
        let mut findings = Vec::new();
        sums::check(&self.dir, ir, stored, &found.files.report, sums, &mut findings)?;
        halt_if(Verdict::Damaged, findings)?;
        found.has_sums = true;
        Ok(())
    }

    /// Traces ranges of the proof again. True if they prove the result.
    fn prove(
        &self,
        found: &mut Verification,
        stored: &TraceResult,
        sums: &Checkpoint,
        scene: &Scene,
        ir: &SceneIr,
    ) -> Step<bool> {
        let Some(proof) = &sums.proof else { return Ok(false) };
        let mut findings = Vec::new();
        let num_rays = ranges::check(stored, (sums, proof), ir, &mut findings)?;
        halt_if(Verdict::Damaged, std::mem::take(&mut findings))?;
        let told = (stored, &found.files.report);
        let sample = (found.files.sha256.as_str(), self.sample);
        let proven = match ranges::trace(told, scene, ir, (sums, proof), sample, &self.adapter, &mut findings)
        {
            Ok(proven) => proven,
            Err(Error::Usage(why)) => {
                found.notes.push(format!("the ranges of the proof cannot be traced here: {why}"));
                return Ok(false);
            }
            Err(error) => return Err(error.into()),
        };
        findings.extend(proven.findings());
        let is_same = proven.is_same() && !proven.sampled.is_empty();
        let covers_all = num_rays == stored.num_rays_total;
        found.proof = Some(Proven { num_rays, ..proven });
        halt_if(Verdict::Different, findings)?;
        if !is_same {
            let why = "ranges that were traced again have other bits, as another adapter, driver or version may give";
            found.notes.push(why.into());
        } else if !covers_all {
            let all = stored.num_rays_total;
            found
                .notes
                .push(format!("the proof is of {num_rays} of {all} rays: parts of the result have none"));
        }
        Ok(is_same && covers_all)
    }

    /// The scene that was named, or the result's scene, with its path. `None` if the result's scene is missing by now.
    fn scene_of(
        &self,
        stored: &TraceResult,
        found: &mut Verification,
    ) -> Result<Option<(PathBuf, Scene, SceneIr)>> {
        let path = self.scene.clone().or_else(|| stored.run.scene.as_ref().map(PathBuf::from));
        let Some(path) = path else {
            found.notes.push("the result does not name its scene; --scene names it".into());
            return Ok(None);
        };
        let beside = self.dir.join(SCENE);
        let is_beside = self.scene.is_none() && found.files.is_known(SCENE) && beside.is_file();
        let path = if is_beside { beside } else { path };
        let scene = match Scene::from_path(&path) {
            Err(error @ Error::File { .. }) if self.scene.is_none() => {
                found.notes.push(format!("{error}; --scene names the scene where it has moved"));
                return Ok(None);
            }
            found => found.map_err(|error| error.in_scene(&path_text(&path)))?,
        };
        let ir = scene.lower()?;
        let ir = if stored.run.photometric { wavelengths_apart::keep_apart(&ir)? } else { ir };
        Ok(Some((path, scene, ir)))
    }
}
