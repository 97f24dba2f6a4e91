//! Compound components against what Optiland builds of them (`python/tools/make_compounds_oracle.py`).

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test fails by panicking")]

use std::collections::BTreeMap;

use nsq_gpu::model::{Annulus, Conic, Frustum, Interaction, SceneIr, Shape, Surface};
use nsq_gpu::scene::Scene;
use serde::Deserialize;

const TOLERANCE: f64 = 1e-13;

#[derive(Deserialize)]
struct Oracle {
    cases: Vec<Case>,
}

#[derive(Deserialize)]
struct Case {
    component: String,
    surfaces: Option<Vec<Expected>>,
}

#[derive(Deserialize)]
struct Expected {
    name: String,
    kind: String,
    geometry: String,
    shape: BTreeMap<String, f64>,
    translation: [f64; 3],
    rotation: [[f64; 3]; 3],
    front: Option<String>,
    back: Option<String>,
}

fn oracle() -> Vec<Case> {
    json5::from_str::<Oracle>(include_str!("data/compounds.json")).unwrap().cases
}

fn scene_of(component: &str) -> String {
    format!(
        r#"{{"nsq_schema_version": 1, "components": [{component}],
            "sources": [{{"type": "point", "name": "S", "cs": {{}}, "total_flux": 1,
                         "spectrum": {{"wavelengths": [0.55], "weights": [1]}}}}],
            "detectors": [{{"type": "far_field", "name": "F", "cs": {{}}}}]}}"#
    )
}

fn close(found: f64, expected: f64, scale: f64) -> bool {
    (found - expected).abs() <= TOLERANCE * scale.max(expected.abs())
}

/// Optiland's parameters of a shape, with the curvature for the radius.
fn parameters(shape: &Shape) -> (&'static str, Vec<(&'static str, f64)>) {
    if let Shape::Conic(Conic { curvature, conic, aperture_radius }) = *shape {
        let numbers = vec![("curvature", curvature), ("conic", conic), ("aperture_radius", aperture_radius)];
        ("ConicGeometry", numbers)
    } else if let Shape::Annulus(Annulus { inner_radius, outer_radius, z_offset }) = *shape {
        let numbers =
            vec![("inner_radius", inner_radius), ("outer_radius", outer_radius), ("z_offset", z_offset)];
        ("AnnularPlaneGeometry", numbers)
    } else if let Shape::Frustum(Frustum { r_front, r_back, z_front, z_back }) = *shape {
        let numbers =
            vec![("r_front", r_front), ("r_back", r_back), ("z_front", z_front), ("z_back", z_back)];
        ("CylindricalFrustumGeometry", numbers)
    } else {
        panic!("no compound has a {shape:?}")
    }
}

fn expected_parameter(expected: &Expected, key: &str) -> f64 {
    match key {
        "curvature" => match expected.shape["radius"] {
            0.0 => 0.0,
            radius => 1.0 / radius,
        },
        key => expected.shape[key],
    }
}

fn assert_surface(found: &Surface, expected: &Expected, ir: &SceneIr) {
    let name = &expected.name;
    assert_eq!(found.name, *name);
    let (geometry, shape) = parameters(&found.shape);
    assert_eq!(geometry, expected.geometry, "{name}");
    for (key, value) in shape {
        assert!(close(value, expected_parameter(expected, key), 1.0), "{name}: {key} = {value}");
    }
    let scale = expected.translation.iter().fold(200.0, |scale: f64, x| scale.max(x.abs()));
    for (axis, origin) in found.frame.origin.to_array().into_iter().enumerate() {
        assert!(close(origin, expected.translation[axis], scale), "{name}: origin {origin} along {axis}");
    }
    for (row, values) in expected.rotation.iter().enumerate() {
        for (column, value) in values.iter().enumerate() {
            let own = found.frame.rotation.col(column)[row];
            assert!(close(own, *value, 1.0), "{name}: rotation[{row}][{column}] = {own}, not {value}");
        }
    }
    let kind = match found.interaction {
        Interaction::Refractive => "RefractiveComponent",
        Interaction::Reflective { .. } => "ReflectiveComponent",
        Interaction::Absorbing => "AbsorbingComponent",
    };
    assert_eq!(kind, expected.kind, "{name}");
    let medium = |id: usize| Some(ir.media[id].name.clone()).filter(|_| !ir.media[id].ambient);
    assert_eq!(medium(found.front), expected.front, "{name}");
    assert_eq!(medium(found.back), expected.back, "{name}");
}

#[test]
fn surfaces_are_those_of_optiland() {
    let mut compared = 0;
    for case in oracle() {
        let Some(expected) = case.surfaces else { continue };
        let scene = Scene::from_json(&scene_of(&case.component)).unwrap_or_else(|err| panic!("{err}"));
        let ir = scene.lower().unwrap();
        assert_eq!(ir.surfaces.len(), expected.len(), "{}", case.component);
        for (found, expected) in ir.surfaces.iter().zip(&expected) {
            assert_surface(found, expected, &ir);
        }
        compared += 1;
    }
    assert!(compared >= 40, "{compared} valid cases");
}

#[test]
fn what_optiland_finds_leaking_is_refused() {
    let mut refused = 0;
    for case in oracle().iter().filter(|case| case.surfaces.is_none()) {
        let message = Scene::from_json(&scene_of(&case.component)).unwrap_err().to_string();
        assert!(message.starts_with("components[0].config: the surfaces of `C"), "{message}");
        assert!(message.contains("increase the thickness"), "{message}");
        refused += 1;
    }
    assert!(refused >= 8, "{refused} leaking cases");
}

const FAR_LENS: &str = r#"{"type": "lens", "name": "L", "cs": {"x": 3e11, "z": -5e11, "ry": 0.3},
    "config": {"r1": 50, "r2": -50, "thickness": 5, "material": "N-BK7", "front_aperture_radius": 10}}"#;

/// Optiland tests in global coordinates, where rounding opens gaps in this lens.
#[test]
fn a_lens_far_from_the_origin_closes() {
    Scene::from_json(&scene_of(FAR_LENS)).unwrap();
}
