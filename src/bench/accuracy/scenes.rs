//! The scenes of the charts, each with one detector.

use crate::error::{Error, Result};
use crate::model::{DetectorKind, Interaction, Sampling, SceneIr, Splat};
use crate::scene::Scene;

/// A scene and one of its detectors.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct AccuracyScene {
    /// Name of the scene's file.
    pub name: &'static str,
    /// The scene's title, for people.
    pub title: &'static str,
    /// The detector, of the kind `irradiance`.
    pub detector: &'static str,
    /// Largest number of events of a ray.
    pub max_depth: u32,
    /// Text of the scene's file.
    pub text: &'static str,
}

macro_rules! scene {
    ($name:literal, $title:literal, $detector:literal, $max_depth:literal) => {
        AccuracyScene {
            name: $name,
            title: $title,
            detector: $detector,
            max_depth: $max_depth,
            text: include_str!(concat!("../../../scenes/", $name, ".json")),
        }
    };
}
pub(super) use scene;

/// The scenes of the charts.
pub const SCENES: [AccuracyScene; 6] = [
    scene!("bench_lens", "A singlet", "D", 16),
    scene!("cooke_triplet", "Cooke triplet, seven stars", "image", 16),
    scene!("heliar_ghosts", "Heliar, light thrown back", "back", 16),
    scene!("light_pipe", "Light pipe, Lambertian", "exit_map", 16),
    scene!("integrating_sphere", "Integrating sphere", "port", 64),
    scene!("scattering_telescope", "Telescope that scatters", "focus", 16),
];

impl AccuracyScene {
    /// The scene as it is measured: each ray lands in one pixel, with Optiland's default policy. A method changes one
    /// of these.
    ///
    /// # Errors
    /// [`Error::Scene`] if the file is refused.
    pub fn plain(&self) -> Result<SceneIr> {
        let mut ir = Scene::from_json(self.text)?.lower()?;
        ir.sampling = Sampling::default();
        set_splat(&mut ir, Splat::Hard);
        Ok(ir)
    }

    /// Index of the detector.
    ///
    /// # Errors
    /// [`Error::Internal`] if no detector has that name.
    pub fn detector(&self, ir: &SceneIr) -> Result<usize> {
        let position = ir.detectors.iter().position(|detector| detector.name == self.detector);
        position.ok_or_else(|| Error::Internal(format!("{}: no detector `{}`", self.name, self.detector)))
    }
}

/// Sets how all maps are splatted.
pub(super) fn set_splat(ir: &mut SceneIr, splat: Splat) {
    for detector in &mut ir.detectors {
        if let DetectorKind::Irradiance(grid) = &mut detector.kind {
            grid.splat = splat;
        }
    }
}

/// True if there is a choice between reflection and refraction.
pub(super) fn is_refractive(ir: &SceneIr) -> bool {
    ir.surfaces.iter().any(|surface| matches!(surface.interaction, Interaction::Refractive))
}
