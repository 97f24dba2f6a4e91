//! The files of a difference: `report.json`, and one `.npz` and one `.png` per detector.

use crate::error::{Error, Result};
use crate::format::pretty_json;
use crate::result::difference::{DetectorDifference, FluxDifference, SceneDifference};
use crate::result::npz::ArrayWriter;
use crate::result::output::{self, REPORT, file_stems, write_bytes};
use crate::result::png::{self, Style};
use ndarray::arr0;
use serde_json::{Map, Value, json};
use std::path::{Path, PathBuf};

/// Version of the report and of the `.npz` files.
const SCHEMA: u32 = 1;

/// The names of the files that [`write`] would write.
pub fn file_names<'a>(detectors: impl Iterator<Item = &'a str>, pictures: bool) -> Vec<String> {
    output::file_names(detectors, pictures.then_some(&[]), false, false, false)
}

/// Writes all files into `dir`, in one step, and returns their paths.
///
/// # Errors
/// [`Error::File`] with the file or folder that could not be written; `dir` is then as it was.
pub fn write(dir: &Path, found: &SceneDifference, pictures: Option<Style>) -> Result<Vec<PathBuf>> {
    let (names, ()) = output::write_by(dir, |folder| {
        let stems = file_stems(found.detectors.iter().map(|detector| detector.flux.name.as_str()));
        let mut names = Vec::new();
        let mut of_detectors = Vec::new();
        for (detector, stem) in found.detectors.iter().zip(stems) {
            let data = format!("{stem}.npz");
            write_arrays(&folder.join(&data), found, detector)?;
            let mut files = json!({"file": data});
            names.push(data);
            if let (Some(style), Some(_)) = (pictures, &detector.map) {
                let picture = format!("{stem}.png");
                png::write_difference(&folder.join(&picture), detector, style)?;
                files["picture"] = json!(picture);
                names.push(picture);
            }
            of_detectors.push(files);
        }
        let mut report = found.to_json();
        for (detector, files) in found.detectors.iter().zip(of_detectors) {
            if let (Value::Object(entry), Value::Object(files)) =
                (&mut report["detectors"][&detector.flux.name], files)
            {
                entry.extend(files);
            }
        }
        write_bytes(&folder.join(REPORT), pretty(&report)?.as_bytes())?;
        names.push(REPORT.into());
        Ok((names, ()))
    })?;
    Ok(names)
}

fn pretty(report: &Value) -> Result<String> {
    pretty_json(report).map_err(|error| Error::Internal(error.to_string()))
}

fn write_arrays(path: &Path, found: &SceneDifference, detector: &DetectorDifference) -> Result<()> {
    let mut file = ArrayWriter::create(path)?;
    let mut unit = "";
    if let Some(map) = &detector.map {
        file.add("difference", &map.values)?;
        file.add_optional("standard_error", &map.errors)?;
        for (name, side) in ["a", "b"].into_iter().zip(&map.sides) {
            if let Some(side) = side.data.result().map() {
                file.add(name, &side.values)?;
                unit = side.quantity.1;
            }
        }
    }
    let flux = &detector.flux;
    file.add("total_flux_difference", &arr0(flux.difference))?;
    file.add_optional("total_flux_standard_error", &flux.standard_error.map(arr0))?;
    file.add("total_flux", &ndarray::arr1(&[flux.a, flux.b]))?;
    let meta = json!({
        "schema": SCHEMA,
        "kind": "difference",
        "name": flux.name,
        "a": found.names[0],
        "b": found.names[1],
        "units": {"difference": unit, "standard_error": unit, "a": unit, "b": unit, "total_flux_difference": "W",
            "total_flux_standard_error": "W", "total_flux": "W, of A and of B"},
    });
    file.add_string("meta", &meta.to_string())?;
    file.finish().map(|_| ())
}

impl SceneDifference {
    /// The report as a document. Fluxes are in W; an error that is not known is null.
    pub fn to_json(&self) -> Value {
        let entry = |row: &FluxDifference| (row.name.clone(), json!(row));
        let all = |rows: &[FluxDifference]| Value::Object(rows.iter().map(entry).collect());
        let detectors: Map<String, Value> = self
            .detectors
            .iter()
            .map(|detector| {
                let (name, mut value) = entry(&detector.flux);
                value["kind"] = json!(detector.kind);
                value["num_rays_hit"] = json!(detector.num_rays_hit);
                value["note"] = json!(detector.note);
                (name, value)
            })
            .collect();
        let run = &self.run;
        json!({
            "schema": SCHEMA,
            "program": run.program,
            "version": run.version,
            "kind": "difference",
            "a": self.names[0],
            "b": self.names[1],
            "num_rays": self.num_rays,
            "num_rays_requested": run.num_rays,
            "partial": run.partial,
            "num_blocks": self.num_blocks,
            "seed": run.seed,
            "max_depth": run.max_depth,
            "min_flux_fraction": run.min_flux_fraction,
            "precision": run.precision,
            "sampler": run.sampler,
            "adapter": run.adapter,
            "driver": run.driver,
            "where": run.filter,
            "trace_time_sec": run.trace_time_sec,
            "scene_warnings": run.scene_warnings,
            "detectors": detectors,
            "totals": all(&self.totals),
            "surfaces": all(&self.surfaces),
            "notes": self.notes,
        })
    }

    /// The report as text.
    ///
    /// # Errors
    /// [`Error::Internal`] if a number is no JSON.
    pub fn report(&self) -> Result<String> {
        pretty(&self.to_json())
    }
}
