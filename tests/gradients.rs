//! Derivatives of maps: equal to those of Optiland's Torch backend by the same draws, to closed forms, and to differences of
//! two traces.
#![allow(
    clippy::unwrap_used,
    clippy::panic,
    clippy::print_stdout,
    reason = "clippy's exemption of tests does not reach their helpers"
)]

mod zoo;

use nsq_gpu::model::SceneIr;
use nsq_gpu::program::Precision;
use nsq_gpu::result::{Gradient, SceneDifference};
use nsq_gpu::run::gradients::{Differentiated, How, LossGradient};
use nsq_gpu::{StandardError, TraceOptions};
use serde_json::Value;
use std::path::{Path, PathBuf};

fn oracle() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/oracle/gradients")
}

/// The text of a scene of the oracle, and what Torch says of it.
fn of_oracle(name: &str) -> (String, Value) {
    let read = |end: &str| std::fs::read_to_string(oracle().join(format!("{name}{end}"))).unwrap();
    (read(".scene.json"), serde_json::from_str(&read(".json")).unwrap())
}

/// Changes a text of a shader.
fn planted<'t>(text: &'t str, wrong: &'t str) -> impl Fn(String) -> String + 't {
    move |wgsl: String| zoo::replaced(&wgsl, text, wrong)
}

/// As users differentiate, with the shaders that other tests have compiled.
fn how() -> How<'static> {
    How { cache: zoo::shaders_of(zoo::gpu()).cache, ..How::default() }
}

fn differentiated(text: &str, names: &[&str]) -> Differentiated {
    let names: Vec<String> = names.iter().map(|name| name.to_string()).collect();
    Differentiated::new(text, &oracle(), &[], &names, |_| Ok(())).unwrap()
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
        let (text, theirs) = of_oracle(name);
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
        let (found, tally) = scene.gradients(zoo::gpu(), &options, how(), |_| true).unwrap();
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

/// A lens and a filter, with light that stays clear of every edge.
const BENCH: &str = r#"{
    "nsq_schema_version": 1,
    "components": [{"name": "L1", "type": "lens", "cs": {"z": 0.0},
        "config": {"r1": 52.0, "r2": -60.0, "thickness": 6.0, "material": {"type": "medium", "name": "glass"},
            "front_aperture_radius": 14.0, "conic1": -0.3}}],
    "sources": [
        {"name": "beam", "type": "collimated", "total_flux": 1.0, "aperture_radius": 8.0, "cs": {"z": -10.0},
            "spectrum": {"wavelengths": [0.4861, 0.6563], "weights": [1, 1]}},
        {"name": "lamp", "type": "extended", "total_flux": 0.5, "width": 3.0, "height": 3.0,
            "half_angle_deg": 4.0, "cs": {"x": 2.0, "z": -12.0}, "spectrum": {"wavelengths": [0.5876], "weights": [1]}}],
    "detectors": [{"name": "image", "type": "irradiance", "width": 12.0, "height": 12.0, "num_pixels_x": 8,
        "num_pixels_y": 8, "cs": {"z": 40.0}}],
    "nsq_gpu": {
        "version": 1,
        "media": {"glass": {"type": "constant", "n": 1.52, "k": 0.0},
            "smoked": {"type": "constant", "n": 1.5, "k": 5e-6}},
        "surfaces": [
            {"name": "filter.front", "shape": {"type": "plane", "width": 60, "height": 60}, "interaction": "refractive",
                "cs": {"z": 20}, "material_back": {"type": "medium", "name": "smoked"}},
            {"name": "filter.back", "shape": {"type": "plane", "width": 60, "height": 60}, "interaction": "refractive",
                "cs": {"z": 22}, "material_front": {"type": "medium", "name": "smoked"},
                "coating": {"type": "simple", "reflectance": 0.2, "transmittance": 0.7}}],
        "sampling": {"rr_start_flux": 1e-6}
    }
}"#;

/// What a scene with a number larger by a step has more than with the number as much smaller.
fn central_difference(text: &str, name: &str, step: f64, options: &TraceOptions) -> SceneDifference {
    let value = nsq_gpu::Scene::numbers(text, &[name.to_string()]).unwrap()[0];
    let at = |value: f64| {
        let numbers = [(name.to_string(), value)];
        nsq_gpu::Scene::with_numbers(text, Path::new(""), &numbers).unwrap().lower().unwrap()
    };
    let (more, less) = (at(value + step), at(value - step));
    let pair = nsq_gpu::run::difference::Pair::new(&more, less).unwrap();
    // Both sides have one shape, and so one shader.
    let options = TraceOptions { live: true, ..options.clone() };
    pair.with_cache(zoo::shaders_of(zoo::gpu()).cache).difference(zoo::gpu(), &options, |_| true).unwrap()
}

/// Compares the first detector's map with differences of two traces, pixel by pixel, for each number and its step. Each
/// derivative shows in more than `least` pixels. Pixels count that are not at the border, or all. Four numbers have one
/// shader, which is compiled in less time than four.
fn check_differences(
    text: &str,
    numbers: &[(&str, f64)],
    options: &TraceOptions,
    has_border: bool,
    least: usize,
) {
    let names: Vec<&str> = numbers.iter().map(|(name, _)| *name).collect();
    let found = differentiated(text, &names).gradients(zoo::gpu(), options, how(), |_| true).unwrap().0;
    for &(name, step) in numbers {
        let ours = found.iter().find(|gradient| gradient.parameter == name).unwrap();
        let num_seen = check_difference(text, ours, step, options, has_border);
        assert!(num_seen > least, "{text}: the derivative by {name} shows in {num_seen} pixels alone");
    }
}

fn check_difference(
    text: &str,
    ours: &Gradient,
    step: f64,
    options: &TraceOptions,
    has_border: bool,
) -> usize {
    let name = ours.parameter.as_str();
    let difference = central_difference(text, name, step, options);
    let theirs = difference.detectors[0].map.as_ref().unwrap();
    let (map, errors) = (ours.map.as_ref().unwrap(), ours.map_errors.as_ref().unwrap());
    let [rows, columns] = [map.shape()[0], map.shape()[1]];
    let (mut scores, mut num_seen) = (Vec::new(), 0);
    let pixels = map.iter().zip(errors).zip(&theirs.values).zip(theirs.errors.as_ref().unwrap());
    for (pixel, (((ours, own), theirs), error)) in pixels.enumerate() {
        let (row, column) = (pixel / columns, pixel % columns);
        let is_inside = |at: usize, num: usize| at > 0 && at + 1 < num;
        if has_border && !(is_inside(row, rows) && is_inside(column, columns)) {
            continue;
        }
        let sigma = own.hypot(error / (2.0 * step));
        scores.push(if sigma > 0.0 { (ours - theirs / (2.0 * step)) / sigma } else { 0.0 });
        num_seen += usize::from(ours.abs() > 5.0 * own);
    }
    let rms = (scores.iter().map(|score| score * score).sum::<f64>() / scores.len() as f64).sqrt();
    let worst = scores.iter().fold(0.0, |worst: f64, score| worst.max(score.abs()));
    // Both sides draw alike, so most differ by less than chance. One in a thousand tables of 64 pixels has a worse rms.
    let at = scores.iter().position(|score| score.abs() == worst);
    assert!(rms < 1.3 && worst < 4.5, "{name}: {rms} {worst} at {at:?}\n{scores:.1?}");
    num_seen
}

/// Pixel by pixel, as far from differences of two traces as chance has it. The step is so large that the difference shows.
#[test]
fn derivatives_are_those_of_differences() {
    let options = TraceOptions { num_rays: 400_000, ..zoo::options(0, 5, Precision::F64) };
    let steps = [
        ("L1.x", 0.02),
        ("L1.z", 0.1),
        ("L1.rx", 2e-3),
        ("L1.thickness", 0.1),
        ("L1.r2", 0.5),
        ("L1.conic1", 0.1),
        ("image.z", 0.1),
        ("image.ry", 5e-3),
        ("image.width", 0.05),
        ("beam.aperture_radius", 0.02),
        ("beam.x", 0.02),
        ("beam.ry", 5e-4),
        ("beam.total_flux", 0.02),
        ("lamp.half_angle_deg", 0.05),
        ("lamp.x", 0.05),
        ("lamp.width", 0.05),
        ("glass.n", 2e-3),
        ("smoked.k", 1e-6),
        ("\"filter.back\".z", 0.1),
        ("\"filter.front\".ry", 1e-2),
        ("\"filter.back\".reflectance", 0.02),
        ("\"filter.back\".transmittance", 0.02),
    ];
    let steps: Vec<(&str, f64)> = zoo::in_turn(steps).collect();
    check_differences(BENCH, &steps, &options, false, 20);
    // So large a step lets enough rays cross the rim, where others are drawn in their place.
    let profile = r#""aperture_radius": 8.0, "profile": "gaussian", "gaussian_sigma": 5.0,"#;
    let gaussian = BENCH.replace(r#""aperture_radius": 8.0,"#, profile);
    assert_ne!(gaussian, BENCH);
    // Ghosts of the rim cross the detector's edge as the rim moves, which no derivative sees: border pixels differ.
    for (name, step, has_border) in [("beam.gaussian_sigma", 0.1, false), ("beam.aperture_radius", 0.2, true)]
    {
        check_differences(&gaussian, &[(name, step)], &options, has_border, 8);
    }
    let simple = r#"{"type": "simple", "reflectance": 0.2, "transmittance": 0.7}"#;
    let [low, high] = [
        "[[0.2, 0.25, 0.5], [0.1, 0.15, 0.4], [0.3, 0.4, 0.5]]",
        "[[0.7, 0.6, 0.4], [0.8, 0.7, 0.5], [0.6, 0.5, 0.4]]",
    ];
    let tabulated = format!(
        r#"{{"type": "tabulated", "wavelengths": [0.4861, 0.5876, 0.6563], "angles": [0, 30, 90],
        "reflectance": {low}, "transmittance": {high}, "reflectance_back": {low}, "transmittance_back": {high}}}"#
    );
    let text = BENCH.replace(simple, &tabulated);
    assert_ne!(text, BENCH);
    let numbers = [("\"filter.back\".reflectance.0.0", 0.02), ("\"filter.back\".transmittance.1.1", 0.02)];
    check_differences(&text, &numbers, &options, false, 8);
}

/// A place in a truncated Gaussian beam keeps its share of the light within, so that a wider beam leaves none beyond the rim.
/// The mean square of the radius is 2 s^2 (1 - q / (exp(q) - 1)), with q = R^2 / (2 s^2).
#[test]
fn a_truncated_gaussian_beam_widens_by_its_formula() {
    const RADIUS: f64 = 8.0;
    let mean_square = |sigma: f64, radius: f64| {
        let q = radius * radius / (2.0 * sigma * sigma);
        2.0 * sigma * sigma * (1.0 - q / q.exp_m1())
    };
    for sigma in [2.0, 4.0, 6.0] {
        let text = format!(
            r#"{{"nsq_schema_version": 1, "components": [],
            "sources": [{{"name": "beam", "type": "collimated", "total_flux": 1.0, "aperture_radius": {RADIUS}, "cs": {{"z": -10.0}},
                "profile": "gaussian", "gaussian_sigma": {sigma}, "spectrum": {{"wavelengths": [0.5], "weights": [1.0]}}}}],
            "detectors": [{{"name": "screen", "type": "irradiance", "width": 20.0, "height": 20.0, "num_pixels_x": 80,
                "num_pixels_y": 80, "splat": "bilinear", "absorb": true, "cs": {{}}}}]}}"#
        );
        let options = TraceOptions { num_rays: 400_000, ..zoo::options(0, 5, Precision::F64) };
        let names = ["beam.gaussian_sigma", "beam.aperture_radius"];
        let scene = differentiated(&text, &names);
        let found = scene.gradients(zoo::gpu(), &options, how(), |_| true).unwrap().0;
        let slope = |of: &dyn Fn(f64) -> f64| (of(1e-4) - of(-1e-4)) / 2e-4;
        let formulas = [
            slope(&|change| mean_square(sigma + change, RADIUS)),
            slope(&|change| mean_square(sigma, RADIUS + change)),
        ];
        for (ours, formula) in found.iter().zip(formulas) {
            // A map is in W/mm^2, and a pixel has a sixteenth of a square millimetre.
            let square = |(pixel, value): (usize, &f64)| {
                let [x, y] = [pixel % 80, pixel / 80].map(|at| (at as f64 + 0.5) * 0.25 - 10.0);
                value / 16.0 * (x * x + y * y)
            };
            let mean: f64 = ours.map.as_ref().unwrap().iter().enumerate().map(square).sum();
            println!("sigma {sigma}, {}: {mean:.4}, formula {formula:.4}", ours.parameter);
            // Four standard errors: the square of a radius of 4 mm spreads by its own size, over 400,000 rays.
            assert!((mean - formula).abs() < 0.1, "{}: {mean}, not {formula}", ours.parameter);
        }
    }
}

/// BENCH with names that move several entries.
fn bench_of_elements() -> String {
    let elements = r#""version": 1, "elements": [
        {"name": "E1", "faces": ["L1"], "behind": []},
        {"name": "E2", "faces": ["filter.front", "filter.back"], "behind": ["image"]},
        {"name": "all", "faces": ["L1", "filter.front"], "parts": ["filter.back"], "pivot": [0, 0, 5]}],"#;
    let barrel = r#""cs": {"z": 2, "reference_cs": {"z": 20, "rx": 0.1, "name": "barrel"}}"#;
    let text = BENCH.replace(r#""version": 1,"#, elements);
    text.replace(r#""cs": {"z": 20}"#, &barrel.replace(r#""z": 2,"#, ""))
        .replace(r#""cs": {"z": 22}"#, barrel)
}

#[test]
#[ignore = "long"]
fn derivatives_of_elements_are_those_of_differences() {
    let options = TraceOptions { num_rays: 400_000, ..zoo::options(0, 5, Precision::F64) };
    let steps = [
        ("E1.y", 0.02),
        ("E1.rx", 2e-3),
        ("E2.ry", 1e-2),
        ("all.x", 0.02),
        ("all.rx", 2e-3),
        ("barrel.rx", 5e-3),
        ("gap_1", 0.1),
        ("gap_2", 0.1),
    ];
    check_differences(&bench_of_elements(), &steps, &options, false, 20);
}

/// The chain rule: an element's derivative is the sum of those of the numbers that its name moves, each as much as it moves.
#[test]
fn a_name_that_moves_several_numbers_has_one_derivative() {
    let text = bench_of_elements().replace(r#", "rx": 0.1, "name""#, r#", "name""#);
    let of = |names: &[&str]| -> Vec<ndarray::ArrayD<f64>> {
        let found = differentiated(&text, names);
        let options = zoo::options(20_000, 5, Precision::F64);
        let found = found.gradients(zoo::gpu(), &options, how(), |_| true).unwrap().0;
        found.into_iter().map(|row| row.map.unwrap()).collect()
    };
    let front = ["\"filter.front\".z", "\"filter.front\".ry"];
    let moved = of(&[front[0], front[1], "L1.x", "L1.ry"]);
    let others = of(&["\"filter.back\".z", "\"filter.back\".ry", "\"filter.front\".x", "\"filter.back\".x"]);
    let elements = of(&["E2.z", "all.ry", "all.x", "gap_1"]);
    let back = of(&["image.z"]);
    // Turned about y, what stands behind the pivot moves along x, and what stands before it moves back.
    let turned = &moved[3] - &moved[2] * 5.0 + &moved[1] + &others[2] * 15.0 + &others[1] + &others[3] * 17.0;
    let expected = [
        &moved[0] + &others[0],
        turned,
        &moved[2] + &others[2] + &others[3],
        &moved[0] + &others[0] + &back[0],
    ];
    for (number, (found, expected)) in elements.iter().zip(expected).enumerate() {
        let size = expected.iter().fold(0.0, |size: f64, value| size.max(value.abs()));
        let apart = (found - &expected).iter().fold(0.0, |apart: f64, value| apart.max(value.abs()));
        assert!(apart < 1e-8 * size, "{number}: {apart} of {size}");
    }
}

/// A face of each shape whose crossings are searched, in light that stays clear of its rim.
#[test]
#[ignore = "long"]
fn derivatives_of_shapes_are_those_of_differences() {
    let options = TraceOptions { num_rays: 400_000, ..zoo::options(0, 5, Precision::F64) };
    for (shape, numbers) in [
        (
            r#""biconic", "radius_x": 30, "radius_y": 45, "conic_x": 0.5, "conic_y": -1"#,
            &[("S.radius_x", 0.2), ("S.radius_y", 0.2), ("S.conic_x", 0.2)][..],
        ),
        (
            r#""toroidal", "radius_x": 30, "radius_y": 45, "conic": 0.5, "coeffs_poly_y": [1e-3, 1e-6]"#,
            &[("S.radius_x", 0.2), ("S.radius_y", 0.2), ("S.coeffs_poly_y.0", 5e-5)],
        ),
        (
            r#""odd_asphere", "radius": 40, "conic": 0, "coefficients": [0.0, 1e-3, 2e-4]"#,
            &[("S.radius", 0.2), ("S.coefficients.0", 1e-3), ("S.coefficients.2", 5e-6)],
        ),
        (
            r#""polynomial", "radius": 40, "conic": 0, "coefficients": [[0, 0.01], [0.02, 1e-3]]"#,
            &[("S.radius", 0.2), ("S.coefficients.1.0", 1e-3), ("S.coefficients.1.1", 1e-4)],
        ),
        (
            r#""chebyshev", "radius": 40, "conic": 0, "norm_x": 12, "norm_y": 12, "coefficients": [[0, 0.05], [0.1, 0.05]]"#,
            &[("S.radius", 0.2), ("S.norm_x", 0.2), ("S.coefficients.1.1", 0.01)],
        ),
        (
            r#""zernike", "radius": 40, "conic": 0, "norm_radius": 12, "coefficients": [0, 0.1, 0, 0.05, 0.02, 0]"#,
            &[("S.radius", 0.2), ("S.coefficients.4", 0.01), ("S.coefficients.5", 0.01)],
        ),
    ] {
        let text = format!(
            r#"{{"nsq_schema_version": 1, "components": [],
            "sources": [{{"name": "beam", "type": "collimated", "total_flux": 1.0, "aperture_radius": 5.0,
                "cs": {{"x": 0.5, "z": -20.0, "ry": 0.02}}, "spectrum": {{"wavelengths": [0.5], "weights": [1.0]}}}}],
            "detectors": [{{"name": "image", "type": "irradiance", "width": 12.0, "height": 12.0, "num_pixels_x": 8,
                "num_pixels_y": 8, "splat": "bilinear", "absorb": true, "cs": {{"z": 25.0}}}}],
            "nsq_gpu": {{"version": 1, "media": {{"glass": {{"type": "constant", "n": 1.5, "k": 0.0}}}}, "surfaces": [
                {{"name": "S", "shape": {{"type": {shape}, "aperture_radius": 10}}, "interaction": "refractive",
                    "material_back": {{"type": "medium", "name": "glass"}}, "cs": {{}}}}]}}}}"#
        );
        check_differences(&text, numbers, &options, false, 8);
    }
}

/// A mirror and a plate that scatter towards a screen: each law has the derivatives of a difference. Light crosses the border of
/// the screen, so pixels there do not count.
#[test]
fn derivatives_of_scattered_light_are_those_of_differences() {
    let options = TraceOptions { num_rays: 400_000, ..zoo::options(0, 5, Precision::F64) };
    let scene = |interaction: &str, bsdf: &str, [x, z]: [f64; 2]| {
        format!(
            r#"{{"nsq_schema_version": 1, "components": [],
            "sources": [{{"name": "beam", "type": "collimated", "total_flux": 1.0, "aperture_radius": 1.0, "cs": {{"z": -10.0}},
                "spectrum": {{"wavelengths": [0.5], "weights": [1.0]}}}}],
            "detectors": [{{"name": "screen", "type": "irradiance", "width": 12.0, "height": 12.0, "num_pixels_x": 8,
                "num_pixels_y": 8, "splat": "bilinear", "absorb": true, "cs": {{"x": {x}, "z": {z}, "ry": 0.5}}}}],
            "nsq_gpu": {{"version": 1, "media": {{"glass": {{"type": "constant", "n": 1.5, "k": 0.0}}}}, "surfaces": [
                {{"name": "S", "shape": {{"type": "plane", "width": 60, "height": 60}}, {interaction}, "scatter_fraction": 0.8,
                    "bsdf": {bsdf}, "cs": {{"ry": 0.3}}}}]}}}}"#
        )
    };
    let mirror = r#""interaction": "reflective", "reflectance": 0.9"#;
    let face = r#""interaction": "refractive", "material_back": {"type": "medium", "name": "glass"}"#;
    let harvey_shack = r#"{"type": "harvey_shack", "b0": 0.5, "l0": 0.2, "s": 2.2}"#;
    let k_correlation = r#"{"type": "k_correlation", "b0": 0.3, "B": 5.0, "s": 2.5}"#;
    let tabulated = r#"{"type": "tabulated", "theta_i": [0, 30, 90], "theta_s": [0, 20, 60, 90],
        "bsdf": [[0.3, 0.2, 0.1, 0.0], [0.4, 0.3, 0.2, 0.1], [0.5, 0.3, 0.1, 0.1]]}"#;
    let through = r#"{"type": "lambertian", "reflectance_value": 0.7, "transmissive_fraction": 0.6}"#;
    let lambertian = r#"{"type": "lambertian", "reflectance_value": 0.7}"#;
    let laws = [
        (
            mirror,
            harvey_shack,
            [-8.0, -12.0],
            &[("S.l0", 5e-3), ("S.s", 0.05), ("S.ry", 2e-3), ("S.z", 0.1)][..],
        ),
        (mirror, k_correlation, [-8.0, -12.0], &[("S.B", 0.1), ("S.s", 0.05), ("S.scatter_fraction", 0.02)]),
        // The distribution's power is 0 here, and next to 0 there.
        (mirror, &k_correlation.replace("2.5", "2.0"), [-8.0, -12.0], &[("S.s", 0.05), ("S.B", 0.1)]),
        (mirror, &k_correlation.replace("2.5", "2.004"), [-8.0, -12.0], &[("S.s", 0.05)]),
        (
            mirror,
            lambertian,
            [-8.0, -12.0],
            &[("S.reflectance_value", 0.02), ("S.ry", 2e-3), ("S.reflectance", 0.02)],
        ),
        (mirror, tabulated, [-8.0, -12.0], &[("S.bsdf.1.2", 0.02), ("S.bsdf.0.1", 0.02), ("S.ry", 2e-3)]),
        (
            face,
            through,
            [3.0, 12.0],
            &[("S.transmissive_fraction", 0.02), ("S.scatter_fraction", 0.02), ("glass.n", 0.02)],
        ),
    ];
    for (interaction, bsdf, at, numbers) in zoo::in_turn(laws) {
        check_differences(&scene(interaction, bsdf, at), numbers, &options, true, 8);
    }
}

/// Whatever the batches, the workgroups and the parameters beside it, a derivative has the same bits.
#[test]
fn derivatives_have_the_same_bits_however_they_are_traced() {
    let options = zoo::options(5000, 2, Precision::F64);
    let of = |names: &[&str], options: &TraceOptions| {
        let scene = differentiated(BENCH, names);
        let found = scene.gradients(zoo::gpu(), options, how(), |_| true).unwrap().0;
        found.into_iter().find(|row| row.parameter == "L1.r1").unwrap()
    };
    let alone = of(&["L1.r1"], &options);
    assert!(alone.map.as_ref().unwrap().iter().any(|value| *value != 0.0));
    for (names, options) in [
        (&["L1.r1"][..], TraceOptions { batch_size: Some(700), ..options.clone() }),
        (&["L1.r1"], TraceOptions { workgroup_size: 32, ..options.clone() }),
        (&["L1.x", "glass.n", "L1.r1", "image.z", "L1.r2"], options.clone()),
    ] {
        let found = of(names, &options);
        assert_eq!((found.map, found.flux), (alone.map.clone(), alone.flux), "{names:?}");
    }
    // On a cache, and from portable integers.
    let scene = differentiated(BENCH, &["L1.r1"]);
    let cache = nsq_gpu::run::PipelineCache::new();
    for _ in 0..2 {
        let how = How { cache: Some(&cache), without_errors: true, ..How::default() };
        let found = scene.gradients(zoo::gpu(), &options, how, |_| true).unwrap().0;
        assert_eq!((&found[0].map, found[0].standard_error), (&alone.map, None));
    }
    assert_eq!(cache.len(), 1, "one shader serves both");
    let found = scene.gradients(zoo::portable_gpu(), &options, How::default(), |_| true).unwrap().0;
    assert_eq!(found[0].map, alone.map);
}

/// Derivatives in f32 and in pairs of f32 are those of f64 to the digits of the tier.
#[test]
fn derivatives_have_the_precision_of_the_tier() {
    let names = ["L1.r1", "L1.conic1", "glass.n", "image.z"];
    let scene = differentiated(BENCH, &names);
    let of = |precision| {
        let options = zoo::options(4000, 2, precision);
        scene.gradients(zoo::gpu(), &options, how(), |_| true).unwrap().0
    };
    let exact = of(Precision::F64);
    for (precision, tolerance) in zoo::in_turn([(Precision::F32, 2e-3), (Precision::Df64, 1e-9)]) {
        for (found, exact) in of(precision).iter().zip(&exact) {
            let (found_map, map) = (found.map.as_ref().unwrap(), exact.map.as_ref().unwrap());
            let size: f64 = map.iter().map(|value| value.abs()).sum();
            let apart: f64 = found_map.iter().zip(map).map(|(a, b)| (a - b).abs()).sum();
            // A draw may fall otherwise in f32: so some rays in a thousand.
            assert!(apart <= tolerance * size, "{precision:?} {}: {:e}", exact.parameter, apart / size);
        }
    }
}

/// A window of index n lets 4 n / (n + 1)^2 through at each face, and sends back the rest; what goes to and fro adds up to
/// 2 n / (n^2 + 1), whose derivative is 2 (1 - n^2) / (n^2 + 1)^2. What it absorbs is exp(-4 pi k d / lambda) a pass.
#[test]
fn a_window_has_the_derivatives_of_its_formula() {
    let window = |n: f64, k: f64| {
        format!(
            r#"{{"nsq_schema_version": 1, "components": [],
                "sources": [{{"name": "beam", "type": "collimated", "total_flux": 2.0, "aperture_radius": 1.0, "cs": {{"z": -5.0}},
                    "spectrum": {{"wavelengths": [0.5], "weights": [1.0]}}}}],
                "detectors": [{{"name": "behind", "type": "irradiance", "width": 8.0, "height": 8.0, "num_pixels_x": 2,
                    "num_pixels_y": 2, "splat": "hard", "cs": {{"z": 20.0}}}}],
                "nsq_gpu": {{"version": 1, "media": {{"glass": {{"type": "constant", "n": {n}, "k": {k}}}}},
                    "sampling": {{"rr_start_flux": 0.0}},
                    "surfaces": [
                        {{"name": "front", "shape": {{"type": "plane", "width": 30, "height": 30}}, "interaction": "refractive",
                            "cs": {{"z": 0}}, "material_back": {{"type": "medium", "name": "glass"}}}},
                        {{"name": "back", "shape": {{"type": "plane", "width": 30, "height": 30}}, "interaction": "refractive",
                            "cs": {{"z": 3}}, "material_front": {{"type": "medium", "name": "glass"}}}}]}}}}"#
        )
    };
    let options = TraceOptions { max_depth: 64, ..zoo::options(1_000_000, 4, Precision::F64) };
    let flux = |text: &str, name: &str| {
        let scene = differentiated(text, &[name]);
        let found = scene.gradients(zoo::gpu(), &options, how(), |_| true).unwrap().0;
        (found[0].flux, found[0].standard_error.unwrap())
    };
    let n = 1.8_f64;
    let (slope, error) = flux(&window(n, 0.0), "glass.n");
    let expected = 2.0 * 2.0 * (1.0 - n * n) / (n * n + 1.0).powi(2);
    assert!(
        (slope - expected).abs() < 4.0 * error && error < 2e-3 * expected.abs(),
        "{slope} ± {error}: {expected}"
    );
    // T = (1 - R)^2 a / (1 - R^2 a^2), with a = exp(-4 pi k d / lambda).
    let (k, d, wavelength) = (2e-6, 3.0, 0.5e-3);
    let rate = 4.0 * std::f64::consts::PI * d / wavelength;
    let (a, r) = ((-rate * k).exp(), ((n - 1.0) / (n + 1.0)).powi(2));
    let by_a = (1.0 - r).powi(2) * (1.0 + (r * a).powi(2)) / (1.0 - (r * a).powi(2)).powi(2);
    let expected = -2.0 * by_a * rate * a;
    let (slope, error) = flux(&window(n, k), "glass.k");
    assert!(
        (slope - expected).abs() < 4.0 * error && error < 2e-3 * expected.abs(),
        "{slope} ± {error}: {expected}"
    );
}

/// Where a thin beam meets a screen, by a parameter: the derivative of the map's centre along x, in mm per unit.
fn slope_of_centre(surfaces: &str, screen_z: f64, beam_x: f64, parameter: &str) -> f64 {
    let text = format!(
        r#"{{"nsq_schema_version": 1, "components": [],
            "sources": [{{"name": "beam", "type": "collimated", "total_flux": 1.0, "aperture_radius": 1e-4,
                "cs": {{"x": {beam_x}, "z": -5.0}}, "spectrum": {{"wavelengths": [0.5], "weights": [1.0]}}}}],
            "detectors": [{{"name": "screen", "type": "irradiance", "width": 40.0, "height": 40.0, "num_pixels_x": 16,
                "num_pixels_y": 16, "cs": {{"z": {screen_z}}}}}],
            "nsq_gpu": {{"version": 1, "media": {{"glass": {{"type": "constant", "n": 1.5, "k": 0.0}}}},
                "sampling": {{"rr_start_flux": 0.0}}, "surfaces": [{surfaces}]}}}}"#
    );
    let scene = differentiated(&text, &[parameter]);
    let options = zoo::options(2_000, 4, Precision::F64);
    let (found, tally) = scene.gradients(zoo::gpu(), &options, how(), |_| true).unwrap();
    // A splat over four pixels keeps the centre of what it spreads.
    let quanta = &tally.detectors[0].quanta;
    let map = found[0].map.as_ref().unwrap();
    let (mut flux, mut centre, mut slope, mut slope_of_flux) = (0.0, 0.0, 0.0, 0.0);
    for (cell, (derivative, quanta)) in map.iter().zip(quanta).enumerate() {
        let (x, area) = (((cell % 16) as f64 + 0.5) * 2.5 - 20.0, 2.5 * 2.5);
        let weight = *quanta as f64 / (1_u64 << 52) as f64 / 2_000.0;
        flux += weight;
        centre += weight * x;
        slope += derivative * area * x;
        slope_of_flux += derivative * area;
    }
    assert!(flux > 0.99, "{parameter}: all light meets the screen, not {flux}");
    (slope - centre / flux * slope_of_flux) / flux
}

/// A mirror turned by t sends the beam off by 2 t: its centre moves by 2 L / cos^2(2 t).
#[test]
fn a_mirror_moves_the_centre_by_its_formula() {
    let turn = 0.1_f64;
    let mirror = format!(
        r#"{{"name": "M", "shape": {{"type": "plane", "width": 30, "height": 30}}, "interaction": "reflective",
            "reflectance": 1.0, "cs": {{"z": 10, "ry": {turn}}}}}"#
    );
    let slope = slope_of_centre(&mirror, -30.0, 0.0, "M.ry");
    let expected = 2.0 * 40.0 / (2.0 * turn).cos().powi(2);
    assert!((slope.abs() - expected).abs() < 1e-4 * expected, "{slope}: {expected}");
}

/// A prism whose back is turned by a sends the beam off by d = asin(n sin a) - a: its centre moves by L / cos^2 d times that.
#[test]
fn a_prism_moves_the_centre_by_its_formula() {
    let (n, a) = (1.5_f64, 0.2_f64);
    let clear = r#""coating": {"type": "simple", "reflectance": 0.0, "transmittance": 1.0}"#;
    let prism = format!(
        r#"{{"name": "front", "shape": {{"type": "plane", "width": 30, "height": 30}}, "interaction": "refractive",
            "cs": {{"z": 0}}, "material_back": {{"type": "medium", "name": "glass"}}, {clear}}},
        {{"name": "back", "shape": {{"type": "plane", "width": 30, "height": 30}}, "interaction": "refractive",
            "cs": {{"z": 5, "ry": {a}}}, "material_front": {{"type": "medium", "name": "glass"}}, {clear}}}"#
    );
    let length = 50.0;
    let refracted = (n * a.sin()).asin();
    let rate = length / (refracted - a).cos().powi(2);
    for (parameter, expected) in [
        ("back.ry", rate * (n * a.cos() / refracted.cos() - 1.0)),
        ("glass.n", rate * a.sin() / refracted.cos()),
    ] {
        let slope = slope_of_centre(&prism, 5.0 + length, 0.0, parameter);
        assert!((slope.abs() - expected).abs() < 1e-4 * expected, "{parameter}: {slope}, not {expected}");
    }
}

/// A thin lens sends a beam at the height h to h (1 - z / f), with 1 / f = (n - 1) (1 / r1 - 1 / r2): its focus moves with r1.
#[test]
fn a_thin_lens_moves_the_centre_by_its_formula() {
    let (r1, r2, z, h) = (50.0_f64, -80.0_f64, 60.0, 0.05);
    let clear = r#""coating": {"type": "simple", "reflectance": 0.0, "transmittance": 1.0}"#;
    let lens = format!(
        r#"{{"name": "front", "shape": {{"type": "conic", "radius": {r1}, "conic": 0, "aperture_radius": 5}},
            "interaction": "refractive", "cs": {{"z": 0}}, "material_back": {{"type": "medium", "name": "glass"}}, {clear}}},
        {{"name": "back", "shape": {{"type": "conic", "radius": {r2}, "conic": 0, "aperture_radius": 5}},
            "interaction": "refractive", "cs": {{"z": 1e-3}}, "material_front": {{"type": "medium", "name": "glass"}}, {clear}}}"#
    );
    for (parameter, expected) in [
        ("front.radius", h * z * 0.5 / (r1 * r1)),
        ("back.radius", -h * z * 0.5 / (r2 * r2)),
        ("glass.n", -h * z * (1.0 / r1 - 1.0 / r2)),
    ] {
        let slope = slope_of_centre(&lens, z, h, parameter);
        assert!((slope - expected).abs() < 1e-3 * expected.abs(), "{parameter}: {slope}, not {expected}");
    }
}

/// A coating of R = 0 and T on a plate whose other face has F: it sends back R + T^2 F / (1 - R F), whose derivative by R is
/// 1 + (T F)^2. Branches without light are drawn where their probability is chosen.
#[test]
fn a_coating_that_reflects_nothing_has_the_derivative_of_its_formula() {
    let text = r#"{"nsq_schema_version": 1, "components": [],
        "sources": [{"name": "beam", "type": "collimated", "total_flux": 2.0, "aperture_radius": 1.0, "cs": {"z": -5.0},
            "spectrum": {"wavelengths": [0.5], "weights": [1.0]}}],
        "detectors": [{"name": "before", "type": "irradiance", "width": 8.0, "height": 8.0, "num_pixels_x": 2,
            "num_pixels_y": 2, "splat": "hard", "cs": {"z": -20.0}}],
        "nsq_gpu": {"version": 1, "media": {"glass": {"type": "constant", "n": 1.8, "k": 0.0}},
            "sampling": {"rr_start_flux": 0.0, "reflect_prob": 0.5},
            "surfaces": [
                {"name": "front", "shape": {"type": "plane", "width": 30, "height": 30}, "interaction": "refractive",
                    "cs": {"z": 0}, "material_back": {"type": "medium", "name": "glass"},
                    "coating": {"type": "simple", "reflectance": 0.0, "transmittance": 0.9}},
                {"name": "back", "shape": {"type": "plane", "width": 30, "height": 30}, "interaction": "refractive",
                    "cs": {"z": 3}, "material_front": {"type": "medium", "name": "glass"}}]}}"#;
    let scene = differentiated(text, &["front.reflectance"]);
    let options = TraceOptions { max_depth: 64, ..zoo::options(1_000_000, 4, Precision::F64) };
    let found = scene.gradients(zoo::gpu(), &options, how(), |_| true).unwrap().0;
    let f = (0.8_f64 / 2.8).powi(2);
    let expected = 2.0 * (1.0 + (0.9 * f).powi(2));
    let (slope, error) = (found[0].flux, found[0].standard_error.unwrap());
    assert!(
        (slope - expected).abs() < 4.0 * error && error < 3e-3 * expected,
        "{slope} ± {error}: {expected}"
    );
    assert_eq!(found[0].num_lost, 0);
}

/// A sphere has a derivative by its conic constant, though spheres alone have a shorter text.
#[test]
fn a_sphere_has_a_derivative_by_its_conic_constant() {
    let by_conic = |conic: &str| {
        let text = BENCH.replace("\"conic1\": -0.3", conic);
        let scene = differentiated(&text, &["L1.conic1", "image.z"]);
        let options = zoo::options(20_000, 3, Precision::F64);
        let found = scene.gradients(zoo::gpu(), &options, how(), |_| true).unwrap().0;
        found[0].map.clone().unwrap()
    };
    let (sphere, nearly) = (by_conic("\"conic1\": 0"), by_conic("\"conic1\": 1e-9"));
    let largest = sphere.iter().fold(0.0, |largest: f64, value| largest.max(value.abs()));
    assert!(largest > 0.0);
    let apart = (&sphere - &nearly).iter().fold(0.0, |apart: f64, value| apart.max(value.abs()));
    assert!(apart < 1e-6 * largest, "{apart:e} of {largest:e}");
}

/// A scene of more faces than are compiled in, among them many that no ray meets: the map is that of the scene without.
#[test]
fn scenes_of_many_faces_have_derivatives() {
    let with = |num: usize| {
        let spare = |i: usize| {
            let z = 60 + i;
            format!(
                r#"{{"name": "spare{i}", "shape": {{"type": "plane", "width": 60, "height": 60}},
                "interaction": "absorbing", "cs": {{"z": {z}}}}}, "#
            )
        };
        let spares: String = (0..num).map(spare).collect();
        let text = BENCH.replace("\"surfaces\": [", &format!("\"surfaces\": [{spares}"));
        let scene = differentiated(&text, &["L1.r1"]);
        let options = zoo::options(5_000, 3, Precision::F64);
        let found = scene.gradients(zoo::gpu(), &options, how(), |_| true).unwrap().0;
        found[0].map.clone().unwrap()
    };
    let (few, many) = (with(0), with(200));
    let largest = few.iter().fold(0.0, |largest: f64, value| largest.max(value.abs()));
    let apart = (&few - &many).iter().fold(0.0, |apart: f64, value| apart.max(value.abs()));
    assert!(apart <= 1e-9 * largest && largest > 0.0, "{apart:e} of {largest:e}");
}

/// Of so many rays, the derivative of the map is that of central differences to 1 % of all its pixels, and that of the flux
/// within three errors. The steps are so small that their own error does not show. Five events let light reach the image that
/// no face reflects: ghosts cross the border of the image, and the difference of 1e8 rays sees that.
#[test]
#[ignore = "long"]
fn derivatives_of_1e8_rays_are_those_of_differences_to_1_percent() {
    let options = TraceOptions { max_depth: 5, ..zoo::options(100_000_000, 5, Precision::F64) };
    let steps = [("L1.r1", 0.5), ("L1.rx", 2e-3), ("glass.n", 2e-3), ("\"filter.back\".transmittance", 0.02)];
    for (name, step) in steps {
        let scene = differentiated(BENCH, &[name]);
        let found = scene.gradients(zoo::gpu(), &options, how(), |_| true).unwrap().0;
        let difference = central_difference(BENCH, name, step, &options);
        let theirs = &difference.detectors[0];
        let (map, expected) =
            (found[0].map.as_ref().unwrap(), &theirs.map.as_ref().unwrap().values / (2.0 * step));
        let size = |map: &ndarray::ArrayD<f64>| map.iter().map(|value| value.abs()).sum::<f64>();
        let apart = size(&(map - &expected)) / size(&expected);
        let (flux, error) = (theirs.flux.difference / (2.0 * step), theirs.flux.standard_error.unwrap());
        let sigma = found[0].standard_error.unwrap().hypot(error / (2.0 * step));
        println!("{name}: {apart:.5} of the map, {:.2} sigmas of the flux", (found[0].flux - flux) / sigma);
        assert!(apart < 0.01, "{name}: {apart} of the map");
        assert!((found[0].flux - flux).abs() < 3.0 * sigma, "{name}: {} not {flux} ± {sigma}", found[0].flux);
    }
}

/// The mean over seeds is that of many rays, and lies within two errors of one seed as often as Student's distribution of 64
/// blocks says: for the flux, and for pixels of a twentieth of the largest derivative at least.
fn check_seeds(seeds: u64, rays_of_truth: u64, shares: std::ops::Range<f64>) {
    let names = ["L1.r1", "image.z", "glass.n"];
    let scene = differentiated(BENCH, &names);
    let cache = nsq_gpu::run::PipelineCache::new();
    let numbers = |num_rays: u64, seed: u64| -> Vec<Vec<(f64, f64)>> {
        let how = How { cache: Some(&cache), ..How::default() };
        let options = zoo::options(num_rays, seed, Precision::F64);
        let found = scene.gradients(zoo::gpu(), &options, how, |_| true).unwrap().0;
        let of_one = |one: &Gradient| {
            let (map, errors) = (one.map.as_ref().unwrap(), one.map_errors.as_ref().unwrap());
            let flux = (one.flux, one.standard_error.unwrap());
            std::iter::once(flux).chain(map.iter().copied().zip(errors.iter().copied())).collect()
        };
        found.iter().map(of_one).collect()
    };
    let all: Vec<_> = (0..seeds).map(|seed| numbers(20_000, seed)).collect();
    let truth = numbers(rays_of_truth, seeds);
    for (parameter, name) in names.iter().enumerate() {
        let count = truth[parameter].len();
        let mean = |number: usize| all.iter().map(|of| of[parameter][number].0).sum::<f64>() / seeds as f64;
        let means: Vec<f64> = (0..count).map(mean).collect();
        let largest = means[1..].iter().fold(0.0, |largest: f64, mean| largest.max(mean.abs()));
        let (mut covered, mut num, mut worst) = (0_u64, 0_u64, 0.0_f64);
        for number in (0..count).filter(|&i| i == 0 || means[i].abs() > 0.05 * largest) {
            let is_covered = |of: &&Vec<Vec<(f64, f64)>>| {
                let (value, error) = of[parameter][number];
                (value - means[number]).abs() <= 1.9983 * error
            };
            covered += all.iter().filter(is_covered).count() as u64;
            num += seeds;
            let square = |of: &Vec<Vec<(f64, f64)>>| (of[parameter][number].0 - means[number]).powi(2);
            let variance = all.iter().map(square).sum::<f64>() / (seeds * (seeds - 1)) as f64;
            let (value, error) = truth[parameter][number];
            worst = worst.max((means[number] - value).abs() / error.hypot(variance.sqrt()));
        }
        let share = covered as f64 / num as f64;
        println!("{name}: {share:.4} of {num} intervals, means within {worst:.2} errors");
        assert!(shares.contains(&share), "{name}: {share}");
        assert!(worst < 4.5, "{name}: {worst} errors off");
    }
}

/// Pixels of one seed share rays, so that the share scatters more than that of as many free draws.
#[test]
fn derivatives_are_unbiased_and_their_errors_are_right() {
    check_seeds(48, 2_000_000, 0.92..0.98);
}

#[test]
#[ignore = "long"]
fn derivatives_are_unbiased_and_their_errors_are_right_over_2000_seeds() {
    check_seeds(2000, 40_000_000, 0.935..0.965);
}

#[test]
fn what_has_no_derivative_is_refused_by_name() {
    let refused = |text: &str, name: &str| {
        let found = Differentiated::new(text, &oracle(), &[], &[name.to_string()], |_| Ok(()));
        found.map(|_| ()).unwrap_err().to_string()
    };
    let said = refused(BENCH, "L2.r1");
    assert!(said.contains("nothing in the scene is called \"L2\"") && said.contains("L1"), "{said}");
    let said = refused(BENCH, "L1.material");
    assert!(said.contains("no single number"), "{said}");
    let split = BENCH.replace("\"rr_start_flux\": 1e-6", "\"split_depth\": 2");
    let said = refused(&split, "L1.r1");
    assert!(said.contains("split rays") && said.contains("nsq-gpu diff"), "{said}");
    let mesh = std::fs::read_to_string(oracle().join("../../../scenes/mesh_prism.json")).unwrap();
    let scene: Value = serde_json::from_str(&mesh).unwrap();
    let source = scene["sources"][0]["name"].as_str().unwrap();
    let said = refused(&mesh, &format!("{source}.total_flux"));
    assert!(said.contains("meshes"), "{said}");
    let flat = BENCH.replace("\"r2\": -60.0", "\"r2\": 0");
    let said = refused(&flat, "L1.r2");
    assert!(said.contains("flat face") && said.contains("1e6"), "{said}");
    let endless = BENCH.replace("\"r2\": -60.0", "\"r2\": \"Infinity\"");
    let said = refused(&endless, "L1.r2");
    assert!(said.contains("L1.r2") && said.contains("1e6"), "{said}");
    let said = refused(BENCH, "image.num_pixels_x");
    assert!(said.contains("`image.num_pixels_x` cannot be changed a little"), "{said}");
    let twice = ["\"filter.back\".z", "\"filter.back\".\"z\""].map(String::from);
    let said = Differentiated::new(BENCH, &oracle(), &[], &twice, |_| Ok(())).unwrap_err().to_string();
    assert!(said.contains("named twice"), "{said}");
    // No ray takes a branch without light.
    let dark = BENCH.replace("\"reflectance\": 0.2", "\"reflectance\": 0.0");
    let said = refused(&dark, "\"filter.back\".reflectance");
    assert!(said.contains("no ray takes the branch"), "{said}");
    let unlit = BENCH.replace("\"total_flux\": 0.5", "\"total_flux\": 0");
    let said = refused(&unlit, "lamp.total_flux");
    assert!(said.contains("`lamp.total_flux` is 0: a dark source"), "{said}");
    // Two faces that touch, and part with the parameter.
    let touching = BENCH.replace("\"cs\": {\"z\": 22}", "\"cs\": {\"z\": 20}");
    let scene = differentiated(&touching, &["\"filter.back\".z"]);
    let options = zoo::options(100, 0, Precision::F64);
    let found = scene.gradients(zoo::gpu(), &options, how(), |_| true);
    let said = found.unwrap_err().to_string();
    assert!(said.contains("filter.back") && said.contains("faces touch"), "{said}");
    let points = TraceOptions { sampler: nsq_gpu::program::Sampler::Sobol, ..options };
    let scene = differentiated(BENCH, &["L1.r1"]);
    let found = scene.gradients(zoo::gpu(), &points, how(), |_| true);
    assert!(found.unwrap_err().to_string().contains("--sampler sobol"));
}

/// Errors planted in the text of derivatives: the oracle by the same draws finds each of them.
#[test]
fn planted_errors_are_found() {
    let errors = [
        ("absorbing_singlet", "glass.k", "exp_real(-absorption * distance)", "exp_real(-absorption)"),
        ("absorbing_singlet", "glass.n", "before * (share / detached(share))", "before"),
        (
            "singlet",
            "L.r1",
            "hit.distance - crossing_step(ray, hit)",
            "hit.distance + crossing_step(ray, hit)",
        ),
        ("singlet", "L.r1", "detached(2.0 * slope_along(o, d, q))", "detached(slope_along(o, d, q))"),
        ("singlet", "L.r2", "note_detected(taps.cells.y, shares.y)", "note_detected(taps.cells.x, shares.y)"),
        ("singlet", "L.r2", "weight - (shares.x + shares.y + shares.z)", "weight - (shares.x + shares.y)"),
        ("singlet", "glass.n", "select(1u, 2u, tangent < 0.0)", "1u"),
        ("gaussian_screen", "L.r1", "note_detected(cell, share)", "note_detected(cell, 0.5 * share)"),
        (
            "scattering_mirror",
            "M.surface.scatter_fraction",
            "select(1.0 - fraction, fraction, scatters)",
            "fraction",
        ),
        (
            "ghosts",
            "glass.n",
            "select(after / select(before, 1.0, before == 0.0), 1.0, before == 0.0)",
            "1.0",
        ),
        ("ghosts", "glass.n", "reflected / p, reflects", "reflected, reflects"),
    ];
    for (name, parameter, text, wrong) in zoo::in_turn(errors) {
        let (scene, theirs) = of_oracle(name);
        let scene = differentiated(&scene, &[parameter]);
        let edit = planted(text, wrong);
        let options = zoo::options(2000, 1, Precision::F64);
        let how = How { edit: Some(&edit), ..How::default() };
        let found = scene.gradients(zoo::gpu(), &options, how, |_| true).unwrap().0;
        let data = numbers(&theirs["parameters"][parameter]["data"]);
        let sum_of_sizes: f64 = data.iter().map(|value| value.abs()).sum();
        let slopes = of_pixel_flux(&found[0], &scene.ir, parameter, &numbers(&theirs["data"]));
        let worst = slopes.iter().zip(&data).fold(0.0, |worst: f64, (a, b)| worst.max((a - b).abs()));
        assert!(worst > 1e-6 * sum_of_sizes, "{name} {parameter}: `{wrong}` changes nothing");
    }
}

/// Adjoints of all cells of all detectors, which differ from cell to cell.
fn some_adjoints(scene: &Differentiated) -> Vec<Vec<f64>> {
    let of = |(number, num): (usize, usize)| {
        (0..num).map(|cell| ((number * 7 + cell * 13) % 17) as f64 / 8.0 - 0.9).collect()
    };
    scene.adjoint_lengths().enumerate().map(of).collect()
}

/// The gradients of a loss back, then forward: by the same draws.
fn back_and_forward(text: &str, names: &[&str], options: &TraceOptions) -> [LossGradient; 2] {
    let scene = differentiated(text, names);
    let adjoints = some_adjoints(&scene);
    [false, true].map(|forward| {
        let how = How { forward, ..how() };
        scene.loss_gradient(zoo::gpu(), options, how, &adjoints, |_| true).unwrap()
    })
}

/// Each number, from the last deposit back and from itself forward: two programs, derived in two ways from one text. Gives how
/// many numbers were differentiated forward on both sides.
fn check_back(what: &str, text: &str, names: &[&str], options: &TraceOptions, tolerance: f64) -> usize {
    let [back, forward] = back_and_forward(text, names, options);
    assert_eq!((back.num_lost, forward.num_lost), (0, 0), "{what}");
    for ((name, back), forward) in names.iter().zip(&back.values).zip(&forward.values) {
        assert!(
            (back - forward).abs() <= tolerance * forward.abs() + 1e-12,
            "{what} {name}: back {back:e}, forward {forward:e}"
        );
    }
    back.num_forward
}

const NAMES: [&str; 20] = [
    "L1.x",
    "L1.z",
    "L1.rx",
    "L1.thickness",
    "L1.r1",
    "L1.r2",
    "L1.conic1",
    "image.z",
    "image.ry",
    "image.width",
    "beam.aperture_radius",
    "beam.x",
    "beam.ry",
    "beam.total_flux",
    "lamp.half_angle_deg",
    "lamp.x",
    "glass.n",
    "smoked.k",
    "\"filter.back\".z",
    "\"filter.front\".ry",
];

#[test]
fn the_way_back_is_the_way_forward() {
    let options = TraceOptions { num_rays: 20_000, ..zoo::options(0, 5, Precision::F64) };
    assert_eq!(check_back("f64", BENCH, &NAMES, &options, 1e-12), 0);
}

/// A gradient has the precision of the tier.
#[test]
fn the_way_back_has_the_precision_of_the_tier() {
    let of = |precision| {
        let scene = differentiated(BENCH, &["L1.r1", "glass.n", "image.z"]);
        let options = zoo::options(2000, 5, precision);
        let adjoints = some_adjoints(&scene);
        scene.loss_gradient(zoo::gpu(), &options, how(), &adjoints, |_| true).unwrap().values
    };
    let exact = of(Precision::F64);
    for (precision, tolerance) in zoo::in_turn([(Precision::F32, 1e-5), (Precision::Df64, 1e-11)]) {
        for (value, exact) in of(precision).iter().zip(&exact) {
            assert!(
                (value - exact).abs() <= tolerance * exact.abs(),
                "{precision:?}: {value:e}, not {exact:e}"
            );
        }
    }
}

/// Whatever the batches, the workgroups and the other parameters, a gradient has the same bits.
#[test]
#[ignore = "long"]
fn the_way_back_has_the_same_bits_however_it_is_gone() {
    let options = zoo::options(5000, 2, Precision::F64);
    let of = |gpu, names: &[&str], options: &TraceOptions| {
        let scene = differentiated(BENCH, names);
        let adjoints = some_adjoints(&scene);
        let found = scene.loss_gradient(gpu, options, How::default(), &adjoints, |_| true).unwrap();
        found.values[names.iter().position(|name| *name == "L1.r1").unwrap()]
    };
    let alone = of(zoo::gpu(), &["L1.r1"], &options);
    for (names, options) in [
        (&["L1.r1"][..], TraceOptions { batch_size: Some(700), ..options.clone() }),
        (&["L1.r1"], TraceOptions { workgroup_size: 32, ..options.clone() }),
        (&["L1.x", "glass.n", "L1.r1", "image.z", "L1.r2"], options.clone()),
    ] {
        assert_eq!(of(zoo::gpu(), names, &options), alone, "{names:?}");
    }
    assert_eq!(of(zoo::portable_gpu(), &["L1.r1"], &options), alone, "portable integers");
}

/// A file of scenes, with whatever it is made of: a number of each source, detector, component and face.
fn some_names(scene: &Value) -> Vec<String> {
    let entries = |list: &Value| list.as_array().cloned().unwrap_or_default();
    let of = |list: &Value, most: usize, keys: &[&str]| -> Vec<String> {
        let all = entries(list).into_iter().take(most).flat_map(|entry| {
            let name = entry["name"].as_str().unwrap_or_default().to_owned();
            let name = if name.contains(['.', ',']) { format!("\"{name}\"") } else { name };
            keys.iter().map(|key| format!("{name}.{key}")).collect::<Vec<_>>()
        });
        all.collect()
    };
    [
        of(&scene["sources"], 2, &["total_flux"]),
        of(&scene["detectors"], 1, &["z"]),
        of(&scene["components"], 1, &["x", "r1", "radius"]),
        of(&scene["nsq_gpu"]["surfaces"], 1, &["z", "radius"]),
    ]
    .concat()
}

/// What [`check_scene`] found.
#[derive(Debug)]
struct BothWays {
    /// Derivatives that were compared.
    num_compared: usize,
    /// Why both sides went forward.
    why_forward: Option<String>,
    /// Numbers that both ways refuse, as what acts at edges alone.
    at_edges: Vec<String>,
    /// Numbers some of whose derivatives both ways count as too large to be summed.
    too_large: Vec<String>,
}

/// Compares both ways by some numbers of a scene.
fn check_scene(name: &str) -> BothWays {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("scenes/{name}.json"));
    let text = std::fs::read_to_string(&path).unwrap();
    let scene: Value = serde_json::from_str(&text.replace("Infinity", "null")).unwrap();
    let folder = path.parent().unwrap();
    let of = |names: &[String]| Differentiated::new(&text, folder, &[], names, |_| Ok(()));
    // More events than the way back keeps at once.
    let options = TraceOptions { max_depth: 40, ..zoo::options(500, 3, Precision::F64) };
    let mut names: Vec<String> =
        some_names(&scene).into_iter().filter(|name| of(std::slice::from_ref(name)).is_ok()).collect();
    let gradient = |scene: &Differentiated, forward: bool| {
        let how = How { forward, ..how() };
        scene.loss_gradient(zoo::gpu(), &options, how, &some_adjoints(scene), |_| true)
    };
    let [mut at_edges, mut too_large] = [vec![], vec![]];
    loop {
        // Meshes and split rays have no derivatives.
        let Ok(scene) = of(&names) else {
            return BothWays { num_compared: 0, why_forward: None, at_edges, too_large };
        };
        let (back, forward) = match (gradient(&scene, false), gradient(&scene, true)) {
            (Ok(back), Ok(forward)) => (back, forward),
            (back, forward) => {
                let [back, forward] = [back, forward].map(|found| found.unwrap_err().to_string());
                assert_eq!(back, forward, "{name}");
                assert!(back.contains("acts at edges alone"), "{name}: {back}");
                let number = names.iter().position(|name| back.contains(&format!("`{name}`"))).unwrap();
                at_edges.push(names.remove(number));
                continue;
            }
        };
        assert_eq!(back.num_lost, forward.num_lost, "{name}");
        if back.num_lost > 0 {
            let is_too_large = |name: &String| {
                gradient(&of(std::slice::from_ref(name)).unwrap(), false).unwrap().num_lost > 0
            };
            too_large.extend(names.extract_if(.., |name| is_too_large(name)));
            continue;
        }
        for ((parameter, back), forward) in names.iter().zip(&back.values).zip(&forward.values) {
            // Parts of a gradient may cancel.
            assert!(
                (back - forward).abs() <= 1e-11 * forward.abs() + 1e-12,
                "{name} {parameter}: back {back:e}, forward {forward:e}"
            );
        }
        return BothWays { num_compared: names.len(), why_forward: back.why_forward, at_edges, too_large };
    }
}

/// With sources, shapes, scattering and detectors of all kinds, and paths of more events than are kept at once.
#[test]
fn the_way_back_is_the_way_forward_in_other_scenes() {
    for name in zoo::in_turn([
        "integrating_sphere",
        "scattering_telescope",
        "telephoto_spectral",
        "tapered_light_guide",
    ]) {
        let found = check_scene(name);
        assert!(found.num_compared > 1 && found.why_forward.is_none(), "{name}: {found:?}");
    }
    let found = check_scene("bench_surface_count_50");
    assert!(found.num_compared > 1 && found.why_forward.unwrap().contains("many surfaces"));
}

#[test]
#[ignore = "long"]
fn the_way_back_is_the_way_forward_in_every_scene() {
    let found: Vec<BothWays> = zoo::scenes().iter().map(|name| check_scene(name)).collect();
    let num_forward = found.iter().filter(|scene| scene.why_forward.is_some()).count();
    let num_refused = found.iter().filter(|scene| scene.num_compared == 0).count();
    assert_eq!((num_forward, num_refused), (7, 3), "{found:?}");
    let at_edges: Vec<&String> = found.iter().flat_map(|scene| &scene.at_edges).collect();
    assert_eq!(at_edges, ["near.z", "between.z", "image.z", "exit_map.z"], "{found:?}");
    // Forty events between balls make 1 mm many times the size of the world.
    let too_large: Vec<&String> = found.iter().flat_map(|scene| &scene.too_large).collect();
    assert_eq!(too_large, ["wall_0.z"], "{found:?}");
}

/// Two mirrors, between which light goes to and fro some 30 times: more events than the way back keeps at once.
const DEEP: &str = r#"{
    "nsq_schema_version": 1,
    "components": [],
    "sources": [{"name": "beam", "type": "collimated", "total_flux": 1.0, "aperture_radius": 0.4, "cs": {"z": -30.0, "rx": 0.8},
        "spectrum": {"wavelengths": [0.5], "weights": [1.0]}}],
    "detectors": [{"name": "screen", "type": "irradiance", "width": 8.0, "height": 8.0, "num_pixels_x": 8, "num_pixels_y": 8,
        "cs": {"z": 31.0}}],
    "nsq_gpu": {
        "version": 1,
        "sampling": {"rr_start_flux": 0.0},
        "surfaces": [
            {"name": "above", "shape": {"type": "plane", "width": 60, "height": 60}, "interaction": "reflective",
                "reflectance": 0.97, "cs": {"y": 1.0, "rx": 1.5707963267948966}},
            {"name": "below", "shape": {"type": "plane", "width": 60, "height": 60}, "interaction": "reflective",
                "reflectance": 0.98, "cs": {"y": -1.0, "rx": 1.5707963267948966}}]
    }
}"#;

/// Beyond the events that are kept, the ray is traced again. Each derivative is that of a product of 30 factors.
#[test]
fn long_paths_are_walked_back_in_parts() {
    let options = TraceOptions { max_depth: 60, ..zoo::options(500, 1, Precision::F64) };
    let scene = differentiated(DEEP, &["above.reflectance", "below.y", "beam.rx", "above.rx"]);
    let tally = zoo::trace(&scene.ir, &options);
    let events = tally.surfaces.iter().map(|surface| surface.absorbed.count).sum::<u64>();
    assert!(events > 20 * 500, "{events} events of 500 rays");
    let names = ["above.reflectance", "below.y", "beam.rx", "above.rx"];
    assert_eq!(check_back("deep", DEEP, &names, &options, 1e-11), 0);
}

#[test]
fn errors_planted_in_the_way_back_are_found() {
    let errors = [
        ("singlet", "L.r1", "(*ray).position -= select(", "(*ray).position += select("),
        ("singlet", "L.r1", "last_hit = Hit((*kept).distances[at],", "last_hit = Hit(0.0,"),
        ("singlet", "glass.n", "(*ray).fresnel = stream_before((*ray).fresnel);", ""),
        ("bench", "beam.total_flux", "adjoint.weight * source().weight", "adjoint.weight"),
        ("singlet", "L.r2", "settle_back(ray, &adjoint);", ""),
        ("absorbing_singlet", "glass.k", "(*kept).media[at] = before.medium;", ""),
        (
            "absorbing_singlet",
            "glass.n",
            "(*kept).weights[at] = before.weight;",
            "(*kept).weights[at] = 1.0;",
        ),
        ("scattering_telescope", "relay.r1", "(*ray).bounce = event;", "(*ray).bounce = 0u;"),
        ("deep", "above.reflectance", "event % NUM_KEPT", "min(event, NUM_KEPT - 1u)"),
        ("deep", "above.reflectance", "left = first;", "left = 0u;"),
    ];
    for (name, parameter, text, wrong) in zoo::in_turn(errors) {
        let scene = match name {
            "deep" => DEEP.to_owned(),
            "bench" => BENCH.to_owned(),
            "scattering_telescope" => include_str!("../scenes/scattering_telescope.json").to_owned(),
            name => of_oracle(name).0,
        };
        let scene = differentiated(&scene, &[parameter]);
        let options = TraceOptions { max_depth: 40, ..zoo::options(2000, 1, Precision::F64) };
        let adjoints = some_adjoints(&scene);
        let edit = planted(text, wrong);
        let of = |edit: Option<&dyn Fn(String) -> String>| {
            // An error may leave nothing, as if the parameter acted at edges alone.
            let how = How { edit, with_edges: true, ..how() };
            scene.loss_gradient(zoo::gpu(), &options, how, &adjoints, |_| true).unwrap().values[0]
        };
        let (right, found) = (of(None), of(Some(&edit)));
        assert!((found - right).abs() > 1e-6 * right.abs(), "{name} {parameter}: `{wrong}` changes nothing");
    }
}

/// A ray whose adjoint is no number is lost alone, as one that ends at no position is: the other rays of its invocation still
/// count.
#[test]
fn a_ray_without_an_adjoint_is_lost_alone() {
    let scene = differentiated(BENCH, &["L1.r1", "glass.n", "beam.total_flux"]);
    let options = zoo::options(1000, 1, Precision::F64);
    let adjoints = some_adjoints(&scene);
    let of = |edit: &dyn Fn(String) -> String| {
        let how = How { edit: Some(edit), ..How::default() };
        scene.loss_gradient(zoo::gpu(), &options, how, &adjoints, |_| true).unwrap()
    };
    let back = "generate_back(index, adjoint);";
    let no_number =
        format!("if index == 70u {{ adjoint.position.x = (noted - noted) / (noted - noted); }} {back}");
    let no_number = planted(back, &no_number);
    let position = "is_valid = has_position(ray);";
    let no_position = planted(position, "is_valid = has_position(ray) & (index != 71u);");
    let first = "fn walk(index: u32) {";
    let skipped = planted(first, "fn walk(index: u32) { if index == 70u || index == 71u { return; }");
    let whole = of(&|text| text);
    let lost = of(&|text| no_number(no_position(text)));
    let without = of(&skipped);
    // Two rays of each source.
    assert_eq!((whole.num_lost, lost.num_lost, without.num_lost), (0, 4, 0));
    for ((whole, lost), without) in whole.values.iter().zip(&lost.values).zip(&without.values) {
        assert!((lost - without).abs() <= 1e-13 * without.abs(), "{lost:e}, not {without:e}");
        assert!((whole - without).abs() > 1e-6 * whole.abs(), "these rays give nothing");
    }
}

/// A wide splat takes many iterations: fewer rays share an invocation, and where a driver cuts loops short all the same, the loss is
/// differentiated forward. No ray is dropped.
#[test]
fn wide_splats_lose_no_ray() {
    let options = zoo::options(300, 5, Precision::F64);
    for (sigma, is_cut) in [(4.0, false), (12.0, false), (40.0, true)] {
        let screen =
            format!(r#""num_pixels_y": 8, "splat": "gaussian", "splat_sigma": {sigma}, "cs": {{"z": 40.0}}"#);
        let text = BENCH.replace("\"num_pixels_y\": 8, \"cs\": {\"z\": 40.0}", &screen);
        assert!(text.contains("gaussian"));
        let num_forward = check_back("wide", &text, &["L1.r1", "image.z"], &options, 1e-9);
        assert_eq!(num_forward > 0, is_cut, "{sigma}: {num_forward}");
    }
}

/// An aspheric lens: its coefficients are numbers of a list. The difference of two traces sees the whole change, because light
/// stays clear of the rim.
#[test]
fn coefficients_of_aspheres_have_derivatives() {
    let text = r#"{"nsq_schema_version": 1, "components": [],
        "sources": [{"name": "beam", "type": "collimated", "total_flux": 1.0, "aperture_radius": 6.0, "cs": {"z": -20.0},
            "spectrum": {"wavelengths": [0.5], "weights": [1.0]}}],
        "detectors": [{"name": "image", "type": "irradiance", "width": 8.0, "height": 8.0, "num_pixels_x": 8,
            "num_pixels_y": 8, "splat": "bilinear", "absorb": true, "cs": {"z": 30.0}}],
        "nsq_gpu": {"version": 1, "media": {"glass": {"type": "constant", "n": 1.5, "k": 0.0}}, "surfaces": [
            {"name": "front", "shape": {"type": "even_asphere", "radius": 40.0, "conic": -0.5, "coefficients": [0.0, 2e-5, 1e-8],
                "aperture_radius": 10.0}, "cs": {}, "interaction": "refractive", "material_back": {"type": "medium", "name": "glass"}},
            {"name": "back", "shape": {"type": "plane", "width": 40, "height": 40}, "interaction": "refractive",
                "material_front": {"type": "medium", "name": "glass"}, "cs": {"z": 5.0}}]}}"#;
    // The first coefficient is 0, the second of the usual size.
    let names = ["front.coefficients.0", "front.coefficients.1", "front.coefficients.2", "front.radius"];
    let options = zoo::options(50_000, 5, Precision::F64);
    assert_eq!(check_back("asphere", text, &names, &options, 1e-11), 0);
    check_differences(text, &[(names[0], 2e-6), (names[1], 4e-7)], &options, false, 5);
}

/// A short difference of two traces confirms the gradient of a loss of light that stays clear of edges, and of no other.
#[test]
fn a_short_difference_confirms_what_stays_clear_of_edges() {
    let wide = BENCH.replace("\"aperture_radius\": 8.0", "\"aperture_radius\": 20.0");
    assert_ne!(wide, BENCH);
    let names = ["glass.n", "L1.r1", "beam.total_flux", "lamp.z", "L1.front_aperture_radius"];
    let cache = nsq_gpu::run::PipelineCache::new();
    let not_confirmed = |text: &str, num_rays: u64, cache, is_flux: bool| {
        let scene = differentiated(text, &names);
        let options = zoo::options(num_rays, 5, Precision::F64);
        let flux = || scene.adjoint_lengths().map(|num| vec![1.0; num]).collect();
        let adjoints = if is_flux { flux() } else { some_adjoints(&scene) };
        let how = How { with_edges: true, ..How::default() };
        let found = scene.loss_gradient(zoo::gpu(), &options, how, &adjoints, |_| true).unwrap();
        let apart = scene.not_confirmed(zoo::gpu(), &options, cache, &adjoints, &found, |_| true).unwrap();
        apart.into_iter().map(|(number, _)| names[number]).collect::<Vec<_>>()
    };
    for num_rays in zoo::in_turn([100, 5_000, 50_000]) {
        assert_eq!(not_confirmed(BENCH, num_rays, None, false), Vec::<&str>::new(), "{num_rays} rays");
    }
    for cache in zoo::in_turn([None, Some(&cache)]) {
        let found = not_confirmed(&wide, 50_000, cache, true);
        assert!(
            found.contains(&"L1.front_aperture_radius") && !found.contains(&"beam.total_flux"),
            "{found:?}"
        );
    }
}

/// A larger lens lets more of a wide beam through: the interior sees nothing of that, and a difference sees it. So it is refused,
/// unless the difference is asked for. Of light that stays clear of edges, both see the same.
#[test]
fn what_crosses_edges_is_told_on_request() {
    let options = TraceOptions { num_rays: 100_000, ..zoo::options(0, 5, Precision::F64) };
    let of = |text: &str, name: &str| {
        let scene = differentiated(text, &[name]);
        let how = How { with_edges: true, ..How::default() };
        let mut found = scene.gradients(zoo::gpu(), &options, how, |_| true).unwrap().0;
        scene.add_edges(zoo::gpu(), &options, None, &mut found, |_| true).unwrap();
        found.swap_remove(0)
    };
    let clear = of(BENCH, "glass.n");
    let edges = clear.with_edges.as_ref().unwrap();
    let sigma = clear.standard_error.unwrap().hypot(edges.standard_error.unwrap());
    assert!((clear.flux - edges.flux).abs() <= 4.5 * sigma, "{clear:?}");
    assert!(clear.flux.abs() > 5.0 * sigma, "{clear:?}");
    let wide = BENCH.replace("\"aperture_radius\": 8.0", "\"aperture_radius\": 20.0");
    assert_ne!(wide, BENCH);
    let name = "L1.front_aperture_radius";
    let rim = of(&wide, name);
    let edges = rim.with_edges.as_ref().unwrap();
    assert_eq!(rim.flux, 0.0);
    assert!(edges.flux > 5.0 * edges.standard_error.unwrap(), "{rim:?}");
    let asked = |text: &str| {
        let scene = differentiated(text, &[name]);
        let maps = scene.gradients(zoo::gpu(), &options, how(), |_| true);
        let loss = scene.loss_gradient(zoo::gpu(), &options, how(), &some_adjoints(&scene), |_| true);
        (maps.map(|(maps, _)| maps[0].flux), loss.map(|loss| loss.values[0]))
    };
    let (maps, loss) = asked(&wide);
    for error in [maps.unwrap_err(), loss.unwrap_err()] {
        assert!(error.to_string().contains("`L1.front_aperture_radius` acts at edges alone"), "{error}");
    }
    // No light meets the rim.
    assert_eq!(asked(BENCH), (Ok(0.0), Ok(0.0)));
}

/// A flat mirror without loss. Moving it along itself changes what its rim clips, and moving it along its normal moves light among
/// pixels without a loss. Neither has a derivative of the flux. The former is refused, in spite of rounding; the latter is 0.
#[test]
fn edges_alone_are_told_from_a_derivative_of_0() {
    let scene = |beam: f64| {
        format!(
            r#"{{"nsq_schema_version": 1, "components": [],
            "sources": [{{"name": "beam", "type": "collimated", "total_flux": 2.0, "aperture_radius": {beam}, "cs": {{"z": -10.0}},
                "spectrum": {{"wavelengths": [0.5], "weights": [1.0]}}}}],
            "detectors": [{{"name": "screen", "type": "irradiance", "width": 30.0, "height": 30.0, "num_pixels_x": 8,
                "num_pixels_y": 8, "splat": "bilinear", "absorb": true, "cs": {{"x": 15.0, "rx": 0.0, "ry": 1.5707963267948966}}}}],
            "nsq_gpu": {{"version": 1, "surfaces": [
                {{"name": "M", "shape": {{"type": "plane", "width": 7, "height": 7}}, "interaction": "reflective", "reflectance": 1.0,
                    "cs": {{"x": 0.3, "y": 1.4, "z": 0.2, "ry": -0.7853981633974483}}}}]}}}}"#
        )
    };
    for precision in [Precision::F64, Precision::F32] {
        let options = zoo::options(20_000, 5, precision);
        let of = |text: &str, name: &str| {
            let scene = differentiated(text, &[name]);
            let maps = scene.gradients(zoo::gpu(), &options, how(), |_| true);
            let ones: Vec<Vec<f64>> = scene.adjoint_lengths().map(|num| vec![1.0; num]).collect();
            let loss = scene.loss_gradient(zoo::gpu(), &options, how(), &ones, |_| true);
            (maps.map(|(maps, _)| maps[0].flux), loss.map(|loss| loss.values[0]))
        };
        let rounding = if precision == Precision::F32 { 1e-5 } else { 1e-11 };
        // All light is caught.
        for name in ["M.y", "M.z"] {
            let (maps, loss) = of(&scene(1.5), name);
            assert!(maps.as_ref().is_ok_and(|flux| flux.abs() < rounding), "{precision:?} {name}: {maps:?}");
            assert!(
                loss.as_ref().is_ok_and(|value| value.abs() < rounding),
                "{precision:?} {name}: {loss:?}"
            );
        }
        // More light of a lamp that lights nothing: no detector sees it, though it changes each ray's share of all light.
        let lamp = r#""sources": [{"name": "away", "type": "point", "total_flux": 0.5, "half_angle_deg": 5.0,
            "cs": {"z": 50.0}, "spectrum": {"wavelengths": [0.5], "weights": [1.0]}}, "#;
        let with_lamp = scene(1.5).replace(r#""sources": ["#, lamp);
        let (maps, loss) = of(&with_lamp, "away.total_flux");
        assert!(maps.as_ref().is_ok_and(|flux| flux.abs() < rounding), "{precision:?}: {maps:?}");
        assert!(loss.as_ref().is_ok_and(|value| value.abs() < rounding), "{precision:?}: {loss:?}");
        let (maps, loss) = of(&scene(4.0), "M.y");
        for error in [maps.unwrap_err(), loss.unwrap_err()] {
            assert!(error.to_string().contains("`M.y` acts at edges alone"), "{precision:?}: {error}");
        }
    }
}

/// A trace that is stopped in its first pass gives derivatives of the rays that are done, scaled to all. One that is stopped later
/// gives those of the passes that are done.
#[test]
fn a_stopped_trace_gives_what_is_done() {
    let options = zoo::options(400_000, 5, Precision::F64);
    let names = ["L1.r2", "L1.z", "L1.thickness", "image.z", "glass.n"];
    let scene = differentiated(BENCH, &names);
    let until = |most: u64| scene.gradients(zoo::gpu(), &options, how(), |done| done < most).unwrap();
    let (whole, _) = until(u64::MAX);
    let (part, tally) = until(100_000);
    // Rays of the pass after which it was stopped count, too.
    assert!((50_000..=107_000).contains(&tally.launched.count), "{}", tally.launched.count);
    assert_eq!(part.len(), 4);
    for (part, whole) in part.iter().zip(&whole) {
        assert_eq!(part.parameter, whole.parameter);
        let error = part.standard_error.unwrap();
        assert!((part.flux - whole.flux).abs() < 4.5 * error, "{part:?} {whole:?}");
        // An error from 16 blocks is known to 18 %.
        let times = error / whole.standard_error.unwrap();
        assert!(
            (1.0..4.0).contains(&times),
            "{}: a quarter of the rays has {times} times the error",
            part.parameter
        );
    }
    let (first, tally) = until(500_000);
    assert_eq!((first.as_slice(), tally.launched.count), (&whole[..4], 400_000));
    let none = scene.gradients(zoo::gpu(), &options, how(), |_| false);
    assert_eq!(none.unwrap_err(), nsq_gpu::Error::Interrupted);
}
