//! Composes the WGSL of one scene: files of shaders/ as they are, with only constants, records and calls around them.
//! No formula is written here.

use crate::error::Result;
use crate::model::Precision;
use crate::program::addition::ShaderAdditions;
use crate::program::layout::bindings;
use crate::program::wgsl::composition::Composition;
use crate::program::wgsl::library::{self, Integers, Real};
use crate::program::wgsl::text::Text;
use crate::shaders::shader;

/// The shader that prepares the next dispatch of a pass.
pub fn advance() -> String {
    bindings::declared(shader!("stages/advance.wgsl").text)
}

impl Composition<'_> {
    /// The whole module: the bindings, the library, the constants, the files that the scene needs (`variants`), and the
    /// text written for this scene. Above each part, a comment names the file, or the module that composes the part.
    pub fn compose(&self, additions: &ShaderAdditions) -> Result<String> {
        let mut text = Text::default();
        library::add(&mut text, self.real_type(), self.integers(), self.options.sampler);
        text.composed("program::wgsl::constants", &self.constants(additions)?);
        text.files(self.files(additions)?);
        text.composed("program::wgsl::rows", &self.rows(additions)?);
        text.composed("program::wgsl::search", &self.nearest_primitive()?);
        text.composed("program::wgsl::trees", &self.waiting());
        additions.all().try_for_each(|addition| addition.add(self, &mut text))?;
        text.composed("program::wgsl::ledger_bins", &self.bins(additions));
        text.composed("program::wgsl::dispatch", &self.dispatch()?);
        text.composed("program::layout::numbers", &self.numbers.declaration());
        self.sums.cut(bindings::declared(&text.into_string()))
    }

    fn real_type(&self) -> Real {
        match self.precision() {
            Precision::F32 => Real::F32,
            Precision::Df64 => Real::Df64,
            Precision::F64 => Real::F64,
        }
    }

    fn integers(&self) -> Integers {
        if self.options.native { Integers::Native } else { Integers::Portable }
    }
}
