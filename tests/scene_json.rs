//! What a valid scene file means.

use nsq_gpu::ir::{EmitterKind, Interaction, Outline, ReflectProb, SceneIr, SensorKind, Shape, Splat};
use nsq_gpu::scene::Scene;

const SCENE: &str = r#"{
  "nsq_schema_version": 1,
  "components": [
    {"type": "lens", "name": "L1",
     "cs": {"x": 0.0, "y": 0.0, "z": 10.0, "rx": 0.0, "ry": 0.0, "rz": 0.0, "reference_cs": null},
     "config": {"r1": 50.0, "r2": Infinity, "thickness": 4.0, "material": "N-BK7", "front_aperture_radius": 10.0,
                "back_aperture_radius": 8.0, "conic1": 0.0, "conic2": 0.0}},
    {"type": "mirror", "name": "M",
     "cs": {"z": 60.0, "rx": 0.1},
     "config": {"radius": -100.0, "reflectance": 0.9, "conic": -1.0, "aperture_radius": 20.0}},
    {"type": "doublet", "name": "D", "cs": {},
     "config": {"r1": 61.0, "r2": -44.0, "r3": -130.0, "thickness1": 6.0, "thickness2": 2.5,
                "material1": {"type": "catalog", "name": "N-BK7"}, "material2": "N-SF5", "aperture_radius": 12.0}}
  ],
  "sources": [
    {"type": "collimated", "name": "S", "cs": {"z": -5.0}, "total_flux": 2.0, "profile": "gaussian",
     "aperture_radius": 3.0, "gaussian_sigma": null,
     "spectrum": {"wavelengths": [0.6563, 0.4861, 0.5876], "weights": [1.0, 2.0, 1.0]}, "medium": null},
    {"type": "point", "name": "P", "cs": {}, "total_flux": 1.0,
     "spectrum": {"wavelengths": [0.5876], "weights": [3.0]}, "half_angle_deg": 180.0}
  ],
  "detectors": [
    {"type": "irradiance", "name": "I", "cs": {"z": 100.0}, "width": 10.0, "height": 5.0},
    {"type": "spectral", "name": "W", "cs": {"z": 110.0}, "width": 10.0, "height": 5.0, "num_bins": 3,
     "num_pixels_x": 4, "num_pixels_y": 2, "splat": "gaussian", "splat_sigma": 0.0, "absorb": false},
    {"type": "far_field", "name": "F", "cs": {}},
    {"type": "ray_database", "name": "R", "cs": {}, "width": 1.0, "height": 2.0}
  ]
}"#;

fn lowered(text: &str) -> SceneIr {
    Scene::from_json(text).unwrap().lower().unwrap()
}

#[test]
fn reads_a_scene_as_optiland_writes_it() {
    let scene = Scene::from_json(SCENE).unwrap();
    let ir = scene.lower().unwrap();
    let names: Vec<&str> = ir.surfaces.iter().map(|surface| surface.name.as_str()).collect();
    let expected = [
        "L1.front", "L1.back", "L1.edge", "L1.rim", "M.surface", "D.front", "D.cemented", "D.back", "D.edge_crown",
        "D.edge_flint",
    ];
    assert_eq!(names, expected);
    assert_eq!(ir.wavelengths, [0.4861, 0.5876, 0.6563]);
    assert_eq!(scene.warnings, Vec::<String>::new());
}
