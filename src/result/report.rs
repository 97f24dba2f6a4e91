//! `report.json`: one versioned document per trace.

use std::collections::HashMap;

use serde::Serialize;
use serde_json::{Map, Value, json};

use crate::format::pretty_json;
use crate::result::integrity::Meta;
use crate::result::{PathTable, TraceResult, few_rays};

/// Version of the document. It grows when a field changes its meaning or goes away, not when one is added.
pub const SCHEMA: u32 = 1;

/// The document: the fields of [`RunInfo`](crate::result::RunInfo) and [`TraceResult`], and these. Fluxes are in W,
/// times in s. Fields that are not known are null.
///
/// - `schema`: the version of the document, [`SCHEMA`].
/// - `rays_per_sec`: rays launched per second. Rays of a trace that this one went on from do not count.
/// - `detectors`:
///   `{name: {kind, absorb, total_flux, total_flux_standard_error, mean_relative_error, num_rays_hit, file, picture, ...}}`
///   in scene order. `mean_relative_error` is the sum of the cells' standard errors over the sum of their values, in
///   flux. `file` and `picture` are null if none was written. Detectors with pixels have `width` and `height` \[mm\].
///   Ray databases have `num_rays_stored`, the number of rows kept, whose flux is `total_flux`. They also have
///   `total_flux_recorded`, the flux of all rows, and `frame`. A frame has the local x, y, z in global coordinates as
///   `axes`, and an `origin` in mm. A flux that rests on fewer than ten rays has `rests_on`, the number of rays.
///   `upper_bound_95` \[W\] stands beside: the flux is below with 95 % confidence. The map of a path has a `title`, its
///   sequence.
/// - `paths` and `paths_without_row`: light by its path, the most flux first, and light whose sequence has no row, by its
///   end. Missing unless light was summed up by its path.
/// - `recoated`: faces whose coatings `paths` takes for others than in the trace; the maps and the sums of detectors are as
///   traced. `coatings`: the faces that ghosts meet, by how much their coatings matter. `coating_warnings`: what to know of
///   both. Missing unless asked for.
/// - `paths_file`, `gradients_file`, `ray_paths`: names of files. The first two are missing, the last is null, where there
///   is none.
/// - `meta`: hashes of the files beside the document, and of itself. Missing where no file was written.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(transparent)]
pub struct Report(Map<String, Value>);

/// The keys of the document, in the order in which they are written.
const KEYS: &str = "schema program version scene num_rays_requested partial stopped_by target_error relative_error where split_depth guide \
    first_ray of_rays scene_warnings lamp_files ray_files photometric color seed max_depth min_flux_fraction precision sampler precision_reason adapter driver \
    rays_per_sec num_rays_before num_rays_total num_rays_absorbed num_rays_escaped num_rays_flux_killed \
    num_rays_depth_killed total_flux_in total_flux_detected total_flux_tapped total_flux_absorbed \
    total_flux_bulk_absorbed total_flux_escaped total_flux_lost flux_conservation_error trace_time_sec first_rays_sec \
    detectors photometry figures surfaces ledger diagnostics paths paths_without_row recoated coatings coating_warnings paths_file gradients gradients_file ray_paths";

/// Names of the files that were written beside the document.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Files {
    /// `.npz` file per detector name.
    pub detectors: HashMap<String, String>,
    /// `.png` file per detector name.
    pub pictures: HashMap<String, String>,
    /// `.png` file in true colours per name of a detector that sees colour.
    pub color_pictures: HashMap<String, String>,
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
        let mut found = fields(&result.run);
        found.extend(fields(result));
        found.insert("schema".into(), json!(SCHEMA));
        found.insert("rays_per_sec".into(), json!(result.run.rays_per_sec(result.num_rays_total)));
        found.insert("detectors".into(), detectors(result, files).into());
        found.extend(result.run.photometric.then(|| ("photometry".into(), photometry(result))));
        if let Some(table) = &result.paths {
            found.insert("paths".into(), json!(table.paths));
            found.extend((!table.other.is_empty()).then(|| ("paths_without_row".into(), json!(table.other))));
            found.extend(coatings(table));
        }
        let names = [("paths_file", &files.paths), ("gradients_file", &files.gradients)];
        let written = names.into_iter().filter(|(_, name)| name.is_some());
        found.extend(written.map(|(key, name)| (key.to_string(), json!(name))));
        found.insert("ray_paths".into(), json!(files.ray_paths));
        let in_order: Map<String, Value> =
            KEYS.split_whitespace().filter_map(|key| found.remove_entry(key)).collect();
        debug_assert!(found.is_empty(), "keys without a place: {found:?}");
        Report(in_order)
    }

    /// True of a key that a document of this version may have.
    pub(crate) fn has_key(key: &str) -> bool {
        key == "meta" || KEYS.split_whitespace().any(|known| known == key)
    }

    /// Adds hashes.
    pub(crate) fn set_meta(&mut self, meta: &Meta) {
        self.0.insert("meta".into(), json!(meta));
    }

    /// The document as indented JSON, with a final line break, fit for a terminal.
    pub fn to_json(&self) -> String {
        // Every key is a string and every value a plain one: serialisation has no way to fail.
        pretty_json(self).unwrap_or_default()
    }
}

/// What a struct has of the document.
fn fields(part: &impl Serialize) -> Map<String, Value> {
    match serde_json::to_value(part) {
        Ok(Value::Object(fields)) => fields,
        _ => Map::new(),
    }
}

/// What is said of new coatings.
fn coatings(table: &PathTable) -> Vec<(String, Value)> {
    let mut found = Vec::new();
    if !table.recoated.is_empty() {
        found.push(("recoated".into(), json!(table.recoated)));
    }
    found.extend(table.coatings.as_ref().map(|coatings| ("coatings".into(), json!(coatings))));
    if !table.coating_warnings.is_empty() {
        found.push(("coating_warnings".into(), json!(table.coating_warnings)));
    }
    found
}

/// Sources and detectors in photometric units.
fn photometry(result: &TraceResult) -> Value {
    let sources: Map<String, Value> =
        result.sources.iter().map(|(name, seen)| (name.clone(), json!(seen))).collect();
    let lit = result
        .detectors
        .iter()
        .filter_map(|detector| Some((detector.name.clone(), detector.luminous.as_ref()?)));
    let detectors: Map<String, Value> = lit.map(|(name, seen)| (name, seen.entry())).collect();
    json!({"sources": sources, "detectors": detectors})
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
        if let Some(picture) = files.color_pictures.get(&detector.name) {
            entry["color_picture"] = json!(picture);
        }
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
