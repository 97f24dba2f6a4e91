//! A folder of results read back: `report.json` and the `.npz` files that it names.

use std::fs;
use std::path::Path;

use serde::Deserialize;
use serde::de::DeserializeOwned;
use serde_json::Value;

use crate::error::{Error, Result};
use crate::result::integrity::{self, Meta};
use crate::result::output::REPORT;
use crate::result::stored::{Entry, Stored};
use crate::result::{Detector, DetectorData, PathTable, Report, RunInfo, SurfaceResult, TraceResult, report};

#[derive(Deserialize)]
struct SurfaceEntry {
    name: String,
    kind: String,
    reached: bool,
    num_rays_absorbed: u64,
    total_flux_absorbed: f64,
}

impl TraceResult {
    /// Reads what [`write_all`](crate::result::output::write_all) wrote into `dir`: the same bits, but for the last
    /// ones of [`SpectralMap::spectrum`](crate::result::SpectralMap::spectrum), which follows from the map, and without recorded paths.
    ///
    /// # Errors
    /// [`Error::File`] with the file that is missing or does not hold what it should.
    pub fn read(dir: &Path) -> Result<TraceResult> {
        let path = dir.join(REPORT);
        loop {
            let text = fs::read_to_string(&path).map_err(|error| Error::file(&path, error))?;
            match Self::read_as(dir, &path, &text) {
                // Another run may have written there meanwhile; then its result is the one.
                Err(_) if fs::read_to_string(&path).is_ok_and(|now| now != text) => {}
                result => return result,
            }
        }
    }

    fn read_as(dir: &Path, path: &Path, text: &str) -> Result<TraceResult> {
        let report: Report = parse(path, text)?;
        if let Some(meta) = &report.meta {
            integrity::check_report(path, text, meta)?;
        }
        if report.schema != report::SCHEMA {
            let problem =
                format!("has schema {}, this program reads schema {}", report.schema, report::SCHEMA);
            return Err(Error::file(path, problem));
        }
        let detectors = report
            .detectors
            .iter()
            .map(|(name, entry)| detector(dir, name, typed(path, entry)?, report.meta.as_ref()))
            .collect::<Result<_>>()?;
        let surfaces =
            report.surfaces.iter().map(|entry| surface(path, typed(path, entry)?)).collect::<Result<_>>()?;
        Ok(assemble(report, detectors, surfaces))
    }
}

fn assemble(report: Report, detectors: Vec<Detector>, surfaces: Vec<SurfaceResult>) -> TraceResult {
    TraceResult {
        run: RunInfo {
            scene: report.scene,
            num_rays: report.num_rays_requested,
            seed: report.seed,
            max_depth: report.max_depth,
            min_flux_fraction: report.min_flux_fraction,
            precision: report.precision,
            precision_reason: report.precision_reason,
            precision_warning: None,
            sampler: report.sampler,
            adapter: report.adapter,
            driver: report.driver,
            trace_time_sec: report.trace_time_sec,
            num_rays_before: report.num_rays_before,
            first_rays_sec: report.first_rays_sec,
            stage_times: report.diagnostics.stage_times.clone(),
            scene_warnings: report.scene_warnings,
            partial: report.partial,
            stopped_by: report.stopped_by,
            target_error: report.target_error,
            filter: report.filter,
            first_ray: report.first_ray,
            of_rays: report.of_rays,
            has_no_gpu: false,
            is_unchecked: report.meta.is_none(),
            program: report.program,
            version: report.version,
        },
        detectors,
        surfaces,
        num_rays_total: report.num_rays_total,
        num_rays_absorbed: report.num_rays_absorbed,
        num_rays_escaped: report.num_rays_escaped,
        num_rays_flux_killed: report.num_rays_flux_killed,
        num_rays_depth_killed: report.num_rays_depth_killed,
        total_flux_in: report.total_flux_in,
        total_flux_detected: report.total_flux_detected,
        total_flux_tapped: report.total_flux_tapped,
        total_flux_absorbed: report.total_flux_absorbed,
        total_flux_bulk_absorbed: report.total_flux_bulk_absorbed,
        total_flux_escaped: report.total_flux_escaped,
        total_flux_lost: report.total_flux_lost,
        flux_conservation_error: report.flux_conservation_error,
        relative_error: report.relative_error,
        ledger: report.ledger,
        diagnostics: report.diagnostics,
        paths: report.paths.map(|paths| PathTable {
            paths,
            other: report.paths_without_row,
            ..Default::default()
        }),
        gradients: report.gradients,
        ray_paths: None,
    }
}

fn parse<T: DeserializeOwned>(path: &Path, text: &str) -> Result<T> {
    serde_json::from_str(text).map_err(|error| Error::file(path, format!("is damaged: {error}")))
}

fn typed<T: DeserializeOwned>(path: &Path, value: &Value) -> Result<T> {
    T::deserialize(value).map_err(|error| Error::file(path, error))
}

fn surface(path: &Path, entry: SurfaceEntry) -> Result<SurfaceResult> {
    const KINDS: [&str; 3] = ["refractive", "reflective", "absorbing"];
    let kind = KINDS.into_iter().find(|kind| *kind == entry.kind);
    Ok(SurfaceResult {
        kind: kind.ok_or_else(|| Error::file(path, format!("no surface is of kind `{}`", entry.kind)))?,
        name: entry.name,
        reached: entry.reached,
        num_rays_absorbed: entry.num_rays_absorbed,
        total_flux_absorbed: entry.total_flux_absorbed,
    })
}

fn detector(dir: &Path, name: &str, entry: Entry, meta: Option<&Meta>) -> Result<Detector> {
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
    })
}
