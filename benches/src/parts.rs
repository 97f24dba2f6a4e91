//! What each part of the CPU backend is worth: the time of a trace without the part, over the time with it. No part changes
//! a bit of a result.

use crate::Summary;
use crate::cases::{Case, in_midst};
use nsq_gpu::Result;
use nsq_gpu::gpu::Gpu;
use nsq_gpu::internals::{CpuOverrides, Override};
use nsq_gpu::program::Precision;
use nsq_gpu::run::{ForAdapter, Shaders, Tracer};
use nsq_gpu::scene::Scene;
use std::time::Instant;

/// A part: its name in the heading, and how a trace goes without it.
type Part = (&'static str, fn(&mut CpuOverrides));

/// The parts. Without the deposit log there is no hot path, without a hot path no side trace and no pair of rays.
const PARTS: [Part; 6] = [
    ("log", |without| without.deferred_splats = Override::Never),
    ("hot path", |without| without.hot_path = Override::Never),
    ("side traces", |without| without.side_traces = Override::Never),
    ("two at a time", |without| without.side_by_side = Override::Never),
    ("several rays", |without| without.rays_per_invocation = Some(1)),
    ("images", |without| without.texel_bytes = Some(0)),
];

/// The times of a case in one precision.
#[derive(Debug, Clone)]
pub struct PartGains {
    /// The case.
    pub case: String,
    /// Its precision.
    pub precision: Precision,
    /// Median time with all parts \[s\].
    pub default_sec: f64,
    /// For each part, the median of the ratios of neighbouring runs: above 1, the part pays.
    pub gains: [f64; PARTS.len()],
}

/// Measures a case. The forms take turns, so that other work on the machine affects all alike.
///
/// # Errors
/// [`nsq_gpu::Error::Device`] if the device fails.
pub fn measure(gpu: &Gpu, case: &Case, precision: Precision, num_runs: usize) -> Result<PartGains> {
    let ir = Scene::from_json(&case.scene)?.lower()?;
    let options = case.options_without_errors(precision, gpu);
    let with = in_midst(case.is_long());
    let tracer = |overrides: &CpuOverrides| {
        Tracer::with(gpu, &ir, &options, ForAdapter::Forced(overrides), Shaders::default())
    };
    let seconds = |tracer: &mut Tracer| -> Result<f64> {
        let start = Instant::now();
        tracer.trace(|_| true)?;
        Ok(start.elapsed().as_secs_f64())
    };
    let mut complete = tracer(&with)?;
    seconds(&mut complete)?;
    let (mut times, mut gains) = (Vec::new(), [0.0; PARTS.len()]);
    for ((_, leave_out), gain) in PARTS.iter().zip(&mut gains) {
        let mut overrides = with.clone();
        leave_out(&mut overrides);
        let mut incomplete = tracer(&overrides)?;
        seconds(&mut incomplete)?;
        let mut ratios = Vec::new();
        for _ in 0..num_runs {
            times.push(seconds(&mut complete)?);
            ratios.push(seconds(&mut incomplete)? / times[times.len() - 1]);
        }
        *gain = Summary::median_of(&ratios);
    }
    Ok(PartGains { case: case.name.clone(), precision, default_sec: Summary::median_of(&times), gains })
}

impl PartGains {
    /// The heading of the table.
    pub fn heading() -> String {
        let parts: String = PARTS.iter().map(|(name, _)| format!("{name:>15}")).collect();
        format!("{:<20}{:>5}{:>12}{parts}\n", "case", "", "with [s]")
    }

    /// The case as a line.
    pub fn line(&self) -> String {
        let PartGains { case, precision, default_sec, gains } = self;
        let gains: String = gains.iter().map(|gain| format!("{gain:>15.2}")).collect();
        format!("{case:<20}{:>5}{default_sec:>12.5}{gains}\n", precision.name())
    }
}
