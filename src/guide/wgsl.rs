//! Composes how rays are guided (shaders/guide): the draws of branches and of scattering, and roulette.

use crate::error::Result;
use crate::model::guide::{PLAIN_SHARE, WORDS};
use crate::program::addition::ShaderAddition;
use crate::program::wgsl::composition::Composition;
use crate::program::wgsl::text::Text;
use crate::shaders::{ShaderFile, shader};

/// Words of a ray's path: its node, and how much likelier the guide made the path. With a filter, a third word is the
/// share of light that followed where the filter left one branch.
pub fn num_path_words(is_filtered: bool) -> usize {
    if is_filtered { 3 } else { 2 }
}

/// How a scene's shader guides rays.
#[derive(Debug)]
pub(super) struct GuideShader {
    /// True if light of some paths alone is kept.
    pub(super) is_filtered: bool,
}

impl ShaderAddition for GuideShader {
    fn replaces(&self) -> Vec<(&'static str, ShaderFile)> {
        vec![
            ("optics/branch", shader!("guide/branch.wgsl")),
            ("optics/survival", shader!("guide/survival.wgsl")),
            ("stages/scatter_branch", shader!("guide/scatter_branch.wgsl")),
        ]
    }

    fn add(&self, _composition: &Composition, text: &mut Text) -> Result<()> {
        let constants =
            format!("const PLAIN_SHARE: f32 = {PLAIN_SHARE:?}f;\nconst GUIDE_WORDS: u32 = {WORDS}u;\n");
        text.composed("guide::wgsl", &constants);
        text.file(match self.is_filtered {
            true => shader!("guide/alone.filtered.wgsl"),
            false => shader!("guide/alone.none.wgsl"),
        });
        Ok(())
    }
}
