//! What a ray file holds, read from its beginning to its end.

use crate::model::sources::OwnFlux;
use crate::model::sources::rays::{Bounds, FileRays, MOST_RAYS, Order, RayGroup, StreamedRay, Written};
use crate::scene::ray_files::{self, FluxKind, RayFile};
use crate::scene::ray_sources::stream::{Ends, FileStream};
use crate::scene::ray_sources::taking::{Refusal, Taking};
use std::path::Path;
use std::sync::Arc;

/// What a file holds, for the sources of one scale, order and list of wavelengths.
pub(super) struct Reading {
    pub(super) set: Arc<FileRays>,
    /// Rays with light.
    pub(super) num_rays: usize,
    /// The flux of all rays, in the file's unit.
    pub(super) total: f64,
    pub(super) unit: Option<String>,
    /// The flux of all rays, if the file says a unit.
    pub(super) flux: Option<OwnFlux>,
    /// Wavelengths \[um\] and weights, if rays have wavelengths of their own.
    pub(super) spectrum: Option<(Vec<f64>, Vec<f64>)>,
    /// The largest distance of a ray's wavelength from the listed one \[um\].
    pub(super) farthest: f64,
    pub(super) remarks: Vec<String>,
    /// How the header's flux differs from the flux of the rays.
    pub(super) excess: ray_files::Result<Option<String>>,
}

impl Reading {
    pub(super) fn of(path: &Path, written: &Written) -> std::result::Result<Self, Refusal> {
        let mut file = RayFile::open(path)?;
        let state = file.state()?;
        let header = file.header().clone();
        let taking = Taking::of(written, &header);
        let mut collected = Collected::new(&taking, header.num_rays);
        let total = file.for_each(|number, ray| collected.add(&taking, number, ray))?;
        let sha256 = file.sha256()?;
        let Collected { num_rays, shares, farthest, rays } = collected;
        let flux = match header.flux_kind {
            Some(_) if taking.is_luminous => Some(OwnFlux::Watts(shares.iter().sum())),
            Some(FluxKind::Luminous) => Some(OwnFlux::Lumens(total)),
            Some(FluxKind::Radiant) => Some(OwnFlux::Watts(total)),
            None => None,
        };
        let listed = taking.wavelengths.iter().copied().flatten().zip(shares);
        let spectrum = listed.filter(|(_, share)| *share > 0.0).unzip();
        Ok(Reading {
            num_rays,
            total,
            unit: header.flux_kind.map(|kind| kind.unit().to_owned()),
            flux,
            spectrum: taking.is_by_wavelength().then_some(spectrum),
            farthest,
            remarks: header.remarks,
            excess: file.compare_total(total),
            set: Arc::new(match rays {
                Rays::Held(mut groups) => {
                    groups.retain(|group| !group.shares.is_empty());
                    FileRays::held(sha256, written.scale, groups)
                }
                Rays::Streamed { ends, bounds } => {
                    let stream = FileStream::new(path, (file, state), taking, ends);
                    FileRays::streamed(sha256, written.scale, Arc::new(stream), bounds)
                }
            }),
        })
    }
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
