//! What a valid scene file means.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test fails by panicking")]

use nsq_gpu::model::{
    Collimated, Conic, DetectorKind, FarField, Interaction, Outline, Point, RayDatabase, ReflectProb,
    SceneIr, Shape, SourceKind, Spectral, Sphere, Splat,
};
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
    {"type": "ray_database", "name": "R", "cs": {"z": -5.0}, "width": 1.0, "height": 2.0}
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
        "L1.front",
        "L1.back",
        "L1.edge",
        "L1.rim",
        "M.surface",
        "D.front",
        "D.cemented",
        "D.back",
        "D.edge_crown",
        "D.edge_flint",
    ];
    assert_eq!(names, expected);
    assert_eq!(ir.wavelengths, [0.4861, 0.5876, 0.6563]);
    assert_eq!(scene.warnings, Vec::<String>::new());
}

#[test]
fn sources_carry_optilands_numbers() {
    let ir = lowered(SCENE);
    let beam = &ir.sources[0];
    assert_eq!(beam.kind, SourceKind::Collimated(Collimated { aperture_radius: 3.0, sigma: Some(1.5) }));
    assert_eq!((beam.total_flux, beam.medium), (2.0, SceneIr::VACUUM));
    // The user's order of wavelengths, as indices into the ascending table.
    assert_eq!(beam.spectrum.wavelengths, [2, 0, 1]);
    assert_eq!(beam.spectrum.cdf, [0.25, 0.75, 1.0]);
    assert_eq!(ir.sources[1].kind, SourceKind::Point(Point { half_angle: std::f64::consts::PI }));
    assert_eq!(ir.sources[1].spectrum.wavelengths, [1]);
}

#[test]
fn detectors_carry_optilands_defaults() {
    let ir = lowered(SCENE);
    let DetectorKind::Irradiance(grid) = &ir.detectors[0].kind else { panic!("not an irradiance map") };
    assert_eq!((grid.num_pixels_x, grid.num_pixels_y, grid.splat), (256, 256, Splat::Bilinear));
    assert_eq!((grid.width, grid.height, ir.detectors[0].absorb), (10.0, 5.0, true));
    let DetectorKind::Spectral(Spectral { grid, wavelength_edges }) = &ir.detectors[1].kind else {
        panic!("not spectral")
    };
    assert_eq!((grid.splat, ir.detectors[1].absorb), (Splat::Hard, false));
    // numpy.linspace(0.4, 0.7, 4)
    assert_eq!(wavelength_edges, &[0.4, 0.5, 0.6, 0.7]);
    assert_eq!(
        ir.detectors[2].kind,
        DetectorKind::FarField(FarField { num_theta: 90, num_phi: 360, sphere: false })
    );
    assert_eq!(
        ir.detectors[3].kind,
        DetectorKind::RayDatabase(RayDatabase { width: 1.0, height: 2.0, max_rays: None })
    );
    assert_eq!(ir.sampling.reflect_prob, ReflectProb::Fresnel);
    assert_eq!(ir.sampling.rr_start_flux, 1e-3);
}

/// `numpy.linspace(0.38, 0.78, 8)`, printed by numpy.
const LINSPACE: [f64; 8] = [
    0.38,
    0.43714285714285717,
    0.49428571428571433,
    0.5514285714285714,
    0.6085714285714285,
    0.6657142857142857,
    0.7228571428571429,
    0.78,
];

#[test]
fn bin_edges_are_numpys() {
    let text = SCENE.replace(r#""num_bins": 3"#, r#""num_bins": 7, "wl_min": 0.38, "wl_max": 0.78"#);
    let DetectorKind::Spectral(Spectral { wavelength_edges, .. }) = &lowered(&text).detectors[1].kind else {
        panic!()
    };
    assert_eq!(wavelength_edges, &LINSPACE);
}

#[test]
fn media_are_shared_by_content_and_tabulated() {
    let ir = lowered(SCENE);
    let names: Vec<&str> = ir.media.iter().map(|medium| medium.name.as_str()).collect();
    assert_eq!(names, ["vacuum", "N-BK7", "N-SF5"]);
    assert!(ir.media[0].ambient && !ir.media[1].ambient);
    assert!((ir.media[1].n[1] - 1.51679844).abs() < 1e-7, "N-BK7 at 0.5876 um: {}", ir.media[1].n[1]);
    let lens = &ir.surfaces[0];
    assert_eq!((lens.front, lens.back), (0, 1));
    let cemented = &ir.surfaces[6];
    assert_eq!((cemented.front, cemented.back), (1, 2));
    assert_eq!(ir.surfaces[4].interaction, Interaction::Reflective { reflectance: vec![0.9; 3] });
}

#[test]
fn infinite_and_zero_radii_are_flat() {
    let zero = SCENE.replace("Infinity", "0");
    assert_eq!(lowered(SCENE).surfaces[1], lowered(&zero).surfaces[1]);
    let quoted = SCENE.replace("Infinity", "\"-Infinity\"");
    assert_eq!(lowered(SCENE).surfaces[1], lowered(&quoted).surfaces[1]);
    let Shape::Conic(Conic { curvature, .. }) = lowered(SCENE).surfaces[1].shape else {
        panic!("not a conic")
    };
    assert_eq!(curvature, 0.0);
}

#[test]
fn comments_and_trailing_commas_are_read() {
    let text = SCENE
        .replacen('{', "\u{feff}{ // a comment\n", 1)
        .replace("\"detectors\": [", "/* and */ detectors: [");
    assert_eq!(lowered(&text), lowered(SCENE));
}

fn with_block(block: &str) -> String {
    let end = SCENE.rfind('}').unwrap();
    format!("{}, \"nsq_gpu\": {{\"version\": 1, {block}}}}}", &SCENE[..end])
}

#[test]
fn the_block_adds_surfaces_media_and_order() {
    let ir = lowered(&with_block(
        r#""media": {"glass": {"type": "constant", "n": 1.5, "k": 1e-6},
                     "tab": {"type": "table", "wavelengths": [0.5876, 0.4861, 0.6563, 0.7], "n": [2, 3, 1, 9]},
                     "same": {"type": "constant", "n": 1.5, "k": 1e-6}},
           "surfaces": [
             {"name": "ball", "cs": {"z": 1}, "shape": {"type": "sphere", "radius": 5, "aperture_radius": null},
              "interaction": "refractive", "material_front": null, "material_back": {"type": "medium", "name": "glass"}},
             {"name": "wall", "cs": {}, "shape": {"type": "plane"}, "interaction": "absorbing"},
             {"name": "tilted", "cs": {}, "shape": {"type": "plane", "width": 2, "height": 3},
              "interaction": "reflective", "material_front": {"type": "medium", "name": "tab"},
              "reflectance": {"wavelengths": [0.4861, 0.5876, 0.6563], "values": [0.1, 0.2, 0.3]}},
             {"name": "disk", "cs": {}, "shape": {"type": "plane", "aperture_radius": 4}, "interaction": "refractive",
              "material_back": {"type": "medium", "name": "same"}}],
           "order": ["ball", "D", "wall", "L1", "tilted", "M", "disk"],
           "detectors": {"R": {"max_rays": 100}},
           "sampling": {"reflect_prob": 0.3, "rr_start_flux": 0.01, "split_depth": 2, "split_budget": 1.5}"#,
    ));
    let names: Vec<&str> = ir.surfaces.iter().map(|surface| surface.name.as_str()).collect();
    let expected = [
        "ball",
        "D.front",
        "D.cemented",
        "D.back",
        "D.edge_crown",
        "D.edge_flint",
        "wall",
        "L1.front",
        "L1.back",
        "L1.edge",
        "L1.rim",
        "tilted",
        "M.surface",
        "disk",
    ];
    assert_eq!(names, expected);
    let surface = |name: &str| ir.surfaces.iter().find(|surface| surface.name == name).unwrap();
    assert_eq!(surface("ball").shape, Shape::Sphere(Sphere { radius: 5.0, aperture_radius: None }));
    assert_eq!(surface("wall").shape, Shape::Plane(Outline::Infinite));
    assert_eq!(surface("tilted").shape, Shape::Plane(Outline::Rectangle { width: 2.0, height: 3.0 }));
    assert_eq!(surface("tilted").interaction, Interaction::Reflective { reflectance: vec![0.1, 0.2, 0.3] });
    // Like Optiland's, a mirror has its front medium on both sides.
    assert_eq!(surface("tilted").front, surface("tilted").back);
    assert_eq!(ir.media[surface("tilted").front].n, [3.0, 2.0, 1.0]);
    assert_eq!(surface("disk").shape, Shape::Plane(Outline::Disk { radius: 4.0 }));
    assert_eq!(surface("ball").back, surface("disk").back, "media of equal content are shared");
    assert_eq!(ir.media[surface("ball").back].k, [1e-6; 3]);
    assert_eq!(
        ir.detectors[3].kind,
        DetectorKind::RayDatabase(RayDatabase { width: 1.0, height: 2.0, max_rays: Some(100) })
    );
    assert_eq!((ir.sampling.reflect_prob, ir.sampling.rr_start_flux), (ReflectProb::Constant(0.3), 0.01));
    assert_eq!((ir.sampling.split_depth, ir.sampling.split_budget), (2, 1.5));
}

#[test]
fn a_solid_of_index_1_is_not_the_ambient_vacuum() {
    let ir = lowered(&with_block(
        r#""media": {"air": {"type": "constant", "n": 1}}, "surfaces": [{"name": "s", "cs": {},
           "shape": {"type": "sphere", "radius": 1}, "interaction": "refractive",
           "material_back": {"type": "medium", "name": "air"}}]"#,
    ));
    let back = ir.surfaces.last().unwrap().back;
    assert_ne!(back, SceneIr::VACUUM);
    assert!(!ir.media[back].ambient);
}

#[test]
fn overrides_change_surfaces_as_optiland_does() {
    let ir = lowered(&with_block(
        r#""overrides": {"L1.back": {"interaction": "reflective", "reflectance": 0.5},
                         "L1.edge": {"interaction": "refractive"},
                         "M.surface": {"aperture_radius": 7, "reflectance": 0.25}}"#,
    ));
    let surface = |name: &str| ir.surfaces.iter().find(|surface| surface.name == name).unwrap();
    let back = surface("L1.back");
    assert_eq!(back.interaction, Interaction::Reflective { reflectance: vec![0.5; 3] });
    assert_eq!((back.front, back.back), (1, 1));
    assert_eq!(surface("L1.edge").interaction, Interaction::Refractive);
    let mirror = surface("M.surface");
    assert_eq!(mirror.shape, Shape::Conic(Conic { curvature: -0.01, conic: -1.0, aperture_radius: 7.0 }));
    assert_eq!(mirror.interaction, Interaction::Reflective { reflectance: vec![0.25; 3] });
}

#[test]
fn whole_numbers_may_have_a_point() {
    let text = SCENE.replace("\"nsq_schema_version\": 1", "\"nsq_schema_version\": 1.0");
    assert_ne!(text, SCENE);
    assert_eq!(Scene::from_json(&text).unwrap().file, Scene::from_json(SCENE).unwrap().file);
}

#[test]
fn doubtful_materials_and_angles_are_warned_of() {
    let text = SCENE.replace("N-SF5", "SF6").replace("\"rx\": 0.1", "\"rx\": 45");
    let warnings = Scene::from_json(&text).unwrap().warnings;
    assert!(warnings.iter().any(|warning| warning.contains("radians")), "{warnings:?}");
    assert!(warnings.iter().any(|warning| warning.contains("SF6")), "{warnings:?}");
    let idle = with_block(r#""overrides": {"L1.front": {"reflectance": 0.5}}"#);
    let warnings = Scene::from_json(&idle).unwrap().warnings;
    assert!(warnings.iter().any(|warning| warning.contains("\"L1.front\" is ignored")), "{warnings:?}");
    let wide = with_block(r#""overrides": {"M.surface": {"aperture_radius": 30}}"#)
        .replace("-100.0", "25")
        .replace("-1.0", "0");
    let warnings = Scene::from_json(&wide).unwrap().warnings;
    assert_eq!(warnings, ["\"M.surface\" ends at 25 mm from its axis, within its aperture"]);
    let far = SCENE.replace("0.6563", "19.5");
    let warnings = Scene::from_json(&far).unwrap().warnings;
    assert!(warnings.iter().any(|warning| warning.contains("19.5 um")), "{warnings:?}");
}

/// In every frame, and in those that it is chained to.
#[test]
fn degrees_for_radians_are_reported_wherever_a_rotation_stands() {
    let plain = r#""cs": {"reference_cs": {"x": 1}}"#;
    let scene = |turned: usize, cs: &str| {
        let cs = |i: usize| if i == turned { cs } else { plain };
        format!(
            r#"{{"nsq_schema_version": 1, "components": [{{"type": "mirror", "name": "M", {}, "config": {{"radius": 0,
            "reflectance": 1, "aperture_radius": 9}}}}], "sources": [{{"type": "point", "name": "S", {}, "total_flux": 1,
            "spectrum": {{"wavelengths": [0.5], "weights": [1]}}}}], "detectors": [{{"type": "irradiance", "name": "D", {},
            "width": 9, "height": 9}}], "nsq_gpu": {{"version": 1, "surfaces": [{{"name": "R", {}, "interaction":
            "reflective", "reflectance": 1, "shape": {{"type": "plane", "width": 9, "height": 9}}}}]}}}}"#,
            cs(0),
            cs(1),
            cs(2),
            cs(3)
        )
    };
    let told = |turned: usize, cs: &str| -> Vec<String> {
        let warnings = Scene::from_json(&scene(turned, cs)).unwrap().warnings;
        warnings.into_iter().filter(|warning| warning.contains("rotations are in radians")).collect()
    };
    for (i, name) in ["M", "S", "D", "R"].into_iter().enumerate() {
        assert_eq!(
            told(i, r#""cs": {"z": 5, "rx": 6.28, "ry": -3.17, "rz": 1.5}"#),
            Vec::<String>::new(),
            "{name}"
        );
        for (cs, words) in [
            (r#""cs": {"rx": 45}"#, "is rotated by 45 rad"),
            (r#""cs": {"rz": -90, "z": 5}"#, "is rotated by -90 rad"),
            (r#""cs": {"rx": 5}"#, "is rotated by 5 rad"),
            (r#""cs": {"ry": -2}"#, "is rotated by -2 rad"),
            (r#""cs": {"reference_cs": {"rx": 2.5}}"#, "is rotated by 2.5 rad"),
            (r#""cs": {"reference_cs": {"ry": 90}}"#, "is rotated by 90 rad"),
            (r#""cs": {"reference_cs": {"reference_cs": {"rx": 30}}}"#, "is rotated by 30 rad"),
        ] {
            let warnings = told(i, cs);
            assert_eq!(warnings.len(), 1, "{name}, {cs}: {warnings:?}");
            assert!(warnings[0].contains(&format!("\"{name}\" {words}")), "{name}, {cs}: {warnings:?}");
        }
    }
}

#[test]
fn a_scene_file_is_read_from_its_path() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.json");
    std::fs::write(&path, SCENE).unwrap();
    let scene = Scene::from_path(&path).unwrap();
    assert_eq!(scene.file, Scene::from_json(SCENE).unwrap().file);
    assert_eq!(scene.resolve("part.stl"), folder.path().join("part.stl"));
}

/// The schema knows every type, and refuses keys that the reader refuses.
#[test]
fn the_schema_describes_every_type() {
    let schema = nsq_gpu::scene::schema().to_string();
    for word in [
        "lens",
        "far_field",
        "harvey_shack",
        "k_correlation",
        "tis",
        "thickness1",
        "nsq_gpu",
        "additionalProperties",
        "frustum",
    ] {
        assert!(schema.contains(&format!("\"{word}\"")), "{word}");
    }
    assert!(!schema.contains(r"\\["), "escapes of the code's documentation");
}

#[test]
fn every_scene_of_the_collection_is_valid() {
    let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes");
    let files = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    let scenes: Vec<_> = files.filter(|path| path.extension().is_some_and(|kind| kind == "json")).collect();
    assert!(scenes.len() >= 30, "{} scenes", scenes.len());
    for path in scenes {
        let scene = Scene::from_path(&path).unwrap_or_else(|err| panic!("{}: {err}", path.display()));
        assert!(!scene.lower().unwrap().surfaces.is_empty(), "{}", path.display());
    }
}

/// One lens and a detector, with changes.
fn warnings_of(detectors: &str, block: &str) -> Vec<String> {
    let text = format!(
        r#"{{"nsq_schema_version": 1, "components": [{{"type": "lens", "name": "L1", "cs": {{"z": 10.0}}, "config":
        {{"r1": 50.0, "r2": Infinity, "thickness": 4.0, "material": "N-BK7", "front_aperture_radius": 10.0}}}}],
        "sources": [{{"type": "point", "name": "S", "cs": {{}}, "total_flux": 1, "spectrum": {{"wavelengths": [0.5, 0.6],
        "weights": [1, 1]}}}}], "detectors": [{detectors}], "nsq_gpu": {{"version": 1, {block}}}}}"#
    );
    Scene::from_json(&text).unwrap().warnings
}

#[test]
fn detectors_that_see_nothing_or_more_than_their_name_are_warned_of() {
    let map = |name: &str, z: f64| {
        format!(r#"{{"type": "irradiance", "name": "{name}", "cs": {{"z": {z}}}, "width": 9, "height": 9}}"#)
    };
    let spectral = |low: f64| {
        format!(
            r#"{{"type": "spectral", "name": "C", "cs": {{"z": 90}}, "width": 9, "height": 9, "wl_min": {low}, "wl_max": 0.6}}"#
        )
    };
    let sampling = r#""sampling": {}"#;
    assert_eq!(warnings_of(&[map("A", 20.0), map("B", 21.0), spectral(0.5)].join(", "), sampling), [""; 0]);
    let expected = "detector \"B\" lies in the plane of \"L1.back\": where the two coincide, rays meet the latter alone, as in \
        Optiland; move one by a micrometre";
    assert_eq!(warnings_of(&[map("A", 20.0), map("B", 14.0)].join(", "), sampling), [expected]);
    let found = warnings_of(&[map("A", 20.0), map("B", 20.0)].join(", "), sampling);
    assert_eq!(found, [expected.replace("L1.back", "A")]);
    let found = warnings_of(&spectral(0.55), sampling);
    assert_eq!(
        found,
        [
            "detector \"C\" counts light of 0.5 um in its first or last bin, though its bins reach from 0.55 to 0.6 um, as in \
          Optiland"
        ]
    );
}

#[test]
fn sources_in_faces_are_warned_of_where_they_shine_to_both_sides_or_into_another_medium() {
    let warnings = |source: &str| {
        let text = format!(
            r#"{{"nsq_schema_version": 1, "components": [{{"type": "lens", "name": "L1", "cs": {{"z": 10.0}}, "config":
            {{"r1": 50.0, "r2": Infinity, "thickness": 4.0, "material": "N-BK7", "front_aperture_radius": 10.0}}}}],
            "sources": [{{{source}, "name": "S", "total_flux": 1, "spectrum": {{"wavelengths": [0.5], "weights": [1]}}}}],
            "detectors": [{{"type": "irradiance", "name": "A", "cs": {{"z": 90}}, "width": 9, "height": 9}}]}}"#
        );
        Scene::from_json(&text).unwrap().warnings
    };
    let point = |z: f64, rx: f64, half_angle: f64| {
        format!(r#""type": "point", "cs": {{"z": {z}, "rx": {rx}}}, "half_angle_deg": {half_angle}"#)
    };
    let both = "source \"S\" lies in the face \"L1.back\" and shines to both sides of it: move it by a micrometre to the side \
        that it belongs to";
    for (source, told) in [
        (point(14.0, 0.0, 180.0), Some(both)),
        (point(14.0, 0.0, 91.0), Some(both)),
        (point(14.0, 0.0, 90.0), None),
        (point(14.0, 1.0, 30.0), None),
        (point(14.0, 1.0, 40.0), Some(both)),
        (point(14.001, 0.0, 180.0), None),
    ] {
        assert_eq!(warnings(&source).first().map(String::as_str), told, "{source}");
    }
    let inward = warnings(&point(14.0, std::f64::consts::PI, 30.0));
    let expected = "source \"S\" lies in the face \"L1.back\" and shines away from it into \"N-BK7\", but is said to be in \"vacuum\"";
    assert!(inward.iter().any(|warning| warning.starts_with(expected)), "{inward:?}");
}

#[test]
fn media_without_a_second_face_and_branches_that_are_never_drawn_are_warned_of() {
    let map = r#"{"type": "irradiance", "name": "A", "cs": {"z": 90}, "width": 9, "height": 9}"#;
    let face = |name: &str, z: f64, sides: &str| {
        format!(
            r#"{{"name": "{name}", "cs": {{"z": {z}}}, "shape": {{"type": "plane", "width": 30, "height": 30}}, "interaction": "refractive", {sides}}}"#
        )
    };
    let slab = |back: &str| {
        let faces = [face("in", 30.0, r#""material_back": "SF10""#), face("out", 35.0, back)];
        format!(r#""surfaces": [{}]"#, faces.join(", "))
    };
    let lone =
        |warnings: Vec<String>| warnings.iter().any(|warning| warning.contains("alone borders on \"SF10\""));
    assert!(!lone(warnings_of(map, &slab(r#""material_front": {"type": "catalog", "name": "SF10"}"#))));
    assert!(lone(warnings_of(map, &slab(r#""material_front": null"#))));
    for (prob, missing) in
        [("0", Some("reflection")), ("1", Some("transmission")), ("0.5", None), ("\"auto\"", None)]
    {
        let found = warnings_of(map, &format!(r#""sampling": {{"reflect_prob": {prob}}}"#));
        let told =
            missing.is_some_and(|missing| found.concat().contains(&format!("no ray takes the {missing} of")));
        assert_eq!((told, found.len()), (missing.is_some(), usize::from(missing.is_some())), "{found:?}");
    }
}

#[test]
fn gaussian_beams_wider_than_their_radius_are_warned_of() {
    let of = |profile: &str| {
        let text = format!(
            r#"{{"nsq_schema_version": 1, "sources": [{{"type": "collimated", "name": "S", "cs": {{}}, "total_flux": 1,
            "aperture_radius": 3, "spectrum": {{"wavelengths": [0.5], "weights": [1]}}, {profile}}}], "components": [],
            "detectors": [{{"type": "irradiance", "name": "A", "cs": {{"z": 9}}, "width": 9, "height": 9}}]}}"#
        );
        Scene::from_json(&text).unwrap().warnings
    };
    // 32 draws beyond the radius: (e^(-R^2 / 2 sigma^2))^32, 85 % of the rays at ten times the radius.
    for (sigma, share) in [(30.0, "85"), (6.0, "1.8"), (3.9, "0.0077")] {
        let found = of(&format!(r#""profile": "gaussian", "gaussian_sigma": {sigma}"#)).concat();
        let told = format!(
            "gaussian_sigma of {sigma} mm in a radius of 3 mm: {share} % of its rays start on the rim"
        );
        assert!(found.contains(&told), "{found}");
    }
    for quiet in [
        r#""profile": "gaussian", "gaussian_sigma": 3.2"#,
        r#""profile": "gaussian""#,
        r#""profile": "tophat", "gaussian_sigma": 30"#,
    ] {
        assert_eq!(of(quiet), [""; 0], "{quiet}");
    }
}
