//! Scene -> [`SceneIr`]: names become indices, degrees become radians, spectra become cumulative weights.

use std::collections::BTreeMap;

use crate::format::shown;
use crate::model::key_path::did_you_mean;
use crate::model::{
    Allowance, MediumId, PathFilter, ReflectProb, Sampling, SceneIr, Source, Spectrum, Surface,
};
use crate::scene::Scene;
use crate::scene::detectors::lowered as lowered_detector;
use crate::scene::frame::frame_of;
use crate::scene::json::{self, GuidePolicy, Material};
use crate::scene::scatter_policy;
use crate::{Error, Result};

/// To which light a file guides rays.
#[derive(Debug, Clone, PartialEq)]
pub struct GuidedLight {
    /// The detector's number; all detectors if none.
    pub detector: Option<usize>,
    /// What its paths match; all if none.
    pub filter: Option<PathFilter>,
}

impl Scene {
    /// True if the file guides rays.
    pub fn is_guided(&self) -> bool {
        self.file.nsq_gpu.as_ref().is_some_and(|block| block.sampling.guide.is_some())
    }

    /// The scene as the tracer sees it.
    ///
    /// # Errors
    /// [`Error::Scene`] if the file guides rays to light that it cannot have, or scatters them towards what it does not have. [`Error::Internal`] if the scene names something that reading it did not resolve.
    pub fn lower(&self) -> Result<SceneIr> {
        let file = &self.file;
        let none = BTreeMap::new();
        let extras = file.nsq_gpu.as_ref().map_or(&none, |block| &block.detectors);
        let policy = file.nsq_gpu.as_ref().map(|block| block.sampling.clone()).unwrap_or_default();
        let mut ir = SceneIr {
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
            sampling: sampling(&policy),
            scatter_sampling: Vec::new(),
            allowed: Allowance::default(),
        };
        scatter_policy::apply(&policy, &mut ir)?;
        self.guided_light(&ir)?;
        Ok(ir)
    }

    /// To which light the file guides rays, if it does.
    ///
    /// # Errors
    /// [`Error::Scene`] with the place, if the light makes no sense in the scene.
    pub fn guided_light(&self, ir: &SceneIr) -> Result<Option<GuidedLight>> {
        let policy = self.file.nsq_gpu.as_ref().and_then(|block| block.sampling.guide.as_ref());
        let Some(GuidePolicy { detector, r#where }) = policy else { return Ok(None) };
        let refused = |key: &str, problem: String, remedy: String| Error::Scene {
            place: format!("nsq_gpu.sampling.guide.{key}"),
            problem,
            remedy,
        };
        let number = |name: &String| {
            let names = || ir.detectors.iter().map(|detector| detector.name.as_str());
            let place = names().position(|known| known == name);
            place.ok_or_else(|| {
                let all: Vec<&str> = names().collect();
                refused(
                    "detector",
                    format!("`{}` is no detector of the scene", shown(name)),
                    did_you_mean(name, all),
                )
            })
        };
        let filter = |text: &String| {
            let advice = || "write it as in --where, such as \"reflections == 2\"".into();
            PathFilter::parse(text, ir).map_err(|error| refused("where", error.to_string(), advice()))
        };
        Ok(Some(GuidedLight {
            detector: detector.as_ref().map(number).transpose()?,
            filter: r#where.as_ref().map(filter).transpose()?,
        }))
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
