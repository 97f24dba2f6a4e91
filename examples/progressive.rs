//! Watches a result converge, and stops the trace when every detector is known to a percent.
//!
//! A trace is a sum over rays, so that the sums so far are a whole result at any moment, with standard errors.
//!
//! `cargo run --example progressive`

#![allow(clippy::print_stdout, reason = "an example shows what it found")]

use nsq_gpu::gpu::{AdapterChoice, Gpu};
use nsq_gpu::result::RunInfo;
use nsq_gpu::result::uncertainty::worst_relative_error;
use nsq_gpu::run::stopping::Stopping;
use nsq_gpu::{Result, Scene, StandardError, TraceOptions, TraceResult, Tracer};
use std::path::Path;

fn main() -> Result<()> {
    let model = Scene::from_path(Path::new("docs/example.json"))?.lower()?;
    let gpu = Gpu::open(&AdapterChoice::default())?;
    let options = TraceOptions {
        num_rays: 100_000_000,
        standard_error: StandardError::On,
        may_end_early: true,
        ..TraceOptions::default()
    };
    let mut tracer = Tracer::new(&gpu, &model, &options)?;
    let mut stopping = Stopping::new(&model, Some(0.01), None);
    let nothing = tracer.empty_tally();
    stopping.prepare(&mut tracer, &nothing)?;
    let (mut stopped_by, mut next) = (None, 0);
    // The closure runs after each pass of some 40 ms; where it returns false the trace ends.
    let tally = tracer.go_on(nothing, |progress| {
        stopped_by = stopping.after_pass(&model, progress)?;
        if progress.done >= next {
            next = 2 * progress.done;
            let error = worst_relative_error(&model, progress.tally()?).unwrap_or(f64::NAN);
            println!("{:>9} rays: relative error {:.2} %", progress.done, 100.0 * error);
        }
        Ok(stopped_by.is_none())
    })?;
    // Marked as partial, fluxes are scaled to all that the sources emit.
    let partial = tally.launched.count < options.num_rays;
    let run = RunInfo { partial, stopped_by, ..options.run_info(&gpu.info) };
    println!("{}", TraceResult::new(&model, &run, &tally)?.report());
    Ok(())
}
