//! Every class of mistake is refused with its place, what is wrong and what would be right.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test fails by panicking")]

use nsq_gpu::Error;
use nsq_gpu::scene::Scene;

const SCENE: &str = r#"{
  "nsq_schema_version": 1,
  "components": [
    {"type": "lens", "name": "L1", "cs": {"z": 10.0, "reference_cs": {"x": 1.0}},
     "config": {"r1": 50.0, "r2": -50.0, "thickness": 4.0, "material": "N-BK7", "front_aperture_radius": 10.0}},
    {"type": "mirror", "name": "M", "cs": {"z": 60.0},
     "config": {"radius": -100.0, "reflectance": 0.9, "aperture_radius": 20.0}}
  ],
  "sources": [
    {"type": "collimated", "name": "S", "cs": {}, "total_flux": 2.0, "aperture_radius": 3.0,
     "spectrum": {"wavelengths": [0.4861, 0.5876], "weights": [1.0, 2.0]}},
    {"type": "point", "name": "P", "cs": {}, "total_flux": 1.0, "half_angle_deg": 30.0,
     "spectrum": {"wavelengths": [0.5876], "weights": [3.0]}}
  ],
  "detectors": [
    {"type": "irradiance", "name": "I", "cs": {}, "width": 10.0, "height": 5.0, "num_pixels_x": 64,
     "splat": "hard"},
    {"type": "spectral", "name": "W", "cs": {}, "width": 11.0, "height": 5.0, "wl_min": 0.4, "wl_max": 0.7},
    {"type": "ray_database", "name": "R", "cs": {}, "width": 12.0, "height": 2.0}
  ],
  "nsq_gpu": {
    "version": 1,
    "media": {"glass": {"type": "constant", "n": 1.5},
              "tab": {"type": "table", "wavelengths": [0.4861, 0.5876], "n": [1.5, 1.6]}},
    "surfaces": [{"name": "ball", "cs": {}, "shape": {"type": "sphere", "radius": 5.0}, "interaction": "refractive",
                  "material_back": {"type": "medium", "name": "glass"}, "bsdf": null, "coating": null}],
    "overrides": {"L1.front": {"interaction": "reflective", "reflectance": 0.5}},
    "order": ["L1", "ball", "M"],
    "detectors": {"R": {"max_rays": 10}},
    "sampling": {"reflect_prob": "auto", "split_depth": 0}
  }
}"#;

#[track_caller]
fn refusal(text: &str) -> (String, String) {
    match Scene::from_json(text) {
        Err(Error::Scene { place, problem, remedy }) => (place, format!("{problem}; {remedy}")),
        other => panic!("not refused: {other:?}"),
    }
}

/// Replaces the first `from` of the scene by `to`, and expects a refusal at `place` that says all of `gist`.
#[track_caller]
fn refused(from: &str, to: &str, place: &str, gist: &[&str]) {
    assert!(SCENE.contains(from), "the scene has no {from}");
    let (found, message) = refusal(&SCENE.replacen(from, to, 1));
    assert_eq!(found, place, "{message}");
    for words in gist {
        assert!(message.contains(words), "{message:?} does not say {words:?}");
    }
}

#[test]
fn the_scene_itself_is_valid() {
    Scene::from_json(SCENE).unwrap().lower().unwrap();
}

#[test]
fn syntax() {
    refused(r#""r1": 50.0,"#, r#""r1": 50.0"#, "line 5, column 28", &["not JSON", "commas"]);
    refused("\"detectors\": [", "\"detectors\": ", "line 18, column 5", &["not JSON"]);
    let (place, message) = refusal(&SCENE[..SCENE.len() - 1]);
    assert_eq!(place, "line 1, column 1");
    assert!(message.contains("ends before what opens here is closed"), "{message}");
    let (place, message) = refusal("{} {}");
    assert_eq!(place, "line 1, column 4", "{message}");
    let (place, _) = refusal("");
    assert_eq!(place, "line 1, column 1");
    let (place, message) = refusal("[1]");
    assert_eq!(place, "the scene file", "{message}");
}

#[test]
fn versions() {
    refused(
        r#""nsq_schema_version": 1"#,
        r#""nsq_schema_version": 2"#,
        "nsq_schema_version",
        &["version `2`", "version 1"],
    );
    refused(
        r#""nsq_schema_version": 1"#,
        r#""nsq_schema_version": "1""#,
        "nsq_schema_version",
        &["version 1"],
    );
    refused(r#""nsq_schema_version": 1,"#, "", "the scene file", &["`nsq_schema_version` is missing"]);
    refused(r#""version": 1,"#, r#""version": 7,"#, "nsq_gpu.version", &["version `7`", "version 1"]);
    refused(r#""version": 1,"#, "", "nsq_gpu", &["`version` is missing"]);
}

#[test]
fn keys() {
    let place = "components[0].config.thicknes";
    refused("thickness", "thicknes", place, &["unknown key `thicknes`", "did you mean `thickness`?"]);
    refused("\"sources\"", "\"source\"", "source", &["did you mean `sources`?"]);
    refused("reference_cs", "refrence_cs", "components[0].cs.refrence_cs", &["`reference_cs`"]);
    refused(r#""x": 1.0"#, r#""a b": 1.0"#, r#"components[0].cs.reference_cs["a b"]"#, &["unknown key"]);
    refused(
        r#""n": 1.5}"#,
        r#""n": 1.5, "m": 1}"#,
        "nsq_gpu.media.glass.m",
        &["unknown key", "did you mean `n`?"],
    );
    refused("max_rays", "max_ray", "nsq_gpu.detectors.R.max_ray", &["`max_rays`"]);
    refused(r#""thickness": 4.0, "#, "", "components[0].config", &["`thickness` is missing"]);
    refused(r#""material": "N-BK7", "#, "", "components[0].config", &["`material` is missing"]);
    let (place, message) = refusal(&SCENE.replacen("sources", &"x".repeat(1_000_000), 1));
    assert!(place.len() + message.len() < 500, "a message as long as the key");
    let twice = r#""thickness": 4.0, "thickness": 4.0"#;
    refused(r#""thickness": 4.0"#, twice, "components[0].config.thickness", &["twice"]);
}

#[test]
fn types() {
    refused(
        r#""type": "lens""#,
        r#""type": "lense""#,
        "components[0].type",
        &["\"lense\"", "did you mean `lens`?"],
    );
    refused(
        r#""type": "mirror""#,
        r#""type": "prism""#,
        "components[1].type",
        &["`lens`", "`mirror`", "`doublet`"],
    );
    refused(r#""type": "mirror", "#, "", "components[1]", &["`type` is missing", "`mirror`"]);
    refused(r#""type": "mirror""#, r#""type": 5"#, "components[1]", &["`type`"]);
    refused(
        r#""type": "sphere""#,
        r#""type": "spere""#,
        "nsq_gpu.surfaces[0].shape.type",
        &["did you mean `sphere`?"],
    );
    refused(r#""splat": "hard""#, r#""splat": "hart""#, "detectors[0].splat", &["did you mean `hard`?"]);
    refused("\"auto\"", "\"atuo\"", "nsq_gpu.sampling.reflect_prob", &["did you mean `auto`?"]);
    refused("\"auto\"", "[]", "nsq_gpu.sampling.reflect_prob", &["`fresnel`", "a number"]);
    refused(
        r#"{"type": "medium", "#,
        r#"{"type": "$object", "#,
        "nsq_gpu.surfaces[0].material_back.type",
        &["`medium`"],
    );
    refused(
        r#""thickness": 4.0"#,
        r#""thickness": "4""#,
        "components[0].config.thickness",
        &["text", "a number"],
    );
    refused(
        r#""thickness": 4.0"#,
        r#""thickness": null"#,
        "components[0].config.thickness",
        &["null", "a number"],
    );
    refused("[1.0, 2.0]", "[1.0, {}]", "sources[0].spectrum.weights[1]", &["an object", "a number"]);
    refused(
        r#""num_pixels_x": 64"#,
        r#""num_pixels_x": 6.5"#,
        "detectors[0].num_pixels_x",
        &["whole number"],
    );
    refused(r#""num_pixels_x": 64"#, r#""num_pixels_x": -1"#, "detectors[0].num_pixels_x", &["whole number"]);
    refused(r#""name": "M""#, r#""name": 3"#, "components[1].name", &["text in quotes"]);
    refused(r#""cs": {"z": 60.0}"#, r#""cs": []"#, "components[1].cs", &["an array", "an object"]);
}

#[test]
fn numbers() {
    refused(r#""thickness": 4.0"#, r#""thickness": NaN"#, "components[0].config.thickness", &["NaN"]);
    refused(r#""r1": 50.0"#, r#""r1": NaN"#, "components[0].config.r1", &["NaN"]);
    refused(
        r#""thickness": 4.0"#,
        r#""thickness": Infinity"#,
        "components[0].config.thickness",
        &["out of range"],
    );
    refused(r#""z": 60.0"#, r#""z": -Infinity"#, "components[1].cs.z", &["out of range"]);
    refused(
        r#""aperture_radius": 20.0"#,
        r#""aperture_radius": -20"#,
        "components[1].config.aperture_radius",
        &["above 0"],
    );
    refused(
        r#""aperture_radius": 20.0"#,
        r#""aperture_radius": 0"#,
        "components[1].config.aperture_radius",
        &["above 0"],
    );
    refused(
        r#""aperture_radius": 20.0"#,
        r#""aperture_radius": 1e300"#,
        "components[1].config.aperture_radius",
        &["too large"],
    );
    refused(
        r#""radius": -100.0"#,
        r#""radius": 1e-300"#,
        "components[1].config.radius",
        &["too small", "flat"],
    );
    refused(
        r#""reflectance": 0.9"#,
        r#""reflectance": 1.1"#,
        "components[1].config.reflectance",
        &["1.1", "from 0 to 1"],
    );
    refused(
        r#""half_angle_deg": 30.0"#,
        r#""half_angle_deg": 181"#,
        "sources[1].half_angle_deg",
        &["from 0 to 180"],
    );
    refused(r#""total_flux": 2.0"#, r#""total_flux": -2.0"#, "sources[0].total_flux", &["-2"]);
    refused(r#""n": 1.5}"#, r#""n": -1.5}"#, "nsq_gpu.media.glass.n", &["-1.5"]);
    refused(r#""n": 1.5}"#, r#""n": 1.5, "k": -1e-6}"#, "nsq_gpu.media.glass.k", &["-0.000001"]);
    refused("\"auto\"", "1.5", "nsq_gpu.sampling.reflect_prob", &["1.5", "from 0 to 1"]);
}

#[test]
fn spectra() {
    let place = "sources[0].spectrum.wavelengths[1]";
    refused("[0.4861, 0.5876]", "[0.4861, 587.6]", place, &["587.6 um", "divide by 1000: 0.5876"]);
    refused("[0.4861, 0.5876]", "[0.4861, 5.9e-7]", place, &["metres"]);
    refused("[0.4861, 0.5876]", "[0.4861, 0]", place, &["no wavelength"]);
    refused("[0.4861, 0.5876]", "[0.4861, -1]", place, &["no wavelength"]);
    refused("[0.4861, 0.5876]", "[]", "sources[0].spectrum.wavelengths", &["empty"]);
    refused("[0.4861, 0.5876]", "[0.5]", "sources[0].spectrum.weights", &["2 values for 1 wavelengths"]);
    refused("[1.0, 2.0]", "[1.0, -2.0]", "sources[0].spectrum.weights[1]", &["-2"]);
    refused("[1.0, 2.0]", "[0, 0]", "sources[0].spectrum.weights", &["all weights are 0"]);
    let dark = SCENE
        .replace(r#""total_flux": 2.0"#, r#""total_flux": 0"#)
        .replace(r#""total_flux": 1.0"#, r#""total_flux": 0"#);
    assert!(refusal(&dark).1.contains("no source emits"));
}

#[test]
fn detectors() {
    refused(
        r#""num_pixels_x": 64"#,
        r#""num_pixels_x": 0"#,
        "detectors[0].num_pixels_x",
        &["0 leaves nothing"],
    );
    let absurd = r#""num_pixels_x": 1e9, "num_pixels_y": 1e9"#;
    refused(r#""num_pixels_x": 64"#, absurd, "detectors[0]", &["1000000000000000000 pixels", "reduce"]);
    refused(r#""width": 10.0"#, r#""width": 0"#, "detectors[0].width", &["above 0"]);
    refused(r#""wl_max": 0.7"#, r#""wl_max": 0.4"#, "detectors[1].wl_max", &["wl_min < wl_max"]);
    refused(r#""wl_max": 0.7"#, r#""wl_max": 700"#, "detectors[1].wl_max", &["divide by 1000: 0.7"]);
    refused(r#""wl_max": 0.7"#, r#""num_bins": 0"#, "detectors[1].num_bins", &["0 leaves nothing"]);
    let blurred = r#""splat": "gaussian", "splat_sigma": 1e6"#;
    refused(r#""splat": "hard""#, blurred, "detectors[0].splat_sigma", &["from 0 to 100"]);
    refused(r#""R": {"#, r#""RR": {"#, r#"nsq_gpu.detectors.RR"#, &["no detector", "did you mean `R`?"]);
    refused(r#""R": {"#, r#""I": {"#, "nsq_gpu.detectors.I.max_rays", &["stores no rays"]);
}

#[test]
fn names() {
    refused(r#""name": "M""#, r#""name": "L1""#, "components[1].name", &["\"L1\" is taken"]);
    refused(r#""name": "ball""#, r#""name": "L1""#, "nsq_gpu.surfaces[0].name", &["\"L1\" is taken"]);
    refused(r#""name": "P""#, r#""name": "S""#, "sources[1].name", &["\"S\" is taken"]);
    refused(r#""name": "W""#, r#""name": "I""#, "detectors[1].name", &["\"I\" is taken"]);
    let endless = format!(r#""name": "{}""#, "x".repeat(70_000));
    refused(r#""name": "W""#, &endless, "detectors[1].name", &["70000 bytes", "at most 65536"]);
    refused(r#""name": "ball""#, r#""name": "L1.front""#, "nsq_gpu.surfaces", &["\"L1.front\""]);
}

/// Any text is a name, as in Optiland: files get names of their own.
#[test]
fn any_text_is_a_name() {
    for name in [
        "",
        ".",
        "..",
        "a/b",
        r"a\\b",
        "a:b",
        "i",
        "con",
        " D ",
        r"a\tb",
        r"\u0000",
        r"\u001b[2J",
        &"x".repeat(300),
    ] {
        for (place, of) in
            [(r#""name": "W""#, "detector"), (r#""name": "M""#, "mirror"), (r#""name": "P""#, "source")]
        {
            let named = SCENE.replacen(place, &format!(r#""name": "{name}""#), 1).replace(r#", "M"]"#, "]");
            let named = named.replace(r#""order": ["L1", "ball"],"#, "");
            Scene::from_json(&named).unwrap_or_else(|err| panic!("{of} {name:?}: {err}")).lower().unwrap();
        }
    }
}

#[test]
fn materials() {
    let place = "components[0].config.material";
    refused("\"N-BK7\"", "\"N-BK77\"", place, &["unknown material \"N-BK77\"", "\"N-BK7\""]);
    refused("\"N-BK7\"", r#"{"type": "catalog", "name": "no such glass"}"#, place, &["unknown material"]);
    refused(
        "\"N-BK7\"",
        r#"{"type": "medium", "name": "glas"}"#,
        place,
        &["\"glas\"", "did you mean `glass`?"],
    );
    refused("\"N-BK7\"", "5", place, &["the number 5"]);
}

#[test]
fn tables_end_where_they_end() {
    let used = SCENE.replace(r#""name": "glass"}"#, r#""name": "tab"}"#);
    Scene::from_json(&used).unwrap();
    let (place, message) = refusal(&used.replace("0.5876], \"n\"", "0.5], \"n\""));
    assert_eq!(place, "nsq_gpu.media.tab.wavelengths");
    assert!(message.contains("no value at 0.5876 um"), "{message}");
    assert!(message.contains("the table is from 0.4861 to 0.5 um"), "{message}");
    let table = r#""reflectance": {"wavelengths": [0.5876], "values": [1]}"#;
    let place = r#"nsq_gpu.overrides["L1.front"].reflectance.wavelengths"#;
    refused(r#""reflectance": 0.5"#, table, place, &["no value at 0.4861 um", "not interpolated"]);
    let twice = r#""reflectance": {"wavelengths": [0.4861, 0.4861], "values": [0, 1]}"#;
    let place = r#"nsq_gpu.overrides["L1.front"].reflectance.wavelengths[1]"#;
    refused(r#""reflectance": 0.5"#, twice, place, &["twice"]);
}

#[test]
fn solids() {
    refused(
        r#""thickness": 4.0"#,
        r#""thickness": -4.0"#,
        "components[0].config",
        &["`L1`", "increase the thickness"],
    );
    refused(
        r#""thickness": 4.0"#,
        r#""thickness": 0.5"#,
        "components[0].config",
        &["`L1`", "increase the thickness"],
    );
    let wider = r#""L1.front": {"aperture_radius": 12.0,"#;
    refused(r#""L1.front": {"#, wider, "components[0].config", &["`L1.front`", "aperture radii"]);
}

#[test]
fn surfaces() {
    let place = "nsq_gpu.surfaces[0].shape";
    let sphere = r#"{"type": "sphere", "radius": 5.0}"#;
    refused(sphere, r#"{"type": "sphere", "radius": 0}"#, &format!("{place}.radius"), &["above 0"]);
    refused(sphere, r#"{"type": "plane", "width": 1}"#, place, &["both `width` and `height`"]);
    let ring = r#"{"type": "annulus", "inner_radius": 2, "outer_radius": 2}"#;
    refused(sphere, ring, &format!("{place}.outer_radius"), &["empty"]);
    let flat = r#"{"type": "frustum", "r_front": 1, "r_back": 1, "z_front": 2, "z_back": 2}"#;
    refused(sphere, flat, &format!("{place}.z_back"), &["no height"]);
    let mirror = r#""interaction": "reflective""#;
    refused(
        r#""interaction": "refractive""#,
        mirror,
        "nsq_gpu.surfaces[0].reflectance",
        &["no reflectance", "no default"],
    );
    let no_value = r#"{"interaction": "reflective"}"#;
    let place = r#"nsq_gpu.overrides["L1.front"].reflectance"#;
    refused(r#"{"interaction": "reflective", "reflectance": 0.5}"#, no_value, place, &["no reflectance"]);
}

#[test]
fn overrides_and_order() {
    let place = r#"nsq_gpu.overrides["L1.frnt"]"#;
    refused("L1.front", "L1.frnt", place, &["no component", "did you mean `L1.front`?"]);
    refused("L1.front", "L1.rim", r#"nsq_gpu.overrides["L1.rim"]"#, &["no component"]);
    let edge = r#""L1.edge": {"aperture_radius": 1.0,"#;
    refused(r#""L1.front": {"#, edge, r#"nsq_gpu.overrides["L1.edge"].aperture_radius"#, &["no aperture"]);
    refused(r#"["L1", "ball", "M"]"#, r#"["L1", "bal", "M"]"#, "nsq_gpu.order[1]", &["\"bal\"", "`ball`"]);
    refused(r#"["L1", "ball", "M"]"#, r#"["L1", "M"]"#, "nsq_gpu.order", &["\"ball\" is missing"]);
    refused(r#"["L1", "ball", "M"]"#, r#"["L1", "L1", "ball", "M"]"#, "nsq_gpu.order[1]", &["twice"]);
}

#[test]
fn splitting_has_limits() {
    let depth = r#""split_depth": 0"#;
    refused(depth, r#""split_depth": 24"#, "nsq_gpu.sampling.split_depth", &["24", "from 0 to 23"]);
    refused(depth, r#""split_depth": -1"#, "nsq_gpu.sampling.split_depth", &["-1"]);
    refused(depth, r#""split_depth": 1.5"#, "nsq_gpu.sampling.split_depth", &["1.5"]);
    let budget = "nsq_gpu.sampling.split_budget";
    refused(depth, r#""split_budget": 0"#, budget, &["0 is out of range", "0.001"]);
    refused(depth, r#""split_budget": Infinity"#, budget, &["out of range"]);
}

#[test]
fn empty_scenes() {
    let (place, message) = refusal(r#"{"nsq_schema_version": 1}"#);
    assert_eq!((place.as_str(), message.contains("no source")), ("sources", true));
    let start = SCENE.find("\"detectors\"").unwrap();
    let end = SCENE.find("\"nsq_gpu\"").unwrap();
    let (place, message) = refusal(&format!("{}{}", &SCENE[..start], &SCENE[end..]));
    assert_eq!((place.as_str(), message.contains("no detector")), ("detectors", true));
}

#[test]
fn chains_of_coordinate_systems_are_bounded() {
    let chain =
        |depth: usize| format!("{}null{}", r#"{"x": 1, "reference_cs": "#.repeat(depth), "}".repeat(depth));
    let with = |depth| SCENE.replacen(r#""cs": {"z": 60.0}"#, &format!(r#""cs": {}"#, chain(depth)), 1);
    assert_eq!(
        Scene::from_json(&with(64)).unwrap().lower().unwrap().surfaces.last().unwrap().frame.origin.x,
        64.0
    );
    let (place, message) = refusal(&with(65));
    assert!(
        place.starts_with("components[1].cs.reference_cs.") && message.contains("longer than 64"),
        "{message}"
    );
    let (_, message) = refusal(&with(100_000));
    assert!(message.contains("nested deeper"), "{message}");
}

#[test]
fn deep_nesting_does_not_overflow_the_stack() {
    for (open, close) in [("[", "]"), ("{\"a\":", "}")] {
        let deep = open.repeat(100_000);
        assert!(refusal(&deep).1.contains("nested deeper"));
        assert!(refusal(&format!("{deep}1{}", close.repeat(100_000))).1.contains("nested deeper"));
        let (place, _) = refusal(&format!("{{}} {deep}"));
        assert_eq!(place, "line 1, column 4");
    }
}

#[test]
fn a_file_that_cannot_be_read() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.json");
    let err = Scene::from_path(&path).unwrap_err();
    assert_eq!(err.exit_code(), 2);
    std::fs::write(&path, b"{\"nsq_schema_version\": \xff}").unwrap();
    let err = Scene::from_path(&path).unwrap_err();
    assert_eq!(err.exit_code(), 3);
    assert!(err.to_string().contains("UTF-8"), "{err}");
}

/// Puts a scatter model on the first single surface.
#[track_caller]
fn refused_bsdf(model: &str, place: &str, gist: &[&str]) {
    let place = format!("nsq_gpu.surfaces[0].bsdf{place}");
    refused(r#""bsdf": null"#, &format!(r#""bsdf": {model}"#), &place, gist);
}

#[test]
fn scatter_models_without_meaning_are_refused() {
    refused_bsdf(
        r#"{"type": "lambertian", "reflectance_value": 1.2}"#,
        ".reflectance_value",
        &["1.2", "0 to 1"],
    );
    refused_bsdf(
        r#"{"type": "lambertian", "transmissive_fraction": -0.1}"#,
        ".transmissive_fraction",
        &["-0.1"],
    );
    refused_bsdf(
        r#"{"type": "harvey_shack", "b0": 0, "l0": 0.01, "s": 2}"#,
        "",
        &["scatters nothing", "b0 > 0"],
    );
    refused_bsdf(
        r#"{"type": "harvey_shack", "b0": 1, "l0": 1e-9, "s": 100}"#,
        "",
        &["scatters nothing", "larger l0"],
    );
    refused_bsdf(r#"{"type": "harvey_shack", "b0": 1, "l0": 0, "s": 2}"#, ".l0", &["out of range"]);
    refused_bsdf(
        r#"{"type": "k_correlation", "b0": 0, "B": 9, "s": 2}"#,
        "",
        &["scatters nothing", "b0 > 0"],
    );
    refused_bsdf(r#"{"type": "k_correlation", "b0": 1, "B": 0, "s": 2}"#, ".B", &["0 is out of range"]);
    refused_bsdf(
        r#"{"type": "k_correlation", "b0": 1, "B": 9, "s": -1}"#,
        ".s",
        &["-1 is out of range", "0 to 1000"],
    );
    refused_bsdf(r#"{"type": "k_correlation", "b0": 1, "b": 9, "s": 2}"#, ".b", &["unknown key `b`"]);
    refused_bsdf(
        r#"{"type": "k_correlation", "b0": 1e-300, "B": 1e12, "s": 1000}"#,
        "",
        &["scatters nothing", "smaller B"],
    );
    let half = r#""coating": null, "scatter_fraction": 1.5"#;
    refused(r#""coating": null"#, half, "nsq_gpu.surfaces[0].scatter_fraction", &["1.5"]);
}

#[test]
fn tis_without_meaning_is_refused() {
    let place = "nsq_gpu.surfaces[0].scatter_fraction";
    let tis = |bsdf: &str| format!(r#""scatter_fraction": "tis", "bsdf": {bsdf}"#);
    let null = r#""bsdf": null"#;
    refused(null, &tis("null"), place, &["the surface has none", "give a `bsdf`"]);
    refused(null, &tis(r#"{"type": "specular"}"#), place, &["`specular`", "a number from 0 to 1"]);
    let bright = r#"{"type": "harvey_shack", "b0": 500, "l0": 0.05, "s": 2}"#;
    refused(
        null,
        &tis(bright),
        place,
        &["is 28.9747", "more light than there is", "0.034513 times the height or less"],
    );
    let bright = r#"{"type": "k_correlation", "b0": 1, "B": 1, "s": 2}"#;
    refused(null, &tis(bright), place, &["is 5.056198", "0.197777 times the height or less"]);
    let table =
        r#"{"type": "tabulated", "theta_i": [0, 90], "theta_s": [0, 90], "bsdf": [[0, 0], [0.1, 0.1]]}"#;
    refused(null, &tis(table), place, &["scatters nothing at normal incidence"]);
    let table =
        r#"{"type": "tabulated", "theta_i": [5, 90], "theta_s": [0, 90], "bsdf": [[0.1, 0.1], [0.1, 0.1]]}"#;
    refused(null, &tis(table), place, &["scatters nothing at normal incidence"]);
    refused(null, &tis(r#"{"type": "lambertian", "reflectance_value": 0}"#), place, &["scatters nothing"]);
    refused(null, r#""bsdf": null, "scatter_fraction": "tiss""#, place, &["unknown value \"tiss\"", "tis"]);
}

#[test]
fn tables_without_meaning_are_refused() {
    let table = |theta_i: &str, theta_s: &str, rows: &str| {
        format!(r#"{{"type": "tabulated", "theta_i": {theta_i}, "theta_s": {theta_s}, "bsdf": {rows}}}"#)
    };
    let good = "[[0.1, 0.1], [0.1, 0.1]]";
    refused_bsdf(r#"{"type": "tabulated"}"#, "", &["either `path` or all of"]);
    refused_bsdf(
        r#"{"type": "tabulated", "path": "a.csv", "theta_i": [0, 90]}"#,
        "",
        &["either `path` or all of"],
    );
    refused_bsdf(&table("[0]", "[0, 90]", good), ".theta_i", &["1 angles are too few"]);
    refused_bsdf(&table("[0, 90]", "[90, 0]", good), ".theta_s[1]", &["ascending"]);
    refused_bsdf(&table("[0, 0]", "[0, 90]", good), ".theta_i[1]", &["each once"]);
    refused_bsdf(&table("[0, 95]", "[0, 90]", good), ".theta_i[1]", &["95", "from 0 to 90"]);
    refused_bsdf(&table("[0, 90]", "[0, 90]", "[[0.1, 0.1]]"), ".bsdf", &["1 rows for 2 angles"]);
    refused_bsdf(&table("[0, 90]", "[0, 90]", "[[0.1, 0.1], [0.1]]"), ".bsdf[1]", &["1 values for 2 angles"]);
    refused_bsdf(&table("[0, 90]", "[0, 90]", "[[0.1, 0.1], [0.1, -1]]"), ".bsdf[1][1]", &["-1"]);
    refused_bsdf(
        r#"{"type": "tabulated", "path": "no such file.csv"}"#,
        ".path",
        &["no such file.csv", "CSV"],
    );
}

/// Reads a scene whose first surface scatters by a file of this text.
fn scattering_by(text: &[u8]) -> nsq_gpu::Result<Scene> {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("scatter.csv"), text).unwrap();
    let model = r#""bsdf": {"type": "tabulated", "path": "scatter.csv"}"#;
    let scene = folder.path().join("scene.json");
    std::fs::write(&scene, SCENE.replacen(r#""bsdf": null"#, model, 1)).unwrap();
    Scene::from_path(&scene)
}

#[track_caller]
fn refused_file(text: &str, line: &str, gist: &str) {
    match scattering_by(text.as_bytes()) {
        Err(Error::Scene { place, problem, remedy }) => {
            assert_eq!(place, format!("nsq_gpu.surfaces[0].bsdf.path{line}"));
            assert!(format!("{problem}; {remedy}").contains(gist), "{problem}; {remedy}");
        }
        other => panic!("not refused: {other:?}"),
    }
}

/// As Excel writes what it calls CSV UTF-8.
#[test]
fn a_table_may_begin_with_a_byte_order_mark() {
    let table = "0,0,0.1\r\n0,90,0.2\r\n90,0,0.1\r\n90,90,0.2\r\n";
    let lowered = |text: &str| scattering_by(text.as_bytes()).unwrap().lower().unwrap();
    assert_eq!(lowered(&format!("\u{feff}{table}")), lowered(table));
    let error = scattering_by(b"# Streuung f\xfcr Wei\xdf\n0,0,0.1\n").unwrap_err().to_string();
    assert!(error.contains("bsdf.path") && error.contains("save it as UTF-8"), "{error}");
}

#[test]
fn files_that_are_no_tables_are_refused_with_their_line() {
    refused_file("0, 0, 0.1\ntheta, 1, 2\n", ", line 2", "is no row of the table");
    refused_file("# header\n0, 0\n", ", line 2", "is no row of the table");
    refused_file("0, 0, 0.1\n0, 0, 0.2\n", ", line 2", "occur twice");
    refused_file("0, 0, 0.1\n0, 120, 0.2\n", ", line 2", "from 0 to 90");
    refused_file("0, 0, 0.1\n0, 90, -0.2\n", ", line 2", "out of range");
    refused_file("0, 0, 0.1\n0, 90, 0.1\n90, 0, 0.1\n", "", "3 rows for 2 x 2 angles");
    refused_file("0, 0, 0.1\n0, 90, 0.1\n", "", "1 angles are too few");
    refused_file("", "", "0 angles are too few");
}

#[test]
fn coatings_that_give_more_than_they_get_are_refused() {
    let coating = |r: &str, t: &str| {
        format!(r#""coating": {{"type": "simple", "reflectance": {r}, "transmittance": {t}}}"#)
    };
    let place = "nsq_gpu.surfaces[0].coating";
    let null = r#""coating": null"#;
    refused(
        null,
        &coating("0.5", "0.6"),
        &format!("{place}.transmittance"),
        &["R = 0.5 and T = 0.6", "R + T <= 1"],
    );
    refused(null, &coating("-0.5", "0.6"), &format!("{place}.reflectance"), &["-0.5"]);
    let table = r#"{"wavelengths": [0.4861, 0.5876], "values": [0.2, 0.7]}"#;
    refused(null, &coating(table, "0.5"), &format!("{place}.transmittance"), &["0.5876 um"]);
    let mirror = r#""L1.front": {"coating": {"type": "simple", "reflectance": 0.1, "transmittance": 0.8}, "#;
    let place = r#"nsq_gpu.overrides["L1.front"].coating"#;
    refused(r#""L1.front": {"#, mirror, place, &["both a reflectance and a coating"]);
    // Of a mirror, too.
    let mirror = r#""L1.front": {"interaction": "reflective", "coating": {"type": "simple", "reflectance": 0.9, "transmittance": 0.5}}"#;
    let old = r#""L1.front": {"interaction": "reflective", "reflectance": 0.5}"#;
    refused(old, mirror, &format!("{place}.transmittance"), &["R = 0.9 and T = 0.5"]);
}

/// Every way in which a table of a coating can be wrong has its place and its advice.
#[test]
fn tables_of_coatings_are_checked() {
    let table = |key: &str, value: &str| {
        let mut keys = [
            ("wavelengths", "[0.4861, 0.5876, 0.6563]"),
            ("angles", "[0, 45, 90]"),
            ("reflectance", "[[0, 0, 1], [0, 0, 1], [0, 0, 1]]"),
            ("transmittance", "[[1, 1, 0], [1, 1, 0], [1, 1, 0]]"),
            ("reflectance_back", "[[0, 0, 1], [0, 0, 1], [0, 0, 1]]"),
            ("transmittance_back", "[[1, 1, 0], [1, 1, 0], [1, 1, 0]]"),
        ];
        keys.iter_mut().filter(|(known, _)| *known == key).for_each(|entry| entry.1 = value);
        let keys: Vec<String> = keys.iter().map(|(key, value)| format!(r#""{key}": {value}"#)).collect();
        format!(r#""coating": {{"type": "tabulated", {}}}"#, keys.join(", "))
    };
    for (key, value, place, said) in [
        ("angles", "[0]", ".angles", "1 angles"),
        ("angles", "[10, 45, 90]", ".angles[0]", "is 10, not 0"),
        ("angles", "[0, 45, 80]", ".angles[2]", "is 80, not 90"),
        ("angles", "[0, 120, 90]", ".angles[1]", "does not exceed"),
        ("angles", "[0, 0.01, 90]", ".angles[1]", "too close"),
        ("wavelengths", "[0.4861, 0.5876, 0.5876]", ".wavelengths[2]", "listed twice"),
        ("wavelengths", "[0.4861, 0.6, 0.7]", ".wavelengths", "0.5876 um"),
        ("reflectance", "[[0, 0, 1]]", ".reflectance", "1 rows for 3 wavelengths"),
        (
            "reflectance_back",
            "[[0, 0, 1], [0, 0], [0, 0, 1]]",
            ".reflectance_back[1]",
            "2 values for 3 angles",
        ),
        (
            "transmittance",
            "[[1, 1, 0], [1, 1.5, 0], [1, 1, 0]]",
            ".transmittance[1][1]",
            "1.5 is not between",
        ),
        (
            "transmittance_back",
            "[[1, 1, 0], [1, 1, 0.5], [1, 1, 0]]",
            ".transmittance_back[1][2]",
            "R = 1 and T = 0.5",
        ),
    ] {
        let place = format!("nsq_gpu.surfaces[0].coating{place}");
        refused(r#""coating": null"#, &table(key, value), &place, &[said]);
    }
}

/// Whoever brings a lens is told how it becomes a scene.
#[test]
fn a_lens_file_names_the_command_that_converts_it() {
    let folder = tempfile::tempdir().unwrap();
    for (name, bytes) in
        [("lens.zmx", &b"\xff\xfeV\x00"[..]), ("lens.SEQ", b"LEN NEW"), ("lens.len", b"LEN NEW")]
    {
        let path = folder.path().join(name);
        std::fs::write(&path, bytes).unwrap();
        let said = Scene::from_path(&path).unwrap_err().to_string();
        let command = format!("python -m nsq_gpu.convert {} -o scene.json", path.display());
        assert!(said.contains(&command), "{said}");
    }
}
