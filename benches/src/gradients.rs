//! What derivatives cost: the time of a trace with maps of derivatives, against the plain loop. Compiling does not count.

use crate::Summary;
use crate::cases::{Case, Kind};
use nsq_gpu::gpu::Gpu;
use nsq_gpu::program::Precision;
use nsq_gpu::run::gradients::{Differentiated, How, MOST_PARAMETERS};
use nsq_gpu::run::{ForAdapter, PipelineCache, Shaders, Tracer};
use nsq_gpu::{Error, Result};
use serde_json::Value;
use std::fmt::Write;
use std::path::Path;
use std::time::Instant;

/// The times of a case in one precision.
#[derive(Debug, Clone)]
pub struct GradientCost {
    /// The case.
    pub case: String,
    /// Its precision.
    pub precision: Precision,
    /// Median time by the plain loop \[s\].
    pub plain_sec: f64,
    /// Median times with one parameter, and with four \[s\].
    pub gradient_sec: [f64; 2],
    /// Median time of the gradient of a loss by four parameters: rays are walked back \[s\].
    pub back_sec: f64,
}

/// The numbers of parameters that are measured.
const COUNTS: [usize; 2] = [1, MOST_PARAMETERS];

/// Names of numbers of a case's lenses: as many as are measured, or none.
fn parameters(case: &Case) -> Vec<String> {
    let scene: Value = serde_json::from_str(&case.scene).unwrap_or_default();
    let components = scene["components"].as_array().into_iter().flatten();
    let lenses = components.filter(|component| component["type"] == "lens");
    let names = lenses
        .filter_map(|lens| lens["name"].as_str())
        .flat_map(|name| ["r1", "r2", "thickness", "z"].map(|key| format!("{name}.{key}")));
    names.take(MOST_PARAMETERS).collect()
}

/// The cases that can be measured: those with a lens.
///
/// # Errors
/// [`Error::Usage`] if there is none.
pub fn cases(all: Vec<Case>) -> Result<Vec<Case>> {
    let has_lens = |case: &Case| parameters(case).len() == MOST_PARAMETERS;
    let cases: Vec<Case> =
        all.into_iter().filter(|case| matches!(case.kind, Kind::Trace) && has_lens(case)).collect();
    if cases.is_empty() {
        return Err(Error::Usage("derivatives are measured by numbers of a lens; name other cases".into()));
    }
    Ok(cases)
}

/// Measures a case. The three take turns, so that other work on the machine affects all alike.
///
/// # Errors
/// [`Error::Device`] if the device fails.
pub fn measure(gpu: &Gpu, case: &Case, precision: Precision, num_runs: usize) -> Result<GradientCost> {
    let names = parameters(case);
    let scene = |num: usize| Differentiated::new(&case.scene, Path::new(""), &[], &names[..num], |_| Ok(()));
    let scenes = COUNTS.map(scene);
    let [one, four] = scenes;
    let scenes = [one?, four?];
    let options = case.options_without_errors(precision, gpu);
    let cache = PipelineCache::new();
    let how = How { cache: Some(&cache), ..How::default() };
    let mut plain = Tracer::with(gpu, &scenes[0].ir, &options, ForAdapter::Nothing, Shaders::default())?;
    let adjoints: Vec<Vec<f64>> = scenes[1].adjoint_lengths().map(|num| vec![1.0; num]).collect();
    let mut times = [const { Vec::new() }; 4];
    // The first round compiles.
    for round in 0..=num_runs {
        let start = Instant::now();
        plain.trace(|_| true)?;
        let mut lap = vec![start.elapsed()];
        for scene in &scenes {
            let start = Instant::now();
            scene.gradients(gpu, &options, how, |_| true)?;
            lap.push(start.elapsed());
        }
        let start = Instant::now();
        scenes[1].loss_gradient(gpu, &options, how, &adjoints, |_| true)?;
        lap.push(start.elapsed());
        if round > 0 {
            times.iter_mut().zip(lap).for_each(|(times, time)| times.push(time.as_secs_f64()));
        }
    }
    let [plain_sec, one, four, back_sec] = times.map(|times| Summary::median_of(&times));
    Ok(GradientCost { case: case.name.clone(), precision, plain_sec, gradient_sec: [one, four], back_sec })
}

impl GradientCost {
    /// The heading of the table.
    pub fn heading() -> String {
        format!(
            "{:<14}{:>5}{:>12}{:>18}{:>18}{:>12}{:>12}{:>12}{:>12}\n",
            "case",
            "",
            "plain [s]",
            "one number [s]",
            "four numbers [s]",
            "back [s]",
            "one/plain",
            "four/plain",
            "back/plain"
        )
    }

    /// The case as a line.
    pub fn line(&self) -> String {
        let GradientCost { case, precision, plain_sec, gradient_sec: [one, four], back_sec } = self;
        let mut line = format!("{case:<14}{:>5}", precision.name());
        let _ = writeln!(
            line,
            "{plain_sec:>12.5}{one:>18.5}{four:>18.5}{back_sec:>12.5}{:>12.2}{:>12.2}{:>12.2}",
            one / plain_sec,
            four / plain_sec,
            back_sec / plain_sec
        );
        line
    }
}
