//! Cat's eyes, the example of docs/adding-a-kind.md: every ray goes back where it came from. Tests alone have it.

use crate::Result;
use crate::model::bsdfs::{Bsdf, BsdfContext, BsdfKind, BsdfWgsl, Labelled, Scattering, WrittenBsdf};
use crate::model::checks;
use crate::shaders::ShaderFile;
use schemars::JsonSchema;
use serde::Deserialize;

/// The cat's eyes.
pub const RETRO: BsdfWgsl = BsdfWgsl {
    name: "retro",
    file: ShaderFile {
        path: "../tests/fixtures/retro.wgsl",
        text: include_str!("../../../tests/fixtures/retro.wgsl"),
    },
    shared: None,
    has_table: false,
    toward: &[],
};

/// Rays go back where they came from.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Retro {
    /// Fraction of the flux that goes back, in \[0, 1\].
    pub share: f64,
}

/// In a scene file the same.
pub type Written = Retro;

impl WrittenBsdf for Retro {
    fn check(&self, at: &dyn Fn(&str) -> String) -> Result<()> {
        checks::fraction(at("share"), self.share)
    }

    fn bsdf(&self, _: &Labelled<'_>, _: &mut BsdfContext<'_>) -> Result<Bsdf> {
        Ok(Bsdf::Retro(self.clone()))
    }
}

impl Scattering for Retro {
    fn kind(&self) -> BsdfKind {
        BsdfKind::Retro
    }

    fn transmissive_fraction(&self) -> f64 {
        0.0
    }

    fn reals(&self) -> Vec<(&'static str, f64)> {
        vec![("retro_share", self.share)]
    }
}

#[cfg(test)]
mod tests {
    use crate::gpu::{AdapterChoice, Gpu};
    use crate::program::Precision;
    use crate::{Scene, TraceOptions, Tracer};

    /// A slanted wall of cat's eyes, a beam towards it, and a detector behind the source. Beside the wall stands matt
    /// paint, which no ray meets: the shader has to distinguish the two.
    fn scene(share: &str) -> crate::Result<Scene> {
        let wall = |name: &str, x: f64, bsdf: &str| {
            format!(
                r#"{{"name": "{name}", "cs": {{"x": {x}, "z": 10.0, "ry": 0.5}}, "interaction": "reflective",
                    "reflectance": 1.0, "shape": {{"type": "plane", "aperture_radius": 4.0}}, "bsdf": {bsdf}}}"#
            )
        };
        let eyes = wall("eyes", 0.0, &format!(r#"{{"type": "retro", "share": {share}}}"#));
        let paint = wall("paint", 50.0, r#"{"type": "lambertian", "reflectance_value": 0.5}"#);
        Scene::from_json(&format!(
            r#"{{
                "nsq_schema_version": 1,
                "sources": [{{"type": "collimated", "name": "S", "cs": {{}}, "total_flux": 1.0, "aperture_radius": 1.0,
                    "spectrum": {{"wavelengths": [0.55], "weights": [1.0]}}}}],
                "detectors": [{{"type": "irradiance", "name": "D", "cs": {{"z": -5.0}}, "width": 2.5, "height": 2.5,
                    "num_pixels_x": 1, "num_pixels_y": 1, "splat": "hard"}}],
                "nsq_gpu": {{"version": 1, "surfaces": [{eyes}, {paint}]}}
            }}"#
        ))
    }

    #[test]
    fn cats_eyes_send_rays_back_to_their_source() {
        let ir = scene("0.75").unwrap().lower().unwrap();
        let gpu = Gpu::open(&AdapterChoice::default()).unwrap();
        let all = [true, false].into_iter().flat_map(|baked| {
            [Precision::F32, Precision::Df64, Precision::F64].map(|precision| (baked, precision))
        });
        for (baked, precision) in all {
            let options =
                TraceOptions { num_rays: 1000, precision, baked: Some(baked), ..TraceOptions::default() };
            let tally = Tracer::new(&gpu, &ir, &options).unwrap().trace(|_| true).unwrap();
            let share = tally.detectors[0].quanta.iter().sum::<u128>() as f64 / tally.launched.quanta as f64;
            assert!((share - 0.75).abs() < 1e-5, "{share} comes back in {precision:?}, baked: {baked}");
        }
    }

    #[test]
    fn a_share_that_nothing_reflects_is_refused_by_its_place() {
        let error = scene("1.5").unwrap_err().to_string();
        assert!(error.contains("nsq_gpu.surfaces[0].bsdf.share"), "{error}");
    }
}
