//! Compares a result with the reference's, ray for ray: counts equal, maps, rows and totals to rounding.

use std::collections::BTreeMap;
use std::fmt::Debug;

use nsq_gpu::TraceResult;
use nsq_gpu::result::{Detector, DetectorData, DetectorDiagnostic, RayDatabase, SurfaceKind};

use crate::oracle::{Body, Digest, MapDigest, Oracle, OracleDetectorDiagnostic, RowsDigest, Totals};

/// Largest difference of a map's bin, or of a sum of bins, in units of the map's peak.
const MAP_LIMIT: f64 = 1e-9;
/// Largest relative difference of a total.
const TOTAL_LIMIT: f64 = 1e-11;
/// A total below this fraction of the launched flux is compared as if it were as large: it is a difference of larger
/// numbers, or a sum of few.
const TOTAL_FLOOR: f64 = 1e-3;
/// Largest difference of a row's number, in units of the column's scale.
const ROW_LIMIT: f64 = 1e-9;
/// Largest difference of a column's sum, in units of the number of rows times the column's scale.
const COLUMN_LIMIT: f64 = 1e-11;
/// Largest relative difference of an axis.
const AXIS_LIMIT: f64 = 1e-12;

/// The worst deviation of each kind, and what broke a limit.
#[derive(Debug, Default)]
pub struct Agreement {
    pub worst: BTreeMap<&'static str, f64>,
    pub violations: Vec<String>,
}

impl Agreement {
    /// Compares a result, traced without caps of ray databases.
    pub fn of(ours: &TraceResult, theirs: &Oracle) -> Self {
        let mut agreement = Agreement::default();
        agreement.totals(ours, theirs);
        agreement.absorbers(ours, theirs);
        agreement.diagnostics(ours, theirs);
        let names: Vec<&String> = ours.detectors.iter().map(|detector| &detector.name).collect();
        let mut sorted = names.clone();
        sorted.sort();
        agreement.equal("detectors", sorted, theirs.detectors.keys().collect());
        for detector in &ours.detectors {
            if let Some(digest) = theirs.detectors.get(&detector.name) {
                agreement.detector(detector, digest, theirs.totals.total_flux_in);
            }
        }
        agreement
    }

    /// Notes a deviation; a NaN is larger than every limit.
    fn note(&mut self, kind: &'static str, what: &str, deviation: f64, limit: f64) {
        let deviation = if deviation.is_nan() { f64::INFINITY } else { deviation };
        let worst = self.worst.entry(kind).or_default();
        *worst = worst.max(deviation);
        if deviation > limit {
            self.violations.push(format!("{what}: {deviation:.3e} > {limit:.0e}"));
        }
    }

    fn equal<T: PartialEq + Debug>(&mut self, what: &str, ours: T, theirs: T) {
        if ours != theirs {
            self.violations.push(format!("{what}: {ours:?}, not {theirs:?}"));
        }
    }

    fn total(&mut self, what: &str, ours: f64, theirs: f64, launched: f64) {
        let scale = theirs.abs().max(TOTAL_FLOOR * launched);
        self.note("total", what, (ours - theirs).abs() / scale, TOTAL_LIMIT);
    }

    fn totals(&mut self, ours: &TraceResult, theirs: &Oracle) {
        let mine = totals_of(ours);
        for ((what, our_count), (_, their_count)) in counts(&mine).into_iter().zip(counts(&theirs.totals)) {
            self.equal(what, our_count, their_count);
        }
        for ((what, our_flux), (_, their_flux)) in fluxes(&mine).into_iter().zip(fluxes(&theirs.totals)) {
            self.total(what, our_flux, their_flux, theirs.totals.total_flux_in);
        }
        let error = (ours.flux_conservation_error - theirs.flux_conservation_error).abs();
        self.note("total", "flux_conservation_error", error, TOTAL_LIMIT);
    }

    fn absorbers(&mut self, ours: &TraceResult, theirs: &Oracle) {
        let mut sums: BTreeMap<&str, (u64, f64)> = BTreeMap::new();
        for surface in ours.surfaces.iter().filter(|surface| surface.kind == SurfaceKind::Absorbing) {
            let sum = sums.entry(&surface.name).or_default();
            *sum = (sum.0 + surface.num_rays_absorbed, sum.1 + surface.total_flux_absorbed);
        }
        let names = sums.keys().map(|name| name.to_string()).collect::<Vec<_>>();
        self.equal("absorbers", names, theirs.absorbers.keys().cloned().collect());
        for (name, absorber) in &theirs.absorbers {
            let (count, flux) = sums.get(name.as_str()).copied().unwrap_or_default();
            self.equal(&format!("rays absorbed by {name}"), count, absorber.num_rays);
            let what = format!("flux absorbed by {name}");
            self.total(&what, flux, absorber.flux, theirs.totals.total_flux_in);
        }
    }

    fn diagnostics(&mut self, ours: &TraceResult, theirs: &Oracle) {
        let (mine, other) = (&ours.diagnostics, &theirs.diagnostics);
        let sorted = |names: &[String]| {
            let mut names = names.to_vec();
            names.sort();
            names
        };
        let unreached = [&mine.unreached_geometry, &other.unreached_geometry].map(|names| sorted(names));
        self.equal("unreached_geometry", &unreached[0], &unreached[1]);
        self.equal("medium_stack_underflows", mine.medium_stack_underflows, other.medium_stack_underflows);
        self.equal("split_budget_saturated", mine.split_budget_saturated, other.split_budget_saturated);
        let depth = mine.depth_truncated_flux_fraction - other.depth_truncated_flux_fraction;
        self.note("total", "depth_truncated_flux_fraction", depth.abs(), TOTAL_LIMIT);
        let roulette = mine.rr_killed_flux_fraction - other.rr_killed_flux_fraction;
        self.note("total", "rr_killed_flux_fraction", roulette.abs(), TOTAL_LIMIT);
        self.equal("diagnosed detectors", mine.detectors.len(), other.detectors.len());
        for (mine, other) in mine.detectors.iter().zip(&other.detectors) {
            self.detector_diagnostic(mine, other);
        }
    }

    fn detector_diagnostic(&mut self, ours: &DetectorDiagnostic, theirs: &OracleDetectorDiagnostic) {
        let what = |field: &str| format!("diagnostics of {}: {field}", theirs.name);
        self.equal(&what("name"), &ours.name, &theirs.name);
        self.equal(&what("num_rays_hit"), ours.num_rays_hit, theirs.num_rays_hit);
        self.equal(&what("num_pixels"), ours.num_pixels, theirs.num_pixels);
        self.equal(&what("mean_hits"), ours.mean_hits_per_pixel, theirs.mean_hits_per_pixel);
        self.equal(&what("undersampled"), ours.undersampled, theirs.undersampled);
        self.equal(&what("rays_needed"), ours.rays_needed_for_5pct, theirs.rays_needed_for_5pct);
    }

    fn detector(&mut self, ours: &Detector, theirs: &Digest, launched: f64) {
        let name = &ours.name;
        self.equal(&format!("{name}: kind"), ours.data.kind(), theirs.kind.as_str());
        self.equal(&format!("{name}: absorb"), ours.absorb, !theirs.transmissive);
        self.equal(&format!("{name}: num_rays_hit"), ours.num_rays_hit, theirs.num_rays_hit);
        self.total(&format!("{name}: total_flux"), ours.total_flux, theirs.total_flux, launched);
        match (&ours.data, &theirs.body) {
            (DetectorData::RayDatabase(rays), Body::Rows(digest)) => self.rows(name, rays, digest),
            (data, Body::Map(digest)) => self.map(name, &MapView::of(data), digest),
            _ => self.violations.push(format!("{name}: a map and a ray database are compared")),
        }
    }

    fn map(&mut self, name: &str, ours: &MapView, theirs: &MapDigest) {
        self.equal(&format!("{name}: shape"), &ours.shape, &theirs.shape);
        if ours.shape != theirs.shape {
            return;
        }
        for (axis, ends) in &theirs.axis_ends {
            let scale = ends[0].abs().max(ends[1].abs());
            let mine = ours.axis_ends.get(axis.as_str()).copied().unwrap_or([f64::NAN; 2]);
            let deviation = (mine[0] - ends[0]).abs().max((mine[1] - ends[1]).abs()) / scale;
            self.note("axis", &format!("{name}: {axis}"), deviation, AXIS_LIMIT);
        }
        let scale = if theirs.peak > 0.0 { theirs.peak } else { 1.0 };
        let peak = ours.values.iter().copied().fold(0.0, f64::max);
        // Of the ring at a pole only the sum is defined, and it may hold the peak.
        if !ours.is_far_field {
            self.note("map", &format!("{name}: peak"), (peak - theirs.peak).abs() / scale, MAP_LIMIT);
        }
        if let Some(values) = &theirs.values {
            self.whole_map(name, ours, values, scale);
        }
        if let Some(sums) = &theirs.axis_sums {
            self.axis_sums(name, ours, sums, scale);
        }
        let (bins, values) = (theirs.bins.iter().flatten(), theirs.bin_values.iter().flatten());
        for (&bin, value) in bins.zip(values).filter(|(bin, _)| **bin >= ours.pole_bins()) {
            let deviation = (ours.values[bin] - value).abs() / scale;
            self.note("map", &format!("{name}: bin {bin}"), deviation, MAP_LIMIT);
        }
    }

    fn whole_map(&mut self, name: &str, ours: &MapView, theirs: &[f64], scale: f64) {
        let pole = ours.pole_bins();
        let ring = ours.values[..pole].iter().sum::<f64>() - theirs[..pole].iter().sum::<f64>();
        self.note("map", &format!("{name}: ring at the pole"), ring.abs() / scale, MAP_LIMIT);
        for (bin, (mine, other)) in ours.values.iter().zip(theirs).enumerate().skip(pole) {
            self.note("map", &format!("{name}: bin {bin}"), (mine - other).abs() / scale, MAP_LIMIT);
        }
    }

    fn axis_sums(&mut self, name: &str, ours: &MapView, theirs: &[Vec<f64>], scale: f64) {
        for (axis, sums) in theirs.iter().enumerate() {
            let mine = ours.sums_along(axis);
            for (i, (mine, other)) in mine.iter().zip(sums).enumerate() {
                let what = format!("{name}: sum {i} of axis {axis}");
                self.note("map", &what, (mine - other).abs() / scale, MAP_LIMIT);
            }
        }
    }

    fn rows(&mut self, name: &str, ours: &RayDatabase, theirs: &RowsDigest) {
        let rows = rows_of(ours);
        self.equal(&format!("{name}: rows"), rows.len(), theirs.rows);
        if rows.len() != theirs.rows || rows.is_empty() {
            return;
        }
        let scales = column_scales(&rows);
        let count = rows.len() as f64;
        for (column, scale) in scales.into_iter().enumerate() {
            let sum: f64 = rows.iter().map(|row| row[column]).sum();
            let squares: f64 = rows.iter().map(|row| row[column] * row[column]).sum();
            let what = format!("{name}: sum of {}", theirs.columns[column]);
            let deviation = (sum - theirs.column_sums[column]).abs() / (count * scale);
            self.note("rows", &what, deviation, COLUMN_LIMIT);
            let deviation = (squares - theirs.column_square_sums[column]).abs() / (count * scale * scale);
            self.note("rows", &format!("{what} squared"), deviation, COLUMN_LIMIT);
        }
        for row in theirs.first_rows.iter().chain(&theirs.last_rows) {
            let deviation = distance_to_rows(row, &rows, &scales);
            self.note("rows", &format!("{name}: row {row:?}"), deviation, ROW_LIMIT);
        }
    }
}

/// How far the nearest of some rows, sorted by their first column, is from a row; columns in units of their scales.
fn distance_to_rows(row: &[f64; 8], rows: &[[f64; 8]], scales: &[f64; 8]) -> f64 {
    let reach = 1e3 * ROW_LIMIT * scales[0];
    let first = rows.partition_point(|other| other[0] < row[0] - reach);
    let near = rows[first..].iter().take_while(|other| other[0] <= row[0] + reach);
    let distance = |other: &[f64; 8]| {
        (0..8).map(|column| (row[column] - other[column]).abs() / scales[column]).fold(0.0, f64::max)
    };
    near.map(distance).fold(f64::INFINITY, f64::min)
}

/// x, y, z, L, M, N, flux, wavelength of every row, sorted.
fn rows_of(rays: &RayDatabase) -> Vec<[f64; 8]> {
    let rays = rays.columns().expect("the rows are in memory");
    let ([x, y, z], [l, m, n]) = (&rays.position, &rays.direction);
    let row = |i: usize| [x[i], y[i], z[i], l[i], m[i], n[i], rays.flux[i], rays.wavelength[i]];
    let mut rows: Vec<[f64; 8]> = (0..rays.flux.len()).map(row).collect();
    rows.sort_by(|a, b| a.partial_cmp(b).expect("rows hold numbers"));
    rows
}

/// Positions share one scale, the largest coordinate; direction cosines and um are of order one.
fn column_scales(rows: &[[f64; 8]]) -> [f64; 8] {
    let largest = |column: usize| rows.iter().map(|row| row[column].abs()).fold(0.0, f64::max);
    let extent = largest(0).max(largest(1)).max(largest(2));
    [extent, extent, extent, 1.0, 1.0, 1.0, largest(6), 1.0]
}

/// A map, its last axis running fastest.
pub struct MapView {
    pub shape: Vec<usize>,
    pub values: Vec<f64>,
    is_far_field: bool,
    axis_ends: BTreeMap<&'static str, [f64; 2]>,
}

impl MapView {
    /// The map of a detector that has one; that of a ray database is empty.
    pub fn of(data: &DetectorData) -> Self {
        let ends = |axis: &ndarray::Array1<f64>| [axis[0], axis[axis.len() - 1]];
        let (shape, values, axis_ends) = match data {
            DetectorData::Irradiance(map) => (
                map.irradiance.shape().to_vec(),
                map.irradiance.iter().copied().collect(),
                vec![("x_coords", ends(&map.x_coords)), ("y_coords", ends(&map.y_coords))],
            ),
            DetectorData::Spectral(map) => (
                map.pixels.irradiance.shape().to_vec(),
                map.pixels.irradiance.iter().copied().collect(),
                vec![
                    ("x_coords", ends(&map.pixels.x_coords)),
                    ("y_coords", ends(&map.pixels.y_coords)),
                    ("wavelengths", ends(&map.wavelengths)),
                ],
            ),
            DetectorData::FarField(map) => (
                map.intensity.shape().to_vec(),
                map.intensity.iter().copied().collect(),
                vec![("theta", ends(&map.theta)), ("phi", ends(&map.phi))],
            ),
            DetectorData::RayDatabase(_) => (vec![], vec![], vec![]),
        };
        let is_far_field = matches!(data, DetectorData::FarField(_));
        MapView { shape, values, is_far_field, axis_ends: axis_ends.into_iter().collect() }
    }

    /// Bins of the ring at the pole, where azimuth is rounding noise: the first ones.
    fn pole_bins(&self) -> usize {
        if self.is_far_field { self.shape[1] } else { 0 }
    }

    /// Sums over all axes but one. The ring at the pole stays out of the sums of the azimuth.
    fn sums_along(&self, axis: usize) -> Vec<f64> {
        let stride: usize = self.shape[axis + 1..].iter().product();
        let first = if axis == 1 { self.pole_bins() } else { 0 };
        let mut sums = vec![0.0; self.shape[axis]];
        for (bin, value) in self.values.iter().enumerate().skip(first) {
            sums[bin / stride % self.shape[axis]] += value;
        }
        sums
    }
}

/// A result's counts and fluxes.
pub fn totals_of(result: &TraceResult) -> Totals {
    Totals {
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
    }
}

/// Counts with their names.
pub fn counts(totals: &Totals) -> [(&'static str, u64); 5] {
    [
        ("num_rays_total", totals.num_rays_total),
        ("num_rays_absorbed", totals.num_rays_absorbed),
        ("num_rays_escaped", totals.num_rays_escaped),
        ("num_rays_flux_killed", totals.num_rays_flux_killed),
        ("num_rays_depth_killed", totals.num_rays_depth_killed),
    ]
}

/// Fluxes with their names.
pub fn fluxes(totals: &Totals) -> [(&'static str, f64); 7] {
    [
        ("total_flux_in", totals.total_flux_in),
        ("total_flux_detected", totals.total_flux_detected),
        ("total_flux_tapped", totals.total_flux_tapped),
        ("total_flux_absorbed", totals.total_flux_absorbed),
        ("total_flux_bulk_absorbed", totals.total_flux_bulk_absorbed),
        ("total_flux_escaped", totals.total_flux_escaped),
        ("total_flux_lost", totals.total_flux_lost),
    ]
}
