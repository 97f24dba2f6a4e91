//! Measures how to cut work for an adapter: invocations a workgroup, and events a dispatch.

use crate::Summary;
use crate::cases::{self, Case};
use nsq_gpu::gpu::Gpu;
use nsq_gpu::internals::{EVENTS_PER_DISPATCH, Tuning, WORKGROUP_SIZES};
use nsq_gpu::program::Precision;
use nsq_gpu::run::{TraceOptions, Tracer};
use nsq_gpu::scene::Scene;
use nsq_gpu::{Error, Result};
use std::fmt::Write;
use std::time::Instant;

/// Cases that spend their time differently: a lens, a cavity of many events, a tree over many surfaces.
const CASES: [&str; 3] = ["rays_1e6", "depth_32", "surfaces_200"];
/// Rays per run.
const NUM_RAYS: u64 = 400_000;
/// Runs of each case, after one to warm up.
const NUM_RUNS: usize = 5;
/// The least gain that counts; a smaller one is noise, and the default stays.
const WORTHWHILE: f64 = 0.03;

/// One way to cut work, and its cost.
#[derive(Debug, Clone, PartialEq)]
pub struct Trial {
    /// The way.
    pub tuning: Tuning,
    /// Median time of each case over the median time of the default.
    pub relative: Vec<f64>,
}

/// The cases for measuring. The cases have fewer rays than usual, because they stand for long traces.
pub fn cases() -> Vec<Case> {
    let all = cases::all(u64::MAX);
    let named = |name| all.iter().find(|case| case.name == name).cloned();
    CASES.into_iter().filter_map(named).collect()
}

/// Measures every way, in turns.
///
/// # Errors
/// The errors of a trace.
pub fn measure(gpu: &Gpu, precision: Precision) -> Result<Vec<Trial>> {
    let ways: Vec<Tuning> = WORKGROUP_SIZES
        .into_iter()
        .flat_map(|workgroup_size| {
            EVENTS_PER_DISPATCH.map(|events_per_dispatch| Tuning { workgroup_size, events_per_dispatch })
        })
        .collect();
    let mut trials: Vec<Trial> = ways.iter().map(|&tuning| Trial { tuning, relative: Vec::new() }).collect();
    for case in cases() {
        let medians = medians_sec(gpu, &case, precision, &ways)?;
        let default = ways.iter().position(|way| *way == Tuning::untuned(&gpu.info)).map(|i| medians[i]);
        let default = default.ok_or_else(|| Error::Internal("the default is not offered".into()))?;
        trials.iter_mut().zip(&medians).for_each(|(trial, median)| trial.relative.push(median / default));
    }
    Ok(trials)
}

/// The median time of each way to trace a case \[s\]. Ways take turns, so that other work on the machine affects all
/// alike.
fn medians_sec(gpu: &Gpu, case: &Case, precision: Precision, ways: &[Tuning]) -> Result<Vec<f64>> {
    let ir = Scene::from_json(&case.scene)?.lower()?;
    let tracer = |way: &Tuning| {
        let options = TraceOptions {
            num_rays: NUM_RAYS,
            max_depth: case.max_depth,
            precision,
            workgroup_size: way.workgroup_size,
            events_per_dispatch: way.events_per_dispatch,
            ..Default::default()
        };
        Tracer::new(gpu, &ir, &options)
    };
    let mut tracers = ways.iter().map(tracer).collect::<Result<Vec<_>>>()?;
    tracers.iter_mut().try_for_each(|tracer| tracer.trace(|_| true).map(drop))?;
    let mut times = vec![Vec::new(); ways.len()];
    for _ in 0..NUM_RUNS {
        for (tracer, times) in tracers.iter_mut().zip(&mut times) {
            let start = Instant::now();
            tracer.trace(|_| true)?;
            times.push(start.elapsed().as_secs_f64());
        }
    }
    times
        .iter()
        .map(|times| Summary::of(times).map(|summary| summary.median))
        .collect::<Option<_>>()
        .ok_or_else(|| Error::Internal("nothing was measured".into()))
}

impl Trial {
    /// Geometric mean over the cases.
    pub fn mean(&self) -> f64 {
        (self.relative.iter().map(|ratio| ratio.ln()).sum::<f64>() / self.relative.len() as f64).exp()
    }
}

/// The fastest way; `untuned` if no other way gains anything worthwhile.
pub fn best(trials: &[Trial], untuned: Tuning) -> Tuning {
    let fastest = trials.iter().min_by(|a, b| a.mean().total_cmp(&b.mean()));
    fastest.filter(|trial| trial.mean() < 1.0 - WORTHWHILE).map_or(untuned, |trial| trial.tuning)
}

/// Every trial as a line.
pub fn table(trials: &[Trial]) -> String {
    let mut text = String::from("workgroup  events a dispatch   mean");
    let cases: String = CASES.iter().map(|name| format!("  {name:>12}")).collect();
    let _ = writeln!(text, "{cases}");
    for trial in trials {
        let Tuning { workgroup_size, events_per_dispatch } = trial.tuning;
        let _ = write!(text, "{workgroup_size:>9}  {events_per_dispatch:>17}  {:>5.3}", trial.mean());
        let relative: String = trial.relative.iter().map(|ratio| format!("  {ratio:>12.3}")).collect();
        let _ = writeln!(text, "{relative}");
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    fn trial(workgroup_size: u32, relative: &[f64]) -> Trial {
        let tuning = Tuning { workgroup_size, ..Tuning::default() };
        Trial { tuning, relative: relative.to_vec() }
    }

    #[test]
    fn every_case_that_is_measured_exists() {
        assert_eq!(cases().iter().map(|case| case.name.as_str()).collect::<Vec<_>>(), CASES);
    }

    #[test]
    fn only_what_gains_more_than_noise_replaces_the_default() {
        let default = trial(64, &[1.0, 1.0]);
        let best = |other| best(&[default.clone(), other], default.tuning).workgroup_size;
        assert_eq!(best(trial(32, &[0.9, 1.1])), 64);
        assert_eq!(best(trial(32, &[0.98, 0.98])), 64);
        assert_eq!(best(trial(128, &[0.8, 1.05])), 128);
    }
}
