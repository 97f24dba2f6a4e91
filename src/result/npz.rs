//! `.npz` files that `numpy.load(allow_pickle=False)` reads: Optiland's keys and shapes, float64 in C order, scalars as
//! 0-d arrays, plus `hits`, `standard_error`, `total_flux_standard_error` and `meta`.
//!
//! `meta` is a 0-d string of JSON: what the file holds, its units, and the trace it comes from. No file holds a time,
//! so equal results are equal files.

use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

use ndarray::arr0;
use ndarray_npy::{NpzWriter, WriteNpyError, WriteNpyExt};
use serde_json::json;

use crate::error::{Error, Result};
use crate::result::{
    Detector, DetectorData, FarFieldPattern, IrradianceMap, RayDatabase, RayPaths, SpectralMap, TraceResult,
};

/// Version of the layout of the files.
pub const SCHEMA: u32 = 1;

/// An `.npz` file in the making.
pub(crate) struct NpzFile {
    path: PathBuf,
    writer: NpzWriter<BufWriter<File>>,
}

impl NpzFile {
    fn create(path: &Path) -> Result<Self> {
        let file = File::create(path).map_err(|error| Error::file(path, error))?;
        Ok(NpzFile { path: path.into(), writer: NpzWriter::new(BufWriter::new(file)) })
    }

    /// Adds an array.
    pub(crate) fn add(&mut self, name: &str, array: &(impl WriteNpyExt + ?Sized)) -> Result<()> {
        self.writer.add_array(name, array).map_err(|error| Error::file(&self.path, error))
    }

    /// Adds an array if it is there.
    pub(crate) fn add_optional(&mut self, name: &str, array: &Option<impl WriteNpyExt>) -> Result<()> {
        array.as_ref().map_or(Ok(()), |array| self.add(name, array))
    }

    /// Adds a column of strings, shape (n,).
    pub(crate) fn add_text<S: AsRef<str>>(&mut self, name: &str, values: &[S]) -> Result<()> {
        self.add(name, &Text { values, shape: format!("({},)", values.len()) })
    }

    /// Adds one string, 0-d.
    fn add_string(&mut self, name: &str, value: &str) -> Result<()> {
        self.add(name, &Text { values: &[value], shape: "()".into() })
    }

    fn finish(self) -> Result<()> {
        let path = self.path;
        let buffer = self.writer.finish().map_err(|error| Error::file(&path, error))?;
        let file = buffer.into_inner().map_err(|error| Error::file(&path, error))?;
        file.sync_all().map_err(|error| Error::file(&path, error))
    }
}

/// Strings as NumPy keeps them: fixed width, UTF-32, padded with zeros; `ndarray-npy` has no such element.
struct Text<'a, S> {
    values: &'a [S],
    shape: String,
}

impl<S: AsRef<str>> WriteNpyExt for Text<'_, S> {
    fn write_npy<W: Write>(&self, mut writer: W) -> std::result::Result<(), WriteNpyError> {
        let width = self.values.iter().map(|value| value.as_ref().chars().count()).max().unwrap_or(0).max(1);
        writer.write_all(&npy_header(&format!("<U{width}"), &self.shape))?;
        for value in self.values {
            let padded = value.as_ref().chars().map(u32::from).chain(std::iter::repeat(0)).take(width);
            let bytes: Vec<u8> = padded.flat_map(u32::to_le_bytes).collect();
            writer.write_all(&bytes)?;
        }
        Ok(writer.flush()?)
    }
}

/// The header of format 1.0: magic, version, length, dictionary, padded so that the data starts at a multiple of 64.
fn npy_header(descr: &str, shape: &str) -> Vec<u8> {
    const PREFIX: usize = 10;
    let dictionary = format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': {shape}, }}");
    let length = (PREFIX + dictionary.len() + 1).next_multiple_of(64) - PREFIX;
    let mut header = b"\x93NUMPY\x01\x00".to_vec();
    header.extend((length as u16).to_le_bytes());
    header.extend(format!("{dictionary:<width$}\n", width = length - 1).into_bytes());
    header
}

/// Writes what one detector recorded to `path`.
///
/// # Errors
/// [`Error::File`] if the file cannot be written.
pub fn write_detector(path: &Path, result: &TraceResult, detector: &Detector) -> Result<()> {
    let mut file = NpzFile::create(path)?;
    let units = match &detector.data {
        DetectorData::Irradiance(map) => map.write(&mut file).map(|()| IrradianceMap::UNITS),
        DetectorData::Spectral(map) => map.write(&mut file).map(|()| SpectralMap::UNITS),
        DetectorData::FarField(pattern) => pattern.write(&mut file).map(|()| FarFieldPattern::UNITS),
        DetectorData::RayDatabase(rays) => rays.write(&mut file).map(|()| RayDatabase::UNITS),
    }?;
    // Optiland's ray database has no sums of its own: they follow from its columns.
    if !matches!(detector.data, DetectorData::RayDatabase(_)) {
        file.add("total_flux", &arr0(detector.total_flux))?;
        file.add("num_rays_hit", &arr0(detector.num_rays_hit as i64))?;
        file.add_optional("total_flux_standard_error", &detector.total_flux_standard_error.map(arr0))?;
    }
    file.add_string("meta", &meta(result, detector.data.kind(), &detector.name, units))?;
    file.finish()
}

/// Writes the recorded paths to `path`.
///
/// # Errors
/// [`Error::File`] if the file cannot be written.
pub fn write_ray_paths(path: &Path, result: &TraceResult, paths: &RayPaths) -> Result<()> {
    let mut file = NpzFile::create(path)?;
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
        "adapter": run.adapter,
        "driver": run.driver,
        "program": run.program,
        "version": run.version,
    })
    .to_string()
}
