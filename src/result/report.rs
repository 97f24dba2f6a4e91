//! `report.json`: one versioned document per trace.

use std::collections::HashMap;

use serde::{Deserialize, Serialize};
use serde_json::{Map, Value, json};

use crate::format::pretty_json;
use crate::result::StoppedBy;
use crate::result::integrity::Meta;
use crate::result::paths::{LightPath, OtherLight};
use crate::result::{Diagnostics, Gradient, Ledger, SurfaceResult, TraceResult, few_rays};

/// Version of the document. It grows when a field changes its meaning or goes away, not when one is added.
pub const SCHEMA: u32 = 1;

/// The document. Fluxes are in W, times in s; the fields from `num_rays_total` to `trace_time_sec` are those of
/// Optiland's `SimulationResult`, by their names and meanings ([`TraceResult`]).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Report {
    /// Version of the document: [`SCHEMA`].
    pub schema: u32,
    /// Name of the program.
    pub program: String,
    /// Version of the program.
    pub version: String,
    /// Path of the scene file; null if the scene did not come from one.
    pub scene: Option<String>,
    /// Rays that the trace was planned with.
    pub num_rays_requested: u64,
    /// True if the trace stopped before all of them were launched.
    pub partial: bool,
    /// Why it stopped before: `interrupt`, `time_limit` or `target_error`; null if it did not.
    pub stopped_by: Option<StoppedBy>,
    /// The target for the relative error; null if there was none.
    pub target_error: Option<f64>,
    /// The largest of all detectors' relative standard errors: of `total_flux`, and `mean_relative_error`. Null where it
    /// is not known. Detectors that no ray reached have none.
    pub relative_error: Option<f64>,
    /// The expression of `--where`: detectors have only the light whose path matches. Missing if there was none.
    #[serde(default, rename = "where", skip_serializing_if = "Option::is_none")]
    pub filter: Option<String>,
    /// Number of the first ray.
    pub first_ray: u64,
    /// The rays are a part of a trace of so many; null if they are a trace of their own.
    pub of_rays: Option<u64>,
    /// What the scene's reader found worth a warning; the diagnostics' warnings repeat it.
    pub scene_warnings: Vec<String>,
    /// Seed of the draws.
    pub seed: u64,
    /// Largest number of events per ray.
    pub max_depth: u32,
    /// Roulette threshold that was asked for, as a fraction of the mean flux of a new ray.
    pub min_flux_fraction: f64,
    /// Arithmetic: `f32` or `f64`.
    pub precision: String,
    /// What the draws were: `pcg` or `sobol`.
    pub sampler: String,
    /// Why this arithmetic was taken; empty if nobody said.
    pub precision_reason: String,
    /// Name of the adapter.
    pub adapter: String,
    /// Its driver.
    pub driver: String,
    /// Rays launched per second, without those of a trace that this one went on from.
    pub rays_per_sec: f64,
    /// Rays of the trace that this one went on from (`--resume`).
    #[serde(default)]
    pub num_rays_before: u64,
    /// Rays launched.
    pub num_rays_total: u64,
    /// Rays that ended on absorbing surfaces.
    pub num_rays_absorbed: u64,
    /// Rays that met nothing any more.
    pub num_rays_escaped: u64,
    /// Rays ended by Russian roulette.
    pub num_rays_flux_killed: u64,
    /// Rays that reached the largest number of events.
    pub num_rays_depth_killed: u64,
    /// Flux launched \[W\].
    pub total_flux_in: f64,
    /// Flux read by all detectors \[W\].
    pub total_flux_detected: f64,
    /// The part of it read in passing \[W\].
    pub total_flux_tapped: f64,
    /// Flux that ended on absorbing surfaces \[W\].
    pub total_flux_absorbed: f64,
    /// Flux taken by absorbing media \[W\].
    pub total_flux_bulk_absorbed: f64,
    /// Flux of the rays that escaped \[W\].
    pub total_flux_escaped: f64,
    /// Flux ended by the depth limit and by roulette \[W\].
    pub total_flux_lost: f64,
    /// Optiland's figure; the ledger is the exact one.
    pub flux_conservation_error: f64,
    /// Wall-clock time of the trace \[s\], without that of a trace that it went on from; 0 of merged results.
    pub trace_time_sec: f64,
    /// From the start of the command to the end of its first dispatch of rays \[s\]: reading the scene, opening the device
    /// and compiling are in it. Null where no command traced, as in merged results.
    #[serde(default)]
    pub first_rays_sec: Option<f64>,
    /// `{name: {kind, absorb, total_flux, total_flux_standard_error, mean_relative_error, num_rays_hit, file, picture, ...}}`
    /// in scene order. Fluxes and their standard errors are in W; `mean_relative_error` is the sum of the cells' standard
    /// errors over the sum of their values, in flux. Both errors are null where they are not known; `file` and `picture` if none was
    /// written. Detectors with pixels have `width` and `height` \[mm\]. Ray databases have `num_rays_stored`, the rows kept, whose
    /// flux is `total_flux`; `total_flux_recorded`, that of all rows; and `frame`, whose `axes` are the local x, y, z in
    /// global coordinates and whose `origin` is in mm. A flux that rests on fewer than ten rays has `rests_on`, the number of rays,
    /// and `upper_bound_95` \[W\], which the flux is below with 95 % confidence. The map of a path has a `title`, its sequence.
    pub detectors: Map<String, Value>,
    /// `[{name, kind, reached, num_rays_absorbed, total_flux_absorbed}]` in scene order; flux in W.
    pub surfaces: Vec<Value>,
    /// `{launched: {count, quanta, flux}, ..., imbalance_quanta, imbalance_flux, invalid_deposits}`: [`Ledger`]. Quanta
    /// are decimal strings, exact; fluxes are in W.
    pub ledger: Ledger,
    /// Optiland's diagnostics, and `warnings`: [`Diagnostics`].
    pub diagnostics: Diagnostics,
    /// Light by its path, each sequence a row, the most flux first: [`LightPath`]. Missing unless it was summed up so.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub paths: Option<Vec<LightPath>>,
    /// Light whose sequence has no row, by its end, where there were more sequences than rows.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub paths_without_row: Vec<OtherLight>,
    /// File of the table of paths, as comma-separated values; missing if there is none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub paths_file: Option<String>,
    /// Derivatives of fluxes by parameters, with standard errors \[W per unit of the parameter\]; missing if there are none.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub gradients: Vec<Gradient>,
    /// File of maps of derivatives; missing if there is none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub gradients_file: Option<String>,
    /// File of the recorded paths; null if there is none.
    pub ray_paths: Option<String>,
    /// Hashes of the files beside the document, and of itself; missing where no file was written, and in old documents.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub meta: Option<Meta>,
}

/// Names of the files that were written beside the document.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Files {
    /// `.npz` file per detector name.
    pub detectors: HashMap<String, String>,
    /// `.png` file per detector name.
    pub pictures: HashMap<String, String>,
    /// File of the table of paths.
    pub paths: Option<String>,
    /// File of maps of derivatives.
    pub gradients: Option<String>,
    /// File of the recorded paths.
    pub ray_paths: Option<String>,
}

impl Report {
    /// The document of a result whose `files` were written.
    pub fn new(result: &TraceResult, files: &Files) -> Self {
        let run = &result.run;
        Report {
            schema: SCHEMA,
            program: run.program.clone(),
            version: run.version.clone(),
            scene: run.scene.clone(),
            num_rays_requested: run.num_rays,
            partial: run.partial,
            stopped_by: run.stopped_by,
            target_error: run.target_error,
            relative_error: result.relative_error,
            filter: run.filter.clone(),
            first_ray: run.first_ray,
            of_rays: run.of_rays,
            scene_warnings: run.scene_warnings.clone(),
            seed: run.seed,
            max_depth: run.max_depth,
            min_flux_fraction: run.min_flux_fraction,
            precision: run.precision.clone(),
            sampler: run.sampler.clone(),
            precision_reason: run.precision_reason.clone(),
            adapter: run.adapter.clone(),
            driver: run.driver.clone(),
            rays_per_sec: run.rays_per_sec(result.num_rays_total),
            num_rays_before: run.num_rays_before,
            num_rays_total: result.num_rays_total,
            num_rays_absorbed: result.num_rays_absorbed,
            num_rays_escaped: result.num_rays_escaped,
            num_rays_flux_killed: result.num_rays_flux_killed,
            num_rays_depth_killed: result.num_rays_depth_killed,
            total_flux_in: result.total_flux_in,
            total_flux_detected: result.total_flux_detected,
            total_flux_tapped: result.total_flux_tapped,
            total_flux_absorbed: result.total_flux_absorbed,
            total_flux_bulk_absorbed: result.total_flux_bulk_absorbed,
            total_flux_escaped: result.total_flux_escaped,
            total_flux_lost: result.total_flux_lost,
            flux_conservation_error: result.flux_conservation_error,
            trace_time_sec: run.trace_time_sec,
            first_rays_sec: run.first_rays_sec,
            detectors: detectors(result, files),
            surfaces: result.surfaces.iter().map(surface).collect(),
            ledger: result.ledger.clone(),
            diagnostics: result.diagnostics.clone(),
            paths: result.paths.as_ref().map(|table| table.paths.clone()),
            paths_without_row: result.paths.as_ref().map_or_else(Vec::new, |table| table.other.clone()),
            paths_file: files.paths.clone(),
            gradients: result.gradients.clone(),
            gradients_file: files.gradients.clone(),
            ray_paths: files.ray_paths.clone(),
            meta: None,
        }
    }

    /// The document as indented JSON, with a final line break, fit for a terminal.
    pub fn to_json(&self) -> String {
        // Every key is a string and every value a plain one: serialisation has no way to fail.
        pretty_json(self).unwrap_or_default()
    }
}

fn detectors(result: &TraceResult, files: &Files) -> Map<String, Value> {
    let entries = result.detectors.iter().map(|detector| {
        let mut entry = json!({
            "kind": detector.data.kind(),
            "absorb": detector.absorb,
            "total_flux": detector.total_flux,
            "total_flux_standard_error": detector.total_flux_standard_error,
            "mean_relative_error": detector.mean_relative_error(),
            "num_rays_hit": detector.num_rays_hit,
            "file": files.detectors.get(&detector.name),
            "picture": files.pictures.get(&detector.name),
        });
        for (key, value) in detector.data.result().entry() {
            entry[key] = value;
        }
        few_rays::add_to(&mut entry, detector.few_rays);
        if let Some(title) = &detector.title {
            entry["title"] = json!(title);
        }
        (detector.name.clone(), entry)
    });
    entries.collect()
}

fn surface(surface: &SurfaceResult) -> Value {
    json!({
        "name": surface.name,
        "kind": surface.kind,
        "reached": surface.reached,
        "num_rays_absorbed": surface.num_rays_absorbed,
        "total_flux_absorbed": surface.total_flux_absorbed,
    })
}
