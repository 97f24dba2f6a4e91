//! Numbers that host and shaders both know are the same numbers.

use crate::layouts::{binding, column};
use crate::variants::{
    Tier, Variant, bsdf_of, bsdfs, detectors, everything_in_buffers, interactions, shapes, sources, splats,
};
use naga::{Expression, Literal, Module};
use nsq_gpu::engine::sums;
use nsq_gpu::model::bsdfs::harvey_shack;
use nsq_gpu::model::sources::rays::UPLOADED_NUMBERS;
use nsq_gpu::model::{Apart, DetectorKind, FarField, Interaction, Splat};
use nsq_gpu::program::layout::tables::LEDGER_CELLS;
use nsq_gpu::program::layout::{bindings, rng};
use nsq_gpu::program::{Precision, Program, events};

fn tables() -> (Variant, Program) {
    let variant = everything_in_buffers();
    let program = variant.program(Tier { precision: Precision::F32, native: false, baked: false });
    (variant, program)
}

/// A constant of a module.
pub fn constant(module: &Module, name: &str) -> f64 {
    let found = module.constants.iter().find(|(_, constant)| constant.name.as_deref() == Some(name));
    let (_, constant) = found.unwrap_or_else(|| panic!("no constant {name}"));
    match module.global_expressions[constant.init] {
        Expression::Literal(Literal::U32(value)) => f64::from(value),
        Expression::Literal(Literal::F32(value)) => f64::from(value),
        ref other => panic!("{name} is {other:?}"),
    }
}

#[test]
fn interactions_have_the_codes_of_the_shaders() {
    let (variant, program) = tables();
    let codes = column(&program, "SurfaceRow", binding(&program, "surface_table"), "interaction");
    for interaction in interactions() {
        let name = match interaction {
            Interaction::Absorbing => "ABSORBING",
            Interaction::Reflective { .. } => "REFLECTIVE",
            Interaction::Refractive => "REFRACTIVE",
        };
        let same =
            |other: &Interaction| std::mem::discriminant(other) == std::mem::discriminant(&interaction);
        let row = variant.ir.surfaces.iter().position(|surface| same(&surface.interaction)).unwrap();
        assert_eq!(codes[row], constant(&program.module, name), "{name}");
    }
}

#[test]
fn splats_have_the_codes_of_the_shaders() {
    let (variant, program) = tables();
    let codes = column(&program, "DetectorRow", binding(&program, "detector_table"), "splat");
    for splat in splats() {
        let name = match splat {
            Splat::Hard => "SPLAT_HARD",
            Splat::Bilinear => "SPLAT_BILINEAR",
            Splat::Gaussian { .. } => "SPLAT_GAUSSIAN",
        };
        let row =
            variant.ir.detectors.iter().position(|s| s.kind.grid().is_some_and(|grid| grid.splat == splat));
        assert_eq!(codes[row.unwrap()], constant(&program.module, name), "{name}");
    }
}

#[test]
fn bsdfs_have_the_codes_of_the_dispatch() {
    let (variant, program) = tables();
    let codes = column(&program, "SurfaceRow", binding(&program, "surface_table"), "bsdf");
    let last = bsdfs().into_iter().max().unwrap();
    for kind in bsdfs() {
        let call = match kind == last {
            true => format!("    return sample_{}(s, surface);", kind.name()),
            false => format!(
                "if surface.bsdf == {}u {{ return sample_{}(s, surface); }}",
                kind.code(),
                kind.name()
            ),
        };
        assert!(program.wgsl.contains(&call), "no `{call}`");
        let model = bsdf_of(kind, 0.25);
        let row =
            variant.ir.surfaces.iter().position(|s| s.scatter.as_ref().is_some_and(|s| s.bsdf == model));
        assert_eq!(codes[row.unwrap()], f64::from(kind.code()), "{kind:?}");
    }
    let smooth = variant.ir.surfaces.iter().position(|surface| surface.scatter.is_none()).unwrap();
    assert_eq!(codes[smooth], constant(&program.module, "SMOOTH"));
}

#[test]
fn harvey_shack_tables_have_the_knots_of_the_shaders() {
    let (_, program) = tables();
    assert_eq!(constant(&program.module, "HARVEY_SHACK_KNOTS"), harvey_shack::KNOTS as f64);
    assert_eq!(constant(&program.module, "HARVEY_SHACK_STEP"), f64::from(harvey_shack::STEP as f32));
}

/// The composed dispatch sends a detector's code to the function of its kind.
#[test]
fn detectors_have_the_codes_of_the_dispatch() {
    let (variant, program) = tables();
    let codes = column(&program, "DetectorRow", binding(&program, "detector_table"), "kind");
    for kind in detectors() {
        let code = kind.function().code();
        let function = match kind {
            DetectorKind::Irradiance(_) => "irradiance",
            DetectorKind::Spectral(_) => "spectral",
            DetectorKind::FarField(FarField { sphere: false, .. }) => "far_field",
            DetectorKind::FarField(_) => "far_field_sphere",
            DetectorKind::RayDatabase(_) => "ray_database",
            DetectorKind::Apart(Apart { ref of, .. }) => match **of {
                DetectorKind::FarField(FarField { sphere: true, .. }) => "far_field_sphere_apart",
                _ => "far_field_apart",
            },
        };
        let call = format!("if detector.kind == {code}u {{ record_{function}(");
        assert!(program.wgsl.contains(&call), "no `{call}`");
        assert!(program.wgsl.contains(&format!("fn record_{function}(")), "{function}");
        let same = |other: &DetectorKind| other.function() == kind.function();
        let row = variant.ir.detectors.iter().position(|detector| same(&detector.kind)).unwrap();
        assert_eq!(codes[row], f64::from(code), "{function}");
    }
}

#[test]
fn shapes_have_the_codes_of_the_dispatch() {
    let (_, program) = tables();
    let codes = column(&program, "PrimitiveRow", binding(&program, "primitive_table"), "shape");
    for kind in shapes() {
        let function = kind.function("distance");
        let case = format!("case {}u: {{ return {function}(o, d, ", kind as u32);
        assert!(program.wgsl.contains(&case), "no `{case}`");
        assert!(program.wgsl.contains(&format!("fn {function}(")), "{function}");
        assert!(codes.contains(&f64::from(kind as u32)), "{kind:?}");
    }
}

/// A function takes the numbers that the host hands over: o, d, so many numbers, leaving; where it searches, also how
/// far.
#[test]
fn shapes_take_the_numbers_of_the_host() {
    let (_, program) = tables();
    for kind in shapes() {
        let function = program
            .module
            .functions
            .iter()
            .find(|(_, f)| f.name.as_deref() == Some(&*kind.function("distance")));
        let expected = kind.num_arguments() + 3 + usize::from(kind.is_searched());
        assert_eq!(function.unwrap().1.arguments.len(), expected, "{kind:?}");
        let arguments = crate::variants::shape_of(kind).arguments();
        assert_eq!(arguments.len(), kind.num_arguments(), "{kind:?}");
    }
}

#[test]
fn sources_have_the_codes_of_the_dispatch() {
    let (variant, program) = tables();
    let last = sources().into_iter().max().unwrap();
    for name in sources() {
        let call = match name == last {
            true => format!("    return emit_{}(key, e);", name.name()),
            false => format!("if e.kind == {}u {{ return emit_{}(key, e); }}", name as u32, name.name()),
        };
        assert!(program.wgsl.contains(&call), "no `{call}`");
        let kind = crate::variants::source_of(name);
        let source = variant.ir.sources.iter().position(|source| source.kind == kind).unwrap();
        let layout = nsq_gpu::program::layout::reals::StructLayout::of(&program.module, "Source").unwrap();
        let offset = layout.offset("kind").unwrap();
        let bytes = &program.source_uniforms[source];
        assert_eq!(bytes[offset..offset + 4], (name as u32).to_le_bytes(), "{name:?}");
    }
    assert_eq!(constant(&program.module, "UPLOADED_RAY_NUMBERS"), UPLOADED_NUMBERS as f64);
}

/// The order in which the host drains the cells.
#[test]
fn ledger_cells_are_numbered_in_order() {
    let (variant, program) = tables();
    for (number, (cell, name)) in LEDGER_CELLS.iter().enumerate() {
        assert_eq!((*cell as usize, constant(&program.module, name)), (number, number as f64), "{name}");
    }
    assert_eq!(constant(&program.module, "CELL_SURFACES"), LEDGER_CELLS.len() as f64);
    assert_eq!(program.cells.detectors[0] as usize, LEDGER_CELLS.len() + variant.ir.surfaces.len());
    assert_eq!(constant(&program.module, "COUNTER_REACHED"), f64::from(program.cells.num_cells));
    assert_eq!(constant(&program.module, "INVALID_DEPOSITS"), sums::INVALID_DEPOSITS as f64);
    assert_eq!(constant(&program.module, "CELL_INVALID"), sums::INVALID_DEPOSITS as f64);
}

/// `take_events` of the host reads these.
#[test]
fn event_kinds_and_fates_are_those_that_the_host_reads() {
    let (_, program) = tables();
    let expected = [
        ("EVENT_RECORDED", events::RECORDED),
        ("EVENT_BIRTH", events::BIRTH),
        ("EVENT_SURFACE", events::SURFACE),
        ("EVENT_DETECTOR", events::DETECTOR),
        ("EVENT_DEATH", events::DEATH),
        ("ESCAPED", events::ESCAPED),
        ("DEPTH_KILLED", events::DEPTH_KILLED),
        ("ROULETTE_KILLED", events::ROULETTE_KILLED),
    ];
    for (name, value) in expected {
        assert_eq!(constant(&program.module, name), f64::from(value), "{name}");
    }
}

/// The shaders deposit a fate in the cell that lies as far behind the first as the fate does.
#[test]
fn cells_of_fates_are_in_the_order_of_fates() {
    let (_, program) = tables();
    let number = |name: &str| constant(&program.module, name);
    for fate in ["ESCAPED", "DEPTH_KILLED", "ROULETTE_KILLED"] {
        let cell = number(&format!("CELL_{fate}"));
        assert_eq!(cell - number("CELL_ESCAPED"), number(fate) - number("ESCAPED"), "{fate}");
    }
    assert!(number("ALIVE") < number("ESCAPED") && number("DETECTED") < number("ESCAPED"));
    assert!(number("ABSORBED") < number("ESCAPED"));
}

#[test]
fn draws_have_a_table_row_for_every_step() {
    let (_, program) = tables();
    assert_eq!(constant(&program.module, "PATH_SAMPLE"), f64::from(rng::PATH_SAMPLE));
    assert_eq!(binding(&program, "rng_table"), bindings::RNG_TABLE);
    let bytes = &program.rng_table;
    // Roulette draws at the count after the last event; a Gaussian beam falls back after its last attempt.
    let events = f64::from(program.options.max_depth) + 1.0;
    let attempts = constant(&program.module, "GAUSSIAN_ATTEMPTS") + 1.0;
    assert!(bytes.len() as f64 / 16.0 >= events.max(attempts));
}
