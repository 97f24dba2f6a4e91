//! A folder of results read back: `report.json` and the `.npz` files that it names.

use std::fs;
use std::path::Path;

use serde::Deserialize;
use serde::de::DeserializeOwned;
use serde_json::{Map, Value};

use crate::error::{Error, Result};
use crate::model::DetectorFunction;
use crate::result::color::Color;
use crate::result::integrity::{self, Meta};
use crate::result::light_paths::OtherLight;
use crate::result::luminous::Luminous;
use crate::result::output::REPORT;
use crate::result::stored::{DetectorEntry, Stored};
use crate::result::{
    CoatingRank, Detector, DetectorData, LightPath, PathTable, Recoated, RunInfo, TraceResult, report,
};

/// What `report.json` has beside the fields of [`RunInfo`] and [`TraceResult`].
#[derive(Deserialize)]
struct Rest {
    schema: u32,
    detectors: Map<String, Value>,
    #[serde(default)]
    paths: Option<Vec<LightPath>>,
    #[serde(default)]
    paths_without_row: Vec<OtherLight>,
    #[serde(default)]
    recoated: Vec<Recoated>,
    #[serde(default)]
    coatings: Option<Vec<CoatingRank>>,
    #[serde(default)]
    coating_warnings: Vec<String>,
    #[serde(default)]
    meta: Option<Meta>,
}

impl TraceResult {
    /// Reads what [`write_all`](crate::result::output::write_all) wrote into `dir`: the same bits, but for the last
    /// ones of [`SpectralMap::spectrum`](crate::result::SpectralMap::spectrum), which follows from the map, and without recorded paths.
    ///
    /// # Errors
    /// [`Error::File`] with the file that is missing or does not hold what it should.
    pub fn read(dir: &Path) -> Result<TraceResult> {
        let path = dir.join(REPORT);
        let unread = |error: std::io::Error| match error.kind() == std::io::ErrorKind::NotFound {
            true => {
                let problem =
                    if dir.is_dir() { "there is no report.json in it" } else { "there is no such folder" };
                Error::file(dir, format!("{problem}; name a folder that `nsq-gpu trace -o` wrote"))
            }
            false => Error::file(&path, error),
        };
        loop {
            let text = fs::read_to_string(&path).map_err(unread)?;
            match Self::read_as(dir, &path, &text) {
                // Another run may have written there meanwhile; then its result is the one.
                Err(_) if fs::read_to_string(&path).is_ok_and(|now| now != text) => {}
                result => return result,
            }
        }
    }

    fn read_as(dir: &Path, path: &Path, text: &str) -> Result<TraceResult> {
        let report: Value =
            serde_json::from_str(text).map_err(|error| Error::file(path, format!("is damaged: {error}")))?;
        let rest: Rest = typed(path, &report)?;
        if let Some(meta) = &rest.meta {
            integrity::check_report(path, text, meta)?;
        }
        if rest.schema != report::SCHEMA {
            let problem = format!("has schema {}, this program reads schema {}", rest.schema, report::SCHEMA);
            return Err(Error::file(path, problem));
        }
        let mut result: TraceResult = typed(path, &report)?;
        let photometry = &report["photometry"];
        result.detectors = rest
            .detectors
            .iter()
            .map(|(name, entry)| {
                let entry: DetectorEntry = typed(path, entry)?;
                let detector = detector(dir, name, entry.clone(), rest.meta.as_ref())?;
                let luminous = photometry["detectors"].get(name);
                let luminous =
                    luminous.map(|seen| luminous_of(dir, name, entry, typed(path, seen)?)).transpose()?;
                Ok(Detector { luminous, ..detector })
            })
            .collect::<Result<_>>()?;
        if let Some(sources) = photometry["sources"].as_object() {
            let source = |(name, seen): (&String, &Value)| Ok((name.clone(), typed(path, seen)?));
            result.sources = sources.iter().map(source).collect::<Result<_>>()?;
        }
        result.run = RunInfo {
            stage_times: result.diagnostics.stage_times.clone(),
            is_unchecked: rest.meta.is_none(),
            ..typed(path, &report)?
        };
        let Rest { paths, paths_without_row: other, recoated, coatings, coating_warnings, .. } = rest;
        let table =
            |paths| PathTable { paths, other, recoated, coatings, coating_warnings, ..Default::default() };
        result.paths = paths.map(table);
        Ok(result)
    }
}

fn typed<T: DeserializeOwned>(path: &Path, value: &Value) -> Result<T> {
    T::deserialize(value).map_err(|error| Error::file(path, format!("is damaged: {error}")))
}

fn detector(dir: &Path, name: &str, entry: DetectorEntry, meta: Option<&Meta>) -> Result<Detector> {
    let path = dir.join(REPORT);
    let file = entry.file.as_ref().ok_or_else(|| {
        Error::file(&path, format!("names no file of detector '{name}'; write one with `trace -o`"))
    })?;
    if let Some(meta) = meta {
        integrity::check_file(dir, file, meta)?;
    }
    let stored = Stored::open(path.clone(), name, entry.clone(), dir.join(file))?;
    let data = DetectorData::read(&entry.kind, stored)?
        .ok_or_else(|| Error::file(path, format!("no detector is of kind `{}`", entry.kind)))?;
    Ok(Detector {
        name: name.into(),
        absorb: entry.absorb,
        total_flux: entry.total_flux,
        total_flux_standard_error: entry.total_flux_standard_error,
        few_rays: entry.few_rays,
        title: entry.title,
        num_rays_hit: entry.num_rays_hit,
        data,
        luminous: None,
    })
}

/// What a detector saw in photometric units, with the maps of its file.
fn luminous_of(dir: &Path, name: &str, entry: DetectorEntry, seen: Luminous) -> Result<Luminous> {
    let Some(file) = entry.file.as_ref().map(|file| dir.join(file)) else { return Ok(seen) };
    let is_intensity = entry.kind == DetectorFunction::FarField.name();
    let mut stored = Stored::open(dir.join(REPORT), name, entry, file)?;
    let seen = Luminous { is_intensity, ..seen };
    let error = format!("{}_standard_error", seen.name());
    let color = match seen.color {
        Some(color) => Some(Color {
            xyz: [stored.array("X")?, stored.array("Y")?, stored.array("Z")?],
            standard_error: stored.optional("standard_error_XYZ")?,
            covariance: stored.optional("covariance_XYZ")?,
            ..color
        }),
        None => None,
    };
    let seen = Luminous { color, ..seen };
    Ok(Luminous { map: stored.array(seen.name())?, standard_error: stored.optional(&error)?, ..seen })
}
