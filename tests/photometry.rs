//! Lumens, lux and candela beside watts: for any spectrum, with right errors, and without a change of what is in watts.
#![allow(clippy::unwrap_used, reason = "clippy's exemption of tests does not reach their helpers")]

mod command;
mod zoo;

use command::{run, stderr};
use nsq_gpu::model::photometry::{MOST_EFFICACY, luminous_efficiency};
use nsq_gpu::model::{DetectorKind, SceneIr};
use nsq_gpu::program::Precision;
use nsq_gpu::result::luminous::Luminous;
use nsq_gpu::result::wavelengths_apart::keep_apart;
use nsq_gpu::result::{RunInfo, Tally};
use nsq_gpu::run::StandardError;
use nsq_gpu::{Run, Scene, TraceOptions, TraceResult};
use serde_json::{Value, json};
use std::f64::consts::PI;

/// A small white lamp above a floor, below a sky.
fn room(source: &Value) -> String {
    let mut lamp = json!({"type": "extended", "name": "lamp", "cs": {}, "aperture_radius": 1.0,
        "spectrum": {"wavelengths": [0.45, 0.55, 0.62, 0.9], "weights": [0.3, 0.3, 0.2, 0.2]}});
    for (key, value) in source.as_object().unwrap() {
        lamp[key] = value.clone();
    }
    json!({"nsq_schema_version": 1, "components": [], "sources": [lamp], "detectors": [
        {"type": "irradiance", "name": "floor", "cs": {"z": 1000.0}, "width": 4000.0, "height": 3000.0, "num_pixels_x": 9,
            "num_pixels_y": 7, "absorb": false},
        {"type": "far_field", "name": "sky", "cs": {"z": 1001.0}, "num_bins_theta": 18, "num_bins_phi": 4}]})
    .to_string()
}

fn lowered(text: &str) -> SceneIr {
    Scene::from_json(text).unwrap().lower().unwrap()
}

fn options(num_rays: u64, seed: u64) -> TraceOptions {
    TraceOptions { standard_error: StandardError::On, ..zoo::options(num_rays, seed, Precision::F64) }
}

fn result(ir: &SceneIr, options: &TraceOptions, tally: &Tally) -> TraceResult {
    let run = RunInfo { photometric: true, num_rays: options.num_rays, ..RunInfo::default() };
    TraceResult::new(ir, &run, tally).unwrap()
}

fn seen<'r>(result: &'r TraceResult, name: &str) -> &'r Luminous {
    result.detectors.iter().find(|detector| detector.name == name).unwrap().luminous.as_ref().unwrap()
}

/// 1,000 lm in are 1,000 lm launched; the floor has I cos^3 / h^2, and the sky F / pi cos(theta).
#[test]
fn lumens_lux_and_candela_of_a_lambertian_lamp() {
    for (spectrum, what) in [
        (json!({"wavelengths": [0.555], "weights": [1.0]}), "at 555 nm"),
        (json!({"wavelengths": [0.45, 0.55, 0.62, 0.9], "weights": [0.3, 0.3, 0.2, 0.2]}), "white"),
    ] {
        let ir = lowered(&room(&json!({"total_flux_lumens": 1000.0, "spectrum": spectrum})));
        let (apart, options) = (keep_apart(&ir).unwrap(), options(1_000_000, 3));
        let result = result(&apart, &options, &zoo::trace(&apart, &options));
        let (_, source) = &result.sources[0];
        assert!((source.flux_lm / 1000.0 - 1.0).abs() < 1e-12, "{what}: {}", source.flux_lm);
        let sky = seen(&result, "sky");
        let error = sky.flux_lm_standard_error.unwrap();
        assert!((sky.flux_lm - 1000.0).abs() < 4.0 * error + 1e-9, "{what}: {} +- {error} lm", sky.flux_lm);
        let (floor, pixel) = (seen(&result, "floor"), [3, 4]);
        let error = floor.standard_error.as_ref().unwrap()[pixel];
        // The mean over the middle pixel, whose rim is 0.31 m away: by a quadrature of cos^4.
        let mean = mean_of_middle(4.0 / 9.0, 3.0 / 7.0) * 1000.0 / PI;
        let score = (floor.map[pixel] - mean) / error;
        assert!(
            score.abs() < 4.0 && error < 0.05 * mean,
            "{what}: {} +- {error} lx, not {mean}",
            floor.map[pixel]
        );
        for row in 0..18 {
            let cells = (0..4).map(|column| [row, column]);
            let sum: f64 = cells.clone().map(|cell| sky.map[cell]).sum();
            let error =
                cells.map(|cell| sky.standard_error.as_ref().unwrap()[cell].powi(2)).sum::<f64>().sqrt();
            let theta = (2.5 + 5.0 * row as f64).to_radians();
            let exact = 4.0 * 1000.0 / PI * theta.cos();
            assert!(
                (sum - exact).abs() < 4.5 * error + 0.002 * exact,
                "{what}, ring {row}: {sum} +- {error}, not {exact} cd"
            );
        }
    }
}

/// The mean of cos^4 over a rectangle of these sides 1 m below.
fn mean_of_middle(width: f64, height: f64) -> f64 {
    let middle = |i: i32, side: f64| side * ((f64::from(i) + 0.5) / 200.0 - 0.5);
    let values = (0..40_000).map(|i| {
        let (x, y) = (middle(i % 200, width), middle(i / 200, height));
        // Light of a bilinear splat counts for a pixel by its distance from the middle, out to the next pixels' middles.
        (1.0 + 4.0 * x * x + 4.0 * y * y).powi(-2)
            * (1.0 - 2.0 * x.abs() / width)
            * (1.0 - 2.0 * y.abs() / height)
            * 4.0
    });
    values.sum::<f64>() / 40_000.0
}

/// What is in watts has the same bits, whether wavelengths were kept apart or not: in scenes with dispersion, splitting, and
/// detectors that let light pass.
#[test]
fn watts_have_the_same_bits_with_and_without_photometry() {
    for name in ["telephoto_spectral", "erfle_eyepiece", "split_ghosts", "cooke_triplet", "opal_lamp"] {
        let mut ir = zoo::load(name);
        if name == "cooke_triplet" {
            let kind = nsq_gpu::model::FarField { num_theta: 9, num_phi: 8, sphere: false };
            ir.detectors[0].kind = DetectorKind::FarField(kind);
        }
        for (sampler, precision) in [
            (nsq_gpu::program::Sampler::Pcg, Precision::F64),
            (nsq_gpu::program::Sampler::Sobol, Precision::F32),
        ] {
            let options = TraceOptions { sampler, precision, ..options(20_000, 5) };
            let apart = keep_apart(&ir).unwrap();
            let of = |ir: &SceneIr| {
                let run = RunInfo { num_rays: options.num_rays, ..RunInfo::default() };
                TraceResult::new(ir, &run, &zoo::trace(ir, &options)).unwrap()
            };
            let [plain, kept] = [of(&ir), of(&apart)];
            assert_eq!(plain.detectors, kept.detectors, "{name}");
            assert_eq!(plain.ledger, kept.ledger, "{name}");
            assert_eq!(plain.relative_error, kept.relative_error, "{name}");
        }
    }
}

/// 95 % intervals of lumens and of a pixel's lux hold the mean of 300 seeds in 92 to 98 % of them.
#[test]
fn intervals_hold_as_often_as_they_say() {
    const SEEDS: u64 = 300;
    let ir = keep_apart(&lowered(&room(&json!({"total_flux": 5.0})))).unwrap();
    let options = options(4000, 0);
    let mut tracer = zoo::tracer(&ir, &options).unwrap();
    let found: Vec<[[f64; 2]; 2]> = zoo::tallies_of(&mut tracer, 0..SEEDS)
        .map(|tally| {
            let result = result(&ir, &options, &tally);
            let floor = seen(&result, "floor");
            let errors = floor.standard_error.as_ref().unwrap();
            [[floor.flux_lm, floor.flux_lm_standard_error.unwrap()], [floor.map[[3, 4]], errors[[3, 4]]]]
        })
        .collect();
    for what in 0..2 {
        let mean = found.iter().map(|all| all[what][0]).sum::<f64>() / SEEDS as f64;
        let held = found.iter().filter(|all| (all[what][0] - mean).abs() < 1.96 * all[what][1]).count();
        let share = held as f64 / SEEDS as f64;
        assert!((0.92..0.98).contains(&share), "number {what}: {share}");
    }
}

/// Lumens of the far field are those of its spectrum: a filter that takes one wavelength takes its lumens.
#[test]
fn lumens_follow_the_wavelengths_that_arrive() {
    let ir = lowered(&room(&json!({"total_flux": 2.0})));
    let (apart, options) = (keep_apart(&ir).unwrap(), options(200_000, 1));
    let result = result(&apart, &options, &zoo::trace(&apart, &options));
    let shares = [(0.45, 0.3), (0.55, 0.3), (0.62, 0.2), (0.9, 0.2)];
    let exact: f64 =
        shares.iter().map(|(x, share)| 2.0 * share * MOST_EFFICACY * luminous_efficiency(*x)).sum();
    let sky = seen(&result, "sky");
    let error = sky.flux_lm_standard_error.unwrap();
    assert!((sky.flux_lm - exact).abs() < 4.0 * error, "{} +- {error}, not {exact}", sky.flux_lm);
    // Infrared alone is refused, in words.
    let dark = room(&json!({"total_flux": 2.0, "spectrum": {"wavelengths": [0.9], "weights": [1.0]}}));
    let refused = Run::new(Scene::from_json(&dark).unwrap()).unwrap().photometric();
    assert!(refused.is_err_and(|error| error.to_string().contains("nobody sees")));
}

/// The command: parts merge to the whole, a trace goes on, `verify` computes lumens anew, and results are read back.
#[test]
fn results_in_lumens_are_merged_resumed_and_verified() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_string();
    std::fs::write(path("room.json"), room(&json!({"total_flux_lumens": 800.0}))).unwrap();
    let scene = path("room.json");
    let report = |name: &str| -> Value {
        serde_json::from_str(&std::fs::read_to_string(folder.path().join(name).join("report.json")).unwrap())
            .unwrap()
    };
    let trace = |name: &str, rays: &str, more: &[&str]| {
        let (out, sums) = (path(name), path(&format!("{name}.bin")));
        let all = [
            &["trace", &scene, "-n", rays, "--standard-error", "on", "-o", &out, "--checkpoint", &sums],
            more,
        ]
        .concat();
        let ran = run(&all);
        assert!(ran.status.success(), "{}", stderr(&ran));
    };
    trace("whole", "20000", &[]);
    trace("one", "12000", &["--first-ray=0", "--of-rays=20000"]);
    trace("two", "8000", &["--first-ray=12000", "--of-rays=20000"]);
    let merged = run(&["merge", &path("one"), &path("two"), "-o", &path("merged")]);
    assert!(merged.status.success(), "{}", stderr(&merged));
    assert_eq!(report("whole")["photometry"], report("merged")["photometry"]);
    assert!(report("whole")["photometry"]["detectors"]["floor"]["mean_lx"].as_f64().unwrap() > 10.0);
    let sums = path("whole.bin");
    trace("resumed", "20000", &["--resume", &sums]);
    assert_eq!(report("whole")["photometry"], report("resumed")["photometry"]);
    let verified = run(&["verify", &path("whole")]);
    assert!(verified.status.success(), "{}", stderr(&verified));
    let back = TraceResult::read(&folder.path().join("whole")).unwrap();
    assert_eq!(
        json!(seen(&back, "floor").flux_lm),
        report("whole")["photometry"]["detectors"]["floor"]["flux_lm"]
    );
    // A number that was changed is found.
    let mut changed = report("whole");
    changed["photometry"]["detectors"]["floor"]["flux_lm"] = json!(123.0);
    std::fs::write(folder.path().join("whole/report.json"), changed.to_string()).unwrap();
    assert!(!run(&["verify", &path("whole")]).status.success());
}

/// A lamp's file stands for its table: the same rays, and its hash in the report.
#[test]
fn a_scene_takes_a_lamps_file() {
    let folder = tempfile::tempdir().unwrap();
    let ies = "IESNA:LM-63-2002\n[TEST] none\n[TESTLAB] none\n[ISSUEDATE] 2026\n[MANUFAC] none\nTILT=NONE\n\
               1 -1 1 3 1 1 2 0 0 0\n1 1 20\n0 45 90\n0\n300 200 10\n";
    std::fs::write(folder.path().join("lamp.ies"), ies).unwrap();
    let of = |source: Value| {
        let text = room(&source);
        let mut scene: Value = serde_json::from_str(&text).unwrap();
        scene["sources"][0].as_object_mut().unwrap().remove("aperture_radius");
        scene.to_string()
    };
    let named = of(json!({"type": "tabulated", "file": "lamp.ies"}));
    let table = of(
        json!({"type": "tabulated", "polar_angles_deg": [0, 45, 90], "intensity": [300, 200, 10], "intensity_units": "cd"}),
    );
    std::fs::write(folder.path().join("named.json"), &named).unwrap();
    let scene = Scene::from_path(&folder.path().join("named.json")).unwrap();
    assert_eq!(scene.lower().unwrap(), lowered(&table));
    assert_eq!((scene.lamp_files.len(), scene.lamp_files[0].sha256.len()), (1, 64));
    let lumens = scene.file.sources[0].total_flux_lumens().unwrap();
    assert!((lumens - scene.lamp_files[0].lumens).abs() < 1e-9 * lumens);
    // A flux of the user's rescales the table.
    let dimmed = of(json!({"type": "tabulated", "file": "lamp.ies", "total_flux_lumens": 100.0}));
    std::fs::write(folder.path().join("dimmed.json"), dimmed).unwrap();
    let dimmed = Scene::from_path(&folder.path().join("dimmed.json")).unwrap();
    assert_eq!(dimmed.file.sources[0].total_flux_lumens(), Some(100.0));
    for (source, problem) in [
        (json!({"type": "tabulated", "file": "none.ies"}), "none.ies"),
        (json!({"type": "tabulated", "file": "lamp.txt"}), ".ldt"),
        (json!({"type": "tabulated", "file": "lamp.ies", "intensity": [1.0]}), "`intensity` as well"),
        (json!({"type": "tabulated", "file": "lamp.ies", "total_flux": -1.0}), "total_flux"),
    ] {
        std::fs::write(folder.path().join("wrong.json"), of(source)).unwrap();
        let error = Scene::from_path(&folder.path().join("wrong.json")).unwrap_err().to_string();
        assert!(error.contains(problem), "{error}");
    }
}

/// Where a filter dims one wavelength, weights differ by wavelength, and the error of lumens is still the scatter over seeds.
#[test]
fn errors_of_lumens_hold_where_wavelengths_are_dimmed() {
    // ln(10) / (4 pi L / lambda), so that 10 % of one wavelength passes.
    let k = |wavelength: f64| 10.0_f64.ln() * wavelength * 1e-3 / (4.0 * PI * 10.0);
    for (weights, extinction) in [([0.01, 0.99], [0.0, k(0.65)]), ([0.5, 0.5], [k(0.555), 0.0])] {
        let text = json!({"nsq_schema_version": 1, "components": [],
            "sources": [{"type": "collimated", "name": "beam", "cs": {"z": -10.0}, "total_flux": 1.0, "medium": {"type": "medium", "name": "filter"},
                "spectrum": {"wavelengths": [0.555, 0.65], "weights": weights}}],
            "detectors": [{"type": "irradiance", "name": "screen", "cs": {}, "width": 4.0, "height": 4.0, "num_pixels_x": 1,
                "num_pixels_y": 1}],
            "nsq_gpu": {"version": 1, "media": {"filter": {"type": "table", "wavelengths": [0.555, 0.65], "n": [1.0, 1.0],
                "k": extinction}}}});
        let ir = lowered(&text.to_string());
        let apart = keep_apart(&ir).unwrap();
        let lumens: Vec<(f64, f64)> = (0..24)
            .map(|seed| {
                let options = options(20_000, seed);
                let result = result(&apart, &options, &zoo::trace(&apart, &options));
                let screen = seen(&result, "screen");
                (screen.flux_lm, screen.flux_lm_standard_error.unwrap())
            })
            .collect();
        let mean = lumens.iter().map(|(flux, _)| flux).sum::<f64>() / 24.0;
        let spread = (lumens.iter().map(|(flux, _)| (flux - mean).powi(2)).sum::<f64>() / 23.0).sqrt();
        let stated = lumens.iter().map(|(_, error)| error).sum::<f64>() / 24.0;
        // The spread of 24 numbers is itself known to 15 %.
        assert!((spread / stated - 1.0).abs() < 0.5, "{weights:?}: stated {stated}, spread {spread}");
    }
}
