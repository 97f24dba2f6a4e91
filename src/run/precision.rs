//! Predicts the error of f32 from the paths that a scene's light takes, to choose the precision that the scene needs.
//!
//! A pilot of some hundred rays is traced in f32 and recorded. Along each path a covariance of position and direction
//! is carried. Every event adds the roundings of its coordinates. Free flight, curvature, reflection and refraction
//! carry on earlier errors, by the derivatives of their laws. Source: ray differentials; Igehy, Tracing Ray
//! Differentials, SIGGRAPH 1999.
//!
//! At a detector the covariance becomes pixels. The paths include the scene's extent, curvatures, pixels and depth. So
//! the prediction differs between a system that focuses errors away and a system that magnifies them.

use crate::error::Result;
use crate::gpu::Gpu;
use crate::model::detectors::grid::ArrivalError;
use crate::model::shapes::Level;
use crate::model::{Detector, Frame, Interaction, Sampling, SceneIr, Surface};
use crate::program::{Precision, centre_of};
use crate::result::{PathEvent, PathEventKind, RayRow, Tally};
use crate::run::{Collect, RecordPaths, StandardError, TraceOptions, Tracer};
use glam::{DMat3, DVec3};
use std::collections::HashSet;

/// Up to this error \[pixels\], a map is as good as exact.
pub const GOOD_PIXELS: f64 = 0.01;
/// Beyond this error \[pixels\], a map in f32 draws a warning.
const BAD_PIXELS: f64 = 0.1;
/// The share of a detector's flux to which the predicted error applies.
const SHARE: f64 = 0.99;
/// Rays of the pilot, and its largest depth. Light that a filter keeps may be rare.
const PILOT_RAYS: u64 = 512;
const FILTERED_PILOT_RAYS: u64 = 1 << 13;
const PILOT_DEPTH: u32 = 256;
/// The number of standard deviations in a bound.
const SIGMAS: f64 = 3.0;
/// Half a unit in the last place of 1 in f32.
const ROUNDING: f64 = 0.5 * f32::EPSILON as f64;
/// Standard deviation of a coordinate's error at an event, and of a direction's components before and after it, in
/// roundings. The value is one rounding at worst. The bound then holds in every scene of the collection
/// (tests/precision.rs).
const ROUNDINGS: f64 = 1.0;

/// The precision that the user asks for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum WantedPrecision {
    /// The least expensive precision that is good enough.
    Auto,
    /// This one.
    Exactly(Precision),
}

/// A precision, and the reason for it.
#[derive(Debug, Clone, PartialEq)]
pub struct ChosenPrecision {
    /// The precision.
    pub precision: Precision,
    /// The reason.
    pub reason: String,
    /// A warning, if there is one.
    pub warning: Option<String>,
}

/// The error of f32 in a detector.
#[derive(Debug, Clone, PartialEq)]
pub struct DetectorError {
    /// Index of the detector.
    pub detector: usize,
    /// The error within which 99 % of the flux lands \[pixels\]; `None` where the detector has no pixels.
    pub pixels: Option<f64>,
    /// The same as a distance \[mm\].
    pub position: f64,
}

/// The error of f32 at one arrival of a ray on a detector.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Arrival {
    /// The ray.
    pub ray_id: u64,
    /// The ray's events before this one.
    pub bounce: u32,
    /// The detector.
    pub detector: usize,
    /// The ray's weight.
    pub weight: f64,
    /// Bound of the position's error across the detector \[mm\].
    pub position: f64,
    /// Bound of the direction's error \[rad\].
    pub direction: f64,
    /// Bound of the error \[pixels\], where there are pixels.
    pub pixels: Option<f64>,
}

/// Chooses the precision of a trace.
///
/// # Errors
/// [`crate::Error::Device`] if the device fails.
pub fn choose(
    gpu: &Gpu,
    ir: &SceneIr,
    options: &TraceOptions,
    wanted: WantedPrecision,
) -> Result<ChosenPrecision> {
    choose_by(gpu, ir, options, wanted, |ir, options| Tracer::new(gpu, ir, options)?.trace(|_| true))
}

/// As [`choose`]. `trace` traces the pilot.
///
/// # Errors
/// The errors of `trace`.
pub fn choose_by(
    gpu: &Gpu,
    ir: &SceneIr,
    options: &TraceOptions,
    wanted: WantedPrecision,
    trace: impl Fn(&SceneIr, &TraceOptions) -> Result<Tally>,
) -> Result<ChosenPrecision> {
    let plain =
        |precision, reason: &str| Ok(ChosenPrecision { precision, reason: reason.into(), warning: None });
    match wanted {
        WantedPrecision::Exactly(precision @ (Precision::Df64 | Precision::F64)) => {
            plain(precision, "asked for")
        }
        WantedPrecision::Exactly(Precision::F32) => {
            let need = Need::of(ir, &predict_by(ir, options, &trace)?);
            let reason = format!("asked for: {}", need.text(ir));
            Ok(ChosenPrecision { precision: Precision::F32, reason, warning: need.warning(ir) })
        }
        WantedPrecision::Auto if gpu.f64 && gpu.info.class.computes_f64_as_fast_as_f32() => {
            plain(Precision::F64, "a processor computes f64 about as fast as f32")
        }
        WantedPrecision::Auto => {
            let need = Need::of(ir, &predict_by(ir, options, &trace)?);
            Ok(need.choice(ir, || finest(gpu)))
        }
    }
}

/// What a scene needs of a precision.
#[derive(Debug, Clone, PartialEq)]
pub enum Need {
    /// The worst error of f32 on a detector with pixels.
    Pixels(DetectorError),
    /// The error on a ray database, which holds positions themselves: every digit counts there.
    Positions(DetectorError),
    /// No ray of the pilot reached a detector.
    Unknown,
}

impl Need {
    /// The need of a scene whose detectors have these errors.
    pub fn of(ir: &SceneIr, errors: &[DetectorError]) -> Self {
        let database = errors.iter().find(|error| is_database(ir, error.detector));
        if let Some(database) = database {
            return Need::Positions(database.clone());
        }
        let worst = errors.iter().max_by(|a, b| a.pixels.unwrap_or(0.0).total_cmp(&b.pixels.unwrap_or(0.0)));
        worst.map_or(Need::Unknown, |worst| Need::Pixels(worst.clone()))
    }

    /// The least expensive precision that is good enough. `finest` is called where that is not f32.
    pub fn choice(&self, ir: &SceneIr, finest: impl FnOnce() -> Precision) -> ChosenPrecision {
        let enough = matches!(self, Need::Pixels(error) if error.pixels.unwrap_or(0.0) <= GOOD_PIXELS);
        let precision = if enough { Precision::F32 } else { finest() };
        let (end, warning) = match precision {
            Precision::F32 if enough => ("", None),
            Precision::F32 => (", but the adapter has neither f64 nor df64", self.warning(ir)),
            Precision::Df64 => ("; the adapter has no f64", None),
            Precision::F64 => ("", None),
        };
        ChosenPrecision { precision, reason: format!("auto: {}{end}", self.text(ir)), warning }
    }

    fn text(&self, ir: &SceneIr) -> String {
        match self {
            Need::Pixels(error) => format!(
                "in f32, 99 % of the flux on `{}` lands within {:.2e} pixel of where it should (predicted; good below \
                 {GOOD_PIXELS})",
                ir.detectors[error.detector].name,
                error.pixels.unwrap_or(0.0)
            ),
            Need::Positions(error) => format!(
                "`{}` records positions, which f32 holds to {:.2e} mm (predicted)",
                ir.detectors[error.detector].name, error.position
            ),
            Need::Unknown => {
                "the error of f32 is unknown: no light of a short trace reached a detector".into()
            }
        }
    }

    fn warning(&self, ir: &SceneIr) -> Option<String> {
        let Need::Pixels(error) = self else { return None };
        let pixels = error.pixels.filter(|pixels| *pixels > BAD_PIXELS)?;
        Some(format!(
            "f32 is too coarse for detector '{}': 1 % of its flux or more may land beyond {pixels:.2} pixel from where it \
             should (predicted); in f64 (--precision f64) it is 2^29 times less, in df64 2^22 times",
            ir.detectors[error.detector].name
        ))
    }
}

/// The most accurate precision that an adapter has.
fn finest(gpu: &Gpu) -> Precision {
    if gpu.f64 {
        return Precision::F64;
    }
    gpu.check_df64().map_or(Precision::F32, |()| Precision::Df64)
}

fn is_database(ir: &SceneIr, detector: usize) -> bool {
    ir.detectors[detector].kind.stores_rays()
}

/// Predicts the error of f32 in every detector that the pilot reaches.
///
/// # Errors
/// [`crate::Error::Device`] if the device fails.
pub fn predict(gpu: &Gpu, ir: &SceneIr, options: &TraceOptions) -> Result<Vec<DetectorError>> {
    predict_by(ir, options, |ir, options| Tracer::new(gpu, ir, options)?.trace(|_| true))
}

fn predict_by(
    ir: &SceneIr,
    options: &TraceOptions,
    trace: impl Fn(&SceneIr, &TraceOptions) -> Result<Tally>,
) -> Result<Vec<DetectorError>> {
    let is_filtered = options.path_filter.is_some();
    let num_rays = if is_filtered { FILTERED_PILOT_RAYS } else { PILOT_RAYS };
    let pilot = TraceOptions {
        collect: Collect::Light,
        num_rays: options.num_rays.min(num_rays),
        max_depth: options.max_depth.min(PILOT_DEPTH),
        precision: Precision::F32,
        paths: RecordPaths::All,
        standard_error: StandardError::Off,
        ..options.clone()
    };
    // A split ray's child begins its path at the split, with errors of its parent. So branches are drawn here, and not
    // split.
    let sampling = Sampling { split_depth: 0, ..ir.sampling };
    // The rows of detectors show what a filter keeps.
    let seen = if is_filtered { ir.with_ray_databases() } else { ir.with_single_cells() };
    let tally = trace(&SceneIr { sampling, ..seen }, &pilot)?;
    let mut arrivals = arrivals(ir, &tally.paths);
    if is_filtered {
        let rows = tally.detectors.iter().enumerate().flat_map(|(number, detector)| {
            detector.rows.iter().map(move |row| (number, row.ray_id, row.bounce))
        });
        let kept: HashSet<(usize, u64, u32)> = rows.collect();
        arrivals.retain(|arrival| kept.contains(&(arrival.detector, arrival.ray_id, arrival.bounce)));
    }
    let of_detector =
        |detector| arrivals.iter().filter(|a| a.detector == detector).copied().collect::<Vec<_>>();
    let errors = (0..ir.detectors.len()).map(|detector| (detector, of_detector(detector)));
    Ok(errors
        .filter(|(_, arrivals)| !arrivals.is_empty())
        .map(|(detector, arrivals)| DetectorError {
            detector,
            pixels: quantile(arrivals.iter().filter_map(|a| Some((a.pixels?, a.weight)))),
            position: quantile(arrivals.iter().map(|a| (a.position, a.weight))).unwrap_or(0.0),
        })
        .collect())
}

/// The value below which [`SHARE`] of the weight lies.
pub fn quantile(values: impl Iterator<Item = (f64, f64)>) -> Option<f64> {
    let mut values: Vec<(f64, f64)> = values.collect();
    values.sort_by(|a, b| a.0.total_cmp(&b.0));
    let total: f64 = values.iter().map(|(_, weight)| weight).sum();
    let mut sum = 0.0;
    let reached = |(_, weight): &&(f64, f64)| {
        sum += weight;
        sum >= SHARE * total
    };
    values.iter().find(reached).or(values.last()).map(|(value, _)| *value)
}

/// The error of f32 at every arrival on a detector, along recorded paths, which are sorted by ray and event.
pub fn arrivals(ir: &SceneIr, paths: &[PathEvent]) -> Vec<Arrival> {
    let centre = centre_of(ir);
    let mut arrivals = Vec::new();
    for path in paths.chunk_by(|a, b| a.ray.ray_id == b.ray.ray_id) {
        let mut path: Vec<&PathEvent> = path.iter().collect();
        path.sort_by_key(|event| (event.ray.bounce, order(event.kind)));
        follow(ir, centre, &path, &mut arrivals);
    }
    arrivals
}

/// Order of events with the same count of bounces: a birth comes before a hit, and a death after it.
fn order(kind: PathEventKind) -> u8 {
    match kind {
        PathEventKind::Birth(_) => 0,
        PathEventKind::Surface(_) | PathEventKind::Detector(_) => 1,
        PathEventKind::Escaped | PathEventKind::DepthKilled | PathEventKind::FluxKilled => 2,
    }
}

fn follow(ir: &SceneIr, centre: DVec3, path: &[&PathEvent], arrivals: &mut Vec<Arrival>) {
    let Some(birth) = path.first() else { return };
    let mut position = DVec3::from_array(birth.ray.position);
    let mut errors = Covariance::NONE;
    errors.round_position((position - centre).length());
    errors.round_direction(birth_roundings(ir, birth));
    for (i, event) in path.iter().enumerate().skip(1) {
        let (hit, direction) =
            (DVec3::from_array(event.ray.position), DVec3::from_array(event.ray.direction));
        let distance = position.distance(hit);
        let size = (hit - centre).length() + distance;
        match event.kind {
            PathEventKind::Surface(index) => {
                let Some(next) = path.get(i + 1) else { break };
                let after = DVec3::from_array(next.ray.direction);
                let surface = &ir.surfaces[index];
                let bend = Bend::new(ir, surface, event.ray.wavelength as usize, hit, direction, after);
                errors.fly(distance, direction, bend.normal, size);
                errors.turn(&bend);
            }
            PathEventKind::Detector(index) => {
                errors.fly(distance, direction, ir.detectors[index].frame.rotation.z_axis, size);
                arrivals.push(arrival(event, index, &ir.detectors[index], &errors));
            }
            PathEventKind::Birth(_)
            | PathEventKind::Escaped
            | PathEventKind::DepthKilled
            | PathEventKind::FluxKilled => break,
        }
        position = hit;
    }
}

/// Roundings of a new ray's direction. Lambert's law draws the cosine: where the cosine is near 1, the sine holds few
/// digits.
fn birth_roundings(ir: &SceneIr, birth: &PathEvent) -> f64 {
    let PathEventKind::Birth(index) = birth.kind else { return 1.0 };
    let source = &ir.sources[index];
    match source.kind.is_lambertian() {
        true => lambertian_roundings(DVec3::from_array(birth.ray.direction), source.frame.rotation.z_axis),
        false => 1.0,
    }
}

/// Roundings of a direction drawn around a normal by Lambert's law. The sine is the root of 1 - cos^2, of which f32
/// holds 24 bits.
fn lambertian_roundings(direction: DVec3, normal: DVec3) -> f64 {
    1.0 + direction.cross(normal).length().max(ROUNDING.sqrt()).recip()
}

fn arrival(event: &PathEvent, index: usize, detector: &Detector, errors: &Covariance) -> Arrival {
    let axes = detector.frame.rotation;
    let along = |matrix: DMat3, axis: DVec3| SIGMAS * axis.dot(matrix * axis).max(0.0).sqrt();
    let (x, y) = (along(errors.pp, axes.x_axis), along(errors.pp, axes.y_axis));
    let dd = errors.dd;
    let bent = SIGMAS * (dd.x_axis.x + dd.y_axis.y + dd.z_axis.z).max(0.0).sqrt();
    let direction = axes.transpose() * DVec3::from_array(event.ray.direction);
    let pixels = detector.kind.cells_off(&ArrivalError { x, y, bent, direction });
    let RayRow { ray_id, bounce, weight, .. } = event.ray;
    Arrival { ray_id, bounce, detector: index, weight, position: x.hypot(y), direction: bent, pixels }
}

/// Covariances of a ray's errors: position with position \[mm^2\], position with direction, direction with direction.
struct Covariance {
    pp: DMat3,
    pd: DMat3,
    dd: DMat3,
}

impl Covariance {
    const NONE: Self = Covariance { pp: DMat3::ZERO, pd: DMat3::ZERO, dd: DMat3::ZERO };

    /// Adds the rounding of a position; `size` is the size of the rounded coordinates \[mm\].
    fn round_position(&mut self, size: f64) {
        self.pp += DMat3::from_diagonal(DVec3::splat((ROUNDINGS * ROUNDING * size).powi(2)));
    }

    fn round_direction(&mut self, roundings: f64) {
        self.dd += DMat3::from_diagonal(DVec3::splat((roundings * ROUNDINGS * ROUNDING).powi(2)));
    }

    /// Carries the errors over a distance, to a face with this normal.
    fn fly(&mut self, distance: f64, direction: DVec3, normal: DVec3, size: f64) {
        self.pp += (self.pd + self.pd.transpose()) * distance + self.dd * (distance * distance);
        self.pd += self.dd * distance;
        // An error along the ray does not leave the face.
        let along = direction.dot(normal);
        if along != 0.0 {
            let onto = DMat3::IDENTITY - outer(direction, normal) * along.recip();
            self.pp = onto * self.pp * onto.transpose();
            self.pd = onto * self.pd;
        }
        self.round_position(size);
    }

    fn turn(&mut self, bend: &Bend) {
        self.round_direction(1.0);
        let (a, b) = (bend.by_direction, bend.by_position);
        let mixed = b * self.pd * a.transpose();
        self.dd = a * self.dd * a.transpose() + mixed + mixed.transpose() + b * self.pp * b.transpose();
        self.pd = self.pd * a.transpose() + self.pp * b.transpose();
        self.round_direction(bend.roundings);
    }
}

/// How an event changes a direction: d(direction after) = by_direction d(direction before) + by_position d(position).
struct Bend {
    normal: DVec3,
    by_direction: DMat3,
    by_position: DMat3,
    /// Roundings of the direction after.
    roundings: f64,
}

impl Bend {
    fn new(
        ir: &SceneIr,
        surface: &Surface,
        wavelength: usize,
        hit: DVec3,
        before: DVec3,
        after: DVec3,
    ) -> Self {
        let index = |medium: usize| ir.media[medium].n[wavelength];
        let (front, back) = (index(surface.front), index(surface.back));
        let (normal, bending) = normal_of(surface, hit).unwrap_or_else(|| {
            // A mesh's normal does not bend, and follows from the directions. Either orientation serves.
            let passed = surface.interaction == Interaction::Refractive;
            let reflection = (after - before).normalize_or(before);
            let refracted = [(front, back), (back, front)]
                .map(|(n1, n2)| (n2 * after - n1 * before).normalize_or(before))
                .into_iter()
                .min_by(|a, b| before.cross(*a).length().total_cmp(&before.cross(*b).length()));
            (if passed { refracted.unwrap_or(reflection) } else { reflection }, DMat3::ZERO)
        });
        let cosine = before.dot(normal);
        let transmitted =
            surface.interaction == Interaction::Refractive && (after.dot(normal) > 0.0) == (cosine > 0.0);
        let (n1, n2) = if cosine > 0.0 { (front, back) } else { (back, front) };
        // The direction after is eta before + share normal; share depends on the cosine alone.
        let (eta, share, slope) = if transmitted {
            let eta = n1 / n2;
            let cosine_after = (1.0 - eta * eta * (1.0 - cosine * cosine)).max(ROUNDING).sqrt();
            let slope = eta * eta * cosine.abs() / cosine_after - eta;
            (eta, cosine.signum() * cosine_after - eta * cosine, slope)
        } else {
            (1.0, -2.0 * cosine, -2.0)
        };
        let specular = eta * before + share * normal;
        let mut by_direction = DMat3::from_diagonal(DVec3::splat(eta)) + outer(normal, normal) * slope;
        let mut by_position =
            (DMat3::from_diagonal(DVec3::splat(share)) + outer(normal, before) * slope) * bending;
        let mut roundings = 1.0;
        if let Some(scatter) = surface.scatter.as_ref().filter(|_| after.distance(specular) > SCATTERED) {
            // A lobe around the normal does not depend on the direction before. Other lobes turn with their reference
            // direction.
            if scatter.bsdf.is_about_normal() {
                by_direction = DMat3::ZERO;
                by_position = with_frame(after, normal) * bending;
                roundings = lambertian_roundings(after, normal);
            } else {
                by_position += bending;
            }
        }
        Bend { normal, by_direction, by_position, roundings }
    }
}

/// How a direction, drawn in the tangent frame of a normal, turns with the normal: d(direction) = M d(normal). The
/// frame is the least rotation from the nearer pole of z, so it also spins around the normal.
fn with_frame(direction: DVec3, normal: DVec3) -> DMat3 {
    let side = if direction.dot(normal) < 0.0 { -1.0 } else { 1.0 };
    let n = side * normal;
    let pole = if n.z < 0.0 { DVec3::NEG_Z } else { DVec3::Z };
    // The tangent along the circle around the pole, times the tangent of half the angle from the pole.
    let around = pole.cross(n) / (1.0 + pole.dot(n));
    let turned = DMat3::from_diagonal(DVec3::splat(direction.dot(n))) - outer(n, direction);
    (turned - outer(n.cross(direction), around)) * side
}

/// A direction that differs from the specular one by more than this was drawn by a BSDF.
const SCATTERED: f64 = 1e-3;

/// The unit normal of a smooth shape at a point, and its derivative by the position \[1/mm\].
fn normal_of(surface: &Surface, hit: DVec3) -> Option<(DVec3, DMat3)> {
    let Frame { origin, rotation } = surface.frame;
    let Level { gradient, hessian, .. } = surface.shape.level(rotation.transpose() * (hit - origin))?;
    let slope = rotation * gradient;
    let length = slope.length().max(f64::MIN_POSITIVE);
    let normal = slope / length;
    let second = rotation * hessian * rotation.transpose();
    Some((normal, (DMat3::IDENTITY - outer(normal, normal)) * second * length.recip()))
}

/// The matrix a b^T.
fn outer(a: DVec3, b: DVec3) -> DMat3 {
    DMat3::from_cols(a * b.x, a * b.y, a * b.z)
}
