//! A mirror: what is scattered goes where a mirror sends it.

use crate::Result;
use crate::model::bsdfs::{Bsdf, BsdfContext, BsdfKind, BsdfWgsl, Labelled, Scattering, WrittenBsdf};
use crate::shaders::shader;
use schemars::JsonSchema;
use serde::Deserialize;

/// The mirror.
pub const SPECULAR: BsdfWgsl = BsdfWgsl {
    name: "specular",
    file: shader!("bsdfs/specular.wgsl"),
    shared: None,
    has_table: false,
    toward: &[],
};

/// Mirror reflection.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Specular {}

/// In a scene file the same.
pub type Written = Specular;

impl WrittenBsdf for Specular {
    fn check(&self, _: &dyn Fn(&str) -> String) -> Result<()> {
        Ok(())
    }

    fn bsdf(&self, _: &Labelled<'_>, _: &mut BsdfContext<'_>) -> Result<Bsdf> {
        Ok(Bsdf::Specular(self.clone()))
    }
}

impl Scattering for Specular {
    fn kind(&self) -> BsdfKind {
        BsdfKind::Specular
    }

    fn transmissive_fraction(&self) -> f64 {
        0.0
    }
}
