//! A folder of results read back: `report.json` and the `.npz` files that it names.

use std::fs::{self, File};
use std::io::BufReader;
use std::path::{Path, PathBuf};

use glam::{DMat3, DVec3};
use ndarray::{Array1, Array3, Axis, Dimension};
use ndarray_npy::npy::header::Header;
use ndarray_npy::{NpzReader, ReadableElement};
use serde::Deserialize;
use serde::de::DeserializeOwned;
use serde_json::Value;
use zip::{CompressionMethod, ZipArchive};

use crate::error::{Error, Result};
use crate::model::Frame;
use crate::result::integrity::{self, Meta};
use crate::result::output::REPORT;
use crate::result::ray_database::RecordedRays;
use crate::result::{
    Detector, DetectorData, FarFieldPattern, IrradianceMap, RayColumns, RayDatabase, Report, RunInfo,
    SpectralMap, SurfaceResult, TraceResult, report,
};

/// What the report says of one detector.
#[derive(Deserialize)]
struct Entry {
    kind: String,
    absorb: bool,
    total_flux: f64,
    #[serde(default)]
    total_flux_standard_error: Option<f64>,
    #[serde(default)]
    total_flux_recorded: Option<f64>,
    num_rays_hit: u64,
    file: Option<String>,
    #[serde(default)]
    width: Option<f64>,
    #[serde(default)]
    height: Option<f64>,
    #[serde(default)]
    frame: Option<FrameEntry>,
}

#[derive(Deserialize)]
struct FrameEntry {
    origin: [f64; 3],
    axes: [[f64; 3]; 3],
}

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
    /// ones of [`SpectralMap::spectrum`], which follows from the map, and without recorded paths.
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
    let file = NpzFile::open(dir.join(file))?;
    let missing = |what: &str| Error::file(&path, format!("has no {what} of detector '{name}'"));
    let size = || {
        let width = entry.width.ok_or_else(|| missing("width"))?;
        entry.height.ok_or_else(|| missing("height")).map(|height| (width, height))
    };
    let data = match entry.kind.as_str() {
        "irradiance" => DetectorData::Irradiance(file.irradiance(size()?)?),
        "spectral" => DetectorData::Spectral(file.spectral(size()?)?),
        "far_field" => DetectorData::FarField(file.far_field()?),
        "ray_database" => {
            let frame = entry.frame.as_ref().ok_or_else(|| missing("frame"))?;
            let frame = Frame {
                origin: DVec3::from_array(frame.origin),
                rotation: DMat3::from_cols_array_2d(&frame.axes),
            };
            DetectorData::RayDatabase(file.ray_database(frame, &entry)?)
        }
        other => return Err(Error::file(path, format!("no detector is of kind `{other}`"))),
    };
    Ok(Detector {
        name: name.into(),
        absorb: entry.absorb,
        total_flux: entry.total_flux,
        total_flux_standard_error: entry.total_flux_standard_error,
        num_rays_hit: entry.num_rays_hit,
        data,
    })
}

/// An `.npz` file that is read.
struct NpzFile {
    path: PathBuf,
    reader: NpzReader<BufReader<File>>,
}

/// Refuses an archive that claims to hold more than it has bytes, before anything is unpacked: this program stores arrays as
/// they are.
fn check_claims(file: &File) -> std::result::Result<(), String> {
    let length = file.metadata().map_err(|error| error.to_string())?.len();
    let mut archive = ZipArchive::new(BufReader::new(file)).map_err(|error| error.to_string())?;
    for index in 0..archive.len() {
        let mut member = archive.by_index(index).map_err(|error| error.to_string())?;
        let (name, size) = (member.name().to_string(), member.size());
        let claims = |what: &str, bytes: u128| {
            Err(format!(
                "`{name}` {what} {bytes} bytes, in a file of {length}: this program did not write it"
            ))
        };
        if member.compression() != CompressionMethod::Stored || size > length {
            return claims("would unpack to", size.into());
        }
        let Ok(header) = Header::from_reader(&mut member) else { continue };
        // Each number or letter takes one byte at least.
        let num_items =
            header.shape.iter().try_fold(1_u128, |product, &side| product.checked_mul(side as u128));
        let num_items = num_items.unwrap_or(u128::MAX);
        if num_items > size.into() {
            return claims("claims more than", num_items);
        }
    }
    Ok(())
}

impl NpzFile {
    fn open(path: PathBuf) -> Result<Self> {
        if !path.is_file() {
            return Err(Error::file(path, "is no file"));
        }
        let file = File::open(&path).map_err(|error| Error::file(&path, error))?;
        check_claims(&file).map_err(|problem| Error::file(&path, problem))?;
        let reader = NpzReader::new(BufReader::new(file)).map_err(|error| Error::file(&path, error))?;
        Ok(NpzFile { path, reader })
    }

    fn array<T: ReadableElement, D: Dimension>(&mut self, name: &str) -> Result<ndarray::Array<T, D>> {
        self.reader.by_name(name).map_err(|error| Error::file(&self.path, format!("`{name}`: {error}")))
    }

    /// An array that a trace without standard errors does not write.
    fn optional<T: ReadableElement, D: Dimension>(
        &mut self,
        name: &str,
    ) -> Result<Option<ndarray::Array<T, D>>> {
        let names = self.reader.names().map_err(|error| Error::file(&self.path, error))?;
        if names.iter().any(|other| other.trim_end_matches(".npy") == name) {
            self.array(name).map(Some)
        } else {
            Ok(None)
        }
    }

    /// The shapes must fit, since whoever shows the arrays indexes them together.
    fn check(&self, fits: bool) -> Result<()> {
        if fits { Ok(()) } else { Err(Error::file(&self.path, "the shapes of its arrays do not fit")) }
    }

    fn irradiance(mut self, (width, height): (f64, f64)) -> Result<IrradianceMap> {
        let map = IrradianceMap {
            irradiance: self.array("irradiance")?,
            x_coords: self.array("x_coords")?,
            y_coords: self.array("y_coords")?,
            hits: self.array("hits")?,
            standard_error: self.optional("standard_error")?,
            width,
            height,
        };
        let shape = (map.y_coords.len(), map.x_coords.len());
        self.check(
            map.irradiance.dim() == shape
                && map.hits.dim() == shape
                && map.standard_error.as_ref().is_none_or(|errors| errors.dim() == shape)
                && !map.hits.is_empty(),
        )?;
        Ok(map)
    }

    fn spectral(mut self, (width, height): (f64, f64)) -> Result<SpectralMap> {
        let irradiance: Array3<f64> = self.array("irradiance")?;
        let (ny, nx, bins) = irradiance.dim();
        let area = (width / nx as f64) * (height / ny as f64);
        let map = SpectralMap {
            x_coords: self.array("x_coords")?,
            y_coords: self.array("y_coords")?,
            wavelengths: self.array("wavelengths")?,
            wavelength_edges: self.array("wavelength_edges")?,
            hits: self.array("hits")?,
            standard_error: self.optional("standard_error")?,
            width,
            height,
            spectrum: irradiance.sum_axis(Axis(0)).sum_axis(Axis(0)) * area,
            irradiance,
        };
        self.check(
            (map.y_coords.len(), map.x_coords.len(), map.wavelengths.len()) == (ny, nx, bins)
                && map.hits.dim() == (ny, nx, bins)
                && map.standard_error.as_ref().is_none_or(|errors| errors.dim() == (ny, nx, bins))
                && map.wavelength_edges.len() == bins + 1
                && !map.hits.is_empty(),
        )?;
        Ok(map)
    }

    fn far_field(mut self) -> Result<FarFieldPattern> {
        let pattern = FarFieldPattern {
            intensity: self.array("intensity")?,
            theta: self.array("theta")?,
            phi: self.array("phi")?,
            hits: self.array("hits")?,
            standard_error: self.optional("standard_error")?,
        };
        let shape = (pattern.theta.len(), pattern.phi.len());
        self.check(
            pattern.intensity.dim() == shape
                && pattern.hits.dim() == shape
                && pattern.standard_error.as_ref().is_none_or(|errors| errors.dim() == shape)
                && !pattern.hits.is_empty(),
        )?;
        Ok(pattern)
    }

    fn ray_database(mut self, frame: Frame, entry: &Entry) -> Result<RayDatabase> {
        let position = [self.array("x")?, self.array("y")?, self.array("z")?];
        let direction = [self.array("L")?, self.array("M")?, self.array("N")?];
        let ray_id: Array1<u64> = self.array("ray_id")?;
        let (mut flux, mut wavelength): (Array1<f64>, Array1<f64>) =
            (self.array("flux")?, self.array("wavelength")?);
        let rows = ray_id.len();
        if rows == 0 {
            // Optiland writes one flux and one wavelength of 0 for a database without rays.
            (flux, wavelength) = (Array1::zeros(0), Array1::zeros(0));
        }
        let columns = position.iter().chain(&direction).chain([&flux, &wavelength]);
        self.check(columns.into_iter().all(|column| column.len() == rows))?;
        let columns = RayColumns { ray_id, position, direction, flux, wavelength };
        let kept_flux = entry.total_flux;
        RayDatabase::of_columns(
            frame,
            &columns,
            RecordedRays {
                num_rays: entry.num_rays_hit,
                kept_flux,
                recorded_flux: entry.total_flux_recorded.unwrap_or(kept_flux),
            },
        )
    }
}
