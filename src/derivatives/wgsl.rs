//! Composes what derivatives need beside the plain text (shaders/derivatives). Some functions take the place of the
//! loop's. Another is the step from a hit to where the surface has moved.

use crate::error::{Error, Result};
use crate::model::primitives::primitives;
use crate::model::shapes::{Normal, Quadric};
use crate::model::{Shape, ShapeKind};
use crate::program::addition::ShaderAddition;
use crate::program::input::ProgramInput;
use crate::program::layout::row_table::RowTable;
use crate::program::layout::{bindings, tables};
use crate::program::rewrite::jvp::NUM_TANGENTS;
use crate::program::rewrite::{jvp, transpose};
use crate::program::wgsl::composition::Composition;
use crate::program::wgsl::constants::Constants;
use crate::program::wgsl::rows::frame_functions;
use crate::program::wgsl::text::Text;
use crate::shaders::{ShaderFile, shader};
use naga::{Module, Scalar};
use std::fmt::Write;

/// Sums of tangents cannot overflow between two readings: 2^43 units of weight, over so many deposits in one cell.
const MOST_DEPOSITS: f64 = (1_u64 << 23) as f64;

/// How a scene's shader is differentiated.
#[derive(Debug)]
pub(super) struct DerivativeShader {
    /// Tangents beside each real: 0 if rays are walked back.
    num_tangents: u32,
    /// How rays choose between reflection and refraction, where surfaces refract.
    branch: Option<ShaderFile>,
}

impl DerivativeShader {
    pub(super) fn new(num_tangents: u32, scene: &ProgramInput) -> Self {
        let branch = match scene.features.importance {
            true => shader!("derivatives/branch.importance.wgsl"),
            false => shader!("derivatives/branch.fresnel.wgsl"),
        };
        DerivativeShader { num_tangents, branch: scene.features.refractive.then_some(branch) }
    }
}

impl ShaderAddition for DerivativeShader {
    fn replaces(&self) -> Vec<(&'static str, ShaderFile)> {
        let hit = match self.num_tangents {
            0 => shader!("derivatives/adjoints.wgsl"),
            _ => shader!("derivatives/tangents.wgsl"),
        };
        let branch = self.branch.map(|file| ("optics/reflection", file));
        let always = [
            ("sums/deposit", shader!("derivatives/seen.wgsl")),
            ("stages/taps", shader!("derivatives/taps.wgsl")),
            ("stages/hit", hit),
            ("optics/attenuated", shader!("derivatives/bulk.wgsl")),
            ("optics/survival", shader!("derivatives/roulette.wgsl")),
            ("stages/scattered", shader!("derivatives/scatter.wgsl")),
            ("sources/accepted", shader!("derivatives/accepted.wgsl")),
        ];
        always.into_iter().chain(branch).collect()
    }

    fn add(&self, composition: &Composition, text: &mut Text) -> Result<()> {
        let (features, cells) = (&composition.features, &composition.cells);
        let mut constants = Constants::default();
        let first = cells.detectors.first().copied().unwrap_or(cells.num_cells);
        constants.uint("FIRST_DETECTOR_CELL", first);
        if self.num_tangents > 0 {
            constants.uint(NUM_TANGENTS, self.num_tangents);
            constants.real("LARGEST_TANGENT", 8796093022208.0 / MOST_DEPOSITS);
        } else {
            constants.bool("HAS_BULK_ABSORPTION", features.bulk_absorption);
            constants.bool("WEIGHTS_VARY", !features.keeps_weight);
        }
        text.composed("derivatives::wgsl", constants.text());
        if self.num_tangents == 0 {
            text.file(match composition.options.native {
                true => shader!("derivatives/streams.native.wgsl"),
                false => shader!("derivatives/streams.portable.wgsl"),
            });
        }
        text.composed("derivatives::wgsl", &composition.crossing_step()?);
        Ok(())
    }

    fn entry_point(&self) -> Option<&'static str> {
        (self.num_tangents == 0).then_some(transpose::ENTRY_POINT)
    }

    fn rewrite(&self, module: &Module, real: Scalar) -> Result<Option<(Module, String)>> {
        match self.num_tangents as usize {
            0 => transpose::rewrite(module, real).map(Some),
            num => jvp::rewrite(module, real, num).map(Some),
        }
    }
}

impl Composition<'_> {
    /// How far a hit is from the surface, along the ray and to first order: zero but for its derivative. The number of
    /// what was hit chooses a quadric. Other shapes have functions of their own.
    fn crossing_step(&self) -> Result<String> {
        let primitives = primitives(self.ir);
        let quadric = |shape: &Shape| shape.quadric().unwrap_or(Quadric::PLANE);
        let mut records = RowTable::new("Crossed", "crossed", bindings::PRIMITIVES);
        tables::put_frames(&mut records, self.ir, primitives.iter().map(|(frame, _)| frame), self.centre);
        records.real("radial", primitives.iter().map(|(_, shape)| quadric(shape).radial));
        records.real("axial", primitives.iter().map(|(_, shape)| quadric(shape).axial));
        records.real("offset", primitives.iter().map(|(_, shape)| quadric(shape).offset));
        records.real("constant", primitives.iter().map(|(_, shape)| quadric(shape).constant));
        let rotated = tables::any_rotated(self.ir, primitives.iter().map(|(frame, _)| frame));
        let rows = if self.options.bakes_records() {
            records.baked(&self.numbers)
        } else {
            records.in_turn(&self.numbers)
        };
        let mut text = rows? + &frame_functions("Crossed", "crossed", rotated);
        text.push_str(
            "fn crossing_step(ray: Ray, hit: Hit) -> real {\n    if hit.primitive == NONE { return 0.0; }\n    \
             let s = crossed_of(hit.primitive);\n    \
             let o = to_crossed(s, ray.position + hit.distance * ray.direction - vec3<real>(s.origin_x, s.origin_y, s.origin_z));\n    \
             let d = to_crossed(s, ray.direction);\n    \
             let q = Quadric(s.radial, s.axial, s.offset, s.constant);\n    \
             var step = value_at(o, q) / detached(2.0 * slope_along(o, d, q));\n",
        );
        for (i, (_, shape)) in primitives.iter().enumerate() {
            let kind = ShapeKind::of(shape);
            match kind.wgsl().normal {
                Normal::Quadric(_) => continue,
                Normal::Own | Normal::Sag => {}
                Normal::Facet => {
                    return Err(Error::Usage(
                        "meshes have no derivatives; compare two scenes by `nsq-gpu diff` instead".into(),
                    ));
                }
            }
            let arguments = self.places.arguments(shape).into_iter().map(|argument| self.real(argument));
            let arguments = arguments.collect::<Result<Vec<_>>>()?.join(", ");
            let [height, normal] = ["height", "normal"].map(|what| kind.function(what));
            let _ = writeln!(
                text,
                "    if hit.primitive == {i}u {{\n        \
                 step = {height}(o, {arguments}) / detached(dot({normal}(o, {arguments}), d));\n    }}"
            );
        }
        Ok(text + "    return step;\n}\n")
    }
}
