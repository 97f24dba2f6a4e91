//! `nsq-gpu check`: finds, without tracing, everything that `trace` would refuse.

use crate::error::Result;
use crate::format::{path_text, shown};
use std::fmt::Write;
use std::path::PathBuf;

/// Arguments of `nsq-gpu check`.
#[derive(clap::Args)]
pub struct Args {
    /// The scene file.
    scene: PathBuf,
}

/// Returns what the scene holds, and its warnings.
pub fn run(args: &Args) -> Result<String> {
    let scene = crate::cli::console::read_scene(&args.scene)?;
    let ir = scene.lower()?;
    let mut text = format!("{} can be traced.\n", path_text(&args.scene));
    let mut list = |title: &str, names: Vec<String>| {
        let _ = writeln!(text, "  {title} ({}): {}", names.len(), names.join(", "));
    };
    list("surfaces", ir.surfaces.iter().map(|s| shown(&s.name)).collect());
    list("sources", ir.sources.iter().map(|e| shown(&e.name)).collect());
    list("detectors", ir.detectors.iter().map(|s| shown(&s.name)).collect());
    list("media", ir.media.iter().map(|m| shown(&m.name)).collect());
    let wavelengths: Vec<String> = ir.wavelengths.iter().map(|w| format!("{w} um")).collect();
    let _ = writeln!(text, "  wavelengths ({}): {}", wavelengths.len(), wavelengths.join(", "));
    let _ = writeln!(text, "  max_depth: {}, unless given", crate::model::depth::of_scene(&ir));
    for warning in scene.warnings.iter().chain(&scene.f32_warnings) {
        let _ = writeln!(text, "  warning: {warning}");
    }
    Ok(text)
}
