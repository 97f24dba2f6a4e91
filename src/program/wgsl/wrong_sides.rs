//! Has the loop count rays that take the inside of a solid for its outside (shaders/optics/wrong_sides.wgsl).

use crate::program::wgsl::composition::Composition;
use crate::program::wgsl::constants::Constants;
use crate::program::wgsl::extension::Extension;
use crate::program::wgsl::text::Text;
use crate::shaders::shader;

/// Functions of the loop whose place those of the file take.
const REPLACED: [(&str, &str); 2] =
    [("fn leave_boundary(", "fn pass_boundary("), ("fn settle(", "fn settle_end(")];

/// The same of a stage that may reject rays.
const REPLACED_ON_PATHS: [(&str, &str); 2] =
    [("fn begin_ray(", "fn begin_on_path("), ("fn end_path(", "fn end_on_path(")];

impl Composition<'_> {
    /// Adds the search where media border on each other. Derivatives need none, because the trace of their light has
    /// searched already.
    pub(super) fn look_for_wrong_sides(&self, extension: &dyn Extension, text: &mut Text) {
        let Some(first) = self.cells.wrong_sides.filter(|_| !self.options.has_derivatives()) else { return };
        REPLACED.iter().for_each(|(before, after)| text.rename(before, after));
        text.file(shader!("optics/wrong_sides.wgsl"));
        if let Some(file) = extension.rejects_wrong_sides() {
            REPLACED_ON_PATHS.iter().for_each(|(before, after)| text.rename(before, after));
            text.file(file);
        }
        let mut constants = Constants::default();
        constants.uint("COUNTER_ENTERED_TWICE", first);
        constants.uint("COUNTER_ENDED_INSIDE", first + self.ir.surfaces.len() as u32);
        text.composed("program::wgsl::wrong_sides", constants.text());
    }
}
