//! Traces a lens from a file: reads the scene, launches a million rays, prints the report, writes the results.
//!
//! `cargo run --example trace_a_lens`, or with a scene of your own: `cargo run --example trace_a_lens -- lens.json`

#![allow(clippy::print_stdout, reason = "an example shows what it found")]

use nsq_gpu::gpu::{AdapterChoice, Gpu};
use nsq_gpu::result::output;
use nsq_gpu::run::precision::{self, Wanted};
use nsq_gpu::{Result, Scene, StandardError, TraceOptions, TraceResult, Tracer};
use std::path::{Path, PathBuf};

fn main() -> Result<()> {
    let path = std::env::args_os().nth(1).map_or_else(|| PathBuf::from("docs/example.json"), PathBuf::from);
    // Reading proves a scene valid: an error names the place in the file, and what would be right.
    let scene = Scene::from_path(&path)?;
    let model = scene.lower()?;

    let gpu = Gpu::open(&AdapterChoice::default())?;
    let options = TraceOptions {
        num_rays: 1_000_000,
        max_depth: nsq_gpu::model::depth::of_scene(&model),
        standard_error: StandardError::On,
        ..TraceOptions::default()
    }
    .tuned(&gpu.info);
    // The cheapest precision that places the light to a hundredth of a pixel.
    let precision = precision::choose(&gpu, &model, &options, Wanted::Auto)?.precision;
    let options = TraceOptions { precision, ..options };

    let tally = Tracer::new(&gpu, &model, &options)?.trace(|_rays_done| true)?;
    let result = TraceResult::new(&model, &options.run_info(&gpu.info), &tally)?;
    println!("{}", result.report());
    for file in output::write_all(Path::new("example-out"), &result)? {
        println!("{}", file.display());
    }
    Ok(())
}
