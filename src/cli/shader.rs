//! `nsq-gpu shader`: prints the WGSL that traces a scene, with the file that each part comes from.

use crate::cli::console::read_scene;
use crate::cli::device_args::DeviceArgs;
use crate::cli::trace_args::{PrecisionArg, wanted};
use crate::error::Result;
use crate::program::Precision;
use crate::run::{Run, Tracer};
use std::path::PathBuf;

/// Arguments of `nsq-gpu shader`.
#[derive(clap::Args)]
pub struct Args {
    /// The scene file.
    scene: PathBuf,
    /// Precision: auto takes what `trace` would take. For df64 the text has f64, which is rewritten into pairs of
    /// 32-bit floats before it is compiled.
    #[arg(long, value_enum, default_value_t = PrecisionArg::Auto)]
    precision: PrecisionArg,
    #[command(flatten)]
    device: DeviceArgs,
}

/// Returns the composed text, as `trace` compiles it without other options.
pub fn run(args: &Args) -> Result<String> {
    let scene = read_scene(&args.scene)?;
    let ir = scene.lower()?;
    let gpu = args.device.open()?;
    let options = Run::of(&scene, &ir).precision(wanted(args.precision)).settle(&gpu)?.options;
    let precision = options.precision;
    let tracer = Tracer::new(&gpu, &ir, &options)?;
    let program = tracer.program();
    let pairs = match precision {
        Precision::Df64 => ", whose f64 are then rewritten as pairs of f32 (program::rewrite::df64)",
        Precision::F32 | Precision::F64 => "",
    };
    let of = args.scene.display();
    Ok(format!("// {of} in {} on {}{pairs}\n{}", precision.name(), gpu.info.name, program.wgsl))
}
