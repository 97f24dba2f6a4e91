//! What the table of paths costs: the time of a trace with it, against the plain loop and against the trace that users get
//! without it.

use crate::Summary;
use crate::cases::{Case, in_midst};
use nsq_gpu::Result;
use nsq_gpu::gpu::Gpu;
use nsq_gpu::program::Precision;
use nsq_gpu::run::{Collect, ForAdapter, Shaders, TraceOptions, Tracer};
use nsq_gpu::scene::Scene;
use std::fmt::Write;
use std::time::Instant;

/// The times of a case in one precision.
#[derive(Debug, Clone)]
pub struct PathCost {
    /// The case.
    pub case: String,
    /// Its precision.
    pub precision: Precision,
    /// Median time by the plain loop \[s\].
    pub plain_sec: f64,
    /// Median time of the trace that users get \[s\].
    pub default_sec: f64,
    /// Median time with the table of paths \[s\].
    pub paths_sec: f64,
    /// Rows of the table.
    pub num_rows: usize,
}

/// Measures a case. The three take turns, so that other work on the machine affects all alike.
///
/// # Errors
/// [`nsq_gpu::Error::Device`] if the device fails.
pub fn measure(gpu: &Gpu, case: &Case, precision: Precision, num_runs: usize) -> Result<PathCost> {
    let ir = Scene::from_json(&case.scene)?.lower()?;
    let options = case.options_without_errors(precision, gpu);
    let overrides = in_midst(case.is_long());
    let with_table = TraceOptions { collect: Collect::paths(), ..options.clone() };
    let mut tracers = [
        Tracer::with(gpu, &ir, &options, ForAdapter::Nothing, Shaders::default())?,
        Tracer::with(gpu, &ir, &options, ForAdapter::Forced(&overrides), Shaders::default())?,
        Tracer::new(gpu, &ir, &with_table)?,
    ];
    let mut num_rows = 0;
    for tracer in &mut tracers {
        num_rows = tracer.trace(|_| true)?.path_sums.map_or(0, |sums| sums.rows.len());
    }
    let mut times = [const { Vec::new() }; 3];
    for _ in 0..num_runs {
        for (tracer, times) in tracers.iter_mut().zip(&mut times) {
            let start = Instant::now();
            tracer.trace(|_| true)?;
            times.push(start.elapsed().as_secs_f64());
        }
    }
    let [plain_sec, default_sec, paths_sec] = times.map(|times| Summary::median_of(&times));
    Ok(PathCost { case: case.name.clone(), precision, plain_sec, default_sec, paths_sec, num_rows })
}

impl PathCost {
    /// The heading of the table.
    pub fn heading() -> String {
        format!(
            "{:<20}{:>5}{:>12}{:>12}{:>12}{:>9}{:>14}{:>14}\n",
            "case", "", "plain [s]", "default [s]", "paths [s]", "rows", "paths/plain", "paths/default"
        )
    }

    /// The case as a line.
    pub fn line(&self) -> String {
        let PathCost { case, precision, plain_sec, default_sec, paths_sec, num_rows } = self;
        let mut line = format!("{case:<20}{:>5}", precision.name());
        let _ = writeln!(
            line,
            "{plain_sec:>12.5}{default_sec:>12.5}{paths_sec:>12.5}{num_rows:>9}{:>14.2}{:>14.2}",
            paths_sec / plain_sec,
            paths_sec / default_sec
        );
        line
    }
}
