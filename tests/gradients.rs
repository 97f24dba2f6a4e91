//! Derivatives of maps: equal to those of Optiland's Torch backend by the same draws, to closed forms, and to differences of
//! two traces.
#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "clippy's exemption of tests does not reach their helpers"
)]

mod zoo;

use nsq_gpu::model::SceneIr;
use nsq_gpu::program::Precision;
use nsq_gpu::result::Gradient;
use nsq_gpu::trace::gradients::Differentiated;
use nsq_gpu::{StandardError, TraceOptions};
use serde_json::Value;
use std::path::{Path, PathBuf};

fn oracle() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/oracle/gradients")
}

fn differentiated(text: &str, names: &[&str]) -> Differentiated {
    let names: Vec<String> = names.iter().map(|name| name.to_string()).collect();
    Differentiated::new(text, &oracle(), &names, |_| Ok(())).unwrap()
}

fn numbers(values: &Value) -> Vec<f64> {
    values.as_array().unwrap().iter().map(|value| value.as_f64().unwrap()).collect()
}

/// Derivatives of the flux in each pixel \[W\]: those of the irradiance times a pixel's area, and the irradiance times those
/// of the area.
fn of_pixel_flux(ours: &Gradient, ir: &SceneIr, parameter: &str, flux: &[f64]) -> Vec<f64> {
    let detector = ir.detectors.iter().find(|detector| detector.name == ours.detector).unwrap();
    let grid = detector.kind.grid().unwrap();
    let area = grid.width * grid.height / f64::from(grid.num_pixels_x * grid.num_pixels_y);
    // The area is in proportion to either side.
    let share = match parameter.rsplit('.').next().unwrap() {
        "width" => 1.0 / grid.width,
        "height" => 1.0 / grid.height,
        _ => 0.0,
    };
    ours.map.as_ref().unwrap().iter().zip(flux).map(|(slope, flux)| slope * area + flux * share).collect()
}

/// By the same draws, each pixel by each parameter.
#[test]
fn derivatives_are_those_of_torch() {
    let mut files: Vec<PathBuf> =
        std::fs::read_dir(oracle()).unwrap().map(|entry| entry.unwrap().path()).collect();
    files.retain(|path| path.to_str().unwrap().ends_with(".scene.json"));
    files.sort();
    let mut num_compared = 0;
    for path in &files {
        let name = path.file_name().unwrap().to_str().unwrap().trim_end_matches(".scene.json");
        let text = std::fs::read_to_string(path).unwrap();
        let theirs = std::fs::read_to_string(oracle().join(format!("{name}.json"))).unwrap();
        let theirs: Value = serde_json::from_str(&theirs).unwrap();
        let all = theirs["parameters"].as_object().unwrap();
        let names: Vec<&str> = all.keys().map(String::as_str).collect();
        let options = TraceOptions {
            max_depth: theirs["max_depth"].as_u64().unwrap() as u32,
            ..zoo::options(
                theirs["num_rays"].as_u64().unwrap(),
                theirs["seed"].as_u64().unwrap(),
                Precision::F64,
            )
        };
        let scene = differentiated(&text, &names);
        let (found, tally) = scene.gradients(zoo::gpu(), &options, |_| true).unwrap();
        let flux = numbers(&theirs["data"]);
        for ours in found.iter().filter(|row| row.detector == theirs["detector"].as_str().unwrap()) {
            let expected = &all[&ours.parameter];
            let data = numbers(&expected["data"]);
            let slopes = of_pixel_flux(ours, &scene.ir, &ours.parameter, &flux);
            let sum_of_sizes: f64 = data.iter().map(|value| value.abs()).sum();
            for (slope, value) in slopes.iter().zip(&data) {
                assert!(
                    (slope - value).abs() <= 1e-9 * sum_of_sizes,
                    "{name} {}: {slope:e}, not {value:e}, of {sum_of_sizes:e} in all",
                    ours.parameter
                );
            }
            let value = expected["flux"].as_f64().unwrap();
            assert!(
                (ours.flux - value).abs() <= 1e-9 * sum_of_sizes,
                "{name} {}: {}",
                ours.parameter,
                ours.flux
            );
            assert_eq!(ours.num_lost, 0);
            num_compared += 1;
        }
        // The maps themselves are those of a trace without derivatives, to the bit.
        let plain = TraceOptions { live: true, standard_error: StandardError::Off, ..options };
        let plain = zoo::trace(&scene.ir, &plain);
        for (ours, theirs) in tally.detectors.iter().zip(&plain.detectors) {
            assert_eq!((&ours.quanta, &ours.hits), (&theirs.quanta, &theirs.hits), "{name}");
        }
    }
    assert_eq!((files.len(), num_compared), (12, 39));
}
