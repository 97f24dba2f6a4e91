//! Measures the error of arithmetic alone. Two tiers trace the same draws. Where a ray takes the same path in both, the
//! results differ by rounding alone.

use crate::bench::accuracy::scenes::AccuracyScene;
use crate::error::Result;
use crate::gpu::Gpu;
use crate::model::SceneIr;
use crate::program::Precision;
use crate::result::{PathEvent, PathEventKind};
use crate::run::{RecordPaths, StandardError, Strict, TraceOptions, Tracer};
use std::time::Instant;

/// The differences between two shaders with the same draws.
#[derive(Debug, Clone, PartialEq)]
pub struct Numerical {
    /// Name of the scene.
    pub scene: &'static str,
    /// The shader: its tier, and the form of the scene in it.
    pub shader: String,
    /// The shader that it is compared with.
    pub against: String,
    /// Rays traced.
    pub num_rays: u64,
    /// Time per ray in this tier, with the scene compiled in \[ns\].
    pub ns_per_ray: f64,
    /// Differences of rays that meet the same surfaces and end in the same way.
    pub same: Differences,
    /// Rays that meet other surfaces, or end in another way.
    pub num_other_fate: u64,
}

/// Differences at the detector.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Differences {
    /// Arrivals compared.
    pub num_arrivals: u64,
    /// Root mean square of their distances \[mm\].
    pub position_rms: f64,
    /// The largest distance \[mm\].
    pub position_max: f64,
    /// Root mean square of the difference of a ray's flux, in units of that flux.
    pub flux_rms: f64,
    /// The largest such difference.
    pub flux_max: f64,
}

impl Numerical {
    /// Share of the rays whose fate differs.
    pub fn other_fate(&self) -> f64 {
        self.num_other_fate as f64 / self.num_rays as f64
    }
}

/// A tier, with the scene compiled in; or in tables, with rounding left to the driver.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Form {
    precision: Precision,
    baked: bool,
}

impl Form {
    fn name(self) -> String {
        format!("{} {}", self.precision.name(), if self.baked { "compiled in" } else { "in tables" })
    }
}

/// Compares every tier with the last one. The last tier is also compared with itself, to show the tier's own rounding.
/// One side has the scene in tables and arithmetic that is not strict, the other the scene compiled in.
///
/// # Errors
/// The errors of a trace.
pub fn measure(
    gpu: &Gpu,
    scene: &AccuracyScene,
    precisions: &[Precision],
    num_rays: u64,
) -> Result<Vec<Numerical>> {
    let ir = scene.plain()?;
    let detector = scene.detector(&ir)?;
    let Some((&finest, coarser)) = precisions.split_last() else { return Ok(Vec::new()) };
    let best = Form { precision: finest, baked: true };
    let forms = coarser.iter().map(|&precision| Form { precision, baked: true });
    let truth = paths(gpu, scene, &ir, best, num_rays)?;
    forms
        .chain([Form { baked: false, ..best }])
        .map(|form| {
            let found = paths(gpu, scene, &ir, form, num_rays)?;
            let (same, num_other_fate) = compare(&found, &truth, detector);
            Ok(Numerical {
                scene: scene.name,
                shader: form.name(),
                against: best.name(),
                num_rays,
                ns_per_ray: ns_per_ray(gpu, scene, &ir, Form { baked: true, ..form }, num_rays)?,
                same,
                num_other_fate,
            })
        })
        .collect()
}

fn options(scene: &AccuracyScene, form: Form, num_rays: u64) -> TraceOptions {
    TraceOptions {
        num_rays,
        max_depth: scene.max_depth,
        precision: form.precision,
        baked: Some(form.baked),
        strict: if form.baked { Strict::Auto } else { Strict::Off },
        standard_error: StandardError::Off,
        ..TraceOptions::default()
    }
}

fn paths(
    gpu: &Gpu,
    scene: &AccuracyScene,
    ir: &SceneIr,
    form: Form,
    num_rays: u64,
) -> Result<Vec<PathEvent>> {
    let options = TraceOptions { paths: RecordPaths::All, ..options(scene, form, num_rays) };
    Ok(Tracer::new(gpu, ir, &options)?.trace(|_| true)?.paths)
}

fn ns_per_ray(gpu: &Gpu, scene: &AccuracyScene, ir: &SceneIr, form: Form, num_rays: u64) -> Result<f64> {
    let num_rays = 16 * num_rays;
    let mut tracer = Tracer::new(gpu, ir, &options(scene, form, num_rays))?;
    tracer.trace(|_| true)?;
    let start = Instant::now();
    tracer.trace(|_| true)?;
    Ok(1e9 * start.elapsed().as_secs_f64() / num_rays as f64)
}

/// Compares recorded paths, sorted by ray and event. Returns the differences on a detector, and the number of rays that
/// took another path.
pub fn compare(found: &[PathEvent], truth: &[PathEvent], detector: usize) -> (Differences, u64) {
    let of_ray = |a: &PathEvent, b: &PathEvent| a.ray.ray_id == b.ray.ray_id;
    let mut sums = Differences::default();
    let mut num_other_fate = 0;
    for (a, b) in found.chunk_by(of_ray).zip(truth.chunk_by(of_ray)) {
        if a.iter().map(|event| event.kind).eq(b.iter().map(|event| event.kind)) {
            let arrivals = a.iter().zip(b).filter(|(a, _)| a.kind == PathEventKind::Detector(detector));
            arrivals.for_each(|(a, b)| sums.add(a, b));
        } else {
            num_other_fate += 1;
        }
    }
    let mean = |sum: f64| (sum / sums.num_arrivals.max(1) as f64).sqrt();
    let (position_rms, flux_rms) = (mean(sums.position_rms), mean(sums.flux_rms));
    (Differences { position_rms, flux_rms, ..sums }, num_other_fate)
}

impl Differences {
    /// Adds the squares of the differences at one arrival; their roots are taken at the end.
    fn add(&mut self, a: &PathEvent, b: &PathEvent) {
        let squares = a.ray.position.iter().zip(&b.ray.position).map(|(a, b)| (a - b).powi(2));
        let distance = squares.sum::<f64>().sqrt();
        let (ours, theirs) = (a.ray.weight, b.ray.weight);
        // A ray that is scattered to nowhere weighs nothing.
        let flux = if ours == theirs { 0.0 } else { (ours / theirs - 1.0).abs() };
        self.num_arrivals += 1;
        self.position_rms += distance * distance;
        self.position_max = self.position_max.max(distance);
        self.flux_rms += flux * flux;
        self.flux_max = self.flux_max.max(flux);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::result::RayRow;

    fn event(ray_id: u64, kind: PathEventKind, x: f64, weight: f64) -> PathEvent {
        let position = [x, 0.0, 0.0];
        let ray = RayRow { ray_id, bounce: 0, wavelength: 0, position, direction: [0.0, 0.0, 1.0], weight };
        PathEvent { ray, kind }
    }

    #[test]
    fn rays_of_another_fate_are_counted_apart() {
        use PathEventKind::{Detector, Escaped, Surface};
        let truth = [
            event(0, Surface(1), 0.0, 1.0),
            event(0, Detector(2), 1.0, 1.0),
            event(1, Detector(2), 2.0, 0.5),
            event(2, Detector(0), 5.0, 1.0),
            event(3, Detector(2), 1.0, 1.0),
        ];
        let mut found = truth;
        found[1].ray.position[0] = 1.3;
        found[2].ray.position[0] = 2.4;
        found[2].ray.weight = 0.51;
        // One ray arrives on another detector, and one has another fate.
        found[3].ray.position[0] = 99.0;
        found[4] = event(3, Escaped, 99.0, 1.0);
        let (same, num_other_fate) = compare(&found, &truth, 2);
        assert_eq!((same.num_arrivals, num_other_fate), (2, 1));
        approx::assert_relative_eq!(same.position_max, 0.4, max_relative = 1e-12);
        approx::assert_relative_eq!(same.position_rms, 0.125_f64.sqrt(), max_relative = 1e-12);
        approx::assert_relative_eq!(same.flux_max, 0.02, max_relative = 1e-12);
    }
}
