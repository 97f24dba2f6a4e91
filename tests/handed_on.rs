//! Options, filters and shares reach every trace that a command makes: the second trace of a derivative, both sides of a
//! difference, the pilot that chooses the precision.
#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "clippy's exemption of tests does not reach their helpers"
)]

mod command;
mod zoo;

use std::collections::BTreeSet;
use std::path::Path;
use std::sync::Arc;

use command::{run, stderr};
use nsq_gpu::model::{PathFilter, ReflectProb, SceneIr};
use nsq_gpu::program::Precision;
use nsq_gpu::run::difference::Pair;
use nsq_gpu::run::gradients::{Differentiated, How};
use nsq_gpu::run::precision::{Need, predict};
use nsq_gpu::{Scene, StandardError, TraceOptions};
use serde_json::Value;

/// A lens and a smoked filter, with two lamps, of which one fills the lens to its rim.
const SCENE: &str = r#"{
    "nsq_schema_version": 1,
    "components": [{"name": "L1", "type": "lens", "cs": {"z": 0.0},
        "config": {"r1": 52.0, "r2": -60.0, "thickness": 6.0, "material": {"type": "medium", "name": "glass"},
            "front_aperture_radius": 14.0}}],
    "sources": [
        {"name": "beam", "type": "collimated", "total_flux": 1.0, "aperture_radius": 15.0, "cs": {"z": -10.0},
            "spectrum": {"wavelengths": [0.4861, 0.6563], "weights": [1, 1]}},
        {"name": "lamp", "type": "extended", "total_flux": 0.5, "width": 3.0, "height": 3.0,
            "half_angle_deg": 4.0, "cs": {"x": 2.0, "z": -12.0}, "spectrum": {"wavelengths": [0.5876], "weights": [1]}}],
    "detectors": [{"name": "image", "type": "irradiance", "width": 12.0, "height": 12.0, "num_pixels_x": 8,
        "num_pixels_y": 8, "cs": {"z": 40.0}}],
    "nsq_gpu": {
        "version": 1,
        "media": {"glass": {"type": "constant", "n": 1.52, "k": 0.0}, "smoked": {"type": "constant", "n": 1.5, "k": 5e-6}},
        "surfaces": [
            {"name": "filter.front", "shape": {"type": "plane", "width": 60, "height": 60}, "interaction": "refractive",
                "cs": {"z": 20}, "material_back": {"type": "medium", "name": "smoked"}},
            {"name": "filter.back", "shape": {"type": "plane", "width": 60, "height": 60}, "interaction": "refractive",
                "cs": {"z": 22}, "material_front": {"type": "medium", "name": "smoked"}}],
        "sampling": {"rr_start_flux": 1e-6}
    }
}"#;

/// What an option of `nsq-gpu trace` does to derivatives.
enum Handed {
    /// The derivative of the interior changes, and so does that with edges.
    Changes(&'static [&'static str]),
    /// Neither changes by a bit.
    Same(&'static [&'static str]),
    /// It is refused beside `--gradient`, in words that have this text.
    Refused(&'static [&'static str], &'static str),
    /// It says where things go or how they look, or is tested by all lines here.
    Elsewhere,
}

use Handed::{Changes, Elsewhere, Refused, Same};

/// All options of `nsq-gpu trace`. A new one needs a line.
const OPTIONS: &[(&str, Handed)] = &[
    ("num-rays", Changes(&["--num-rays=3000"])),
    ("first-ray", Refused(&["--first-ray=10"], "--first-ray")),
    ("of-rays", Refused(&["--of-rays=100000"], "--of-rays")),
    ("target-error", Refused(&["--target-error=1%"], "--target-error")),
    ("time-limit", Refused(&["--time-limit=60s"], "--time-limit")),
    ("standard-error", Refused(&["--standard-error=on"], "--standard-error on")),
    ("seed", Changes(&["--seed=5"])),
    ("max-depth", Changes(&["--max-depth=5"])),
    ("min-flux-fraction", Changes(&["--min-flux-fraction=0.99"])),
    ("batch-size", Same(&["--batch-size=1000"])),
    ("precision", Changes(&["--precision=f64"])),
    ("sampler", Refused(&["--sampler=sobol"], "--sampler sobol")),
    ("strict", Elsewhere),
    ("paths", Refused(&["--paths=on"], "--paths on")),
    ("path-rows", Same(&["--path-rows=100"])),
    ("where", Changes(&["--where=reflections == 2"])),
    ("guide", Refused(&["--guide"], "derivatives take rays that are not guided")),
    // A file that must be there.
    ("guide-from", Elsewhere),
    ("guide-to", Refused(&["--guide", "--guide-to=g.json"], "derivatives take rays that are not guided")),
    ("rays-out", Refused(&["--rays-out=x.tm25ray"], "--rays-out")),
    ("figures", Refused(&["--figures"], "--figures")),
    ("photometric", Refused(&["--photometric"], "--photometric")),
    ("rr-start-flux", Changes(&["--rr-start-flux=0.99"])),
    ("reflect-prob", Changes(&["--reflect-prob=0.5"])),
    ("split-depth", Refused(&["--split-depth=1"], "split rays")),
    ("scatter-prob", Refused(&["--scatter-prob=0.5"], "no surface scatters")),
    ("scatter-to", Refused(&["--scatter-to=L1.front=film"], "--scatter-to L1.front=film")),
    ("checkpoint", Refused(&["--checkpoint=sums.bin"], "--checkpoint")),
    ("overwrite", Refused(&["--overwrite"], "--overwrite")),
    ("checkpoint-interval", Refused(&["--checkpoint-interval=1s"], "--checkpoint-interval")),
    ("resume", Refused(&["--resume=sums.bin"], "--resume")),
    ("adapter", Elsewhere),
    ("portable", Same(&["--portable"])),
    ("record-paths", Refused(&["--record-paths=10", "--output=never"], "--record-paths")),
    ("gradient", Elsewhere),
    ("gradient-edges", Elsewhere),
    ("output", Elsewhere),
    ("no-pictures", Elsewhere),
    // Pictures alone: tests/pictures.rs.
    ("scale", Elsewhere),
    ("unit", Elsewhere),
    ("far-fields", Elsewhere),
    ("profile", Refused(&["--profile"], "--profile")),
    ("proof", Refused(&["--proof"], "--proof")),
    ("json", Elsewhere),
    ("progress", Same(&["--progress=never"])),
    ("watch-stdin", Elsewhere),
    ("help", Elsewhere),
];

/// The names of a command's options, as its parser lists them.
fn options_of(command: &str) -> BTreeSet<String> {
    let help = String::from_utf8(run(&[command, "--help"]).stdout).unwrap();
    let lines = help.lines().filter(|line| line.trim_start().starts_with('-'));
    let name = |line: &str| {
        let (_, rest) = line.split_once("--")?;
        Some(rest.split(|letter: char| !letter.is_ascii_lowercase() && letter != '-').next()?.to_string())
    };
    lines.filter_map(name).collect()
}

fn file(folder: &Path) -> String {
    let path = folder.join("scene.json");
    std::fs::write(&path, SCENE).unwrap();
    path.to_str().unwrap().to_string()
}

/// The derivative of the interior and that with edges. Rays and precision are given unless the arguments give them.
fn derivatives(scene: &str, arguments: &[&str]) -> Result<[f64; 2], String> {
    let mut all = vec!["trace", scene, "--gradient=L1.r1", "--gradient-edges", "--json"];
    with_defaults(&mut all, arguments);
    let said = run(&all);
    if !said.status.success() {
        return Err(stderr(&said));
    }
    let report: Value = serde_json::from_slice(&said.stdout).unwrap();
    let row = &report["gradients"][0];
    Ok([&row["flux"], &row["with_edges"]["flux"]].map(|value| value.as_f64().unwrap()))
}

/// What the image has of both scenes of a difference.
fn sides(scene: &str, arguments: &[&str]) -> [f64; 2] {
    let mut all = vec!["diff", scene, "--set=L1.r1=53", "--json"];
    with_defaults(&mut all, arguments);
    let said = run(&all);
    assert!(said.status.success(), "{}", stderr(&said));
    let report: Value = serde_json::from_slice(&said.stdout).unwrap();
    let image = &report["detectors"]["image"];
    [&image["a"], &image["b"]].map(|value| value.as_f64().unwrap())
}

fn with_defaults<'a>(all: &mut Vec<&'a str>, arguments: &[&'a str]) {
    for default in ["--num-rays=2000", "--precision=f32", "--rr-start-flux=1e-6"] {
        let name = default.split('=').next().unwrap();
        if !arguments.iter().any(|given| given.starts_with(name)) {
            all.push(default);
        }
    }
    all.extend(arguments);
}

#[test]
fn every_option_of_a_trace_reaches_both_traces_of_a_derivative_and_of_a_difference() {
    let listed: BTreeSet<String> = OPTIONS.iter().map(|(name, _)| name.to_string()).collect();
    assert_eq!(options_of("trace"), listed, "each option of `nsq-gpu trace` has a line in OPTIONS");
    let folder = tempfile::tempdir().unwrap();
    let scene = file(folder.path());
    let plain = derivatives(&scene, &[]).unwrap();
    let plain_sides = sides(&scene, &[]);
    for (name, handed) in OPTIONS {
        match handed {
            Changes(arguments) => {
                let found = derivatives(&scene, arguments).unwrap();
                assert!(found[0] != plain[0], "{name}: the interior has not heard of it");
                assert!(found[1] != plain[1], "{name}: the difference of two traces has not heard of it");
                let found = sides(&scene, arguments);
                assert!(
                    found[0] != plain_sides[0] && found[1] != plain_sides[1],
                    "{name}: {found:?} by `diff`"
                );
            }
            Same(arguments) => assert_eq!(derivatives(&scene, arguments).unwrap(), plain, "{name}"),
            Refused(arguments, text) => {
                let said = derivatives(&scene, arguments).expect_err(name);
                assert!(said.contains(text), "{name}: {said}");
            }
            Elsewhere => {}
        }
    }
}

/// A double Gauss whose faces reflect a hundredth.
fn coated_double_gauss() -> String {
    let text = std::fs::read_to_string(zoo::repository("scenes/double_gauss.json")).unwrap();
    let face = "\"interaction\": \"refractive\",";
    assert!(text.contains(face));
    text.replace(
        face,
        &format!(
            "{face} \"coating\": {{\"type\": \"simple\", \"reflectance\": 0.01, \"transmittance\": 0.99}},"
        ),
    )
}

fn filtered(ir: &SceneIr, filter: &str, num_rays: u64) -> TraceOptions {
    let filter = PathFilter::parse(filter, ir).unwrap();
    TraceOptions { path_filter: Some(Arc::new(filter)), ..zoo::options(num_rays, 1, Precision::F64) }
}

/// The derivative of ghosts with edges is the difference of ghosts, and not of all light.
#[test]
fn the_second_trace_of_a_derivative_keeps_the_light_that_the_first_keeps() {
    let text = coated_double_gauss();
    let name = "face_1.radius".to_string();
    let value = Scene::numbers(&text, std::slice::from_ref(&name)).unwrap()[0];
    let scene =
        Differentiated::new(&text, Path::new(""), &[], std::slice::from_ref(&name), |_| Ok(())).unwrap();
    let at = |value: f64| {
        let mut ir =
            Scene::with_numbers(&text, Path::new(""), &[(name.clone(), value)]).unwrap().lower().unwrap();
        ir.sampling.reflect_prob = ReflectProb::Constant(0.1);
        ir
    };
    let step = 2e-3 * value;
    let (more, less) = (at(value + step), at(value - step));
    let flux = |filter: &str| {
        let options = filtered(&scene.ir, filter, 20_000);
        let how = How { with_edges: true, ..How::default() };
        let mut found = scene.gradients(zoo::gpu(), &options, how, |_| true).unwrap().0;
        scene.add_edges(zoo::gpu(), &options, None, &mut found, |_| true).unwrap();
        let edges = found[0].with_edges.clone().unwrap();
        let pair = Pair::new(&more, less.clone()).unwrap();
        let difference = pair.difference(zoo::gpu(), &options, |_| true).unwrap();
        let image = &difference.detectors[0];
        let expected = image.flux.difference / (2.0 * step);
        let error = edges.standard_error.unwrap();
        println!(
            "{filter}: interior {:e}, {:e} +- {error:e} with edges, {expected:e} by diff",
            found[0].flux, edges.flux
        );
        assert!(
            (edges.flux - expected).abs() <= 1e-6 * expected.abs(),
            "{filter}: {} {expected}",
            edges.flux
        );
        let of_map = |map: &ndarray::ArrayD<f64>| map.iter().map(|value| value.abs()).sum::<f64>();
        let (ours, theirs) =
            (of_map(&edges.map.unwrap()), of_map(&image.map.as_ref().unwrap().values) / (2.0 * step));
        assert!((ours - theirs).abs() <= 1e-6 * theirs, "{filter}: maps of {ours} and {theirs}");
        (edges.flux, error)
    };
    let (ghosts, error) = flux("reflections == 2");
    let (all, _) = flux("reflections >= 0");
    assert!((all - ghosts).abs() > 10.0 * error, "ghosts {ghosts:e} +- {error:e}, all light {all:e}");
}

/// Light that goes twice between two faces is farther off in f32 than light that goes straight on.
#[test]
fn the_pilot_predicts_the_error_of_the_light_that_is_kept() {
    let ir = Scene::from_json(SCENE).unwrap().lower().unwrap();
    let predicted = |filter: &str| {
        let errors = predict(zoo::gpu(), &ir, &filtered(&ir, filter, 100_000)).unwrap();
        match Need::of(&ir, &errors) {
            Need::Pixels(error) => error.pixels,
            Need::Positions(_) | Need::Unknown => None,
        }
    };
    let (all, straight, ghosts) = (
        predicted("events >= 0").unwrap(),
        predicted("reflections == 0").unwrap(),
        predicted("reflections == 2").unwrap(),
    );
    assert!(ghosts > 1.1 * straight, "{ghosts} pixels of ghosts, {straight} of light that goes straight on");
    assert!((all / straight - 1.0).abs() < 0.1, "{all} pixels of all light, {straight} of most of it");
    assert_eq!(predicted("reflections == 7"), None);
}

/// Each source launches as many rays as it is told to.
#[test]
fn both_sides_of_a_difference_share_rays_as_they_are_told() {
    let ir = Scene::from_json(SCENE).unwrap().lower().unwrap();
    let options = TraceOptions { shares: Some([1.0, 3.0].into()), ..zoo::options(2000, 1, Precision::F64) };
    let found = Pair::new(&ir, ir.clone()).unwrap().difference(zoo::gpu(), &options, |_| true).unwrap();
    let of = |shares| {
        let options = TraceOptions { shares, standard_error: StandardError::Off, ..options.clone() };
        zoo::result(&ir, &options).detectors[0].num_rays_hit
    };
    assert_eq!(found.detectors[0].num_rays_hit, [of(options.shares.clone()); 2]);
    assert_ne!(of(options.shares.clone()), of(None));
}

#[test]
fn options_that_a_command_cannot_hand_on_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let scene = file(folder.path());
    let refused = |arguments: &[&str], text: &str| {
        let said = run(arguments);
        assert_eq!(said.status.code(), Some(2), "{arguments:?}: {}", stderr(&said));
        assert!(stderr(&said).contains(text), "{arguments:?}: {}", stderr(&said));
    };
    refused(&["sweep", &scene, "--set=L1.r1=50,51", "-n=100", "--paths=on"], "leave out --paths on");
    for option in
        ["--paths=on", "--standard-error=on", "--standard-error=off", "--first-ray=1", "--time-limit=1s"]
    {
        let name = option.split('=').next().unwrap();
        refused(&["diff", &scene, "--set=L1.r1=50", "-n=100", option], &format!("{name} belongs to a trace"));
    }
    refused(
        &["paths", &scene, "-n=100", "--sampler=sobol", "--standard-error=on"],
        "--standard-error on with --sampler sobol",
    );
}

/// `paths` sums second moments where that is asked for, and not else.
#[test]
fn a_table_of_paths_comes_with_the_standard_errors_that_are_asked_for() {
    let folder = tempfile::tempdir().unwrap();
    let scene = file(folder.path());
    let report = |name: &str, option: &str| -> Value {
        let out = folder.path().join(name);
        let out = out.to_str().unwrap();
        let said = run(&["paths", &scene, "-n=2000", option, "-o", out, "--no-pictures"]);
        assert!(said.status.success(), "{}", stderr(&said));
        serde_json::from_slice(&std::fs::read(Path::new(out).join("report.json")).unwrap()).unwrap()
    };
    let has_moments = |report: &Value| report["detectors"]["image"]["total_flux_standard_error"].to_string();
    println!("{}", report("plain", "--standard-error=auto")["detectors"]["image"]);
    assert_ne!(
        has_moments(&report("on", "--standard-error=on")),
        has_moments(&report("off", "--standard-error=off"))
    );
}
