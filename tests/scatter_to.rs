//! Scattering that is drawn on purpose, towards targets and with probabilities of the user's: no expectation changes.
#![allow(clippy::unwrap_used, reason = "clippy's exemption of tests does not reach their helpers")]

mod command;
mod zoo;

use command::{run, stderr};
use nsq_gpu::model::SceneIr;
use nsq_gpu::program::{Precision, Sampler};
use nsq_gpu::result::{RunInfo, TraceResult};
use nsq_gpu::run::StandardError;
use nsq_gpu::{Scene, TraceOptions};
use serde_json::{Value, json};
use std::f64::consts::PI;

/// A tilted plate that scatters, and three detectors about it.
fn plate(bsdf: &Value, refracts: bool, sampling: &Value) -> Value {
    let mut surface = json!({"name": "S", "cs": {"rx": 0.4}, "shape": {"type": "plane", "aperture_radius": 20.0}, "bsdf": bsdf,
        "scatter_fraction": 0.3});
    let optics = match refracts {
        true => json!({"interaction": "refractive", "material_front": null, "material_back": "N-BK7"}),
        false => json!({"interaction": "reflective", "reflectance": 0.9}),
    };
    surface.as_object_mut().unwrap().extend(optics.as_object().unwrap().clone());
    let detector = |name: &str, cs: Value, size: f64| json!({"type": "irradiance", "name": name, "cs": cs, "width": size, "height": 0.75 * size, "num_pixels_x": 1, "num_pixels_y": 1});
    json!({"nsq_schema_version": 1, "components": [],
        "sources": [{"type": "collimated", "name": "beam", "cs": {"z": -50.0}, "aperture_radius": 5.0,
            "spectrum": {"wavelengths": [0.55], "weights": [1.0]}, "total_flux": 1.0}],
        "detectors": [
            detector("back", json!({"x": 15.0, "y": 20.0, "z": -30.0, "rx": 0.5}), 8.0),
            detector("through", json!({"x": -10.0, "y": 5.0, "z": 40.0}), 12.0),
            detector("far", json!({"y": -60.0, "z": -40.0, "rx": 0.9}), 10.0)],
        "nsq_gpu": {"version": 1, "surfaces": [surface], "sampling": sampling}})
}

/// A target of each shape, and more rays that scatter.
fn on_purpose() -> Value {
    json!({"scatter_prob": 0.6, "scatter_to": [
        {"surface": "S", "target": "back", "share": 0.3},
        {"surface": "S", "target": {"sphere": {"center": [-10.0, 5.0, 40.0], "radius": 9.0}}, "share": 0.2},
        {"surface": "S", "target": {"disk": {"center": [0.0, -60.0, -40.0], "normal": [0.0, 0.7, 0.6], "radius": 8.0}}, "share": 0.2},
        {"surface": "*", "target": {"cone": {"axis": [0.2, 0.1, -1.0], "half_angle_deg": 30.0}}, "share": 0.1}]})
}

/// Laws whose directions have a density.
fn laws() -> Vec<Value> {
    vec![
        json!({"type": "lambertian", "reflectance_value": 0.8}),
        json!({"type": "lambertian", "reflectance_value": 0.8, "transmissive_fraction": 0.4}),
        json!({"type": "harvey_shack", "b0": 10.0, "l0": 0.05, "s": 1.8, "transmissive_fraction": 0.3}),
        json!({"type": "k_correlation", "b0": 10.0, "B": 20.0, "s": 2.0}),
        json!({"type": "k_correlation", "b0": 10.0, "B": 8.0, "s": 1.5, "transmissive_fraction": 0.6}),
        json!({"type": "tabulated", "theta_i": [0.0, 45.0, 90.0], "theta_s": [0.0, 30.0, 60.0, 90.0],
            "bsdf": [[0.5, 0.3, 0.2, 0.1], [0.4, 0.3, 0.3, 0.1], [0.3, 0.2, 0.2, 0.2]], "transmissive_fraction": 0.3}),
        json!({"type": "measured", "angle_of_incidence_deg": [0.0, 50.0], "scatter_azimuth_deg": [0.0, 90.0, 180.0, 250.0, 360.0],
            "scatter_radial_deg": [0.0, 20.0, 60.0, 110.0], "tis": [0.6, 0.8], "values": [
                [[3.0, 1.0, 0.4, 0.1], [3.0, 0.5, 0.2, 0.1], [3.0, 2.0, 0.4, 0.2], [3.0, 0.2, 0.1, 0.0], [3.0, 1.0, 0.4, 0.1]],
                [[2.0, 1.0, 0.4, 0.1], [2.0, 0.5, 0.2, 0.1], [2.0, 2.0, 0.4, 0.2], [2.0, 0.2, 0.1, 0.0], [2.0, 1.0, 0.4, 0.1]]]}),
    ]
}

fn path_in(folder: &tempfile::TempDir, name: &str) -> String {
    folder.path().join(name).display().to_string()
}

fn written(folder: &tempfile::TempDir, name: &str, text: &str) -> String {
    std::fs::write(folder.path().join(name), text).unwrap();
    path_in(folder, name)
}

fn lowered(scene: &Value) -> SceneIr {
    Scene::from_json(&scene.to_string()).unwrap().lower().unwrap()
}

fn options(num_rays: u64, seed: u64, precision: Precision) -> TraceOptions {
    TraceOptions { standard_error: StandardError::On, ..zoo::options(num_rays, seed, precision) }
}

/// Flux and standard error of each detector.
fn fluxes(ir: &SceneIr, options: &TraceOptions) -> Vec<[f64; 2]> {
    let tally = zoo::trace(ir, options);
    let run = RunInfo { num_rays: options.num_rays, ..RunInfo::default() };
    let result = TraceResult::new(ir, &run, &tally).unwrap();
    assert_eq!(result.ledger.imbalance_quanta, 0, "the ledger closes");
    let of = |detector: &nsq_gpu::result::Detector| {
        [detector.total_flux, detector.total_flux_standard_error.unwrap_or(0.0)]
    };
    result.detectors.iter().map(of).collect()
}

/// Of every law, on both sides of mirrors and of glass, in three tiers and with Sobol points: what detectors record is what
/// plain rays bring.
#[test]
fn what_is_drawn_on_purpose_is_what_plain_rays_bring() {
    for law in zoo::in_turn(laws()) {
        for refracts in [false, true] {
            let [plain, aimed] =
                [json!({}), on_purpose()].map(|sampling| lowered(&plate(&law, refracts, &sampling)));
            let expected = fluxes(&plain, &options(500_000, 7, Precision::F64));
            for (precision, sampler) in [
                (Precision::F32, Sampler::Pcg),
                (Precision::Df64, Sampler::Pcg),
                (Precision::F64, Sampler::Pcg),
                (Precision::F64, Sampler::Sobol),
            ] {
                let found = fluxes(&aimed, &TraceOptions { sampler, ..options(30_000, 3, precision) });
                for (detector, (found, expected)) in found.iter().zip(&expected).enumerate() {
                    let error = found[1].hypot(expected[1]);
                    let off = (found[0] - expected[0]).abs();
                    assert!(
                        off <= 4.5 * error,
                        "{law} {precision:?} {sampler:?} detector {detector}: {found:?}, by plain rays {expected:?}"
                    );
                }
            }
        }
    }
}

/// A wrong density is seen: shares that the shader does not have.
#[test]
fn a_wrong_share_is_seen() {
    let law = &laws()[0];
    let plain = fluxes(&lowered(&plate(law, false, &json!({}))), &options(2_000_000, 7, Precision::F64));
    let mut aimed = lowered(&plate(law, false, &on_purpose()));
    // Twice the light scatters than was asked for.
    aimed.surfaces[0].scatter.as_mut().unwrap().fraction = 0.33;
    let found = fluxes(&aimed, &options(200_000, 3, Precision::F64));
    let off = (found[0][0] - plain[0][0]) / found[0][1].hypot(plain[0][1]);
    assert!(off > 4.5, "{off} standard errors");
}

/// Facets of a painted ball scatter towards detectors as they do without targets.
#[test]
fn facets_scatter_towards_targets() {
    const RINGS: u32 = 8;
    const AROUND: u32 = 12;
    let mut vertices = vec![[0.0, 0.0, 5.0]];
    for i in 1..RINGS {
        let polar = PI * f64::from(i) / f64::from(RINGS);
        vertices.extend((0..AROUND).map(|j| {
            let turn = 2.0 * PI * f64::from(j) / f64::from(AROUND);
            [5.0 * polar.sin() * turn.cos(), 5.0 * polar.sin() * turn.sin(), 5.0 * polar.cos()]
        }));
    }
    vertices.push([0.0, 0.0, -5.0]);
    let (ring, last) = (|i: u32, j: u32| 1 + (i - 1) * AROUND + j % AROUND, vertices.len() as u32 - 1);
    let mut faces = Vec::new();
    for j in 0..AROUND {
        faces.extend([[0, ring(1, j), ring(1, j + 1)], [last, ring(RINGS - 1, j + 1), ring(RINGS - 1, j)]]);
        for i in 1..RINGS - 1 {
            let (a, b) = (ring(i, j), ring(i + 1, j + 1));
            faces.extend([[a, ring(i + 1, j), b], [a, b, ring(i, j + 1)]]);
        }
    }
    let scene = |law: &Value, sampling: &Value| {
        lowered(&json!({"nsq_schema_version": 1, "components": [],
            "sources": [{"type": "collimated", "name": "beam", "cs": {"x": 1.5, "z": -40.0}, "aperture_radius": 6.0, "total_flux": 1.0,
                "spectrum": {"wavelengths": [0.55], "weights": [1.0]}}],
            "detectors": [
                {"type": "irradiance", "name": "eye", "cs": {"y": 40.0, "z": -30.0, "rx": PI / 3.0}, "width": 3.0, "height": 3.0,
                    "num_pixels_x": 1, "num_pixels_y": 1},
                {"type": "irradiance", "name": "side", "cs": {"x": 30.0, "ry": PI / 2.0}, "width": 8.0, "height": 8.0,
                    "num_pixels_x": 1, "num_pixels_y": 1}],
            "nsq_gpu": {"version": 1, "sampling": sampling, "surfaces": [{"name": "ball", "cs": {},
                "shape": {"type": "mesh", "vertices": vertices, "faces": faces}, "interaction": "reflective", "reflectance": 0.8,
                "bsdf": law, "scatter_fraction": 0.6}]}}))
    };
    let aimed = json!({"scatter_prob": 0.8, "scatter_to": [{"surface": "ball", "target": "eye", "share": 0.4},
        {"surface": "ball", "target": "side", "share": 0.3}]});
    for law in [&laws()[0], &laws()[6]] {
        let expected = fluxes(&scene(law, &json!({})), &options(1_000_000, 3, Precision::F64));
        for precision in [Precision::F32, Precision::F64] {
            let found = fluxes(&scene(law, &aimed), &options(100_000, 5, precision));
            for (found, expected) in found.iter().zip(&expected) {
                let error = found[1].hypot(expected[1]);
                assert!(
                    (found[0] - expected[0]).abs() < 4.5 * error,
                    "{law}: {found:?}, by plain rays {expected:?}"
                );
            }
            assert!(found[0][1] / found[0][0] < 0.02, "{law}: {found:?}");
        }
    }
}

/// 95 % intervals of what detectors record hold the mean over 400 seeds in 92 to 98 % of all seeds.
#[test]
fn intervals_hold_as_often_as_they_say() {
    const SEEDS: u64 = 400;
    let mut held = Vec::new();
    for law in laws() {
        let ir = lowered(&plate(&law, false, &on_purpose()));
        let options = options(4000, 1, Precision::F64);
        let mut tracer = zoo::tracer(&ir, &options).unwrap();
        let found: Vec<TraceResult> = zoo::tallies_of(&mut tracer, 100..100 + SEEDS)
            .map(|tally| zoo::result_of(&ir, &options, &tally))
            .collect();
        for detector in 0..ir.detectors.len() {
            let of = || found.iter().map(|result| &result.detectors[detector]);
            if of().any(|detector| detector.num_rays_hit < 100) {
                continue;
            }
            let mean = of().map(|detector| detector.total_flux).sum::<f64>() / SEEDS as f64;
            let holds = |detector: &&nsq_gpu::result::Detector| {
                (detector.total_flux - mean).abs() < 1.96 * detector.total_flux_standard_error.unwrap()
            };
            held.push(of().filter(holds).count() as f64 / SEEDS as f64);
        }
    }
    let mean = held.iter().sum::<f64>() / held.len() as f64;
    assert!(held.len() >= laws().len(), "{held:?}");
    assert!(
        held.iter().all(|share| (0.92..=0.98).contains(share)) && (mean - 0.95).abs() < 0.01,
        "{mean}: {held:?}"
    );
}

/// A small Lambertian patch lights a square in front of it by its configuration factor, whatever share of the rays goes there
/// (Siegel and Howell, Thermal Radiation Heat Transfer: a plane element to a parallel rectangle, with a corner above it). A beam
/// that a tiny mirror folds lights the patch.
#[test]
fn a_square_gets_its_form_factor() {
    let scene = |share: Option<f64>| {
        let to = share
            .map_or(json!([]), |share| json!([{"surface": "paint", "target": "square", "share": share}]));
        json!({"nsq_schema_version": 1, "components": [],
            "sources": [{"type": "collimated", "name": "beam", "cs": {"x": -50.0, "ry": PI / 2.0}, "aperture_radius": 1e-3,
                "spectrum": {"wavelengths": [0.55], "weights": [1.0]}, "total_flux": 1.0}],
            "detectors": [{"type": "irradiance", "name": "square", "cs": {"z": -100.0}, "width": 4.0, "height": 4.0,
                "num_pixels_x": 1, "num_pixels_y": 1}],
            "nsq_gpu": {"version": 1, "sampling": {"scatter_to": to}, "surfaces": [
                {"name": "fold", "cs": {"ry": -PI / 4.0}, "shape": {"type": "plane", "aperture_radius": 0.003},
                    "interaction": "reflective", "reflectance": 1.0},
                {"name": "paint", "cs": {"z": 30.0}, "shape": {"type": "plane", "aperture_radius": 5.0},
                    "interaction": "reflective", "reflectance": 1.0, "bsdf": {"type": "lambertian"}}]}})
    };
    // Of four squares of side a at a height h: F = 4 / (2 pi) 2 X / sqrt(1 + X^2) atan(X / sqrt(1 + X^2)), X = a / h.
    let x: f64 = 2.0 / 130.0;
    let root = (1.0 + x * x).sqrt();
    let expected = 4.0 / (2.0 * PI) * 2.0 * (x / root) * (x / root).atan();
    for share in [0.2, 0.5, 0.9] {
        let [[flux, error]] = fluxes(&lowered(&scene(Some(share))), &options(100_000, 1, Precision::F64))[..]
        else {
            panic!("one detector")
        };
        // The mirror hides 0.003 % of the square.
        assert!(
            (flux / expected - 1.0).abs() < 4.0 * error / flux + 1e-4,
            "{share}: {flux} ± {error}, {expected}"
        );
        assert!(error / flux < 0.01, "{share}: {error} of {flux}");
    }
    let [[_, error]] = fluxes(&lowered(&scene(None)), &options(100_000, 1, Precision::F64))[..] else {
        panic!()
    };
    assert!(error / expected > 0.1, "plain rays are worth less: {error}");
}

/// A mirror's far side gets no ray, although a target lies there: what would have no weight ends at the mirror.
#[test]
fn rays_without_weight_end() {
    let scene = json!({"nsq_schema_version": 1, "components": [],
        "sources": [{"type": "collimated", "name": "beam", "cs": {"z": 10.0, "rx": PI}, "aperture_radius": 1.0, "total_flux": 1.0,
            "spectrum": {"wavelengths": [0.55], "weights": [1.0]}}],
        "detectors": [{"type": "irradiance", "name": "behind", "cs": {"z": -10.0}, "width": 4.0, "height": 4.0,
            "num_pixels_x": 1, "num_pixels_y": 1}],
        "nsq_gpu": {"version": 1, "sampling": {"scatter_to": [{"surface": "paint", "target": "behind", "share": 0.5}]},
            "surfaces": [{"name": "paint", "cs": {}, "shape": {"type": "plane", "aperture_radius": 5.0},
                "interaction": "reflective", "reflectance": 1.0, "bsdf": {"type": "lambertian"}}]}});
    let tally = zoo::trace(&lowered(&scene), &zoo::options(10_000, 1, Precision::F32));
    assert_eq!(tally.detectors[0].hits.iter().sum::<u64>(), 0);
}

/// No weight is more than 1 / (1 - shares) times the plain one: here f / P times that.
#[test]
fn weights_are_bounded() {
    for law in laws() {
        let scene = plate(&law, false, &on_purpose());
        let mut scene = scene;
        scene["detectors"] = json!([{"type": "ray_database", "name": "all", "cs": {"z": -100.0}, "width": 1e6, "height": 1e6}]);
        scene["nsq_gpu"]["sampling"]["scatter_to"].as_array_mut().unwrap().remove(0);
        let ir = lowered(&scene);
        let tally = zoo::trace(&ir, &zoo::options(100_000, 5, Precision::F64));
        let result =
            TraceResult::new(&ir, &RunInfo { num_rays: 100_000, ..RunInfo::default() }, &tally).unwrap();
        let nsq_gpu::result::DetectorData::RayDatabase(rays) = &result.detectors[0].data else { panic!() };
        let weight = rays.columns().unwrap().flux.iter().fold(0.0_f64, |most, flux| most.max(*flux)) * 1e5;
        // Reflectance 0.9; a tabulated law weighs up to pi 0.5.
        let most = (0.9 * (0.3 / 0.6) / 0.5 * f64::max(1.0, PI * 0.5)).max(0.9 * 0.7 / 0.4);
        assert!(weight > 0.5 && weight <= most * (1.0 + 1e-9), "{law}: {weight} of {most}");
    }
}

/// What cannot be is refused where it stands, with what would be right.
#[test]
fn what_cannot_be_is_named() {
    let refused = |sampling: Value| {
        let scene = plate(&laws()[0], false, &sampling);
        Scene::from_json(&scene.to_string()).and_then(|scene| scene.lower()).unwrap_err().to_string()
    };
    for (sampling, said) in [
        (
            json!({"scatter_prob": 1.0}),
            "nsq_gpu.sampling.scatter_prob: the probability 1 leaves one branch undrawn",
        ),
        (json!({"scatter_prob": {"T": 0.5}}), "`T` is no surface; these scatter: `S`"),
        (
            json!({"scatter_to": [{"surface": "S", "target": "bakc"}]}),
            "scatter_to[0].target: `bakc` is no detector and no surface",
        ),
        (
            json!({"scatter_to": [{"surface": "S", "target": "back", "share": 1.0}]}),
            "scatter_to[0].share: the share 1",
        ),
        (json!({"scatter_to": [{"surface": "S", "target": {}}]}), "the target has no shape"),
        (
            json!({"scatter_to": [{"surface": "S", "target": {"cone": {"axis": [0, 0, 0], "half_angle_deg": 5}}}]}),
            "a cone has an axis",
        ),
        (
            json!({"scatter_to": [{"surface": "S", "target": "back", "share": 0.6}, {"surface": "*", "target": "far", "share": 0.5}]}),
            "shares of 1.1 together",
        ),
        (json!({"scatter_to": [{"surface": "S", "targt": "back"}]}), "targt"),
    ] {
        let text = refused(sampling.clone());
        assert!(text.contains(said), "{sampling}: {text}");
    }
    let mirror = plate(
        &json!({"type": "specular"}),
        false,
        &json!({"scatter_to": [{"surface": "S", "target": "back"}]}),
    );
    let error = Scene::from_json(&mirror.to_string()).unwrap().lower().unwrap_err().to_string();
    assert!(error.contains("as a mirror does"), "{error}");
}

/// By the command: options take the place of the file's, a proof and a checkpoint know them, derivatives refuse them.
#[test]
fn the_command_draws_on_purpose() {
    let folder = tempfile::tempdir().unwrap();
    let scene = written(&folder, "plate.json", &plate(&laws()[0], false, &json!({})).to_string());
    let [done, sums] = ["done", "sums.bin"].map(|name| path_in(&folder, name));
    let aimed = ["--scatter-to", "S=back:0.4", "--scatter-prob", "S=0.5"];
    let trace = |more: &[&str]| {
        run(&[&["trace", &scene, "-n", "20000", "--precision=f64"], &aimed[..], more].concat())
    };
    let output = trace(&["-o", &done, "--proof", "--no-pictures"]);
    assert!(output.status.success(), "{}", stderr(&output));
    let verified = run(&["verify", &done]);
    assert!(
        verified.status.success() && String::from_utf8_lossy(&verified.stdout).contains("proven"),
        "{}",
        stderr(&verified)
    );
    let begun = trace(&["--checkpoint", &sums, "-o", &path_in(&folder, "begun"), "--no-pictures"]);
    assert!(begun.status.success(), "{}", stderr(&begun));
    let other = run(&["trace", &scene, "-n", "20000", "--precision=f64", "--resume", &sums]);
    assert!(stderr(&other).contains("sampling"), "{}", stderr(&other));
    for (more, said) in [
        (&["--scatter-to", "S=bakc"][..], "--scatter-to S=bakc: `bakc` is no detector and no surface"),
        (&["--scatter-to", "S"][..], "names no target"),
        (&["--scatter-prob", "S=2"][..], "--scatter-prob: the probability 2"),
        (&["--scatter-to", "S=back", "--gradient", "back.z"][..], "rays that scatter on purpose"),
    ] {
        let output = run(&[&["trace", &scene, "-n", "100"], more].concat());
        assert!(!output.status.success() && stderr(&output).contains(said), "{more:?}: {}", stderr(&output));
    }
}

/// A parabola's scatter in its field: PST / b0 is the solid angle of the mirror times the lobe's height at x / f, to first order
/// (an angle of scattering a sends light to x = f a, and a beam of E0 brings f b0 Omega to the image).
#[test]
fn a_parabola_scatters_into_its_field() {
    const B0: f64 = 0.01;
    let scene = json!({"nsq_schema_version": 1,
        "components": [{"type": "mirror", "name": "M", "cs": {},
            "config": {"radius": -2000.0, "conic": -1.0, "reflectance": 1.0, "aperture_radius": 125.0}}],
        "sources": [{"type": "collimated", "name": "star", "cs": {"z": -1100.0}, "aperture_radius": 125.0,
            "spectrum": {"wavelengths": [0.55], "weights": [1.0]}, "total_flux": 1.0}],
        "detectors": [{"type": "irradiance", "name": "image", "cs": {"x": 10.0, "z": -1000.0}, "width": 0.4, "height": 0.4,
            "num_pixels_x": 1, "num_pixels_y": 1, "absorb": false}],
        "nsq_gpu": {"version": 1,
            "overrides": {"M.surface": {"bsdf": {"type": "k_correlation", "b0": B0, "B": 100.0, "s": 1.5}, "scatter_fraction": "tis"}},
            "sampling": {"scatter_prob": 0.9, "scatter_to": [{"surface": "M.surface", "target": "image", "share": 0.9}]}}});
    let folder = tempfile::tempdir().unwrap();
    let file = written(&folder, "parabola.json", &scene.to_string());
    // A source that lies towards +x by 0.01 rad comes to a focus 10 mm towards -x, which is 20 mm from the detector.
    let turned = 0.01_f64.atan().to_degrees();
    let output = run(&[
        "pst",
        &file,
        "--detector",
        "image",
        "--source",
        "star",
        "--pivot",
        "0,0,0",
        "--angles",
        &format!("0,{turned}"),
        "-n",
        "4e5",
        "--json",
    ]);
    assert!(output.status.success(), "{}", stderr(&output));
    let document: Value = serde_json::from_slice(&output.stdout).unwrap();
    let omega = PI * 0.125_f64.powi(2);
    let mut checked = 0;
    for point in document["points"].as_array().unwrap() {
        let scattered = point["by_order"][1]["pst"].as_f64().unwrap() / B0;
        let offset = if point["angle_deg"] == 0.0 { 10.0 } else { 20.0 };
        let expected = omega * (1.0 + (100.0 * offset / 1000.0_f64).powi(2)).powf(-0.75);
        let error = point["by_order"][1]["standard_error"].as_f64().unwrap() / B0;
        let off = (scattered - expected).abs();
        assert!(off < 0.02 * expected + 3.0 * error, "{point}: {scattered} ± {error}, expected {expected}");
        assert!(error < 0.02 * expected, "{point}");
        let by_mirror = point["by_first_scatterer"]["M.surface"]["pst"].as_f64().unwrap() / B0;
        assert!((by_mirror / scattered - 1.0).abs() < 1e-9, "{point}");
        checked += 1;
    }
    assert_eq!(checked, 2);
}

/// Which surfaces a source lights and a detector sees: a white wall in the light and in view, one in the light alone, one in view
/// alone, and one that is neither.
#[test]
fn surfaces_are_lit_and_seen() {
    let wall = |name: &str, x: f64, z: f64, ry: f64| {
        json!({"name": name, "cs": {"x": x, "z": z, "ry": ry}, "shape": {"type": "plane", "width": 14.0, "height": 14.0},
            "interaction": "reflective", "reflectance": 0.5, "bsdf": {"type": "lambertian"}})
    };
    let scene = json!({"nsq_schema_version": 1, "components": [],
        "sources": [{"type": "collimated", "name": "beam", "cs": {"z": -100.0}, "aperture_radius": 4.0,
            "spectrum": {"wavelengths": [0.55], "weights": [1.0]}, "total_flux": 2.0}],
        "detectors": [{"type": "irradiance", "name": "sensor", "cs": {"x": 60.0, "ry": PI / 2.0}, "width": 10.0, "height": 10.0,
            "num_pixels_x": 1, "num_pixels_y": 1}],
        "nsq_gpu": {"version": 1, "surfaces": [
            wall("both", 0.0, 0.0, -PI / 4.0), wall("seen", 90.0, 0.0, PI / 2.0), wall("neither", -200.0, 300.0, 0.0)]}});
    let folder = tempfile::tempdir().unwrap();
    let file = written(&folder, "walls.json", &scene.to_string());
    let output = run(&[
        "surfaces",
        &file,
        "--detector",
        "sensor",
        "-n",
        "50000",
        "--json",
        "--scatter-to",
        "both=sensor",
    ]);
    assert!(output.status.success(), "{}", stderr(&output));
    let document: Value = serde_json::from_slice(&output.stdout).unwrap();
    let of = |name: &str, key: &str| {
        let all = document["surfaces"].as_array().unwrap();
        all.iter().find(|surface| surface["name"] == name).unwrap()[key].as_f64().unwrap()
    };
    assert!((of("both", "receives") - 2.0).abs() < 1e-9, "{document}");
    assert!(of("both", "seen") > 0.0 && of("seen", "seen") > 0.0, "{document}");
    assert_eq!([of("seen", "receives"), of("neither", "receives")], [0.0; 2], "{document}");
    assert!(of("neither", "seen") < 1e-3, "{document}");
    // A wall that fills a solid angle of the sensor: E = 0.5 * 2 W / pi * cos / d^2 over 1 cm^2, to a tenth.
    let sends = of("both", "sends");
    let expected = 0.5 * 2.0 / PI * (PI / 4.0).cos() / 3600.0 * 100.0;
    assert!((sends / expected - 1.0).abs() < 0.1, "{sends} W, expected {expected} W");
    assert_eq!(document["surfaces"][0]["name"], "both");
}
