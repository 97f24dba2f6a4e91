//! The `.npz` files of a result: one a detector, and one of recorded paths.

use std::path::Path;

use ndarray::arr0;
use serde_json::json;

use crate::error::Result;
use crate::result::npz::ArrayWriter;
use crate::result::{Detector, RayPaths, TraceResult};

/// Version of the layout of the files.
pub const SCHEMA: u32 = 1;

/// Writes what one detector recorded to `path`.
///
/// # Errors
/// [`crate::Error::File`] if the file cannot be written.
pub fn write_detector(path: &Path, result: &TraceResult, detector: &Detector) -> Result<()> {
    add_detector(ArrayWriter::create(path)?, result, detector).map(|_| ())
}

/// The arrays of [`write_detector`]'s file, each in the format `.npy`.
///
/// # Errors
/// [`crate::Error::File`] if rows that lie on disk cannot be read.
pub fn detector_arrays(result: &TraceResult, detector: &Detector) -> Result<Vec<(String, Vec<u8>)>> {
    add_detector(ArrayWriter::in_memory(), result, detector)
}

fn add_detector(
    mut file: ArrayWriter,
    result: &TraceResult,
    detector: &Detector,
) -> Result<Vec<(String, Vec<u8>)>> {
    let data = detector.data.result();
    data.write(&mut file)?;
    // Optiland's ray database has no sums of its own: they follow from its columns.
    if data.map().is_some() {
        file.add("total_flux", &arr0(detector.total_flux))?;
        file.add("num_rays_hit", &arr0(detector.num_rays_hit as i64))?;
        file.add_optional("total_flux_standard_error", &detector.total_flux_standard_error.map(arr0))?;
    }
    let mut units = data.units().to_vec();
    if let Some(seen) = &detector.luminous {
        seen.add_to(&mut file)?;
        units.extend(seen.units());
    }
    file.add_string("meta", &meta(result, detector.data.kind(), &detector.name, &units))?;
    file.finish()
}

/// Writes maps of derivatives to `path`: an array `DETECTOR/PARAMETER` each, and `DETECTOR/PARAMETER/standard_error`.
/// Each has the shape of the detector's map, and its unit per unit of the parameter.
///
/// # Errors
/// [`crate::Error::File`] if the file cannot be written.
pub fn write_gradients(path: &Path, result: &TraceResult) -> Result<()> {
    add_gradients(ArrayWriter::create(path)?, result).map(|_| ())
}

/// The arrays of [`write_gradients`]'s file, each in the format `.npy`.
///
/// # Errors
/// None: nothing is written.
pub fn gradient_arrays(result: &TraceResult) -> Result<Vec<(String, Vec<u8>)>> {
    add_gradients(ArrayWriter::in_memory(), result)
}

fn add_gradients(mut file: ArrayWriter, result: &TraceResult) -> Result<Vec<(String, Vec<u8>)>> {
    for row in &result.gradients {
        let name = format!("{}/{}", row.detector, row.parameter);
        file.add_optional(&name, &row.map)?;
        file.add_optional(&format!("{name}/standard_error"), &row.map_errors)?;
        if let Some(edges) = &row.with_edges {
            file.add_optional(&format!("{name}/with_edges"), &edges.map)?;
            file.add_optional(&format!("{name}/with_edges/standard_error"), &edges.map_errors)?;
        }
    }
    let units = [(
        "derivative",
        "unit of the map per unit of the parameter: mm, um, rad, W or 1, degrees where the file has degrees",
    )];
    file.add_string("meta", &meta(result, "gradients", "gradients", &units))?;
    file.finish()
}

/// Writes the recorded paths to `path`.
///
/// # Errors
/// [`crate::Error::File`] if the file cannot be written.
pub fn write_ray_paths(path: &Path, result: &TraceResult, paths: &RayPaths) -> Result<()> {
    add_ray_paths(ArrayWriter::create(path)?, result, paths).map(|_| ())
}

/// The arrays of [`write_ray_paths`]'s file, each in the format `.npy`.
///
/// # Errors
/// [`crate::Error::File`] if rows that lie on disk cannot be read.
pub fn ray_path_arrays(result: &TraceResult, paths: &RayPaths) -> Result<Vec<(String, Vec<u8>)>> {
    add_ray_paths(ArrayWriter::in_memory(), result, paths)
}

fn add_ray_paths(
    mut file: ArrayWriter,
    result: &TraceResult,
    paths: &RayPaths,
) -> Result<Vec<(String, Vec<u8>)>> {
    paths.write(&mut file)?;
    file.add_string("meta", &meta(result, "ray_paths", "ray_paths", RayPaths::UNITS))?;
    file.finish()
}

fn meta(result: &TraceResult, kind: &str, name: &str, units: &[(&str, &str)]) -> String {
    let run = &result.run;
    let units: serde_json::Map<String, serde_json::Value> =
        units.iter().map(|(key, unit)| (key.to_string(), json!(unit))).collect();
    json!({
        "schema": SCHEMA,
        "kind": kind,
        "name": name,
        "units": units,
        "num_rays": result.num_rays_total,
        "partial": run.partial,
        "seed": run.seed,
        "max_depth": run.max_depth,
        "min_flux_fraction": run.min_flux_fraction,
        "precision": run.precision,
        "sampler": run.sampler,
        "adapter": run.adapter,
        "driver": run.driver,
        "program": run.program,
        "version": run.version,
    })
    .to_string()
}
