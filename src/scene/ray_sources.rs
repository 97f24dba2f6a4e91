//! Ray files that sources name: read, and put into the sources.

use crate::format::{shown, significant};
use crate::model::photometry;
use crate::model::place::{key_of, quoted};
use crate::model::sources::OwnFlux;
use crate::model::sources::rays::{MOST_RAYS, RayFileUsed, RayGroup, RaySet, Written};
use crate::scene::json::{SceneFile, Source};
use crate::scene::ray_files::{self, FluxKind, RayFile, Wavelengths};
use crate::{Error, Result};
use std::path::Path;
use std::sync::Arc;

/// A ray's wavelength is put to the nearest one of the source's spectrum, if that is so near \[um\].
const FARTHEST: f64 = 0.025;

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
        let refused = |error: ray_files::Error| {
            Error::file(
                &path,
                format!("{}: {}; {}; {place} names it", error.place, error.problem, error.remedy),
            )
        };
        used.push(read(&path, written, warnings).map_err(|error| match error {
            Refusal::OfFile(error) => refused(error),
            Refusal::OfScene(problem, remedy) => Error::scene(&place, problem, remedy),
        })?);
    }
    Ok(used)
}

/// A shift of a wavelength that is taken for rounding \[um\].
const ROUNDED: f64 = 1e-6;

/// What is wrong with the file, or with what the scene says of it.
enum Refusal {
    OfFile(ray_files::Error),
    OfScene(String, String),
}

impl From<ray_files::Error> for Refusal {
    fn from(error: ray_files::Error) -> Self {
        Refusal::OfFile(error)
    }
}

fn read(
    path: &Path,
    written: &mut Written,
    warnings: &mut Vec<String>,
) -> std::result::Result<RayFileUsed, Refusal> {
    let mut file = RayFile::open(path)?;
    let header = file.header().clone();
    if header.num_rays > MOST_RAYS as u64 {
        return Err(Refusal::OfScene(
            format!(
                "{} has {} rays, and at most {MOST_RAYS} are held",
                quoted(&written.file),
                header.num_rays
            ),
            "name a smaller file of the lamp: makers have one of 100,000 or 500,000 rays".into(),
        ));
    }
    let says_flux = written.total_flux.is_some() || written.total_flux_lumens.is_some();
    let said = |text: String| format!("{} of {}: {text}", quoted(&written.file), quoted(&written.name));
    let mut found: Vec<String> = header.remarks.iter().cloned().map(said).collect();
    let mut groups = Groups::new(written, &header.wavelengths, header.flux_kind);
    let total = file.for_each(|number, ray| groups.add(number, ray))?;
    // A flux that the scene says takes the place of the file's.
    if !says_flux {
        found.extend(file.compare_total(total)?.map(said));
    }
    if groups.groups.iter().all(|group| group.shares.is_empty()) {
        let problem = format!("{} has no rays with light", quoted(&written.file));
        return Err(Refusal::OfScene(problem, "name a file with rays".into()));
    }
    if groups.farthest > ROUNDED {
        let nm = significant(1e3 * groups.farthest, 3);
        found
            .push(said(format!("wavelengths of rays are put to those of the spectrum, at most {nm} nm off")));
    }
    warnings.extend(found);
    let sha256 = file.sha256()?;
    let unit = header.flux_kind.map(|kind| kind.unit().to_owned());
    written.flux = match (header.flux_kind, groups.watts) {
        (_, Some(watts)) => Some(OwnFlux::Watts(watts)),
        (Some(FluxKind::Radiant), None) => Some(OwnFlux::Watts(total)),
        (Some(FluxKind::Luminous), None) => Some(OwnFlux::Lumens(total)),
        (None, None) => None,
    };
    let groups = groups.finish(written);
    let num_rays = groups.iter().map(|group| group.shares.len()).sum();
    written.set = Some(Arc::new(RaySet { sha256: sha256.clone(), scale: written.scale, groups }));
    Ok(RayFileUsed {
        source: written.name.clone(),
        file: written.file.clone(),
        sha256,
        num_rays,
        flux: total,
        unit,
    })
}

/// Rays by wavelength.
struct Groups {
    groups: Vec<RayGroup>,
    /// True if rays have wavelengths of their own.
    by_wavelength: bool,
    scale: f64,
    /// The flux \[W\] of luminous rays that have wavelengths of their own.
    watts: Option<f64>,
    /// The largest distance of a ray's wavelength from the one it is put to \[um\].
    farthest: f64,
}

impl Groups {
    fn new(written: &Written, wavelengths: &Wavelengths, kind: Option<FluxKind>) -> Self {
        let by_wavelength = matches!(wavelengths, Wavelengths::PerRay | Wavelengths::One(_));
        let group = |wavelength| RayGroup {
            wavelength,
            positions: Vec::new(),
            directions: Vec::new(),
            shares: Vec::new(),
        };
        let groups = match by_wavelength {
            true => written.spectrum.wavelengths.iter().map(|wavelength| group(Some(*wavelength))).collect(),
            false => vec![group(None)],
        };
        let watts = (by_wavelength && kind == Some(FluxKind::Luminous)).then_some(0.0);
        Groups { groups, by_wavelength, scale: written.scale, watts, farthest: 0.0 }
    }

    fn add(&mut self, number: u64, ray: &ray_files::Ray) -> std::result::Result<(), Refusal> {
        if ray.flux <= 0.0 {
            return Ok(());
        }
        let own = ray.wavelength.filter(|_| self.by_wavelength);
        let distance = |group: &RayGroup| match (group.wavelength, own) {
            (Some(listed), Some(own)) => (listed - own).abs(),
            _ => 0.0,
        };
        let nearest = self.groups.iter_mut().min_by(|a, b| distance(a).total_cmp(&distance(b)));
        let Some(group) = nearest else { return Ok(()) };
        let off = distance(group);
        if off > FARTHEST {
            return Err(Refusal::OfScene(
                format!(
                    "ray {number} of the file has a wavelength of {} um, and the spectrum of the source has none within {} nm",
                    significant(own.unwrap_or(0.0), 6),
                    1e3 * FARTHEST
                ),
                "add wavelengths to the spectrum of the source".into(),
            ));
        }
        self.farthest = self.farthest.max(off);
        let mut share = ray.flux;
        if let Some(watts) = &mut self.watts {
            let efficacy = group.wavelength.map_or(0.0, photometry::efficacy);
            if !photometry::is_visible(efficacy) {
                return Err(Refusal::OfScene(
                    format!("ray {number} has a flux in lm, and nobody sees light of its wavelength"),
                    "name a file whose flux is in W".into(),
                ));
            }
            share /= efficacy;
            *watts += share;
        }
        group.positions.push(ray.position.map(|x| x * self.scale));
        group.directions.push(ray.direction);
        group.shares.push(share);
        Ok(())
    }

    /// The groups that have rays. The spectrum of the source becomes the file's.
    fn finish(mut self, written: &mut Written) -> Vec<RayGroup> {
        if self.by_wavelength {
            self.groups.retain(|group| !group.shares.is_empty());
            written.spectrum.wavelengths = self.groups.iter().filter_map(|group| group.wavelength).collect();
            written.spectrum.weights = self.groups.iter().map(|group| group.shares.iter().sum()).collect();
        }
        self.groups
    }
}

/// One line of a ray file for a report.
impl std::fmt::Display for RayFileUsed {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let unit = self.unit.as_deref().unwrap_or("in all");
        write!(f, "{}: {} rays, {} {unit}", shown(&self.file), self.num_rays, significant(self.flux, 6))
    }
}
