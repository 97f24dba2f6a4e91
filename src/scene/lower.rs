//! Scene -> [`SceneIr`]: names become indices, degrees become radians, spectra become cumulative weights.

use std::collections::BTreeMap;

use crate::model::{Allowance, MediumId, ReflectProb, Sampling, SceneIr, Source, Spectrum, Surface};
use crate::scene::Scene;
use crate::scene::detectors::lowered as lowered_detector;
use crate::scene::frame::frame_of;
use crate::scene::json::{self, Material};
use crate::{Error, Result};

impl Scene {
    /// The scene as the tracer sees it.
    ///
    /// # Errors
    /// [`Error::Internal`] if the scene names something that reading it did not resolve.
    pub fn lower(&self) -> Result<SceneIr> {
        let file = &self.file;
        let none = BTreeMap::new();
        let extras = file.nsq_gpu.as_ref().map_or(&none, |block| &block.detectors);
        Ok(SceneIr {
            wavelengths: self.wavelengths.clone(),
            media: self.media.media.clone(),
            surfaces: surfaces(self)?,
            meshes: self.meshes.clone(),
            sources: file.sources.iter().map(|written| source(self, written)).collect::<Result<_>>()?,
            detectors: file
                .detectors
                .iter()
                .map(|written| lowered_detector(written, extras.get(written.name())))
                .collect(),
            sampling: sampling(
                &file.nsq_gpu.as_ref().map(|block| block.sampling.clone()).unwrap_or_default(),
            ),
            allowed: Allowance::default(),
        })
    }
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
            shape: surface.shape.clone(),
            interaction: surface.interaction.clone(),
            coating: surface.coating.clone(),
            scatter: surface.scatter.clone(),
            front: medium(scene, &surface.front)?,
            back: medium(scene, &surface.back)?,
        })
    });
    lowered.collect()
}

fn source(scene: &Scene, written: &json::Source) -> Result<Source> {
    Ok(Source {
        name: written.name().to_owned(),
        frame: frame_of(written.cs()),
        kind: written.kind(),
        total_flux: written.total_flux(),
        spectrum: spectrum(written.spectrum(), &scene.wavelengths)?,
        medium: medium(scene, written.medium())?,
    })
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
