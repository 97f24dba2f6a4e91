//! Ray files that sources name: read, and put into the sources.

mod known;
mod reading;
mod stream;
mod taking;

use crate::format::{shown, significant};
use crate::model::key_path::{key_of, quoted};
use crate::model::sources::rays::{RayFileUsed, Written};
use crate::scene::json::{SceneFile, Source};
use crate::scene::ray_files;
use crate::scene::ray_sources::taking::Refusal;
use crate::{Error, Result};
use std::path::Path;

/// Puts the rays of the files that sources name into these sources.
pub(super) fn fill(
    file: &mut SceneFile,
    folder: &Path,
    warnings: &mut Vec<String>,
) -> Result<Vec<RayFileUsed>> {
    let mut used = Vec::new();
    for (i, source) in file.sources.iter_mut().enumerate() {
        let Source::Rays(written) = source else { continue };
        let place = key_of(&format!("sources[{i}]"), "file");
        let path = folder.join(&written.file);
        let refused = |error: ray_files::Error| Error::file(&path, format!("{error}; {place} names it"));
        used.push(read(&path, written, warnings).map_err(|error| match error {
            Refusal::OfFile(error) => refused(error),
            Refusal::OfScene(problem, remedy) => Error::scene(&place, problem, remedy),
        })?);
    }
    Ok(used)
}

/// A shift of a wavelength that is taken for rounding \[um\].
const ROUNDED: f64 = 1e-6;

/// Reads a file, and puts its rays into a source.
fn read(
    path: &Path,
    written: &mut Written,
    warnings: &mut Vec<String>,
) -> std::result::Result<RayFileUsed, Refusal> {
    let reading = known::reading(path, written)?;
    let said = |text: &String| format!("{} of {}: {text}", quoted(&written.file), quoted(&written.name));
    let mut found: Vec<String> = reading.remarks.iter().map(said).collect();
    // A flux that the scene says takes the place of the file's.
    if written.total_flux.is_none() && written.total_flux_lumens.is_none() {
        found.extend(reading.excess.clone()?.as_ref().map(said));
    }
    if reading.num_rays == 0 {
        let problem = format!("{} has no rays with light", quoted(&written.file));
        return Err(Refusal::OfScene(problem, "name a file with rays".into()));
    }
    if reading.farthest > ROUNDED {
        let nm = significant(1e3 * reading.farthest, 3);
        found.push(said(&format!("wavelengths of rays are put to the spectrum's, at most {nm} nm off")));
    }
    warnings.extend(found);
    written.flux = reading.flux;
    if let Some((wavelengths, weights)) = &reading.spectrum {
        (written.spectrum.wavelengths, written.spectrum.weights) = (wavelengths.clone(), weights.clone());
    }
    written.set = Some(reading.set.clone());
    Ok(RayFileUsed {
        source: written.name.clone(),
        file: written.file.clone(),
        sha256: reading.set.sha256.clone(),
        num_rays: reading.num_rays,
        flux: reading.total,
        unit: reading.unit.clone(),
    })
}

/// One line of a ray file for a report.
impl std::fmt::Display for RayFileUsed {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let unit = self.unit.as_deref().unwrap_or("in all");
        write!(f, "{}: {} rays, {} {unit}", shown(&self.file), self.num_rays, significant(self.flux, 6))
    }
}
