//! Ray files that sources name: read, and put into the sources.

mod stream;
mod taking;

use crate::format::{shown, significant};
use crate::model::place::{key_of, quoted};
use crate::model::sources::OwnFlux;
use crate::model::sources::rays::{
    Bounds, MOST_RAYS, Order, RayFileUsed, RayGroup, RaySet, StreamedRay, Written,
};
use crate::scene::json::{SceneFile, Source};
use crate::scene::ray_files::{self, FluxKind, RayFile};
use crate::scene::ray_sources::stream::{Ends, FileStream};
use crate::scene::ray_sources::taking::{Refusal, Taking};
use crate::{Error, Result};
use std::path::Path;
use std::sync::Arc;

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

fn read(
    path: &Path,
    written: &mut Written,
    warnings: &mut Vec<String>,
) -> std::result::Result<RayFileUsed, Refusal> {
    let mut file = RayFile::open(path)?;
    let header = file.header().clone();
    let says_flux = written.total_flux.is_some() || written.total_flux_lumens.is_some();
    let said = |text: String| format!("{} of {}: {text}", quoted(&written.file), quoted(&written.name));
    let mut found: Vec<String> = header.remarks.iter().cloned().map(said).collect();
    let taking = Taking::of(written, &header);
    let mut collected = Collected::new(&taking, header.num_rays);
    let total = file.for_each(|number, ray| collected.add(&taking, number, ray))?;
    // A flux that the scene says takes the place of the file's.
    if !says_flux {
        found.extend(file.compare_total(total)?.map(said));
    }
    let watts: f64 = collected.shares.iter().sum();
    if collected.num_rays == 0 {
        let problem = format!("{} has no rays with light", quoted(&written.file));
        return Err(Refusal::OfScene(problem, "name a file with rays".into()));
    }
    if collected.farthest > ROUNDED {
        let nm = significant(1e3 * collected.farthest, 3);
        found
            .push(said(format!("wavelengths of rays are put to those of the spectrum, at most {nm} nm off")));
    }
    warnings.extend(found);
    let sha256 = file.sha256()?;
    let unit = header.flux_kind.map(|kind| kind.unit().to_owned());
    written.flux = match header.flux_kind {
        Some(FluxKind::Luminous) if !taking.is_luminous => Some(OwnFlux::Lumens(total)),
        Some(_) => Some(OwnFlux::Watts(watts)),
        None => None,
    };
    // The spectrum of the source becomes the file's.
    if taking.is_by_wavelength() {
        let listed = taking.wavelengths.iter().copied().flatten().zip(&collected.shares);
        let (wavelengths, weights) = listed.filter(|(_, share)| **share > 0.0).unzip();
        (written.spectrum.wavelengths, written.spectrum.weights) = (wavelengths, weights);
    }
    let num_rays = collected.num_rays;
    written.set = Some(Arc::new(match collected.rays {
        Rays::Held(mut groups) => {
            groups.retain(|group| !group.shares.is_empty());
            RaySet::held(sha256.clone(), written.scale, groups)
        }
        Rays::Streamed { ends, bounds } => {
            let stream = FileStream::new(path, file, taking, ends);
            RaySet::streamed(sha256.clone(), written.scale, Arc::new(stream), bounds)
        }
    }));
    Ok(RayFileUsed {
        source: written.name.clone(),
        file: written.file.clone(),
        sha256,
        num_rays,
        flux: total,
        unit,
    })
}

/// What is kept of all rays of a file.
struct Collected {
    /// Rays with light.
    num_rays: usize,
    /// The shares of all rays, by the number of their wavelength.
    shares: Vec<f64>,
    /// The largest distance of a ray's wavelength from the listed one \[um\].
    farthest: f64,
    rays: Rays,
}

enum Rays {
    /// The rays themselves.
    Held(Vec<RayGroup>),
    /// Where they are in the file, and what contains them.
    Streamed { ends: Ends, bounds: Bounds },
}

impl Collected {
    fn new(taking: &Taking, num_rays: u64) -> Self {
        let group = |wavelength: &Option<f64>| RayGroup {
            wavelength: *wavelength,
            positions: Vec::new(),
            directions: Vec::new(),
            shares: Vec::new(),
        };
        let is_held = taking.order == Order::Drawn && num_rays <= MOST_RAYS as u64;
        let rays = match is_held {
            true => Rays::Held(taking.wavelengths.iter().map(group).collect()),
            false => Rays::Streamed { ends: Ends::new(taking.order), bounds: Bounds::default() },
        };
        Collected { num_rays: 0, shares: vec![0.0; taking.wavelengths.len()], farthest: 0.0, rays }
    }

    fn add(
        &mut self,
        taking: &Taking,
        number: u64,
        ray: &ray_files::Ray,
    ) -> std::result::Result<(), Refusal> {
        let share = taking.share(number, ray.flux, ray.wavelength)?;
        if let Rays::Streamed { ends, .. } = &mut self.rays {
            ends.add(number, share)?;
        }
        if share == 0.0 {
            return Ok(());
        }
        let taken = taking.ray(number, ray)?;
        self.num_rays += 1;
        self.farthest = self.farthest.max(taken.off);
        let StreamedRay { position, direction, .. } = taken.ray;
        if let Some(sum) = self.shares.get_mut(taken.number) {
            *sum += share;
        }
        match &mut self.rays {
            Rays::Held(groups) => {
                if let Some(group) = groups.get_mut(taken.number) {
                    group.positions.push(position);
                    group.directions.push(direction);
                    group.shares.push(share);
                }
            }
            Rays::Streamed { bounds, .. } => bounds.add(position, direction),
        }
        Ok(())
    }
}

/// One line of a ray file for a report.
impl std::fmt::Display for RayFileUsed {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let unit = self.unit.as_deref().unwrap_or("in all");
        write!(f, "{}: {} rays, {} {unit}", shown(&self.file), self.num_rays, significant(self.flux, 6))
    }
}
