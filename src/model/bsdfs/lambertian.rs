//! Lambert's law: matt paint, opal glass.

use crate::Result;
use crate::model::bsdfs::{Bsdf, BsdfContext, BsdfKind, BsdfWgsl, Labelled, Scattering, WrittenBsdf};
use crate::model::checks;
use crate::shaders::shader;
use schemars::JsonSchema;
use serde::Deserialize;

/// Lambert's law.
pub const LAMBERTIAN: BsdfWgsl = BsdfWgsl {
    name: "lambertian",
    file: shader!("bsdfs/lambertian.wgsl"),
    shared: None,
    has_table: false,
    toward: &[shader!("scatter_to/lambertian.wgsl")],
};

/// Cosine-weighted over the hemisphere.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Lambertian {
    /// Fraction of the flux that is scattered, in \[0, 1\].
    #[serde(default = "one")]
    pub reflectance_value: f64,
    /// Fraction of the scattered rays that are transmitted.
    #[serde(default)]
    pub transmissive_fraction: f64,
}

fn one() -> f64 {
    1.0
}

/// In a scene file the same.
pub type Written = Lambertian;

impl WrittenBsdf for Lambertian {
    fn check(&self, at: &dyn Fn(&str) -> String) -> Result<()> {
        checks::fraction(at("reflectance_value"), self.reflectance_value)?;
        checks::fraction(at("transmissive_fraction"), self.transmissive_fraction)
    }

    fn bsdf(&self, _: &Labelled<'_>, _: &mut BsdfContext<'_>) -> Result<Bsdf> {
        Ok(Bsdf::Lambertian(self.clone()))
    }
}

impl Scattering for Lambertian {
    fn kind(&self) -> BsdfKind {
        BsdfKind::Lambertian
    }

    fn transmissive_fraction(&self) -> f64 {
        self.transmissive_fraction
    }

    fn reals(&self) -> Vec<(&'static str, f64)> {
        vec![("lambertian", self.reflectance_value)]
    }

    fn is_about_normal(&self) -> bool {
        true
    }

    fn keeps_level(&self) -> bool {
        true
    }

    fn by_tis(&self) -> Option<(f64, Bsdf)> {
        let white = Lambertian { reflectance_value: 1.0, ..self.clone() };
        Some((self.reflectance_value, Bsdf::Lambertian(white)))
    }
}
