//! From exact sums to what users read, with Optiland's names and meanings.

use crate::error::{Error, Result};
use crate::model::{Interaction, SceneIr, Sensor, SensorKind};
use crate::result::StoppedBy;
use crate::result::uncertainty::{relative_error_of_map, worst_relative_error};
use crate::result::{
    Booking, Diagnostics, FarFieldPattern, IrradianceMap, Ledger, QUANTA_PER_WEIGHT, RayDatabase, RayPaths,
    Recorded, Rows, SensorTally, SpectralMap, Tally, Uncertainty,
};
use serde::{Deserialize, Serialize};
use std::path::Path;
use std::sync::Arc;

/// How the trace was run.
#[derive(Debug, Clone, PartialEq)]
pub struct RunInfo {
    /// Path of the scene file, if the scene came from one.
    pub scene: Option<String>,
    /// Rays that the trace was planned with.
    pub num_rays: u64,
    /// Seed of the draws.
    pub seed: u64,
    /// Largest number of events per ray.
    pub max_depth: u32,
    /// Roulette threshold that was asked for, as a fraction of the mean flux of a new ray.
    pub min_flux_fraction: f64,
    /// Arithmetic of the trace: `f32` or `f64`.
    pub precision: String,
    /// What the draws were: `pcg` or `sobol`.
    pub sampler: String,
    /// Why this arithmetic was taken; empty if nobody said.
    pub precision_reason: String,
    /// What to beware of in it.
    pub precision_warning: Option<String>,
    /// Name of the adapter.
    pub adapter: String,
    /// Its driver and version.
    pub driver: String,
    /// Wall-clock time of the trace \[s\], without that of a trace that it went on from; 0 where nobody measured it.
    pub trace_time_sec: f64,
    /// Rays of the trace that this one went on from.
    pub num_rays_before: u64,
    /// From the start of the command to the end of its first dispatch of rays \[s\]; none where nobody measured it.
    pub first_rays_sec: Option<f64>,
    /// What the stages took on the device, if they were timed.
    pub stage_times: Vec<StageTime>,
    /// What the scene's reader found worth a warning.
    pub scene_warnings: Vec<String>,
    /// True if the trace stopped before all its rays were launched.
    pub partial: bool,
    /// Why it stopped, if it did.
    pub stopped_by: Option<StoppedBy>,
    /// The target for the relative error, if there was one.
    pub target_error: Option<f64>,
    /// Number of the first ray.
    pub first_ray: u64,
    /// The rays are a part of a trace of so many, if they are.
    pub of_rays: Option<u64>,
    /// No GPU was found, so that a processor traced.
    pub has_no_gpu: bool,
    /// Read from files without hashes, as older versions wrote them: damage would not be noticed.
    pub is_unchecked: bool,
    /// Name of the program.
    pub program: String,
    /// Version of the program.
    pub version: String,
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

/// The results of one trace. The flux fields and counts are those of Optiland's `SimulationResult`.
#[derive(Debug, Clone, PartialEq)]
pub struct TraceResult {
    /// How the trace was run.
    pub run: RunInfo,
    /// Detectors in scene order.
    pub detectors: Vec<Detector>,
    /// Surfaces in scene order.
    pub surfaces: Vec<SurfaceResult>,
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
    /// Flux of all sources \[W\]. Of a partial trace, that of the rays launched, scaled as every flux is: as if all that
    /// the sources emit had been shared among them.
    pub total_flux_in: f64,
    /// Sum over all detectors of what they read, transmissive ones included \[W\]. Of a ray database with `max_rays`
    /// it counts the rows that were kept, as Optiland does.
    pub total_flux_detected: f64,
    /// The part of `total_flux_detected` that transmissive detectors read in passing \[W\].
    pub total_flux_tapped: f64,
    /// Flux that ended on absorbing surfaces \[W\].
    pub total_flux_absorbed: f64,
    /// Flux taken by absorbing media \[W\].
    pub total_flux_bulk_absorbed: f64,
    /// Flux of the rays that escaped \[W\].
    pub total_flux_escaped: f64,
    /// Flux ended by the depth limit and by roulette \[W\].
    pub total_flux_lost: f64,
    /// Optiland's figure: |in - (detected - tapped) - absorbed - bulk_absorbed - escaped - lost| / in. It has no bin
    /// for what mirrors take nor for weight gained and lost by sampling; [`Ledger`] has them all and closes.
    pub flux_conservation_error: f64,
    /// The largest of all detectors' relative errors ([`worst_relative_error`]); none where no detector was hit, or
    /// second moments were not summed.
    pub relative_error: Option<f64>,
    /// Where every quantum went.
    pub ledger: Ledger,
    /// Signs that the result should be read with care.
    pub diagnostics: Diagnostics,
    /// Recorded paths, if any.
    pub ray_paths: Option<RayPaths>,
}

/// What one detector recorded.
#[derive(Debug, Clone, PartialEq)]
pub struct Detector {
    /// The user's name for it.
    pub name: String,
    /// True if it ended the rays that it recorded.
    pub absorb: bool,
    /// Flux recorded \[W\]; of a ray database, of the rows kept.
    pub total_flux: f64,
    /// Standard error of `total_flux` \[W\]; none where second moments were not summed, or where a ray database dropped
    /// rows.
    pub total_flux_standard_error: Option<f64>,
    /// Rays recorded, those included that a ray database did not keep.
    pub num_rays_hit: u64,
    /// The recording.
    pub data: DetectorData,
}

/// A recording, by kind of detector.
#[derive(Debug, Clone, PartialEq)]
pub enum DetectorData {
    /// Flux per area.
    Irradiance(IrradianceMap),
    /// Flux per area and wavelength bin.
    Spectral(SpectralMap),
    /// Flux per solid angle.
    FarField(FarFieldPattern),
    /// Rays.
    RayDatabase(RayDatabase),
}

/// What happened at one surface.
#[derive(Debug, Clone, PartialEq)]
pub struct SurfaceResult {
    /// Optiland's label, such as `L1.front`; `component_3` if it has none.
    pub name: String,
    /// `refractive`, `reflective` or `absorbing`.
    pub kind: &'static str,
    /// True if some ray hit it.
    pub reached: bool,
    /// Rays that ended there (absorbing), or events with a loss (reflective).
    pub num_rays_absorbed: u64,
    /// Flux left there \[W\].
    pub total_flux_absorbed: f64,
}

/// Converts weights and quanta to watts.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FluxUnit {
    total_flux: f64,
    num_rays: f64,
}

impl FluxUnit {
    /// The unit of a trace of `num_rays` rays through a scene whose sources emit `total_flux` \[W\].
    pub fn new(total_flux: f64, num_rays: u64) -> Self {
        FluxUnit { total_flux, num_rays: num_rays.max(1) as f64 }
    }

    /// Flux of a sum \[W\]. The ratio comes first, so that all quanta launched are exactly the flux emitted.
    pub fn watts(self, quanta: u128) -> f64 {
        self.total_flux * (quanta as f64 / (QUANTA_PER_WEIGHT * self.num_rays))
    }

    /// Flux of one ray \[W\].
    pub fn watts_of_weight(self, weight: f64) -> f64 {
        self.total_flux * (weight / self.num_rays)
    }
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
            partial: false,
            stopped_by: None,
            target_error: None,
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

impl TraceResult {
    /// Reads the sums of a trace of `ir` out into physical units, with the rows that the tally holds.
    ///
    /// # Errors
    /// [`Error::Internal`] if the tally is not one of this scene.
    pub fn new(ir: &SceneIr, run: &RunInfo, tally: &Tally) -> Result<TraceResult> {
        check_shape(ir, tally)?;
        TraceResult::with_rows(ir, run, tally, &Recorded::of_tally(ir, tally)?)
    }

    /// As [`TraceResult::new`], with rows that were recorded apart from the tally.
    ///
    /// # Errors
    /// [`Error::Internal`] if tally or rows are not those of this scene, [`Error::File`] if the rows cannot be read.
    pub fn with_rows(ir: &SceneIr, run: &RunInfo, tally: &Tally, recorded: &Recorded) -> Result<TraceResult> {
        check_shape(ir, tally)?;
        let emitted: f64 = ir.emitters.iter().map(|emitter| emitter.total_flux).sum();
        let unit = FluxUnit::new(emitted, if run.partial { tally.launched.count } else { run.num_rays });
        let uncertainty = Uncertainty::new(ir, tally, unit);
        let total_flux_in = if run.partial { unit.watts(tally.launched.quanta) } else { emitted };

        let detectors: Vec<Detector> = ir
            .sensors
            .iter()
            .zip(&tally.sensors)
            .zip(&recorded.databases)
            .map(|((sensor, sums), rows)| {
                Detector::new(sensor, sums, rows.as_ref(), unit, &uncertainty, &ir.wavelengths)
            })
            .collect::<Result<_>>()?;
        let surfaces = surfaces(ir, tally, unit);
        let ledger = Ledger::new(ir, tally, unit);
        let total_flux_detected = total_flux(detectors.iter());
        let total_flux_tapped = total_flux(detectors.iter().filter(|detector| !detector.absorb));
        let total_flux_lost = ledger.depth.flux + ledger.roulette_loss.flux;

        let mut result = TraceResult {
            run: run.clone(),
            detectors,
            surfaces,
            num_rays_total: tally.launched.count,
            num_rays_absorbed: ledger.absorbed.count,
            num_rays_escaped: ledger.escaped.count,
            num_rays_flux_killed: ledger.roulette_loss.count,
            num_rays_depth_killed: ledger.depth.count,
            total_flux_in,
            total_flux_detected,
            total_flux_tapped,
            total_flux_absorbed: ledger.absorbed.flux,
            total_flux_bulk_absorbed: ledger.bulk.flux,
            total_flux_escaped: ledger.escaped.flux,
            total_flux_lost,
            flux_conservation_error: 0.0,
            relative_error: worst_relative_error(ir, tally).filter(|error| error.is_finite()),
            ledger,
            diagnostics: Diagnostics::default(),
            ray_paths: RayPaths::new(ir, unit, recorded.paths.clone()),
        };
        result.flux_conservation_error = result.conservation_error();
        result.diagnostics = Diagnostics::new(ir, &result, tally, &uncertainty);
        Ok(result)
    }

    /// The result of the detector of this name.
    pub fn detector(&self, name: &str) -> Option<&Detector> {
        self.detectors.iter().find(|detector| detector.name == name)
    }

    /// A fraction of the launched flux; 0 where nothing was launched.
    pub fn fraction_of_launched(&self, flux: f64) -> f64 {
        if self.total_flux_in > 0.0 { flux / self.total_flux_in } else { 0.0 }
    }

    fn conservation_error(&self) -> f64 {
        let unaccounted = self.total_flux_in
            - (self.total_flux_detected - self.total_flux_tapped)
            - self.total_flux_absorbed
            - self.total_flux_bulk_absorbed
            - self.total_flux_escaped
            - self.total_flux_lost;
        self.fraction_of_launched(unaccounted.abs())
    }
}

impl Detector {
    fn new(
        sensor: &Sensor,
        sums: &SensorTally,
        rows: Option<&Arc<Rows>>,
        unit: FluxUnit,
        uncertainty: &Uncertainty,
        wavelengths: &[f64],
    ) -> Result<Self> {
        let mut total_flux_standard_error = uncertainty.of_total(sums);
        let Booking { count: num_rays_hit, quanta } = sums.total();
        let mut total_flux = unit.watts(quanta);
        let data = match &sensor.kind {
            SensorKind::Irradiance(grid) => {
                DetectorData::Irradiance(IrradianceMap::new(grid, sums, unit, uncertainty)?)
            }
            SensorKind::Spectral { grid, wavelength_edges } => {
                DetectorData::Spectral(SpectralMap::new(grid, wavelength_edges, sums, unit, uncertainty)?)
            }
            SensorKind::FarField { num_theta, num_phi } => {
                DetectorData::FarField(FarFieldPattern::new(*num_theta, *num_phi, sums, unit, uncertainty)?)
            }
            SensorKind::RayDatabase { .. } => {
                let rows = rows.ok_or_else(|| Error::Internal(format!("no rows for `{}`", sensor.name)))?;
                let database = RayDatabase::new(sensor.frame, rows.clone(), total_flux, unit, wavelengths)?;
                if database.truncated {
                    total_flux = database.kept_flux;
                    total_flux_standard_error = None;
                }
                DetectorData::RayDatabase(database)
            }
        };
        Ok(Detector {
            name: sensor.name.clone(),
            absorb: sensor.absorb,
            total_flux,
            total_flux_standard_error,
            num_rays_hit,
            data,
        })
    }

    /// Standard error of `total_flux` relative to it; none where there is no flux or no error.
    pub fn total_flux_relative_error(&self) -> Option<f64> {
        self.total_flux_standard_error.filter(|_| self.total_flux > 0.0).map(|error| error / self.total_flux)
    }

    /// Error of the map: the sum of the cells' standard errors over the sum of their values, in flux. It is the mean of the
    /// cells' relative errors, each weighted by the cell's flux. None of a dark map, or without errors.
    pub fn mean_relative_error(&self) -> Option<f64> {
        let alike = || std::iter::repeat(1.0);
        match &self.data {
            DetectorData::Irradiance(map) => {
                relative_error_of_map(&map.irradiance, map.standard_error.as_ref()?, alike())
            }
            DetectorData::Spectral(map) => {
                relative_error_of_map(&map.irradiance, map.standard_error.as_ref()?, alike())
            }
            DetectorData::FarField(pattern) => {
                let columns = pattern.phi.len();
                let sizes = pattern.solid_angles().into_iter();
                let sizes = sizes.flat_map(|size| std::iter::repeat_n(size, columns));
                relative_error_of_map(&pattern.intensity, pattern.standard_error.as_ref()?, sizes)
            }
            DetectorData::RayDatabase(_) => None,
        }
    }
}

impl DetectorData {
    /// Optiland's name of the kind.
    pub fn kind(&self) -> &'static str {
        match self {
            DetectorData::Irradiance(_) => "irradiance",
            DetectorData::Spectral(_) => "spectral",
            DetectorData::FarField(_) => "far_field",
            DetectorData::RayDatabase(_) => "ray_database",
        }
    }

    /// Pixels, or directions; none for a ray database. Wavelength bins do not count, as in Optiland's diagnostics.
    pub fn num_pixels(&self) -> Option<u64> {
        match self {
            DetectorData::Irradiance(map) => Some(map.irradiance.len() as u64),
            DetectorData::Spectral(map) => Some((map.x_coords.len() * map.y_coords.len()) as u64),
            DetectorData::FarField(pattern) => Some(pattern.intensity.len() as u64),
            DetectorData::RayDatabase(_) => None,
        }
    }
}

/// Starts at 0, since the empty sum of floats is -0.
fn total_flux<'a>(detectors: impl Iterator<Item = &'a Detector>) -> f64 {
    detectors.fold(0.0, |sum, detector| sum + detector.total_flux)
}

/// Refuses sums that are not of this scene.
pub(crate) fn check_shape(ir: &SceneIr, tally: &Tally) -> Result<()> {
    let sensors_fit = ir.sensors.len() == tally.sensors.len()
        && ir.sensors.iter().zip(&tally.sensors).all(|(sensor, sums)| {
            sums.quanta.len() == sensor.num_cells() && sums.hits.len() == sensor.num_cells()
        });
    if sensors_fit && ir.surfaces.len() == tally.surfaces.len() {
        Ok(())
    } else {
        Err(Error::Internal("the sums of the trace do not have the shape of the scene".into()))
    }
}

fn surfaces(ir: &SceneIr, tally: &Tally, unit: FluxUnit) -> Vec<SurfaceResult> {
    ir.surfaces
        .iter()
        .zip(&tally.surfaces)
        .enumerate()
        .map(|(index, (surface, sums))| SurfaceResult {
            name: if surface.name.is_empty() { format!("component_{index}") } else { surface.name.clone() },
            kind: match surface.interaction {
                Interaction::Refractive => "refractive",
                Interaction::Reflective { .. } => "reflective",
                Interaction::Absorbing => "absorbing",
            },
            reached: sums.reached,
            num_rays_absorbed: sums.absorbed.count,
            total_flux_absorbed: unit.watts(sums.absorbed.quanta),
        })
        .collect()
}
