//! `nsq-gpu lamp`: shows what a lamp file says, as a source of a scene takes it.

use crate::error::{Error, Result};
use crate::format::{path_text, pretty_json, shown};
use crate::scene::lamp_files;
use crate::scene::lamps::{Lamp, Opening};
use serde_json::{Value, json};
use std::path::PathBuf;

/// Arguments of `nsq-gpu lamp`.
#[derive(clap::Args)]
pub struct Args {
    /// The file: IES LM-63 (.ies) or EULUMDAT (.ldt)
    file: PathBuf,
    /// Print the table as JSON, as a source of type `tabulated` has it: angles in deg, intensity in cd. Plane C lies at the
    /// azimuth 360 - C.
    #[arg(long)]
    json: bool,
}

/// Returns what the file says.
pub fn run(args: &Args) -> Result<String> {
    let (lamp, sha256) = lamp_files::read(&args.file)?;
    if args.json {
        return pretty_json(&document(&lamp, &sha256)).map_err(|err| Error::internal("a lamp as JSON", &err));
    }
    let planes = match lamp.azimuth_angles_deg.len() {
        1 => "a lamp of revolution".to_owned(),
        count => format!("{count} planes C from 0 to 360 deg"),
    };
    let gamma =
        [lamp.polar_angles_deg.first(), lamp.polar_angles_deg.last()].map(|end| end.copied().unwrap_or(0.0));
    let peak = lamp.intensity.iter().flatten().copied().fold(0.0, f64::max);
    let mut lines = vec![
        path_text(&args.file),
        format!(
            "  light        {:.6} lm, of which the file says {}",
            lamp.lumens(),
            stated(lamp.lamp_lumens)
        ),
        format!("  intensity    up to {peak:.6} cd"),
        format!(
            "  directions   {planes}; gamma from {} to {} deg, {} angles",
            gamma[0],
            gamma[1],
            lamp.polar_angles_deg.len()
        ),
        format!("  opening      {}", opening(lamp.opening)),
    ];
    if let Some(watts) = lamp.watts {
        lines.push(format!("  power        {watts} W, {:.4} lm/W", lamp.lumens() / watts));
    }
    lines.extend(lamp.keywords.iter().map(|(key, value)| format!("  {:<12} {}", shown(key), shown(value))));
    lines.push(format!("  sha256       {sha256}"));
    lines.extend(lamp.remarks.iter().map(|remark| format!("  note: {remark}")));
    Ok(lines.join("\n") + "\n")
}

fn stated(lumens: Option<f64>) -> String {
    lumens.map_or("nothing of the lamps in it".into(), |lumens| format!("that its lamps have {lumens} lm"))
}

fn opening(opening: Opening) -> String {
    match opening {
        Opening::Point => "a point".into(),
        Opening::Disk { radius } => format!("a disk of radius {radius} mm"),
        Opening::Rectangle { width, height } => format!("{width} mm along C0 by {height} mm along C90"),
    }
}

fn document(lamp: &Lamp, sha256: &str) -> Value {
    let opening = match lamp.opening {
        Opening::Point => json!({"type": "point"}),
        Opening::Disk { radius } => json!({"type": "disk", "radius": radius}),
        Opening::Rectangle { width, height } => {
            json!({"type": "rectangle", "width": width, "height": height})
        }
    };
    let keywords: serde_json::Map<String, Value> =
        lamp.keywords.iter().map(|(key, value)| (key.clone(), json!(value))).collect();
    let (azimuths, rows) = lamp.in_frame();
    json!({
        "polar_angles_deg": lamp.polar_angles_deg, "azimuth_angles_deg": azimuths, "intensity": rows, "opening": opening, "lumens": lamp.lumens(), "lamp_lumens": lamp.lamp_lumens,
        "watts": lamp.watts, "keywords": keywords, "remarks": lamp.remarks, "sha256": sha256,
    })
}
