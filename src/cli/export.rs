//! `nsq-gpu export`: writes the far field of a result as a lamp file.

use crate::cli::console::say;
use crate::cli::output_file::OutputFile;
use crate::error::{Error, Result};
use crate::format::{path_text, percent, shown, significant};
use crate::result::lamp::lamp_of;
use crate::result::{Detector, DetectorData, TraceResult};
use crate::scene::lamps::{Lamp, write_eulumdat, write_ies};
use std::path::{Path, PathBuf};

/// Arguments of `nsq-gpu export`.
#[derive(clap::Args)]
#[command(after_help = "Example: nsq-gpu export results --detector sky --ies luminaire.ies")]
pub struct Args {
    /// Folder that `trace -o` or `merge -o` wrote, of a photometric trace.
    result: PathBuf,
    /// The far field. It may be left out where there is one alone.
    #[arg(long, value_name = "NAME")]
    detector: Option<String>,
    /// Write an IES file, LM-63-2019.
    #[arg(long, value_name = "FILE", required_unless_present = "ldt")]
    ies: Option<PathBuf>,
    /// Write a EULUMDAT file.
    #[arg(long, value_name = "FILE")]
    ldt: Option<PathBuf>,
    /// No light comes from behind. A far field without "sphere": true adds it to the light forwards.
    #[arg(long)]
    forward: bool,
    /// Replace files that are there.
    #[arg(long)]
    overwrite: bool,
}

/// Error of a far field's cells from which a note says that a lamp's file would hold noise.
const NOISY: f64 = 0.05;

/// Writes the files, and says what they hold.
pub fn run(args: &Args) -> Result<String> {
    let result = TraceResult::read(&args.result)?;
    let detector = detector(&result, args.detector.as_deref())?;
    let lamp = lamp_of(&result, detector, args.forward)?;
    let place = |path: &PathBuf| OutputFile::new(path, args.overwrite, Path::new(""), |_| false);
    let [ies, ldt] = [&args.ies, &args.ldt].map(|path| path.as_ref().map(place).transpose());
    let texts = [(ies?, Ok(write_ies(&lamp))), (ldt?, write_eulumdat(&lamp))];
    let mut said = String::new();
    for (place, text) in texts {
        let Some(place) = place else { continue };
        let text = text.map_err(|error| Error::Usage(format!("{}; {}", error.problem, error.remedy)))?;
        let path = place.write(text.as_bytes())?;
        say(&format!("written: {}", path.display()));
        said += &line(path, &lamp);
    }
    if let Some(error) = detector.mean_relative_error().filter(|error| *error > NOISY) {
        said += &format!(
            "note: the intensities are known to {} on average, and their peak is noise: trace more rays, or take fewer bins\n",
            percent(error)
        );
    }
    Ok(said)
}

fn line(path: &Path, lamp: &Lamp) -> String {
    let peak = lamp.intensity.iter().flatten().copied().fold(0.0, f64::max);
    format!(
        "{}: {} lm, up to {} cd, {} planes C, {} angles gamma\n",
        path_text(path),
        significant(lamp.lumens(), 6),
        significant(peak, 5),
        lamp.azimuth_angles_deg.len(),
        lamp.polar_angles_deg.len()
    )
}

/// The detector of this name, or the only far field.
fn detector<'a>(result: &'a TraceResult, name: Option<&str>) -> Result<&'a Detector> {
    let far_fields: Vec<&Detector> = result
        .detectors
        .iter()
        .filter(|detector| matches!(detector.data, DetectorData::FarField(_)))
        .collect();
    let found = match name {
        Some(name) => result.detectors.iter().find(|detector| detector.name == name),
        None if far_fields.len() == 1 => far_fields.first().copied(),
        None => None,
    };
    let names = || far_fields.iter().map(|detector| shown(&detector.name)).collect::<Vec<_>>().join(", ");
    let missing = || match name {
        Some(name) => format!("no detector is called `{}`", shown(name)),
        None => format!("the result has {} far fields; name one with --detector", far_fields.len()),
    };
    found.ok_or_else(|| match far_fields.is_empty() {
        true => Error::Usage(
            "the result has no far field: add a detector of type far_field, with \"sphere\": true".into(),
        ),
        false => Error::Usage(format!("{}: there are {}", missing(), names())),
    })
}
