//! Rays of files as sources: what a trace launches is what the file holds, and what a trace records another one goes on with.
#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "clippy's exemption of tests does not reach their helpers"
)]

mod command;
mod zoo;

use crate::zoo::forced::Asked;
use command::{run, stderr};
use nsq_gpu::model::SceneIr;
use nsq_gpu::model::sources::rays::MOST_RAYS;
use nsq_gpu::program::Precision;
use nsq_gpu::result::DetectorData;
use nsq_gpu::scene::ray_files::{FluxKind, Ray, RayFile, Tm25Labels, Tm25Writer, Wavelengths};
use nsq_gpu::{Scene, TraceOptions, TraceResult};
use serde_json::{Value, json};
use std::f64::consts::PI;
use std::fs::File;
use std::path::Path;

/// Rays from a dome of 2 mm, two wavelengths, with uneven fluxes and directions that lean to +x.
fn dome(num_rays: u32) -> Vec<Ray> {
    let mut state = 7_u64;
    let mut next = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 11) as f64 / (1_u64 << 53) as f64
    };
    (0..num_rays)
        .map(|i| {
            let (cosine, turn) = (next(), 2.0 * PI * next());
            let sine = (1.0 - cosine * cosine).sqrt();
            let place = [sine * turn.cos(), sine * turn.sin(), cosine];
            let lean = [place[0] + 0.3, place[1], place[2] + 0.4];
            let length = lean.iter().map(|x| x * x).sum::<f64>().sqrt();
            // As f32, which the file holds.
            let rounded = |x: f64| f64::from(x as f32);
            Ray {
                position: place.map(|x| rounded(2.0 * x)),
                direction: lean.map(|x| rounded(x / length)),
                flux: rounded(if i % 7 == 0 { 8.0 } else { next() }),
                wavelength: Some(if i % 3 == 0 { 0.45 } else { 0.6 }),
            }
        })
        .collect()
}

fn write(path: &Path, rays: &[Ray], wavelengths: Wavelengths) {
    let labels = Tm25Labels {
        flux_kind: FluxKind::Radiant,
        wavelengths,
        name: "dome".into(),
        software: "test".into(),
        date: String::new(),
    };
    let mut file = Tm25Writer::new(File::create(path).unwrap(), labels).unwrap();
    rays.iter().for_each(|ray| file.push(ray).unwrap());
    file.finish().unwrap();
}

fn scene(source: &Value, detectors: &Value) -> Value {
    let mut lamp = json!({"type": "rays", "name": "dome", "cs": {},
        "spectrum": {"wavelengths": [0.45, 0.6], "weights": [1.0, 1.0]}});
    for (key, value) in source.as_object().unwrap() {
        lamp[key] = value.clone();
    }
    json!({"nsq_schema_version": 1, "components": [], "sources": [lamp], "detectors": detectors})
}

fn read(folder: &Path, scene: &Value) -> nsq_gpu::Result<Scene> {
    let path = folder.join("scene.json");
    std::fs::write(&path, scene.to_string()).unwrap();
    Scene::from_path(&path)
}

fn lowered(folder: &Path, scene: &Value) -> SceneIr {
    read(folder, scene).unwrap().lower().unwrap()
}

fn traced(ir: &SceneIr, num_rays: u64, precision: Precision) -> TraceResult {
    zoo::result(ir, &TraceOptions { min_flux_fraction: 0.0, ..zoo::options(num_rays, 5, precision) })
}

/// Pixels on a screen above the dome get the light of those rays of the file that go there: by wavelength, in every tier. A large
/// file stays on its disk.
#[test]
fn a_trace_launches_the_rays_of_the_file() {
    launches_the_rays_of(5000);
    launches_the_rays_of(MOST_RAYS as u32 + 5000);
}

fn launches_the_rays_of(num_in_file: u32) {
    let folder = tempfile::tempdir().unwrap();
    let rays = dome(num_in_file);
    write(&folder.path().join("dome.tm25ray"), &rays, Wavelengths::PerRay);
    let screen = json!([{"type": "spectral", "name": "screen", "cs": {"z": 10.0}, "width": 30.0, "height": 30.0,
        "num_pixels_x": 5, "num_pixels_y": 5, "num_bins": 2, "wl_min": 0.4, "wl_max": 0.65, "splat": "hard"}]);
    let ir = lowered(folder.path(), &scene(&json!({"file": "dome.tm25ray", "scale": 2.0}), &screen));
    let all: f64 = rays.iter().map(|ray| ray.flux).sum();
    assert!((ir.emitted_flux() / all - 1.0).abs() < 1e-9, "{} of {all}", ir.emitted_flux());
    let mut expected = [[[0.0; 2]; 5]; 5];
    for ray in &rays {
        let path = (10.0 - 2.0 * ray.position[2]) / ray.direction[2];
        let [x, y] = [0, 1].map(|axis| 2.0 * ray.position[axis] + path * ray.direction[axis]);
        let [i, j] = [x, y].map(|x| ((x + 15.0) / 6.0).floor());
        if path > 0.0 && (0.0..5.0).contains(&i) && (0.0..5.0).contains(&j) {
            expected[j as usize][i as usize][usize::from(ray.wavelength == Some(0.6))] += ray.flux / all;
        }
    }
    let num_rays = 200_000;
    for precision in [Precision::F32, Precision::Df64, Precision::F64] {
        let tally = zoo::trace(&ir, &zoo::options(num_rays, 3, precision));
        let launched = tally.launched.quanta as f64;
        for (cell, quanta) in tally.detectors[0].quanta.iter().enumerate() {
            // Bins of a pixel lie side by side.
            let share = expected[cell / 10][cell / 2 % 5][cell % 2];
            let sigma = (share * (1.0 - share) / num_rays as f64).sqrt();
            let found = *quanta as f64 / launched;
            // A ray on the edge of a pixel may fall to either side.
            assert!(
                (found - share).abs() < 4.5 * sigma + 2e-4,
                "{precision:?}, {cell}: {found}, not {share} ± {sigma}"
            );
        }
    }
}

/// A lamp, a lens; the rays behind the lens recorded; and the rest of the way from there, by both formats. It brings what the whole
/// trace brings.
#[test]
fn a_chain_is_the_whole() {
    let folder = tempfile::tempdir().unwrap();
    let wall = json!({"type": "irradiance", "name": "wall", "cs": {"z": 300.0}, "width": 60.0, "height": 60.0, "num_pixels_x": 4,
        "num_pixels_y": 4, "splat": "hard"});
    let plane =
        json!({"type": "ray_database", "name": "plane", "cs": {"z": 60.0}, "width": 100.0, "height": 100.0});
    let first = |detectors: Value| {
        json!({"nsq_schema_version": 1,
            "components": [{"type": "lens", "name": "L", "cs": {"z": 40.0}, "config": {"r1": 40.0, "r2": -60.0, "thickness": 8.0,
                "front_aperture_radius": 15.0, "material": "N-BK7"}}],
            "sources": [{"type": "point", "name": "lamp", "cs": {}, "half_angle_deg": 20.0, "total_flux": 2.0,
                "spectrum": {"wavelengths": [0.45, 0.6], "weights": [1.0, 2.0]}}],
            "detectors": detectors})
    };
    let place = |name: &str| folder.path().join(name).display().to_string();
    std::fs::write(place("first.json"), first(json!([plane])).to_string()).unwrap();
    let out = run(&[
        "trace",
        &place("first.json"),
        "-n",
        "40000",
        "-o",
        &place("out"),
        "--rays-out",
        &place("plane.tm25ray"),
    ]);
    assert!(out.status.success(), "{}", stderr(&out));
    // What is there stays.
    let again = run(&["trace", &place("first.json"), "-n", "1000", "--rays-out", &place("plane.tm25ray")]);
    assert!(!again.status.success() && stderr(&again).contains("exists"), "{}", stderr(&again));
    let whole = traced(&lowered(folder.path(), &first(json!([wall]))), 400_000, Precision::F64);
    let DetectorData::Irradiance(whole) = &whole.detectors[0].data else { panic!() };
    for file in ["plane.tm25ray", "out/plane.npz"] {
        let rest = scene(&json!({"file": file}), &json!([wall]));
        let rest = traced(&lowered(folder.path(), &rest), 400_000, Precision::F64);
        let DetectorData::Irradiance(rest) = &rest.detectors[0].data else { panic!() };
        let pixel = 15.0 * 15.0;
        for (found, expected) in rest.irradiance.iter().zip(&whole.irradiance) {
            let share = expected * pixel / 2.0;
            // The errors of 40,000 recorded rays, and of 400,000 rays twice. One recorded ray may lie in a dark pixel.
            let least = share.max(1.0 / 40_000.0);
            let sigma = (least * (1.0 - share) * (1.0 / 40_000.0 + 2.0 / 400_000.0)).sqrt();
            let off = (found - expected) * pixel / 2.0;
            assert!(off.abs() < 4.5 * sigma + 1e-6, "{file}: {off} ± {sigma} of {share}");
        }
    }
    let written = RayFile::open(&folder.path().join("plane.tm25ray")).unwrap();
    assert_eq!(written.header().wavelengths, Wavelengths::PerRay);
}

/// Rays of equal flux that are taken in order: each launches once, twice, and so on, whatever the batches are, and paths are found
/// again.
#[test]
fn in_order_each_ray_is_taken_as_often() {
    let folder = tempfile::tempdir().unwrap();
    let rays: Vec<Ray> = dome(6000).into_iter().map(|ray| Ray { flux: 0.5, ..ray }).collect();
    write(&folder.path().join("dome.tm25ray"), &rays, Wavelengths::PerRay);
    let screen = json!([{"type": "spectral", "name": "screen", "cs": {"z": 10.0}, "width": 30.0, "height": 30.0,
        "num_pixels_x": 5, "num_pixels_y": 5, "num_bins": 2, "wl_min": 0.4, "wl_max": 0.65, "splat": "hard"}]);
    let source = json!({"file": "dome.tm25ray", "order": "in_order"});
    let ir = lowered(folder.path(), &scene(&source, &screen));
    let mut expected = vec![0_u64; 50];
    for ray in &rays {
        let path = (10.0 - ray.position[2]) / ray.direction[2];
        let cell = [0, 1].map(|axis| (ray.position[axis] + path * ray.direction[axis] + 15.0) / 6.0);
        if path > 0.0 && cell.iter().all(|x| (0.0..5.0).contains(x)) {
            let [i, j] = cell.map(|x| x as usize);
            expected[2 * (5 * j + i) + usize::from(ray.wavelength == Some(0.6))] += 1;
        }
    }
    for (num_turns, batch_size) in [(1, None), (1, Some(700)), (3, Some(4096))] {
        let options =
            TraceOptions { batch_size, ..zoo::options(num_turns * rays.len() as u64, 3, Precision::F64) };
        let tally = zoo::trace(&ir, &options);
        let of_ray = tally.launched.quanta / u128::from(options.num_rays);
        let found: Vec<u64> =
            tally.detectors[0].quanta.iter().map(|quanta| (quanta / of_ray) as u64).collect();
        let all: Vec<u64> = expected.iter().map(|count| num_turns * count).collect();
        assert_eq!(found, all, "{num_turns} times, by {batch_size:?}");
    }
}

/// Light by its path: a ray of each path is traced again, from a list of rays that the host uploads anew.
#[test]
fn paths_of_streamed_rays_are_found_again() {
    let folder = tempfile::tempdir().unwrap();
    let rays: Vec<Ray> = dome(3000).into_iter().map(|ray| Ray { flux: 0.5, ..ray }).collect();
    write(&folder.path().join("dome.tm25ray"), &rays, Wavelengths::PerRay);
    let mut behind = scene(
        &json!({"file": "dome.tm25ray", "order": "in_order"}),
        &json!([{"type": "irradiance", "name": "screen", "cs": {"z": 60.0}, "width": 80.0, "height": 80.0}]),
    );
    behind["components"] = json!([{"type": "lens", "name": "L", "cs": {"z": 20.0}, "config": {"r1": 40.0, "r2": -60.0,
        "thickness": 8.0, "front_aperture_radius": 15.0, "material": "N-BK7"}}]);
    let path = folder.path().join("scene.json");
    std::fs::write(&path, behind.to_string()).unwrap();
    let out = run(&["paths", &path.display().to_string(), "-n", "60000", "--seed", "4", "--json"]);
    assert!(out.status.success(), "{}", stderr(&out));
    let table: Value = serde_json::from_slice(&out.stdout).unwrap();
    let text = table.to_string();
    assert!(text.contains("L.front") && text.contains("L.back"), "{text}");
    assert!(!text.contains("not found"), "{text}");
}

/// Rays that are split come more than once into the list of rays that are traced again, as ids 0, 0, 2 here.
#[test]
fn paths_of_split_streamed_rays_are_found_again() {
    let folder = tempfile::tempdir().unwrap();
    let ray = |position: [f64; 3], direction: [f64; 3]| Ray {
        position,
        direction,
        flux: 0.5,
        wavelength: Some(0.6),
    };
    let ahead = [0.0, 0.0, 1.0];
    let rays = [ray([0.0; 3], ahead), ray([0.0; 3], [0.0, 0.0, -1.0]), ray([50.0, 0.0, 0.0], ahead)];
    write(&folder.path().join("three.tm25ray"), &rays, Wavelengths::PerRay);
    let mut split = scene(
        &json!({"file": "three.tm25ray", "order": "in_order"}),
        &json!([{"type": "irradiance", "name": "behind", "cs": {"z": 60.0}, "width": 40.0, "height": 40.0},
            {"type": "irradiance", "name": "beside", "cs": {"x": 50.0, "z": 60.0}, "width": 20.0, "height": 20.0}]),
    );
    split["components"] = json!([{"type": "lens", "name": "L", "cs": {"z": 20.0}, "config": {"r1": 40.0, "r2": -60.0,
        "thickness": 8.0, "front_aperture_radius": 15.0, "material": "N-BK7"}}]);
    let path = folder.path().join("scene.json");
    std::fs::write(&path, split.to_string()).unwrap();
    let out = run(&["trace", &path.display().to_string(), "-n", "3", "--split-depth", "6", "--paths", "on"]);
    assert!(out.status.success(), "{}", stderr(&out));
}

/// A file is read once for many scenes, and again when it has changed.
#[test]
fn a_file_is_read_again_once_it_has_changed() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("dome.tm25ray");
    let screen =
        json!([{"type": "irradiance", "name": "screen", "cs": {"z": 60.0}, "width": 80.0, "height": 80.0}]);
    let lamp = scene(&json!({"file": "dome.tm25ray"}), &screen);
    let mut fluxes = Vec::new();
    for num_rays in [500, 500, 700] {
        let rays = dome(num_rays);
        if num_rays == 700 || fluxes.is_empty() {
            write(&file, &rays, Wavelengths::PerRay);
        }
        let found = lowered(folder.path(), &lamp).emitted_flux();
        assert!((found / rays.iter().map(|ray| ray.flux).sum::<f64>() - 1.0).abs() < 1e-9);
        fluxes.push(found);
    }
    assert!(fluxes[0] == fluxes[1] && fluxes[1] != fluxes[2], "{fluxes:?}");
}

/// A file that changes under a trace is not taken for the one that the scene was read with.
#[test]
fn a_file_that_changes_is_noticed() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("dome.tm25ray");
    let rays: Vec<Ray> = dome(5000).into_iter().map(|ray| Ray { flux: 0.5, ..ray }).collect();
    write(&file, &rays, Wavelengths::PerRay);
    let screen =
        json!([{"type": "irradiance", "name": "screen", "cs": {"z": 60.0}, "width": 80.0, "height": 80.0}]);
    let ir = lowered(folder.path(), &scene(&json!({"file": "dome.tm25ray", "order": "in_order"}), &screen));
    write(
        &file,
        &rays.iter().map(|ray| Ray { position: ray.direction, ..*ray }).collect::<Vec<_>>(),
        Wavelengths::PerRay,
    );
    let mut tracer = zoo::options(1000, 3, Precision::F32).tracer(zoo::gpu(), &ir).unwrap();
    let error = tracer.trace(|_| true).unwrap_err().to_string();
    assert!(error.contains("not those that were there when the scene was read"), "{error}");
}

#[test]
fn what_cannot_be_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let rays = dome(50);
    write(&folder.path().join("dome.tm25ray"), &rays, Wavelengths::PerRay);
    let dark: Vec<Ray> = rays.iter().map(|ray| Ray { flux: 0.0, ..*ray }).collect();
    write(&folder.path().join("dark.tm25ray"), &dark, Wavelengths::PerRay);
    std::fs::write(folder.path().join("text.tm25ray"), "no rays").unwrap();
    let mut bytes = std::fs::read(folder.path().join("dome.tm25ray")).unwrap();
    // Half of the flux.
    let total: f64 = rays.iter().map(|ray| ray.flux).sum();
    let at = bytes.windows(4).position(|four| four == (total as f32).to_le_bytes()).unwrap();
    bytes[at..at + 4].copy_from_slice(&(0.5 * total as f32).to_le_bytes());
    std::fs::write(folder.path().join("half.tm25ray"), bytes).unwrap();
    let screen = json!([{"type": "far_field", "name": "far", "cs": {"z": 10.0}}]);
    let refused = |source: Value| {
        let scene = scene(&source, &screen);
        read(folder.path(), &scene).map(|_| ()).unwrap_err().to_string()
    };
    for (source, said) in [
        (json!({"file": "nowhere.tm25ray"}), "there is no such file"),
        (json!({"file": "text.tm25ray"}), "it does not begin with `TM25`"),
        (json!({"file": "dark.tm25ray"}), "no rays with light"),
        (json!({"file": "half.tm25ray"}), "say which of the two holds"),
        (
            json!({"file": "dome.tm25ray", "order": "in_order"}),
            "so all must have the same flux; ray 1 of the file has",
        ),
        (json!({"file": "dome.tm25ray", "order": "sorted"}), "unknown value \"sorted\""),
        (json!({"file": "dome.tm25ray", "scale": 0.0}), "scale"),
        (
            json!({"file": "dome.tm25ray", "spectrum": {"wavelengths": [0.45], "weights": [1.0]}}),
            "none within 25 nm",
        ),
    ] {
        let error = refused(source.clone());
        assert!(error.contains(said), "{source}: {error}");
    }
    // The scene's flux takes the place of the file's.
    let ir = lowered(folder.path(), &scene(&json!({"file": "half.tm25ray", "total_flux": 3.0}), &screen));
    assert!((ir.emitted_flux() - 3.0).abs() < 1e-12);
    let shifted = scene(
        &json!({"file": "dome.tm25ray", "spectrum": {"wavelengths": [0.46, 0.6], "weights": [1.0, 1.0]}}),
        &screen,
    );
    let warnings = read(folder.path(), &shifted).unwrap().warnings;
    assert!(warnings.iter().any(|warning| warning.contains("at most 10 nm off")), "{warnings:?}");
}

/// A text file says neither W nor lm. Where the scene says lumens, fluxes of rays are lumens.
#[test]
fn fluxes_of_a_text_file_are_lumens_if_the_scene_says_lumens() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("rays.dat"), "2 4\n10 0 0 0 0 1 1.0 0.45\n-10 0 0 0 0 1 1.0 0.55\n")
        .unwrap();
    let screen = |name: &str, x: f64| {
        json!({"type": "irradiance", "name": name, "cs": {"x": x, "z": 1.0}, "width": 10.0, "height": 10.0,
            "num_pixels_x": 1, "num_pixels_y": 1})
    };
    let fluxes = |given: &str| -> Vec<f64> {
        let mut source = json!({"type": "rays", "name": "L", "file": "rays.dat", "cs": {},
            "spectrum": {"wavelengths": [0.45, 0.55], "weights": [1, 1]}});
        source[given] = json!(100.0);
        let scene = json!({"nsq_schema_version": 1, "components": [], "sources": [source],
            "detectors": [screen("blue", 10.0), screen("green", -10.0)]});
        let ir = lowered(folder.path(), &scene);
        let result = traced(&ir, 40_000, Precision::F64);
        result.detectors.iter().map(|detector| detector.total_flux).collect()
    };
    let [blue, green] = fluxes("total_flux")[..] else { panic!() };
    assert!((blue / green - 1.0).abs() < 0.05, "{blue} and {green} W");
    let [blue, green] = fluxes("total_flux_lumens")[..] else { panic!() };
    // Equal lumens, so that watts are as the eye's efficacies at 550 and 450 nm.
    let right = nsq_gpu::model::photometry::luminous_efficiency(0.55)
        / nsq_gpu::model::photometry::luminous_efficiency(0.45);
    assert!((blue / green / right - 1.0).abs() < 0.1, "{blue} and {green} W, not {right} to 1");
}
