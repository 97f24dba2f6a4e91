//! `nsq-gpu check`: finds, without tracing, everything that `trace` would refuse.

use crate::error::Result;
use crate::format::{path_text, shown};
use crate::scene::notes;
use std::fmt::Write;
use std::path::PathBuf;

/// Arguments of `nsq-gpu check`.
#[derive(clap::Args)]
pub struct Args {
    /// The scene file.
    scene: PathBuf,
    /// Print which side of each surface is its front, and which media lie in front and behind. Example: nsq-gpu check
    /// lens.json --sides
    #[arg(long)]
    sides: bool,
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
    for line in notes::extents(&ir) {
        let _ = writeln!(text, "  {line}");
    }
    for file in &scene.ray_files {
        let _ = writeln!(text, "  rays of {}: {file}", shown(&file.source));
    }
    if args.sides {
        text.push_str(&notes::sides(&ir));
    }
    for note in notes::of(&ir) {
        let _ = writeln!(text, "  note: {note}");
    }
    for warning in scene.warnings.iter().chain(&scene.f32_warnings) {
        let _ = writeln!(text, "  warning: {warning}");
    }
    Ok(text)
}
