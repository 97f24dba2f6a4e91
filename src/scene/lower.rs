//! Scene -> [`SceneIr`]: names become indices, degrees become radians, spectra become cumulative weights.

use std::collections::BTreeMap;

use crate::model::{
    CollimatedGaussian, CollimatedTophat, Emitter, EmitterKind, Extended, Frame, MediumId, Outline,
    PixelGrid, Point, ReflectProb, Sampling, SceneIr, Sensor, SensorKind, Spectrum, Splat, Surface,
};
use crate::scene::json::{self, Detector, DetectorExtra, Material, Profile, Source, SplatKind};
use crate::scene::{Scene, frame_of};
use crate::{Error, Result};

/// Lowers a valid scene.
pub(crate) fn lower(scene: &Scene) -> Result<SceneIr> {
    let file = &scene.file;
    let none = BTreeMap::new();
    let extras = file.nsq_gpu.as_ref().map_or(&none, |block| &block.detectors);
    Ok(SceneIr {
        wavelengths: scene.wavelengths.clone(),
        media: scene.media.media.clone(),
        surfaces: surfaces(scene)?,
        meshes: scene.meshes.clone(),
        emitters: file.sources.iter().map(|source| emitter(scene, source)).collect::<Result<_>>()?,
        sensors: file
            .detectors
            .iter()
            .map(|detector| sensor(detector, extras.get(detector.name())))
            .collect(),
        sampling: sampling(&file.nsq_gpu.as_ref().map(|block| block.sampling.clone()).unwrap_or_default()),
    })
}

fn medium(scene: &Scene, material: &Material) -> Result<MediumId> {
    scene
        .media
        .id(material)
        .ok_or_else(|| Error::Internal(format!("the material {material:?} was not resolved")))
}

fn surfaces(scene: &Scene) -> Result<Vec<Surface>> {
    let lowered = scene.surfaces.iter().map(|surface| {
        Ok(Surface {
            name: surface.name.clone(),
            frame: surface.frame,
            shape: surface.shape,
            interaction: surface.interaction.clone(),
            coating: surface.coating.clone(),
            scatter: surface.scatter.clone(),
            front: medium(scene, &surface.front)?,
            back: medium(scene, &surface.back)?,
        })
    });
    lowered.collect()
}

fn emitter(scene: &Scene, source: &Source) -> Result<Emitter> {
    Ok(Emitter {
        name: source.name().to_owned(),
        frame: frame_of(source.cs()),
        kind: emitter_kind(source),
        total_flux: source.total_flux(),
        spectrum: spectrum(source.spectrum(), &scene.wavelengths)?,
        medium: medium(scene, source.medium())?,
    })
}

/// How the rays of a source are born.
pub(crate) fn emitter_kind(source: &Source) -> EmitterKind {
    match source {
        Source::Point(point) => EmitterKind::Point(Point { half_angle: point.half_angle_deg.to_radians() }),
        Source::Collimated(beam) => {
            let aperture_radius = beam.aperture_radius;
            match beam.profile {
                Profile::Tophat => EmitterKind::CollimatedTophat(CollimatedTophat { aperture_radius }),
                Profile::Gaussian => {
                    let sigma = beam.gaussian_sigma.unwrap_or(aperture_radius / 2.0);
                    EmitterKind::CollimatedGaussian(CollimatedGaussian { aperture_radius, sigma })
                }
            }
        }
        Source::Extended(area) => EmitterKind::Extended(Extended {
            area: match area.aperture_radius {
                Some(radius) => Outline::Disk { radius },
                None => Outline::Rectangle { width: area.width, height: area.height },
            },
            half_angle: area.half_angle_deg.to_radians(),
        }),
    }
}

fn spectrum(spectrum: &json::Spectrum, wavelengths: &[f64]) -> Result<Spectrum> {
    let index = |wavelength: &f64| {
        wavelengths
            .binary_search_by(|listed| listed.total_cmp(wavelength))
            .map_err(|_| Error::Internal(format!("the wavelength {wavelength} um was not listed")))
    };
    Ok(Spectrum {
        wavelengths: spectrum.wavelengths.iter().map(index).collect::<Result<_>>()?,
        cdf: cumulative(&spectrum.weights),
    })
}

/// Sums in the order of `numpy.cumsum`, divided by the last, so that draws fall as they do in Optiland.
fn cumulative(weights: &[f64]) -> Vec<f64> {
    let mut sum = 0.0;
    let mut sums: Vec<f64> = weights
        .iter()
        .map(|weight| {
            sum += weight;
            sum
        })
        .collect();
    sums.iter_mut().for_each(|partial| *partial /= sum);
    sums
}

pub(crate) fn sensor(detector: &Detector, extra: Option<&DetectorExtra>) -> Sensor {
    let frame: Frame = frame_of(detector.cs());
    let (kind, absorb) = match detector {
        Detector::Irradiance(d) => {
            let splat = splat(d.splat, d.splat_sigma);
            (SensorKind::Irradiance(grid(d.width, d.height, d.num_pixels_x, d.num_pixels_y, splat)), d.absorb)
        }
        Detector::Spectral(d) => {
            let splat = splat(d.splat, d.splat_sigma);
            let grid = grid(d.width, d.height, d.num_pixels_x, d.num_pixels_y, splat);
            let wavelength_edges = edges(d.wl_min, d.wl_max, d.num_bins);
            (SensorKind::Spectral { grid, wavelength_edges }, d.absorb)
        }
        Detector::FarField(d) => {
            (SensorKind::FarField { num_theta: d.num_bins_theta, num_phi: d.num_bins_phi }, d.absorb)
        }
        Detector::RayDatabase(d) => {
            // Optiland's 0 stands for no limit.
            let max_rays = extra.and_then(|extra| extra.max_rays).filter(|limit| *limit > 0);
            (SensorKind::RayDatabase { width: d.width, height: d.height, max_rays }, d.absorb)
        }
    };
    Sensor { name: detector.name().to_owned(), frame, kind, absorb }
}

fn grid(width: f64, height: f64, num_pixels_x: u32, num_pixels_y: u32, splat: Splat) -> PixelGrid {
    PixelGrid { width, height, num_pixels_x, num_pixels_y, splat }
}

fn splat(kind: SplatKind, sigma: f64) -> Splat {
    match kind {
        SplatKind::Hard => Splat::Hard,
        SplatKind::Bilinear => Splat::Bilinear,
        // A Gaussian without width is a point, as in Optiland.
        SplatKind::Gaussian if sigma == 0.0 => Splat::Hard,
        SplatKind::Gaussian => Splat::Gaussian { sigma },
    }
}

/// Bin edges by the arithmetic of `numpy.linspace`, so that a wavelength on an edge falls as it does in Optiland.
fn edges(start: f64, stop: f64, bins: u32) -> Vec<f64> {
    let step = (stop - start) / f64::from(bins);
    let mut edges: Vec<f64> = (0..=bins).map(|i| f64::from(i) * step + start).collect();
    if let Some(last) = edges.last_mut() {
        *last = stop;
    }
    edges
}

fn sampling(policy: &json::SamplingPolicy) -> Sampling {
    Sampling {
        reflect_prob: match policy.reflect_prob {
            json::ReflectProb::Fresnel => ReflectProb::Fresnel,
            json::ReflectProb::Auto => ReflectProb::Auto,
            json::ReflectProb::Constant(p) => ReflectProb::Constant(p),
        },
        rr_start_flux: policy.rr_start_flux,
        split_depth: policy.split_depth,
        split_budget: policy.split_budget,
    }
}
