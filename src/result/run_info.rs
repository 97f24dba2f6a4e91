//! How a trace was run: what a report says beside the numbers.

use crate::format::{plain, thousands};
use crate::model::guide::{Guide, PLAIN_SHARE};
use crate::model::sources::rays::RayFileUsed;
use crate::model::sources::tabulated::LampFile;
use crate::result::stopped_by::StoppedBy;
use serde::{Deserialize, Serialize};
use std::path::Path;

/// How the trace was run. `report.json` has its fields under the same names, but where another one is given.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RunInfo {
    /// Path of the scene file, if the scene came from one.
    pub scene: Option<String>,
    /// Rays that the trace was planned with.
    #[serde(rename = "num_rays_requested")]
    pub num_rays: u64,
    /// Seed of the draws.
    pub seed: u64,
    /// Largest number of events per ray.
    pub max_depth: u32,
    /// Roulette threshold that was asked for, as a fraction of the mean flux of a new ray.
    pub min_flux_fraction: f64,
    /// Arithmetic of the trace: `f32`, `df64` or `f64`.
    pub precision: String,
    /// What the draws were: `pcg` or `sobol`.
    pub sampler: String,
    /// Why this arithmetic was taken; empty if nobody said.
    pub precision_reason: String,
    /// What to beware of in it.
    #[serde(skip)]
    pub precision_warning: Option<String>,
    /// Name of the adapter.
    pub adapter: String,
    /// Its driver and version.
    pub driver: String,
    /// Wall-clock time of the trace \[s\], without the time of a trace that it went on from; 0 if nobody measured it.
    pub trace_time_sec: f64,
    /// Rays of the trace that this one went on from.
    #[serde(default)]
    pub num_rays_before: u64,
    /// From the start of the command to the end of its first dispatch of rays \[s\]; `None` if nobody measured it.
    #[serde(default)]
    pub first_rays_sec: Option<f64>,
    /// What the stages took on the device, if they were timed.
    #[serde(skip)]
    pub stage_times: Vec<StageTime>,
    /// What the scene's reader found worth a warning.
    pub scene_warnings: Vec<String>,
    /// True if results are in lumens, lux and candela as well.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub photometric: bool,
    /// Detectors that see colour.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub color: Vec<String>,
    /// The ray files that its sources name.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub ray_files: Vec<RayFileUsed>,
    /// The lamp files that its sources name.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub lamp_files: Vec<LampFile>,
    /// True if the trace stopped before all its rays were launched.
    pub partial: bool,
    /// Why it stopped, if it did.
    pub stopped_by: Option<StoppedBy>,
    /// The target for the relative error, if there was one.
    pub target_error: Option<f64>,
    /// Maps have only the light whose path matches this expression, if there is one.
    #[serde(default, rename = "where", skip_serializing_if = "Option::is_none")]
    pub filter: Option<String>,
    /// Rays were split at so many of their first events.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub split_depth: u32,
    /// How rays were guided, if they were.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub guide: Option<GuideInfo>,
    /// Number of the first ray.
    pub first_ray: u64,
    /// The rays are a part of a trace of so many, if they are.
    pub of_rays: Option<u64>,
    /// No GPU was found, so that a processor traced.
    #[serde(skip)]
    pub has_no_gpu: bool,
    /// Read from files without hashes, as older versions wrote them: damage would not be noticed.
    #[serde(skip)]
    pub is_unchecked: bool,
    /// Name of the program.
    pub program: String,
    /// Version of the program.
    pub version: String,
}

/// How the rays of a trace were guided.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct GuideInfo {
    /// The first 64 bits of the SHA-256 of what was learned.
    pub hash: String,
    /// The nodes of its tree.
    pub num_nodes: usize,
    /// Rays of the pilot; null where the guide was given.
    pub pilot_rays: Option<u64>,
    /// Rows to which it guides; null where it was given.
    pub num_rows: Option<usize>,
    /// No ray weighs more than so many times a plain ray on its path.
    pub most_weight: f64,
}

impl GuideInfo {
    /// What a report says of a guide that was not learned for the trace.
    pub fn of(guide: &Guide) -> Self {
        GuideInfo {
            hash: guide.hash(),
            num_nodes: guide.num_nodes(),
            pilot_rays: None,
            num_rows: None,
            most_weight: 1.0 / PLAIN_SHARE,
        }
    }

    /// A line of the report.
    pub fn line(&self) -> String {
        let learned = match (self.num_rows, self.pilot_rays) {
            (Some(rows), Some(rays)) => {
                format!(" to {rows} rows, which a pilot of {} rays has found", thousands(rays))
            }
            _ => " by a guide that was given".into(),
        };
        format!(
            "guided{learned}: no ray weighs more than {} times a plain one (guide {})\n",
            self.most_weight,
            plain(&self.hash)
        )
    }
}

/// What one stage of a trace took on the device.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct StageTime {
    /// The stage: `trace_new`, `advance` or `trace_queued`.
    pub stage: String,
    /// Times that it was dispatched.
    pub num_dispatches: u64,
    /// Time on the device \[s\].
    pub time_sec: f64,
}

/// True of a depth that says nothing.
fn is_zero(depth: &u32) -> bool {
    *depth == 0
}

impl Default for RunInfo {
    fn default() -> Self {
        RunInfo {
            scene: None,
            num_rays: 0,
            seed: 0,
            max_depth: 16,
            min_flux_fraction: 1e-6,
            precision: "f32".into(),
            sampler: "pcg".into(),
            precision_reason: String::new(),
            precision_warning: None,
            adapter: String::new(),
            driver: String::new(),
            trace_time_sec: 0.0,
            num_rays_before: 0,
            first_rays_sec: None,
            stage_times: Vec::new(),
            scene_warnings: Vec::new(),
            photometric: false,
            color: Vec::new(),
            lamp_files: Vec::new(),
            ray_files: Vec::new(),
            partial: false,
            stopped_by: None,
            target_error: None,
            guide: None,
            split_depth: 0,
            filter: None,
            first_ray: 0,
            of_rays: None,
            has_no_gpu: false,
            is_unchecked: false,
            program: env!("CARGO_PKG_NAME").into(),
            version: env!("CARGO_PKG_VERSION").into(),
        }
    }
}

impl RunInfo {
    /// What is to be said of results that [`RunInfo::is_unchecked`].
    pub fn unchecked_notice(&self, dir: &Path) -> String {
        format!("{} is of an older version, without hashes: damage would not be noticed", dir.display())
    }

    /// Rays launched per second, of `launched` in all; 0 where no time was measured.
    pub fn rays_per_sec(&self, launched: u64) -> f64 {
        let own = launched.saturating_sub(self.num_rays_before);
        if self.trace_time_sec > 0.0 { own as f64 / self.trace_time_sec } else { 0.0 }
    }
}
