//! Keeps the raw sums of a trace in a file: to resume a trace, and to add up traces of several machines.
//!
//! A file is little-endian. Its header has the eight bytes `NSQTALLY`, and the version of the format (u32). The length
//! of the rest (u64) and the CRC-32 of the rest (u32) follow. Then come an [`Identity`] and a [`Tally`], in the
//! encoding of [postcard](https://docs.rs/postcard), and with a proof a [`Proof`]. A file holds no time, so that equal sums are equal files.
//!
//! A file is written to a hidden file beside its place, which is then renamed. Whatever happens meanwhile, a whole file
//! is there: the new one or the one before.

use crate::error::{Error, Result};
use crate::format::plain;
use crate::gpu::AdapterInfo;
use crate::guide::Guide;
use crate::model::{ReflectProb, Sampling, ScatterSampling, SceneIr};
use crate::placing;
use crate::result::output::{REPORT, SUMS_MAGIC, TALLY, holds_sums};
use crate::result::wavelengths_apart;
use crate::result::{DetectorTally, Tally, integrity};
use crate::run::proof::Proof;
use crate::run::{Collect, RecordPaths, TraceOptions};
use serde::{Deserialize, Serialize};
use std::fmt::Write as _;
use std::fs;
use std::path::{Path, PathBuf};

/// Version of the format.
pub const FORMAT: u32 = 7;
/// The same of a file whose sums have a proof, which follows them.
pub const FORMAT_WITH_PROOF: u32 = 8;

const HEADER_BYTES: usize = 24;

/// Identifies the trace to which sums belong.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Identity {
    /// Version of the program.
    pub version: String,
    /// Path of the scene file, as the user gave it.
    pub scene: Option<String>,
    /// Hash of the lowered scene, without its sampling policy.
    pub scene_hash: u128,
    /// The sampling policy.
    pub sampling: String,
    /// Number of rays that the trace was planned with.
    pub num_rays: u64,
    /// Id of the first ray.
    pub first_ray: u64,
    /// Number of rays of the larger trace of which this trace is a part, if it is one.
    pub of_rays: Option<u64>,
    /// Seed of the draws.
    pub seed: u64,
    /// Largest number of events of a ray.
    pub max_depth: u32,
    /// Roulette threshold, as the user gave it.
    pub min_flux_fraction: f64,
    /// Precision: `f32`, `df64` or `f64`.
    pub precision: String,
    /// Kind of draws: `pcg` or `sobol`.
    pub sampler: String,
    /// Which paths are recorded.
    pub paths: String,
    /// The table of paths.
    pub path_table: String,
    /// The filter of paths.
    pub path_filter: String,
    /// Whether second moments are summed.
    pub standard_error: String,
    /// What guided the rays, if they were guided.
    pub guide: Option<Guide>,
    /// Name of the adapter.
    pub adapter: String,
    /// The adapter's driver, and whether arithmetic was strict.
    pub driver: String,
}

/// The sums of a trace, and its identity.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Checkpoint {
    /// The trace.
    pub identity: Identity,
    /// The sums so far.
    pub tally: Tally,
    /// Their proof, if it was kept.
    #[serde(skip)]
    pub proof: Option<Proof>,
}

/// The hash of what guided rays.
fn hash_of(identity: &Identity) -> String {
    identity.guide.as_ref().map_or("none".into(), Guide::hash)
}

/// Stands between a sampling policy and how scattering was drawn.
const SCATTERING: &str = ", scattering ";

/// The sampling policy, and how scattering was drawn on purpose, if it was.
fn sampling_text(ir: &SceneIr) -> String {
    let policy = format!("{:?}", ir.sampling);
    match ir.scatter_sampling.is_empty() {
        true => policy,
        false => policy + SCATTERING + &serde_json::to_string(&ir.scatter_sampling).unwrap_or_default(),
    }
}

/// Marks the identity of sums whose recorded paths are in a file of their own.
const PATHS_APART: &str = ", in ray_paths.npz alone";

/// What differs between two lists of fields, each as text that is not long.
fn apart(theirs: &str, ours: &str) -> (String, String) {
    const LONGEST: usize = 120;
    let fields = |text: &str| -> Vec<String> { text.split(", ").map(String::from).collect() };
    let (theirs, ours) = (fields(theirs), fields(ours));
    let of = |fields: &[String], others: &[String]| {
        let more: Vec<&str> =
            fields.iter().filter(|field| !others.contains(field)).map(String::as_str).collect();
        let text = if more.is_empty() { "no more".to_owned() } else { more.join(", ") };
        match text.char_indices().nth(LONGEST) {
            Some((end, _)) => format!("{}…", &text[..end]),
            None => text,
        }
    };
    (of(&theirs, &ours), of(&ours, &theirs))
}

impl Identity {
    /// The identity of a trace of `ir` on an adapter.
    pub fn new(ir: &SceneIr, scene: Option<String>, options: &TraceOptions, adapter: &AdapterInfo) -> Self {
        Identity {
            version: env!("CARGO_PKG_VERSION").into(),
            scene,
            scene_hash: scene_hash(ir),
            sampling: sampling_text(ir),
            num_rays: options.num_rays,
            first_ray: options.first_ray,
            of_rays: options.of_rays,
            seed: options.seed,
            max_depth: options.max_depth,
            min_flux_fraction: options.min_flux_fraction,
            precision: options.precision.name().into(),
            sampler: options.sampler.name().into(),
            paths: format!("{:?}", options.paths),
            path_table: match options.collect {
                Collect::Paths { rows, ends: false } => format!("{rows} rows"),
                Collect::Paths { rows, ends: true } => format!("{rows} rows with all ends"),
                _ => "none".into(),
            },
            path_filter: options.path_filter.as_ref().map_or("none".into(), |filter| filter.text.clone()),
            standard_error: format!("{:?}", options.standard_error).to_lowercase(),
            guide: options.guide.as_deref().cloned(),
            adapter: adapter.name.clone(),
            driver: options.driver(adapter),
        }
    }

    /// Gives a scene the sampling of the trace, which options may have changed.
    pub(crate) fn set_sampling(&self, ir: &mut SceneIr) {
        if let Some(policy) = self.sampling_policy() {
            (ir.sampling, ir.scatter_sampling) = policy;
        }
    }

    /// The sampling policy, and how scattering was drawn on purpose, read from their text; `None` if another version wrote it.
    fn sampling_policy(&self) -> Option<(Sampling, Vec<ScatterSampling>)> {
        let (policy, scattering) = match self.sampling.split_once(SCATTERING) {
            Some((policy, json)) => (policy, serde_json::from_str(json).ok()?),
            None => (self.sampling.as_str(), Vec::new()),
        };
        let fields = policy.strip_prefix("Sampling { ")?.strip_suffix(" }")?;
        let mut found = Sampling::default();
        for field in fields.split(", ") {
            let (name, value) = field.split_once(": ")?;
            match name {
                "reflect_prob" => found.reflect_prob = reflect_prob(value)?,
                "rr_start_flux" => found.rr_start_flux = value.parse().ok()?,
                "split_depth" => found.split_depth = value.parse().ok()?,
                "split_budget" => found.split_budget = value.parse().ok()?,
                _ => return None,
            }
        }
        (format!("{found:?}") == policy).then_some((found, scattering))
    }

    /// The differences that prevent adding the sums of two traces, one line each: `what: theirs there, ours here`.
    pub fn differences(&self, theirs: &Identity) -> Vec<String> {
        let scene = |identity: &Identity| {
            let path = identity.scene.as_deref().unwrap_or("a scene");
            format!("{path} ({:032x})", identity.scene_hash)
        };
        let mut lines = Vec::new();
        if self.scene_hash != theirs.scene_hash {
            lines.push(format!("scene: {} there, {} here", scene(theirs), scene(self)));
        }
        let mut compare = |what: &str, theirs: &dyn std::fmt::Display, ours: &dyn std::fmt::Display| {
            let (theirs, ours) = (theirs.to_string(), ours.to_string());
            if theirs != ours {
                lines.push(format!("{what}: {theirs} there, {ours} here"));
            }
        };
        compare("version of the program", &theirs.version, &self.version);
        compare("seed", &theirs.seed, &self.seed);
        compare("precision", &theirs.precision, &self.precision);
        compare("sampler", &theirs.sampler, &self.sampler);
        compare("max_depth", &theirs.max_depth, &self.max_depth);
        compare("min_flux_fraction", &theirs.min_flux_fraction, &self.min_flux_fraction);
        let (of_theirs, of_ours) = apart(&theirs.sampling, &self.sampling);
        compare("sampling", &of_theirs, &of_ours);
        compare("standard errors", &theirs.standard_error, &self.standard_error);
        compare("recorded paths", &theirs.paths, &self.paths);
        compare("table of paths", &theirs.path_table, &self.path_table);
        compare("filter of paths", &theirs.path_filter, &self.path_filter);
        compare("guide", &hash_of(theirs), &hash_of(self));
        // A file may hold any text.
        lines.iter().map(|line| plain(line)).collect()
    }

    /// The same identity, with the rows of recorded paths in a file of their own instead of among the sums.
    #[must_use]
    pub fn with_paths_apart(mut self) -> Self {
        if self.paths != format!("{:?}", RecordPaths::None) {
            self.paths += PATHS_APART;
        }
        self
    }

    fn has_paths_apart(&self) -> bool {
        self.paths.ends_with(PATHS_APART)
    }

    /// [`Identity::differences`], and further ones that would prevent resuming a trace. Parts of a trace may differ in
    /// these; a trace and its own beginning may not.
    pub fn differences_from_beginning(&self, theirs: &Identity) -> Vec<String> {
        let mut lines = self.differences(theirs);
        let whole =
            |rays: Option<u64>| rays.map_or("a trace of its own".into(), |rays| format!("part of {rays}"));
        for (what, theirs, ours) in [
            ("rays", theirs.num_rays.to_string(), self.num_rays.to_string()),
            ("first ray", theirs.first_ray.to_string(), self.first_ray.to_string()),
            ("rays are", whole(theirs.of_rays), whole(self.of_rays)),
        ] {
            if theirs != ours {
                lines.push(format!("{what}: {theirs} there, {ours} here"));
            }
        }
        lines
    }

    /// True if the same compiler compiled the same shaders: equal rays then have equal bits.
    pub fn same_device(&self, other: &Identity) -> bool {
        (&self.adapter, &self.driver) == (&other.adapter, &other.driver)
    }
}

fn reflect_prob(text: &str) -> Option<ReflectProb> {
    match text {
        "Fresnel" => Some(ReflectProb::Fresnel),
        "Auto" => Some(ReflectProb::Auto),
        constant => {
            let number = constant.strip_prefix("Constant(")?.strip_suffix(")")?;
            number.parse().ok().map(ReflectProb::Constant)
        }
    }
}

impl Checkpoint {
    /// Refuses sums that lack their rows of ray databases or paths. `option` names the option that would have kept the
    /// rows.
    ///
    /// # Errors
    /// [`Error::Usage`] with the path and the option.
    pub fn check_rows(&self, path: &Path, option: &str) -> Result<()> {
        let recorded = |detector: &DetectorTally| detector.recorded.count > detector.rows.len() as u64;
        if !self.tally.detectors.iter().any(recorded) && !self.identity.has_paths_apart() {
            return Ok(());
        }
        Err(Error::Usage(format!(
            "{} holds the sums of its rays, but not the rows of ray databases or paths; trace it with {option}, which keeps \
             them together",
            path.display()
        )))
    }

    /// Refuses sums of a file that no trace of the scene gives: [`Tally::check`].
    ///
    /// # Errors
    /// [`Error::File`] with the path and what is wrong.
    pub fn check(&self, path: &Path, ir: &SceneIr) -> Result<()> {
        self.tally.check(ir).map_err(|problem| Error::file(path, problem))
    }

    /// The contents of a file.
    ///
    /// # Errors
    /// [`Error::Internal`] if the sums cannot be encoded.
    pub fn to_bytes(&self) -> Result<Vec<u8>> {
        encode(&self.identity, &self.tally, self.proof.as_ref())
    }

    /// Reads a file. For a folder, reads the file that a trace wrote there.
    ///
    /// # Errors
    /// [`Error::File`] if the file cannot be read, is damaged, or has another format.
    pub fn read(path: &Path) -> Result<Self> {
        let is_folder = path.is_dir();
        if is_folder && path.join(REPORT).is_file() {
            integrity::check_folder(path)?;
        }
        let path = if is_folder { path.join(TALLY) } else { PathBuf::from(path) };
        if path.exists() && !path.is_file() {
            return Err(Error::file(path, "is no file"));
        }
        let bytes = fs::read(&path).map_err(|error| Error::file(&path, error))?;
        decode(&bytes).map_err(|problem| Error::file(&path, problem))
    }
}

/// Writes the sums of a trace so far. An existing file is replaced in one step.
///
/// # Errors
/// [`Error::File`] if the file cannot be written; an existing file then stays.
pub fn write(path: &Path, identity: &Identity, tally: &Tally, proof: Option<&Proof>) -> Result<()> {
    let bytes = encode(identity, tally, proof)?;
    check_is_own(path)?;
    placing::replace_file(path, &bytes).map_err(|error| Error::file(path, placing::own_word(error)))
}

/// Checks before a long trace whether [`write`] could write a file.
///
/// # Errors
/// [`Error::File`] if it could not, or if anything but a file of sums would be lost.
pub fn check_writable(path: &Path) -> Result<()> {
    check_is_own(path)?;
    placing::check_folder_of(path).map_err(|error| Error::file(path, placing::own_word(error)))
}

/// How many rays of a trace a file holds already. A missing or empty file holds 0.
///
/// # Errors
/// [`Error::File`] if the file holds the sums of another trace, or damaged ones. With `overwrite` such a file holds 0.
pub fn rays_in(path: &Path, identity: &Identity, overwrite: bool) -> Result<u64> {
    if path.symlink_metadata().map_or(0, |found| found.len()) == 0 {
        return Ok(0);
    }
    let refused = |problem: String| match overwrite {
        true => Ok(0),
        false => Err(Error::file(
            path,
            format!("{problem}; --overwrite replaces it, or name another file for the sums of this trace"),
        )),
    };
    match Checkpoint::read(path) {
        Ok(found) => match identity.differences_from_beginning(&found.identity) {
            differences if differences.is_empty() => Ok(found.tally.launched.count),
            differences => refused(format!("holds the sums of another trace: {}", differences.join("; "))),
        },
        Err(Error::File { problem, .. }) => refused(problem),
        Err(error) => Err(error),
    }
}

/// Refuses to replace anything but a file of sums. An empty file holds nothing that could be lost.
fn check_is_own(path: &Path) -> Result<()> {
    let refused = |what: &str| {
        Err(Error::file(
            path,
            format!("{what}; sums replace only a file of sums: name another one, or move this one away"),
        ))
    };
    match path.symlink_metadata() {
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => match path.file_name() {
            Some(_) => Ok(()),
            None => refused("is no name of a file"),
        },
        Err(error) => Err(Error::file(path, error)),
        Ok(found) if found.is_dir() => refused("is a folder"),
        Ok(found) if found.is_symlink() => refused("is a link"),
        Ok(found) if found.is_file() && (found.len() == 0 || holds_sums(path)) => Ok(()),
        Ok(_) => refused("is no file of sums of this program"),
    }
}

pub(crate) fn encode(identity: &Identity, tally: &Tally, proof: Option<&Proof>) -> Result<Vec<u8>> {
    let unencoded = |error| Error::Internal(format!("encoding the sums: {error}"));
    let mut bytes = vec![0; HEADER_BYTES];
    bytes = postcard::to_extend(&(identity, tally), bytes).map_err(unencoded)?;
    let mut format = FORMAT;
    if let Some(proof) = proof {
        bytes = postcard::to_extend(proof, bytes).map_err(unencoded)?;
        format = FORMAT_WITH_PROOF;
    }
    let (length, sum) = (bytes.len() - HEADER_BYTES, crc32fast::hash(&bytes[HEADER_BYTES..]));
    bytes[..8].copy_from_slice(SUMS_MAGIC);
    bytes[8..12].copy_from_slice(&format.to_le_bytes());
    bytes[12..20].copy_from_slice(&(length as u64).to_le_bytes());
    bytes[20..24].copy_from_slice(&sum.to_le_bytes());
    Ok(bytes)
}

fn decode(bytes: &[u8]) -> std::result::Result<Checkpoint, String> {
    let Some((header, body)) = bytes.split_at_checked(HEADER_BYTES).filter(|_| bytes.starts_with(SUMS_MAGIC))
    else {
        return Err("is no file of sums of this program".into());
    };
    let word = |at: usize| u32::from_le_bytes([header[at], header[at + 1], header[at + 2], header[at + 3]]);
    let format = word(8);
    if ![FORMAT, FORMAT_WITH_PROOF].contains(&format) {
        return Err(format!(
            "is of format {format}; this program reads format {FORMAT} and {FORMAT_WITH_PROOF}"
        ));
    }
    let length = u64::from(word(12)) | (u64::from(word(16)) << 32);
    if length != body.len() as u64 {
        return Err(format!("is damaged: {} bytes where {length} should be", body.len()));
    }
    if word(20) != crc32fast::hash(body) {
        return Err("is damaged: its checksum is wrong".into());
    }
    let damaged = |error| format!("is damaged: {error}");
    let (mut checkpoint, mut rest): (Checkpoint, _) = postcard::take_from_bytes(body).map_err(damaged)?;
    if format == FORMAT_WITH_PROOF {
        let (proof, behind) = postcard::take_from_bytes(rest).map_err(damaged)?;
        (checkpoint.proof, rest) = (Some(proof), behind);
    }
    // A device would read beyond the end of a bad table.
    if let Some(problem) = checkpoint.identity.guide.as_ref().and_then(Guide::problem) {
        return Err(format!("has a guide that {problem}"));
    }
    match rest {
        [] => Ok(checkpoint),
        rest => Err(format!("is damaged: {} bytes follow its sums", rest.len())),
    }
}

/// The hash FNV-1a with 128 bits: stable between versions of Rust, and not secret.
struct Fnv(u128);

impl std::fmt::Write for Fnv {
    fn write_str(&mut self, text: &str) -> std::fmt::Result {
        for byte in text.bytes() {
            self.0 = (self.0 ^ u128::from(byte)).wrapping_mul(0x0000_0000_0100_0000_0000_0000_0000_013B);
        }
        Ok(())
    }
}

/// The scene of this hash: as it is, or one that keeps light of each wavelength apart. `None` if the hash is another's.
pub fn scene_of_hash(ir: SceneIr, hash: u128) -> Option<SceneIr> {
    if scene_hash(&ir) == hash {
        return Some(ir);
    }
    wavelengths_apart::keep_apart(&ir).ok().filter(|apart| scene_hash(apart) == hash)
}

/// The hash of a scene without its sampling policy. Rust writes every float so that it reads back to the same bits.
pub fn scene_hash(ir: &SceneIr) -> u128 {
    let mut hash = Fnv(0x6C62_272E_07BB_0142_62B8_2175_6295_C58D);
    let SceneIr {
        wavelengths,
        media,
        surfaces,
        meshes,
        sources,
        detectors,
        sampling: _,
        scatter_sampling: _,
        allowed: _,
    } = ir;
    // Writing to Fnv never fails.
    let _ = write!(hash, "{wavelengths:?}{media:?}{surfaces:?}{meshes:?}{sources:?}{detectors:?}");
    hash.0
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use crate::model::scatter_sampling::{Target, TargetShape};
    use crate::result::{DetectorTally, FluxSum, Moments};
    use crate::run::proof::{PartProof, RangeProof};

    #[test]
    fn the_sampling_policy_is_read_back() {
        let identity = checkpoint().identity;
        let ir = crate::Scene::from_json(include_str!("../../docs/example.json")).unwrap().lower().unwrap();
        for reflect_prob in [ReflectProb::Fresnel, ReflectProb::Auto, ReflectProb::Constant(0.1 + 0.2)] {
            let policy = Sampling { reflect_prob, rr_start_flux: 1e-300, split_depth: 7, split_budget: 4.3 };
            let target = |half_angle| Target {
                share: 0.1 + 0.2,
                shape: TargetShape::Cone { axis: [0.1, 0.2, 0.3], half_angle },
            };
            let scattering =
                ScatterSampling { prob: Some(1.0 / 3.0), targets: vec![target(1e-3), target(0.7)] };
            for scatter_sampling in [vec![], vec![scattering, ScatterSampling::default()]] {
                let ir =
                    SceneIr { sampling: policy, scatter_sampling: scatter_sampling.clone(), ..ir.clone() };
                let written = Identity { sampling: sampling_text(&ir), ..identity.clone() };
                assert_eq!(written.sampling_policy(), Some((policy, scatter_sampling)));
            }
        }
        for other in
            ["", "Sampling {  }", "Sampling { split_depth: 1 }", "Sampling { other: 1, split_depth: 1 }"]
        {
            let written = Identity { sampling: other.into(), ..identity.clone() };
            assert_eq!(written.sampling_policy(), None, "{other}");
        }
    }

    fn checkpoint() -> Checkpoint {
        let detector = DetectorTally {
            quanta: vec![0, u128::MAX, 1 << 52],
            hits: vec![0, u64::MAX, 1],
            squares: vec![0, 3, 1 << 100],
            totals: vec![Moments { quanta: 5, squares: u128::MAX }],
            replicates: vec![1, u128::MAX],
            ..DetectorTally::default()
        };
        let launched = FluxSum { count: 7, quanta: 7 << 52 };
        let tally = Tally { launched, detectors: vec![detector], ..Tally::default() };
        let identity = Identity {
            version: "0.1.0".into(),
            scene: Some("scene.json".into()),
            scene_hash: 1 << 127,
            sampling: "fresnel".into(),
            num_rays: 100,
            first_ray: 1 << 40,
            of_rays: Some(u64::MAX),
            seed: 3,
            max_depth: 16,
            min_flux_fraction: 1e-6,
            precision: "f64".into(),
            sampler: "pcg".into(),
            paths: "None".into(),
            path_table: "none".into(),
            path_filter: "none".into(),
            standard_error: "auto".into(),
            guide: None,
            adapter: "adapter".into(),
            driver: "driver".into(),
        };
        Checkpoint { identity, tally, proof: None }
    }

    #[test]
    fn sums_survive_a_round_trip() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.tally");
        let checkpoint = checkpoint();
        for proof in [None, Some(Proof { parts: vec![part_proof()] })] {
            let checkpoint = Checkpoint { proof, ..checkpoint.clone() };
            write(&path, &checkpoint.identity, &checkpoint.tally, checkpoint.proof.as_ref()).unwrap();
            assert_eq!(Checkpoint::read(&path).unwrap(), checkpoint);
            assert_eq!(fs::read(&path).unwrap(), checkpoint.to_bytes().unwrap());
        }
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
    }

    #[test]
    fn damage_is_found_wherever_it_is() {
        for proof in [None, Some(Proof { parts: vec![part_proof()] })] {
            check_damage(&Checkpoint { proof, ..checkpoint() }.to_bytes().unwrap());
        }
    }

    fn part_proof() -> PartProof {
        let range = RangeProof { end: 10, sha256: [7; 32], checksums: vec![1, u128::MAX] };
        let (adapter, driver) = ("adapter".into(), "driver".into());
        PartProof { num_rays: 10, first_ray: 0, of_rays: None, adapter, driver, ranges: vec![range] }
    }

    fn check_damage(bytes: &[u8]) {
        assert!(decode(bytes).is_ok());
        for place in 0..bytes.len() {
            for bit in 0..8 {
                let mut damaged = bytes.to_vec();
                damaged[place] ^= 1 << bit;
                assert!(decode(&damaged).is_err(), "bit {bit} of byte {place}");
            }
            assert!(decode(&bytes[..place]).is_err(), "cut off at {place}");
        }
        assert!(decode(&[bytes, &[0]].concat()).is_err());
    }

    #[test]
    fn another_format_is_named() {
        let mut bytes = checkpoint().to_bytes().unwrap();
        bytes[8] = 99;
        assert_eq!(decode(&bytes).unwrap_err(), "is of format 99; this program reads format 7 and 8");
        assert!(decode(b"PK and more than twenty-four bytes").unwrap_err().contains("no file of sums"));
    }

    #[test]
    fn only_sums_are_replaced_and_no_link_is_followed() {
        let folder = tempfile::tempdir().unwrap();
        let Checkpoint { identity, tally, .. } = checkpoint();
        let path = |name: &str| folder.path().join(name);
        let refused = |path: &Path| {
            let before = fs::read(path).ok();
            let told = [check_writable(path), write(path, &identity, &tally, None)];
            assert!(
                told.iter().all(|told| matches!(told, Err(Error::File { path: named, .. }) if named == path))
            );
            assert_eq!(fs::read(path).ok(), before);
        };
        fs::write(path("scene.json"), "{}").unwrap();
        fs::create_dir(path("folder")).unwrap();
        [path("scene.json"), path("folder"), path("missing/c.tally")].iter().for_each(|path| refused(path));
        // An empty file, as `mktemp` makes one, holds nothing that could be lost.
        fs::write(path("empty"), "").unwrap();
        for name in ["empty", "new", "new"] {
            check_writable(&path(name)).unwrap();
            write(&path(name), &identity, &tally, None).unwrap();
            assert_eq!(Checkpoint::read(&path(name)).unwrap().tally, tally);
        }
        #[cfg(unix)]
        {
            use std::os::unix::fs::symlink;
            refused(Path::new("/dev/null"));
            symlink(path("new"), path("link")).unwrap();
            refused(&path("link"));
            // A link like this one was in the way of versions whose temporary name was predictable.
            symlink(path("scene.json"), path("new.new")).unwrap();
            write(&path("new"), &identity, &Tally::default(), None).unwrap();
            assert_eq!(fs::read_to_string(path("scene.json")).unwrap(), "{}");
        }
        let hidden = fs::read_dir(folder.path())
            .unwrap()
            .filter(|entry| entry.as_ref().unwrap().file_name().to_string_lossy().starts_with('.'));
        assert_eq!(hidden.count(), 0);
    }

    #[test]
    fn every_difference_is_named() {
        let ours = checkpoint().identity;
        assert_eq!(ours.differences_from_beginning(&ours), Vec::<String>::new());
        let other = Identity {
            scene_hash: 5,
            seed: 4,
            precision: "f32".into(),
            sampler: "pcg".into(),
            version: "9.9.9".into(),
            num_rays: 1000,
            ..ours.clone()
        };
        let lines = ours.differences_from_beginning(&other).join("; ");
        for words in [
            "scene: ",
            "seed: 4 there, 3 here",
            "precision: f32",
            "program: 9.9.9",
            "rays: 1000 there, 100 here",
        ] {
            assert!(lines.contains(words), "{lines}");
        }
        assert_eq!(ours.differences(&other).len(), 4, "parts may have their own numbers of rays");
    }
}
