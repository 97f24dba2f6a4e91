//! Lamp files that sources name: read, and put into the sources' tables as if the user had written the numbers.

use crate::format::hex;
use crate::model::key_path::{key_of, quoted};
use crate::model::sources::tabulated::{IntensityUnits, LampFile, Rows, Written};
use crate::model::whole_files;
use crate::scene::json::{SceneFile, Source};
use crate::scene::lamps::{Lamp, Malformed, Opening, read_eulumdat, read_ies};
use crate::{Error, Result};
use sha2::{Digest, Sha256};
use std::path::Path;

/// Longest file that is read \[bytes\].
const MAX_BYTES: u64 = 16 << 20;

/// Reads a lamp file by the ending of its name, and gives its hash as well.
///
/// # Errors
/// [`Error::File`] if it cannot be read, with the line.
pub fn read(path: &Path) -> Result<(Lamp, String)> {
    let ending = path.extension().and_then(|ending| ending.to_str()).unwrap_or("").to_ascii_lowercase();
    let parse: fn(&str) -> std::result::Result<Lamp, Malformed> = match ending.as_str() {
        "ies" => read_ies,
        "ldt" => read_eulumdat,
        _ => {
            let problem = "the name of a lamp file ends in .ies (IES LM-63) or .ldt (EULUMDAT)";
            return Err(Error::file(path, problem));
        }
    };
    let bytes = whole_files::read(path, MAX_BYTES).map_err(|err| Error::file(path, err))?;
    let lamp = parse(&whole_files::text(&bytes))
        .map_err(|err| Error::file(path, format!("{}: {}; {}", err.place, err.problem, err.remedy)))?;
    Ok((lamp, hex(&Sha256::digest(&bytes))))
}

/// Puts the tables of the files that sources name into these sources.
pub(super) fn fill(file: &mut SceneFile, folder: &Path, warnings: &mut Vec<String>) -> Result<Vec<LampFile>> {
    let mut files = Vec::new();
    for (i, source) in file.sources.iter_mut().enumerate() {
        let Source::Tabulated(written) = source else { continue };
        let place = format!("sources[{i}]");
        let Some(named) = written.file_and_table(&place)?.map(str::to_owned) else { continue };
        let place = key_of(&place, "file");
        let (lamp, sha256) = read(&folder.join(&named)).map_err(|err| {
            if let Error::File { path, problem } = err {
                return Error::File { path, problem: format!("{problem}; {place} names it") };
            }
            err
        })?;
        let said = lamp
            .remarks
            .iter()
            .map(|remark| format!("{} of {}: {remark}", quoted(&named), quoted(&written.name)));
        warnings.extend(said);
        files.push(LampFile { source: written.name.clone(), file: named, sha256, lumens: lamp.lumens() });
        take(written, lamp);
    }
    Ok(files)
}

/// A flux that the scene gives stays, and the table then says its shares alone. So does an area that the scene gives.
fn take(written: &mut Written, lamp: Lamp) {
    let has_flux = written.total_flux.is_some() || written.total_flux_lumens.is_some();
    written.intensity_units = if has_flux { IntensityUnits::Relative } else { IntensityUnits::Luminous };
    if (written.width, written.height, written.radius) == (None, None, None) {
        match lamp.opening {
            Opening::Point => {}
            Opening::Disk { radius } => written.radius = Some(radius),
            Opening::Rectangle { width, height } => {
                (written.width, written.height) = (Some(width), Some(height));
            }
        }
    }
    let (azimuths, rows) = lamp.in_frame();
    written.polar_angles_deg = lamp.polar_angles_deg;
    written.azimuth_angles_deg = azimuths;
    written.intensity = Rows::Azimuths(rows);
}
