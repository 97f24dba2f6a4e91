//! What Optiland computed for a scene (tests/oracle/), and how far a result is from it.

use crate::bench::root;
use crate::checks::Outcome;
use nsq_gpu::TraceResult;
use nsq_gpu::result::{Detector, DetectorData, RayDatabase, SurfaceKind};
use serde_json::Value;

/// Largest difference of a bin, in units of the map's peak; also of a total, in units of the flux launched.
const LIMIT: f64 = 1e-9;
/// In f32 a decision flips with a probability of about 1e-7 and a position is off by 1e-6: of 1e5 rays a few go
/// elsewhere.
const ROUGH_LIMIT: f64 = 1e-3;

/// One file of tests/oracle/.
pub struct Oracle(Value);

impl Oracle {
    /// The oracle of a scene.
    pub fn load(scene: &str) -> Self {
        let path = root().join("tests/oracle").join(format!("{scene}.json"));
        let text =
            std::fs::read_to_string(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
        Oracle(serde_json::from_str(&text).unwrap())
    }

    /// Rays that Optiland traced.
    pub fn num_rays(&self) -> u64 {
        self.0["num_rays"].as_u64().unwrap()
    }

    /// Rays that met a surface.
    pub fn surface_hits(&self, surface: &str) -> u64 {
        self.0["surface_hits"][surface]
            .as_u64()
            .unwrap_or_else(|| panic!("the oracle has no surface {surface}"))
    }

    /// Ray by ray the same: counts are equal, maps agree to rounding.
    pub fn compare(&self, result: &TraceResult) -> Outcome {
        equal("counts", counts(result).to_vec(), self.counts())?;
        equal("underflows", result.diagnostics.medium_stack_underflows, self.underflows())?;
        let mut unreached = self.unreached();
        let mut ours = result.diagnostics.unreached_geometry.clone();
        unreached.sort();
        ours.sort();
        equal("unreached", ours, unreached)?;
        self.compare_fluxes(result, LIMIT)?;
        self.compare_absorbers(result)?;
        for detector in &result.detectors {
            let theirs = &self.0["detectors"][&detector.name];
            equal("hits", detector.num_rays_hit, theirs["num_rays_hit"].as_u64().unwrap())?;
            match &detector.data {
                DetectorData::RayDatabase(rays) => compare_rows(rays, theirs)?,
                _ => compare_map(detector, theirs)?,
            }
        }
        Ok(())
    }

    /// The same but for a few rays.
    pub fn compare_roughly(&self, result: &TraceResult) -> Outcome {
        for (ours, theirs) in counts(result).into_iter().zip(self.counts()) {
            let difference = ours.abs_diff(theirs) as f64 / self.num_rays() as f64;
            if difference > ROUGH_LIMIT {
                return Err(format!("a count is {ours} instead of {theirs}"));
            }
        }
        self.compare_fluxes(result, ROUGH_LIMIT)
    }

    fn counts(&self) -> Vec<u64> {
        ["total", "absorbed", "escaped", "flux_killed", "depth_killed"]
            .map(|name| self.0[format!("num_rays_{name}")].as_u64().unwrap())
            .to_vec()
    }

    fn underflows(&self) -> u64 {
        self.0["diagnostics"]["medium_stack_underflows"].as_u64().unwrap()
    }

    fn unreached(&self) -> Vec<String> {
        let names = self.0["diagnostics"]["unreached_geometry"].as_array().unwrap();
        names.iter().map(|name| name.as_str().unwrap().to_string()).collect()
    }

    fn compare_fluxes(&self, result: &TraceResult, limit: f64) -> Outcome {
        let fluxes = [
            ("in", result.total_flux_in),
            ("detected", result.total_flux_detected),
            ("tapped", result.total_flux_tapped),
            ("absorbed", result.total_flux_absorbed),
            ("bulk_absorbed", result.total_flux_bulk_absorbed),
            ("escaped", result.total_flux_escaped),
            ("lost", result.total_flux_lost),
        ];
        for (name, ours) in fluxes {
            let theirs = self.0[format!("total_flux_{name}")].as_f64().unwrap();
            close(name, ours, theirs, result.total_flux_in, limit)?;
        }
        Ok(())
    }

    fn compare_absorbers(&self, result: &TraceResult) -> Outcome {
        for surface in result.surfaces.iter().filter(|surface| surface.kind == SurfaceKind::Absorbing) {
            let theirs = &self.0["absorbers"][&surface.name];
            equal(&surface.name, Some(surface.num_rays_absorbed), theirs["num_rays"].as_u64())?;
            let flux = theirs["flux"].as_f64().unwrap();
            close(&surface.name, surface.total_flux_absorbed, flux, result.total_flux_in, LIMIT)?;
        }
        Ok(())
    }
}

fn counts(result: &TraceResult) -> [u64; 5] {
    [
        result.num_rays_total,
        result.num_rays_absorbed,
        result.num_rays_escaped,
        result.num_rays_flux_killed,
        result.num_rays_depth_killed,
    ]
}

fn equal<T: PartialEq + std::fmt::Debug>(what: &str, ours: T, theirs: T) -> Outcome {
    if ours == theirs { Ok(()) } else { Err(format!("{what}: {ours:?} instead of {theirs:?}")) }
}

fn close(what: &str, ours: f64, theirs: f64, scale: f64, limit: f64) -> Outcome {
    let deviation = (ours - theirs).abs() / scale;
    // Written so that a NaN is far from everything.
    if deviation <= limit { Ok(()) } else { Err(format!("{what}: {ours:e} instead of {theirs:e}")) }
}

fn numbers(values: &Value) -> Vec<f64> {
    values.as_array().unwrap().iter().map(|value| value.as_f64().unwrap()).collect()
}

/// Every bin of a small map; of a large one the sampled bins, and the sums along the axes.
fn compare_map(detector: &Detector, theirs: &Value) -> Outcome {
    let (values, shape) = map_of(&detector.data);
    let peak = theirs["peak"].as_f64().unwrap().max(f64::MIN_POSITIVE);
    let polar = matches!(detector.data, DetectorData::FarField(_));
    for (bin, expected) in listed_bins(theirs) {
        // On the axis the azimuth is rounding noise: of the ring at the pole only the sum is defined.
        if !(polar && bin < shape[1]) {
            close(&detector.name, values[bin], expected, peak, LIMIT)?;
        }
    }
    let axes = theirs["axis_sums"].as_array().cloned().unwrap_or_default();
    // Sums over the polar angle, per azimuth, contain the pole.
    for (axis, sums) in axes.iter().enumerate().filter(|(axis, _)| !(polar && *axis == 1)) {
        let length = values.len() as f64 / shape[axis] as f64;
        for (index, expected) in numbers(sums).into_iter().enumerate() {
            close(&detector.name, axis_sum(&values, &shape, axis, index), expected, peak * length, LIMIT)?;
        }
    }
    Ok(())
}

fn listed_bins(theirs: &Value) -> Vec<(usize, f64)> {
    if theirs["values"].is_array() {
        return numbers(&theirs["values"]).into_iter().enumerate().collect();
    }
    let bins = theirs["bins"].as_array().unwrap().iter().map(|bin| bin.as_u64().unwrap() as usize);
    bins.zip(numbers(&theirs["bin_values"])).collect()
}

/// A map's values in C order, and its shape.
fn map_of(data: &DetectorData) -> (Vec<f64>, Vec<usize>) {
    match data {
        DetectorData::Irradiance(map) => {
            (map.irradiance.iter().copied().collect(), map.irradiance.shape().to_vec())
        }
        DetectorData::Spectral(map) => {
            let map = &map.pixels;
            (map.irradiance.iter().copied().collect(), map.irradiance.shape().to_vec())
        }
        DetectorData::FarField(map) => {
            (map.intensity.iter().copied().collect(), map.intensity.shape().to_vec())
        }
        DetectorData::RayDatabase(_) => (Vec::new(), Vec::new()),
    }
}

fn axis_sum(values: &[f64], shape: &[usize], axis: usize, index: usize) -> f64 {
    let stride: usize = shape[axis + 1..].iter().product();
    values.iter().enumerate().filter(|(i, _)| i / stride % shape[axis] == index).map(|(_, value)| value).sum()
}

/// Sums of the columns and of their squares.
fn compare_rows(rays: &RayDatabase, theirs: &Value) -> Outcome {
    equal("rows", Some(rays.num_rays()), theirs["rows"].as_u64())?;
    let rays = rays.columns().map_err(|error| error.to_string())?;
    let [x, y, z] = &rays.position;
    let [l, m, n] = &rays.direction;
    let columns = [x, y, z, l, m, n, &rays.flux, &rays.wavelength];
    let sums = numbers(&theirs["column_sums"]);
    let squares = numbers(&theirs["column_square_sums"]);
    for ((column, sum), square) in columns.into_iter().zip(sums).zip(squares) {
        let scale = (square * column.len() as f64).sqrt().max(f64::MIN_POSITIVE);
        close("column", column.sum(), sum, scale, LIMIT)?;
        close("column of squares", column.iter().map(|v| v * v).sum(), square, square.max(1e-300), LIMIT)?;
    }
    Ok(())
}
