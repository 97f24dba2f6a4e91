//! Fluxes that rest on few rays: the bound is right as often as it says, and every table has it.
#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "clippy's exemption of tests does not reach their helpers"
)]

mod command;
mod zoo;

use command::{run, stderr};
use glam::{DMat3, DVec3};
use nsq_gpu::TraceOptions;
use nsq_gpu::model::{
    Collimated, Detector, DetectorKind, Frame, Interaction, Medium, Outline, PixelGrid, ReflectProb,
    Sampling, SceneIr, Shape, Source, SourceKind, Spectrum, Splat, Surface,
};
use nsq_gpu::program::Precision;
use serde_json::Value;
use std::path::Path;

fn at(z: f64) -> Frame {
    Frame { origin: DVec3::new(0.0, 0.0, z), rotation: DMat3::IDENTITY }
}

/// A beam of 1 W and 10 mm radius, and a detector behind a plane that takes the fraction `share` of what passes.
fn beam(plane: Interaction, share: f64) -> SceneIr {
    let medium =
        |name: &str, n| Medium { name: name.into(), ambient: name == "vacuum", n: vec![n], k: vec![0.0] };
    let width = (share * std::f64::consts::PI).sqrt() * 10.0;
    let grid = PixelGrid { width, height: width, num_pixels_x: 2, num_pixels_y: 2, splat: Splat::Hard };
    // A mirror sends the light back.
    let z = if matches!(plane, Interaction::Reflective { .. }) { -10.0 } else { 10.0 };
    SceneIr {
        wavelengths: vec![0.5],
        media: vec![medium("vacuum", 1.0), medium("glass", 1.5)],
        surfaces: vec![Surface {
            name: "plane".into(),
            frame: at(5.0),
            shape: Shape::Plane(Outline::Infinite),
            interaction: plane,
            coating: None,
            scatter: None,
            front: 0,
            back: 1,
        }],
        meshes: vec![],
        sources: vec![Source {
            name: "lamp".into(),
            frame: at(0.0),
            kind: SourceKind::Collimated(Collimated { aperture_radius: 10.0, sigma: None }),
            total_flux: 1.0,
            spectrum: Spectrum { wavelengths: vec![0], cdf: vec![1.0] },
            medium: SceneIr::VACUUM,
        }],
        detectors: vec![Detector {
            name: "rare".into(),
            frame: at(z),
            kind: DetectorKind::Irradiance(grid),
            absorb: true,
        }],
        sampling: Sampling { rr_start_flux: 0.0, ..Sampling::default() },
        scatter_sampling: Vec::new(),
        allowed: Default::default(),
    }
}

/// Rays that weigh as much as at birth, less, and by sampling more. What a symmetric error says is wrong far more often.
#[test]
fn a_bound_is_right_in_nineteen_traces_of_twenty() {
    const SEEDS: u64 = 600;
    const NUM_RAYS: u64 = 2000;
    // Three rays are expected: so the bound of no ray is just too low, and that of one is enough.
    let of_glass = 0.96;
    let mut sampled = beam(Interaction::Refractive, 2.0 * 3.0 / NUM_RAYS as f64);
    sampled.sampling.reflect_prob = ReflectProb::Constant(0.5);
    for (what, ir, truth) in [
        ("heavy", sampled, of_glass * 6.0 / NUM_RAYS as f64),
        ("plain", beam(Interaction::Refractive, 3.2 / NUM_RAYS as f64), of_glass * 3.2 / NUM_RAYS as f64),
        (
            "light",
            beam(Interaction::Reflective { reflectance: vec![0.3] }, 3.2 / NUM_RAYS as f64),
            0.3 * 3.2 / NUM_RAYS as f64,
        ),
    ] {
        let options = TraceOptions { max_depth: 4, ..zoo::options(NUM_RAYS, 0, Precision::F32) };
        let mut tracer = zoo::tracer(&ir, &options).unwrap();
        let (mut num_right, mut num_by_errors, mut num_few) = (0, 0, 0);
        for tally in zoo::tallies_of(&mut tracer, 0..SEEDS) {
            let result = zoo::result_of(&ir, &options, &tally);
            let found = &result.detectors[0];
            let error = found.total_flux_standard_error.unwrap();
            num_by_errors += u64::from(found.total_flux + 1.645 * error >= truth);
            let bound = match found.few_rays {
                Some(few) => few.upper_bound_95,
                // Of ten rays or more the normal law does.
                None => found.total_flux + 1.645 * error,
            };
            num_few += u64::from(found.few_rays.is_some());
            num_right += u64::from(bound >= truth);
        }
        println!(
            "{what}: {num_right} of {SEEDS} right, {num_by_errors} by standard errors, {num_few} of few rays"
        );
        // Three standard deviations of 600 draws of 95 % are 16.
        assert!(num_right >= 570 - 16, "{what}: {num_right}");
        assert!(num_few > 590, "{what}: {num_few}");
        assert!(num_by_errors < 520, "{what}: an error says enough, {num_by_errors}");
    }
}

const SCENE: &str = r#"{
  "nsq_schema_version": 1,
  "components": [{
    "name": "L", "type": "lens", "cs": {"z": 5},
    "config": {"r1": 1000.0, "r2": -1000.0, "thickness": 2.0, "material": "N-BK7", "front_aperture_radius": 20.0}
  }],
  "sources": [{
    "name": "lamp", "type": "collimated", "total_flux": 1.0, "aperture_radius": 10.0, "cs": {"z": -10},
    "spectrum": {"wavelengths": [0.5876], "weights": [1]}
  }],
  "detectors": [
    {"name": "rare", "type": "irradiance", "width": 0.2, "height": 0.2, "num_pixels_x": 2, "num_pixels_y": 2, "cs": {"z": 20}},
    {"name": "rest", "type": "irradiance", "width": 50, "height": 50, "num_pixels_x": 5, "num_pixels_y": 5, "cs": {"z": 30}}
  ]
}"#;

/// The scene in a folder of its own, and a place for results.
fn scene() -> (tempfile::TempDir, String, String) {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).display().to_string();
    std::fs::write(path("scene.json"), SCENE).unwrap();
    let (scene, out) = (path("scene.json"), path("out"));
    (folder, scene, out)
}

fn stdout(arguments: &[&str]) -> String {
    let output = run(arguments);
    assert!(output.status.success(), "{arguments:?}: {}", stderr(&output));
    String::from_utf8(output.stdout).unwrap()
}

fn json(text: &str) -> Value {
    serde_json::from_str(text).unwrap()
}

/// Checks an entry of a report: how many rays, and a bound between that of none and that of ten.
fn assert_few(entry: &Value, num_rays: f64) {
    let rests_on = entry["rests_on"].as_u64().unwrap_or_else(|| panic!("{entry}"));
    let bound = entry["upper_bound_95"].as_f64().unwrap();
    assert!(rests_on < 10 && (2.9..17.0).contains(&(bound * num_rays)), "{entry}");
}

/// The line of a text that begins so.
fn line<'a>(text: &'a str, start: &str) -> &'a str {
    text.lines()
        .find(|line| line.trim_start().starts_with(start))
        .unwrap_or_else(|| panic!("{start}: {text}"))
}

fn assert_line_of_few(line: &str) {
    assert!(line.contains("≤ ") && line.contains("rests on ") && line.contains(" ray"), "{line}");
}

#[test]
fn a_trace_and_what_is_made_of_it_say_what_a_flux_rests_on() {
    let (_folder, scene, out) = scene();
    let text =
        stdout(&["trace", &scene, "-n", "20000", "--standard-error", "on", "-o", &out, "--paths", "on"]);
    assert_line_of_few(line(&text, "rare "));
    assert!(!line(&text, "rest ").contains("rests on"), "{text}");
    assert!(text.contains("≤: fewer than 10 rays"), "{text}");
    assert!(line(&text, "warning: the flux of detector 'rare'").contains("below "), "{text}");
    let report = json(&std::fs::read_to_string(Path::new(&out).join("report.json")).unwrap());
    assert_few(&report["detectors"]["rare"], 20000.0);
    assert!(report["detectors"]["rest"].get("rests_on").is_none());
    assert!(report["detectors"]["rare"]["total_flux_standard_error"].is_f64(), "the old key stays");
    let rows = report["paths"].as_array().unwrap();
    let few = rows.iter().filter(|row| row["num_rays"].as_u64() < Some(10));
    assert!(few.clone().next().is_some());
    few.for_each(|row| assert_few(row, 20000.0));
    assert!(rows.iter().any(|row| row.get("rests_on").is_none()));
    // What is read back says the same.
    let read = nsq_gpu::TraceResult::read(Path::new(&out)).unwrap();
    assert_eq!(line(&read.report(), "rare "), line(&text, "rare "));
    let rests_on = read.detector("rare").unwrap().few_rays.unwrap().rests_on;
    assert_eq!(report["detectors"]["rare"]["rests_on"], rests_on);

    let paths = stdout(&["paths", &scene, "-n", "20000", "--detector", "rare"]);
    assert_line_of_few(line(&paths, "1 "));
    let table = json(&stdout(&["paths", &scene, "-n", "20000", "--detector", "rare", "--json"]));
    assert_few(&table["paths"][0], 20000.0);

    let mut parts = Vec::new();
    for first in ["0", "10000"] {
        let part = format!("{out}_{first}");
        stdout(&[
            "trace",
            &scene,
            "-n",
            "10000",
            "--first-ray",
            first,
            "--standard-error",
            "on",
            "-o",
            &part,
        ]);
        parts.push(part);
    }
    let merged = stdout(&["merge", &parts[0], &parts[1]]);
    assert_eq!(line(&merged, "rare "), line(&text, "rare "));
}

#[test]
fn differences_and_sweeps_say_what_they_rest_on() {
    let (folder, scene, _) = scene();
    let change = ["diff", &scene, "--set", "rare.width=0.3", "-n", "20000"];
    let text = stdout(&change);
    assert_line_of_few(line(&text, "rare "));
    let found = json(&stdout(&[&change[..], &["--json"]].concat()));
    assert_few(&found["detectors"]["rare"], 20000.0);
    assert!(found["totals"]["launched"].get("rests_on").is_none(), "{}", found["totals"]["launched"]);
    let large = json(&stdout(&["diff", &scene, "--set", "rare.width=8", "--json", "-n", "20000"]));
    assert!(large["detectors"]["rare"].get("rests_on").is_none(), "{}", large["detectors"]["rare"]);

    let csv = folder.path().join("points.csv").display().to_string();
    let set = ["sweep", &scene, "--set", "rare.width=0.2,8", "-n", "20000"];
    let table = stdout(&[&set[..], &["-o", &csv]].concat());
    assert!(table.contains("≤ "), "{table}");
    let document = json(&stdout(&[&set[..], &["--json"]].concat()));
    assert_few(&document["points"][0]["fluxes"]["rare"], 20000.0);
    assert!(document["points"][1]["fluxes"]["rare"].get("rests_on").is_none());
    let csv = std::fs::read_to_string(csv).unwrap();
    let rows: Vec<Vec<&str>> = csv.lines().map(|row| row.split(',').collect()).collect();
    let bound = rows[0].iter().position(|title| *title == "rare upper bound 95 % [W]").unwrap();
    assert!(!rows[1][bound].is_empty() && rows[2][bound].is_empty(), "{csv}");
}

/// A faint flux has digits, and so many that its error has two.
#[test]
fn a_sweep_prints_digits_that_mean_something() {
    let (_folder, scene, _) = scene();
    let table = stdout(&[
        "sweep",
        &scene,
        "--set",
        "lamp.total_flux=3e-8,3",
        "-n",
        "20000",
        "--standard-error",
        "on",
    ]);
    let faint: Vec<&str> = table.lines().nth(1).unwrap().split_whitespace().collect();
    assert_eq!(faint[0], "3e-8");
    let rest: f64 = faint[4].parse().unwrap();
    assert!(faint[4].ends_with("e-8") && (2.4e-8..3e-8).contains(&rest), "{table}");
    let error: f64 = faint[5].parse().unwrap();
    let digits = faint[4].split('e').next().unwrap().trim_start_matches("0.").replace('.', "").len();
    let expected = (rest.log10().floor() - error.log10().floor() + 2.0) as usize;
    assert!(digits <= expected && digits + 2 > expected, "{table}");
}

#[test]
fn nothing_is_promised_from_few_rays() {
    let (_folder, scene, _) = scene();
    let output = run(&["trace", &scene, "-n", "20000", "--target-error", "1%"]);
    assert_eq!(output.status.code(), Some(6));
    let said = stderr(&output);
    assert!(said.contains("rests on fewer than 10 rays") && !said.contains("-n"), "{said}");
    // Many rays tell how many more it takes.
    let output = run(&["trace", &scene, "-n", "2e6", "--target-error", "1%"]);
    let said = stderr(&output);
    assert!(output.status.code() == Some(6) && said.contains("give about -n"), "{said}");
}
