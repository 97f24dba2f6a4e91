//! Composes what derivatives need beside the plain text (shaders/derivatives): functions that take the place of the loop's,
//! and the step from a hit to where the surface has moved.

use crate::error::{Error, Result};
use crate::model::ShapeKind;
use crate::model::primitives::primitives;
use crate::model::shapes::Normal;
use crate::program::tangents::NUM_TANGENTS;
use crate::program::wgsl::composition::Composition;
use crate::program::wgsl::constants::Constants;
use crate::program::wgsl::dispatch::quadric_of;
use crate::program::wgsl::text::Text;
use crate::shaders::shader;
use std::fmt::Write;

/// Functions of every loop whose places others take; the plain ones then have these names with `_of_value`.
const REPLACED: [&str; 4] = ["deposit_weight", "deposit_tap", "deposit_taps", "intersect"];

/// Sums of tangents cannot overflow between two readings: 2^43 units of weight, over so many deposits in one cell.
const MOST_DEPOSITS: f64 = (1_u64 << 23) as f64;

impl Composition<'_> {
    /// Makes the functions of the loop tell derivatives, if there are any to tell.
    pub(super) fn tell_tangents(&self, text: &mut Text) -> Result<()> {
        let num = self.options.tangents;
        if num == 0 {
            return Ok(());
        }
        let features = &self.features;
        let some = [
            (features.refractive, "draw_reflection", shader!("derivatives/branch.wgsl")),
            (features.bulk_absorption, "attenuated", shader!("derivatives/bulk.wgsl")),
            (features.roulette, "roulette", shader!("derivatives/roulette.wgsl")),
            (!features.bsdfs.is_empty(), "scatter", shader!("derivatives/scatter.wgsl")),
        ];
        let some = || some.iter().filter(|(is_needed, ..)| *is_needed);
        for name in REPLACED.into_iter().chain(some().map(|(_, name, _)| *name)) {
            text.rename(&format!("fn {name}("), &format!("fn {name}_of_value("));
        }
        let mut constants = Constants::default();
        constants.uint(NUM_TANGENTS, num);
        let first = self.cells.detectors.first().copied().unwrap_or(self.cells.num_cells);
        constants.uint("FIRST_DETECTOR_CELL", first);
        constants.real("LARGEST_TANGENT", 8796093022208.0 / MOST_DEPOSITS);
        text.composed("program::wgsl::tangents", constants.text());
        text.file(shader!("derivatives/tangents.wgsl"));
        text.files(some().map(|(.., file)| *file));
        text.composed("program::wgsl::tangents", &self.crossing_step()?);
        Ok(())
    }

    /// How far a hit is from the surface, along the ray and to first order: zero but for its derivative.
    fn crossing_step(&self) -> Result<String> {
        let mut text = String::from(
            "fn crossing_step(start: Ray, hit: Hit) -> real {\n    var ray = start;\n    \
             ray.position += hit.distance * start.direction;\n    switch hit.primitive {\n",
        );
        for (i, (frame, shape)) in primitives(self.ir).iter().enumerate() {
            let kind = ShapeKind::of(shape);
            let (o, d) = self.in_frame(frame)?;
            let arguments: Vec<String> = self
                .places
                .arguments(shape)
                .into_iter()
                .map(|argument| self.real(argument))
                .collect::<Result<_>>()?;
            let arguments = arguments.join(", ");
            let step = match kind.wgsl().normal {
                Normal::Quadric(_) => {
                    let quadric = quadric_of(kind, "o", &arguments);
                    format!("value_at(o, {quadric}) / detached(2.0 * slope_along(o, d, {quadric}))")
                }
                Normal::Own | Normal::Sag => {
                    let [height, normal] = ["height", "normal"].map(|what| kind.function(what));
                    format!("{height}(o, {arguments}) / detached(dot({normal}(o, {arguments}), d))")
                }
                Normal::Facet => {
                    return Err(Error::Usage(
                        "derivatives have no rule for meshes; leave the mesh out, or compare scenes by `nsq-gpu diff`"
                            .into(),
                    ));
                }
            };
            let _ = writeln!(
                text,
                "        case {i}u: {{\n            let o = {o};\n            let d = {d};\n            return {step};\n        }}"
            );
        }
        Ok(text + "        default: { return 0.0; }\n    }\n}\n")
    }
}
