//! The command stops when it is told to, goes on where it was, and loses nothing.
#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "clippy's exemption of tests does not reach their helpers"
)]

mod command;
#[path = "zoo/files.rs"]
mod files;

use command::{command, run, stderr};
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::Duration;

const TOLERANCE: i32 = 6;
const USAGE: i32 = 2;

fn trace<'a>(scene: &'a str, more: &[&'a str]) -> Vec<&'a str> {
    [&["trace", scene, "--precision", "f32", "--standard-error", "on", "--json"], more].concat()
}

fn succeed(arguments: &[&str]) -> Value {
    let output = run(arguments);
    assert!(output.status.success(), "{arguments:?}: {}", stderr(&output));
    serde_json::from_slice(&output.stdout).unwrap()
}

fn refuse(arguments: &[&str], words: &[&str]) {
    let output = run(arguments);
    assert_eq!(output.status.code(), Some(USAGE), "{arguments:?}: {}", stderr(&output));
    for word in words {
        assert!(stderr(&output).contains(word), "no `{word}` in {}", stderr(&output));
    }
}

/// The files of a folder; of the report without its timing, and what was traced before.
fn files(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    let mut files = BTreeMap::new();
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_name().unwrap().to_string_lossy().into_owned();
        let mut bytes = std::fs::read(&path).unwrap();
        if name == "report.json" {
            let mut report: Value = serde_json::from_slice(&bytes).unwrap();
            // And without its hashes: its own is one of the timing, too, and that of the sums' file one of the scene's path.
            for timing in ["trace_time_sec", "first_rays_sec", "rays_per_sec", "num_rays_before", "meta"] {
                report.as_object_mut().unwrap().remove(timing);
            }
            bytes = report.to_string().into_bytes();
        }
        files.insert(name, bytes);
    }
    files
}

const CAVITY: &str = "scenes/bench_cavity.json";
const LENS: &str = "scenes/bench_lens.json";
const BEAMS: &str = "scenes/tessar_gaussian_beams.json";

// Stopping.

#[test]
fn a_target_is_met_at_the_same_ray_whatever_the_batch() {
    let by_sampler = ["pcg", "sobol"].map(rays_to_a_target);
    assert!(by_sampler[1] < by_sampler[0], "{by_sampler:?}");
}

fn rays_to_a_target(sampler: &'static str) -> u64 {
    let target = |more: &[&'static str]| {
        let stops = ["-n", "1e7", "--target-error", "3%", "--sampler", sampler];
        succeed(&trace(CAVITY, &[&stops, more].concat()))
    };
    let report = target(&[]);
    let rays = report["num_rays_total"].as_u64().unwrap();
    assert!((1 << 14..10_000_000).contains(&rays), "{rays}");
    assert_eq!(
        (&report["stopped_by"], &report["partial"]),
        (&Value::from("target_error"), &Value::from(true))
    );
    assert!(report["relative_error"].as_f64().unwrap() <= 0.03);
    // What was launched stands for all that the source emits.
    assert_eq!(report["total_flux_in"].as_f64(), Some(1.0));
    assert_eq!(target(&["--batch-size", "3000"])["num_rays_total"].as_u64(), Some(rays));
    rays
}

#[test]
fn a_target_that_is_not_met_is_exit_code_6_with_the_result() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    let output = run(&trace(LENS, &["-n", "20000", "--target-error", "0.0001", "-o", out.to_str().unwrap()]));
    assert_eq!(output.status.code(), Some(TOLERANCE), "{}", stderr(&output));
    assert!(stderr(&output).contains("above the target of 0.010 %"), "{}", stderr(&output));
    let report: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(report["num_rays_total"], 20_000);
    assert!(out.join("report.json").exists());
}

#[test]
fn a_time_limit_ends_a_trace_that_would_take_for_ever() {
    let report = succeed(&trace(LENS, &["-n", "1e13", "--time-limit", "300ms"]));
    assert_eq!(report["stopped_by"], "time_limit");
    assert!(report["num_rays_total"].as_u64().unwrap() > 0);
    let warnings = report["diagnostics"]["warnings"].as_array().unwrap();
    assert!(
        warnings.iter().any(|warning| warning.as_str().unwrap().starts_with("stopped at the time limit"))
    );
}

#[test]
fn progress_tells_the_error() {
    let output = run(&trace(CAVITY, &["-n", "1e7", "--target-error", "1%", "--progress", "json"]));
    let lines: Vec<Value> = stderr(&output).lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    let errors: Vec<f64> = lines.iter().filter_map(|line| line["relative_error"].as_f64()).collect();
    assert!(lines.iter().all(|line| line["eta_sec"].is_number()));
    assert!(errors.windows(2).all(|pair| pair[1] <= 1.2 * pair[0]), "{errors:?}");
}

// The largest number of events.

/// A scene of so many windows, each of two faces, between a beam and a detector.
fn windows(folder: &Path, num: usize) -> String {
    let cs = |z: usize| serde_json::json!({"x": 0, "y": 0, "z": z, "rx": 0, "ry": 0, "rz": 0, "reference_cs": null});
    let face = |face: usize| {
        let side = if face.is_multiple_of(2) { "material_back" } else { "material_front" };
        serde_json::json!({
            "name": format!("face {face}"), "shape": {"type": "plane"}, "interaction": "refractive", "cs": cs(face + 1),
            side: {"type": "medium", "name": "glass"},
        })
    };
    let scene = serde_json::json!({
        "nsq_schema_version": 1,
        "components": [],
        "sources": [{"name": "beam", "type": "collimated", "total_flux": 1.0, "aperture_radius": 1.0, "cs": cs(0),
                     "spectrum": {"wavelengths": [0.55], "weights": [1]}}],
        "detectors": [{"name": "D", "type": "irradiance", "width": 9.0, "height": 9.0, "num_pixels_x": 2,
                       "num_pixels_y": 2, "cs": cs(2 * num + 1)}],
        "nsq_gpu": {
            "version": 1,
            "media": {"glass": {"type": "constant", "n": 1.5}},
            "surfaces": (0..2 * num).map(face).chain([serde_json::json!({
                "name": "wall", "shape": {"type": "plane"}, "interaction": "absorbing", "cs": cs(2 * num + 2),
            })]).collect::<Vec<_>>(),
        },
    });
    let path = folder.join("windows.json");
    std::fs::write(&path, scene.to_string()).unwrap();
    path.to_str().unwrap().into()
}

#[test]
fn the_largest_number_of_events_follows_the_scene() {
    let folder = tempfile::tempdir().unwrap();
    let scene = windows(folder.path(), 12);
    let traced = |more: &[&'static str]| succeed(&trace(&scene, &[&["-n", "20000"], more].concat()));
    let grave = |report: &Value| report["diagnostics"]["grave"].to_string();
    // Twice the faces, without the wall.
    let report = traced(&[]);
    assert_eq!(report["max_depth"], 48);
    // 24 faces of 4 % pass (1 - R) / (1 + 23 R) of the light, but for what meets more than 48 of them.
    let flux = report["detectors"]["D"]["total_flux"].as_f64().unwrap();
    assert!((flux - 0.96 / 1.92).abs() < 0.03, "{flux}");
    let report = traced(&["--max-depth", "16"]);
    assert_eq!(
        (&report["max_depth"], &report["detectors"]["D"]["num_rays_hit"]),
        (&Value::from(16), &Value::from(0))
    );
    assert!(
        grave(&report)
            .contains("and D got no light; give --max-depth 48, in Python NsqGpuBackend(max_depth=48)")
    );
    let said = |arguments: &[&str]| String::from_utf8(run(arguments).stdout).unwrap();
    assert!(said(&["check", &scene]).contains("max_depth: 48, unless given"));
    assert!(said(&["trace", &scene, "-n", "1000"]).contains("max_depth 48, "));
    assert_eq!(succeed(&trace(&windows(folder.path(), 2), &["-n", "1000"]))["max_depth"], 16);
}

#[test]
fn what_goes_on_keeps_the_largest_number_of_events() {
    let folder = tempfile::tempdir().unwrap();
    let place = |name: &str| folder.path().join(name).to_str().unwrap().to_string();
    let scene = windows(folder.path(), 12);
    let (file, parts) = (place("run.tally"), ["a", "b", "both"].map(place));
    let checkpoint = ["-n", "20000", "--checkpoint", &file];
    succeed(&trace(&scene, &[&checkpoint[..], &["--max-depth", "9"]].concat()));
    let resume = [&checkpoint[..], &["--resume", &file]].concat();
    assert_eq!(succeed(&trace(&scene, &resume))["max_depth"], 9);
    refuse(&trace(&scene, &[&resume[..], &["--max-depth", "48"]].concat()), &["max_depth: 9 there, 48 here"]);
    for (part, first_ray) in parts.iter().zip(["0", "1000"]) {
        succeed(&trace(&scene, &["-n", "1000", "--first-ray", first_ray, "--max-depth", "9", "-o", part]));
    }
    assert_eq!(succeed(&["merge", &parts[0], &parts[1], "-o", &parts[2], "--json"])["max_depth"], 9);
}

// Checkpoints.

/// A trace that writes checkpoints as often as it can.
fn checkpointed<'a>(checkpoint: &'a str, num_rays: &'a str, sampler: &'a str) -> Vec<&'a str> {
    let writes = ["--checkpoint", checkpoint, "--checkpoint-interval", "1ms"];
    trace(
        BEAMS,
        &[&["-n", num_rays, "--sampler", sampler, "--batch-size", "1000"], writes.as_slice()].concat(),
    )
}

/// Waits until the file is there, at most for a minute.
fn wait_for(path: &Path, child: &mut Child) {
    for _ in 0..6000 {
        if path.exists() || child.try_wait().unwrap().is_some() {
            return;
        }
        std::thread::sleep(Duration::from_millis(10));
    }
    panic!("{} never came", path.display());
}

#[test]
fn a_killed_trace_goes_on_to_the_bits_of_an_unbroken_one() {
    kill_and_go_on("pcg", &[0, 7, 23, 40, 90]);
    kill_and_go_on("sobol", &[15, 60]);
}

fn kill_and_go_on(sampler: &str, delays_ms: &[u64]) {
    let folder = tempfile::tempdir().unwrap();
    let place = |name: &str| folder.path().join(name).to_str().unwrap().to_string();
    let (checkpoint, whole, broken) = (place("c.tally"), place("whole"), place("broken"));
    let num_rays = "400000";
    succeed(&trace(BEAMS, &["-n", num_rays, "--sampler", sampler, "-o", &whole]));
    let mut kills = 0;
    for &delay_ms in delays_ms {
        let mut arguments = checkpointed(&checkpoint, num_rays, sampler);
        if Path::new(&checkpoint).exists() {
            arguments.extend(["--resume", &checkpoint]);
        }
        let mut child = command(&arguments).stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
        wait_for(Path::new(&checkpoint), &mut child);
        std::thread::sleep(Duration::from_millis(delay_ms));
        kills += u32::from(child.try_wait().unwrap().is_none());
        child.kill().unwrap();
        child.wait().unwrap();
        assert!(
            nsq_gpu::run::checkpoint::Checkpoint::read(Path::new(&checkpoint)).is_ok(),
            "a whole file is there"
        );
    }
    assert!(kills > 0, "the trace was never killed while it ran");
    let report = succeed(&trace(
        BEAMS,
        &["-n", num_rays, "--sampler", sampler, "--resume", &checkpoint, "-o", &broken],
    ));
    assert_eq!(report["num_rays_total"], 400_000);
    let before = report["num_rays_before"].as_u64().unwrap();
    assert!(0 < before && before <= 400_000);
    let [rate, seconds] = ["rays_per_sec", "trace_time_sec"].map(|key| report[key].as_f64().unwrap());
    approx::assert_relative_eq!(rate * seconds, (400_000 - before) as f64, max_relative = 1e-9);
    let (whole, broken) = (files(Path::new(&whole)), files(Path::new(&broken)));
    assert_eq!(whole.keys().collect::<Vec<_>>(), broken.keys().collect::<Vec<_>>());
    for (name, bytes) in &whole {
        assert!(broken[name] == *bytes, "{name} differs");
    }
}

#[test]
fn an_interrupted_trace_leaves_a_checkpoint_to_go_on_from() {
    let folder = tempfile::tempdir().unwrap();
    let checkpoint = folder.path().join("c.tally");
    let arguments =
        trace(BEAMS, &["-n", "1e10", "--checkpoint", checkpoint.to_str().unwrap(), "--progress", "json"]);
    let mut child = command(&arguments).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let mut lines = BufReader::new(child.stderr.take().unwrap()).lines();
    lines.next().unwrap().unwrap();
    let killed = Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap();
    assert!(killed.success());
    lines.for_each(|line| drop(line.unwrap()));
    let output = child.wait_with_output().unwrap();
    assert_eq!(output.status.code(), Some(130));
    let report: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!((&report["partial"], &report["stopped_by"]), (&Value::from(true), &Value::from("interrupt")));
    let found = nsq_gpu::run::checkpoint::Checkpoint::read(&checkpoint).unwrap();
    assert_eq!(Some(found.tally.launched.count), report["num_rays_total"].as_u64());
}

#[test]
fn a_result_whose_rows_went_to_files_is_no_beginning() {
    let folder = tempfile::tempdir().unwrap();
    let place = |name: &str| folder.path().join(name).to_str().unwrap().to_string();
    let (paths, rows) = (place("paths"), place("rows"));
    let options = ["-n", "1000", "--record-paths", "all", "-o"];
    succeed(&trace(LENS, &[&options[..], &[&paths]].concat()));
    refuse(
        &trace(LENS, &[&options[..], &[&paths, "--resume", &paths]].concat()),
        &["not the rows", "--checkpoint"],
    );
    succeed(&trace("scenes/filter_stack.json", &["-n", "1000", "-o", &rows]));
    refuse(
        &trace("scenes/filter_stack.json", &["-n", "1000", "--resume", &rows]),
        &["not the rows", "--checkpoint"],
    );
}

#[test]
fn checkpoints_of_other_traces_are_refused_by_what_differs() {
    let folder = tempfile::tempdir().unwrap();
    let checkpoint = folder.path().join("c.tally");
    let file = checkpoint.to_str().unwrap();
    succeed(&trace(LENS, &["-n", "1000", "--checkpoint", file]));
    let go_on = |more: &[&'static str]| -> Vec<String> {
        let arguments = trace(LENS, more);
        arguments.into_iter().map(String::from).chain(["--resume".to_string(), file.to_string()]).collect()
    };
    for (more, words) in [
        (["-n", "1000", "--seed", "3"].as_slice(), ["another trace", "seed: 0 there, 3 here"]),
        (&["-n", "2000"], ["another trace", "rays: 1000 there, 2000 here"]),
        (&["-n", "1000", "--max-depth", "9"], ["another trace", "max_depth: 16 there, 9 here"]),
        (&["-n", "1000", "--first-ray", "5"], ["another trace", "first ray: 0 there, 5 here"]),
    ] {
        let arguments = go_on(more);
        refuse(&arguments.iter().map(String::as_str).collect::<Vec<_>>(), &words);
    }
    refuse(
        &["trace", LENS, "--precision", "f64", "--standard-error", "on", "-n", "1000", "--resume", file],
        &["precision: f32 there, f64 here"],
    );
    refuse(&trace("scenes/bench_cavity.json", &["-n", "1000", "--resume", file]), &["scene: ", "bench_lens"]);
    let mut bytes = std::fs::read(&checkpoint).unwrap();
    *bytes.last_mut().unwrap() ^= 1;
    std::fs::write(&checkpoint, bytes).unwrap();
    refuse(&trace(LENS, &["-n", "1000", "--resume", file]), &["c.tally", "damaged"]);
    refuse(&trace(LENS, &["-n", "1000", "--resume", LENS]), &["no file of sums"]);
}

// Merging.

#[test]
fn parts_merge_to_the_bits_of_one_run() {
    let folder = tempfile::tempdir().unwrap();
    let place = |name: &str| folder.path().join(name).to_str().unwrap().to_string();
    let cases = [(LENS, "pcg", None), (BEAMS, "pcg", Some("50000")), (BEAMS, "sobol", Some("50000"))];
    for (scene, sampler, whole_of) in files::in_turn(cases) {
        let names =
            ["whole", "a", "b", "c", "merged"].map(|name| place(&format!("{name}_{sampler}{}", scene.len())));
        let [whole, a, b, c, merged] = names.each_ref().map(String::as_str);
        succeed(&trace(scene, &["-n", "50000", "--sampler", sampler, "-o", whole]));
        for (out, first, num) in [(a, "0", "20001"), (b, "20001", "9999"), (c, "30000", "20000")] {
            let mut arguments =
                trace(scene, &["-n", num, "--sampler", sampler, "--first-ray", first, "-o", out]);
            arguments.extend(whole_of.iter().flat_map(|rays| ["--of-rays", rays]));
            succeed(&arguments);
        }
        let output = run(&["merge", c, a, b, "-o", merged, "--json"]);
        assert!(output.status.success(), "{}", stderr(&output));
        assert!(stderr(&output).contains("bit for bit"), "{}", stderr(&output));
        let (whole, merged) = (files(Path::new(whole)), files(Path::new(merged)));
        for (name, bytes) in whole.iter().filter(|(name, _)| name.ends_with(".npz") || name.ends_with(".png"))
        {
            assert!(merged[name] == *bytes, "{scene}: {name} differs");
        }
        let report = |files: &BTreeMap<String, Vec<u8>>| -> Value {
            serde_json::from_slice(&files["report.json"]).unwrap()
        };
        for key in ["ledger", "detectors", "total_flux_in", "relative_error", "num_rays_total"] {
            assert_eq!(report(&whole)[key], report(&merged)[key], "{scene}: {key}");
        }
    }
}

/// Rays are split because an option says so, and not the scene, at a face that scatters: errors of rows that cannot be known stay
/// unknown, rows of rays keep their order, and the report keeps the filter.
#[test]
fn parts_of_split_rays_merge_to_the_report_of_one_run() {
    let folder = tempfile::tempdir().unwrap();
    let place = |name: &str| folder.path().join(name).to_str().unwrap().to_string();
    let plane = json!({"type": "plane", "width": 40, "height": 40});
    let glass = json!({"type": "medium", "name": "g"});
    let scene = json!({"nsq_schema_version": 1, "components": [],
        "sources": [{"name": "b", "type": "collimated", "aperture_radius": 3, "total_flux": 1, "cs": {"z": -10},
                     "spectrum": {"wavelengths": [0.5], "weights": [1]}}],
        "detectors": [{"name": "rays", "type": "ray_database", "width": 30, "height": 30, "absorb": false, "cs": {"z": 9}},
                      {"name": "D", "type": "irradiance", "width": 40, "height": 40, "num_pixels_x": 8, "num_pixels_y": 8,
                       "cs": {"z": 10}}],
        "nsq_gpu": {"version": 1, "media": {"g": {"type": "constant", "n": 1.5}}, "surfaces": [
            {"name": "f", "shape": plane, "interaction": "refractive", "cs": {"z": 0}, "material_back": glass,
             "coating": {"type": "simple", "reflectance": 0.5, "transmittance": 0.5},
             "bsdf": {"type": "lambertian", "transmissive_fraction": 0.5}, "scatter_fraction": 1.0},
            {"name": "k", "shape": plane, "interaction": "refractive", "cs": {"z": 4}, "material_front": glass}]}});
    let file = place("scene.json");
    std::fs::write(&file, scene.to_string()).unwrap();
    let how = ["--split-depth", "4", "--paths", "on", "--no-pictures", "--where", "reflections < 3"];
    let [whole, a, b, merged] = ["whole", "a", "b", "merged"].map(place);
    let whole_report = succeed(&trace(&file, &[&how[..], &["-n", "2000", "-o", &whole]].concat()));
    for (out, first, num) in [(&a, "0", "900"), (&b, "900", "1100")] {
        let part = ["-n", num, "--first-ray", first, "--of-rays", "2000", "-o", out];
        succeed(&trace(&file, &[&how[..], &part].concat()));
    }
    let merged_report = succeed(&["merge", &a, &b, "-o", &merged, "--no-pictures", "--json"]);
    let rows = whole_report["paths"].as_array().unwrap();
    assert!(rows.len() > 5 && rows.iter().any(|row| row["standard_error"].is_null()), "{rows:?}");
    for key in ["paths", "ledger", "where", "split_depth"] {
        assert!(!whole_report[key].is_null(), "{key}");
        assert_eq!(whole_report[key], merged_report[key], "{key}");
    }
    // Neither is taken for damaged.
    for folder in [&whole, &merged] {
        let output = run(&["verify", folder]);
        assert!(
            output.status.success(),
            "{folder}: {}{}",
            String::from_utf8_lossy(&output.stdout),
            stderr(&output)
        );
    }
    let [whole, merged] = [whole, merged].map(|folder| files(Path::new(&folder)));
    assert!(whole["rays.npz"] == merged["rays.npz"], "rays.npz differs");
}

/// The tables of parts add up to the whole's, and parts of other tables or filters are refused.
#[test]
fn tables_of_paths_merge_to_that_of_one_run() {
    const GHOSTS: &str = "scenes/cooke_triplet.json";
    let folder = tempfile::tempdir().unwrap();
    let place = |name: &str| folder.path().join(name).to_str().unwrap().to_string();
    let part = |first: &'static str, num: &'static str| {
        ["-n", num, "--first-ray", first, "--of-rays", "20000", "--paths", "on"]
    };
    for filter in [&[][..], &["--where", "reflections > 0"]] {
        let [whole, a, b] = ["whole", "a", "b"].map(|name| place(&format!("{name}{}", filter.len())));
        let whole =
            succeed(&trace(GHOSTS, &[&["-n", "20000", "--paths", "on", "-o", &whole], filter].concat()));
        for (out, part) in [(&a, part("0", "7001")), (&b, part("7001", "12999"))] {
            succeed(&trace(GHOSTS, &[&part[..], filter, &["-o", out]].concat()));
        }
        let merged = succeed(&["merge", &b, &a, "--json"]);
        assert!(whole["paths"].as_array().unwrap().len() > 50);
        for key in ["paths", "ledger"] {
            assert_eq!(whole[key], merged[key], "{key}, {filter:?}");
        }
    }
    let (all, ghosts) = (place("a0"), place("b2"));
    refuse(
        &["merge", &all, &ghosts],
        &["does not add up", "filter of paths: reflections > 0 there, none here"],
    );
    let few = place("few");
    let part = [&part("7001", "12999")[..], &["--path-rows", "50", "-o", &few]].concat();
    succeed(&trace(GHOSTS, &part));
    refuse(&["merge", &all, &few], &["does not add up", "table of paths: 50 rows there, 262144 rows here"]);
}

#[test]
fn merge_says_where_the_bits_are_not_those_of_one_run() {
    let folder = tempfile::tempdir().unwrap();
    let place = |name: &str| folder.path().join(name).to_str().unwrap().to_string();
    let (a, b) = (place("a"), place("b"));
    succeed(&trace(BEAMS, &["-n", "1000", "-o", &a]));
    succeed(&trace(BEAMS, &["-n", "1000", "--first-ray", "5000", "-o", &b]));
    let output = run(&["merge", &a, &b]);
    assert!(output.status.success(), "{}", stderr(&output));
    assert!(stderr(&output).contains("not the bits of one run") && stderr(&output).contains("--of-rays"));
    assert!(stderr(&output).contains("gaps"), "{}", stderr(&output));
}

/// Of so few rays of a long trace no path is recorded, which is no reason to refuse them.
#[test]
fn parts_that_record_no_path_by_chance_are_merged_and_others_are_not() {
    let folder = tempfile::tempdir().unwrap();
    let place = |name: &str| folder.path().join(name).to_str().unwrap().to_string();
    let [a, b, c, d] = ["a", "b", "c", "d"].map(place);
    let part = |first: &'static str| ["-n", "100", "--first-ray", first, "--of-rays", "1e9"];
    for (first, out) in [("0", &a), ("100", &b)] {
        succeed(&trace(LENS, &[&part(first)[..], &["--record-paths", "1", "-o", out]].concat()));
    }
    succeed(&["merge", &a, &b, "--json"]);
    succeed(&trace(LENS, &[&part("200")[..], &["-o", &c]].concat()));
    refuse(&["merge", &a, &c], &["does not add up", "recorded paths: None there, About(1) here"]);
    succeed(&trace(LENS, &["-n", "100", "--record-paths", "all", "-o", &d]));
    refuse(&["merge", &d, &c], &["not the rows", "--first-ray"]);
}

#[test]
fn what_does_not_add_up_is_not_merged() {
    let folder = tempfile::tempdir().unwrap();
    let place = |name: &str| folder.path().join(name).to_str().unwrap().to_string();
    let [a, b, c, d] = ["a", "b", "c", "d"].map(place);
    succeed(&trace(LENS, &["-n", "1000", "-o", &a]));
    succeed(&trace(LENS, &["-n", "1000", "--first-ray", "999", "-o", &b]));
    succeed(&trace(LENS, &["-n", "1000", "--first-ray", "1000", "--seed", "4", "-o", &c]));
    succeed(&trace("scenes/bench_cavity.json", &["-n", "1000", "--first-ray", "1000", "-o", &d]));
    refuse(&["merge", &a, &b], &["both hold the rays 999 to 999", "--first-ray"]);
    refuse(&["merge", &a, &a], &["both hold the rays 0 to 999"]);
    refuse(&["merge", &a, &c], &["does not add up", "seed: 4 there, 0 here"]);
    refuse(&["merge", &a, &d], &["does not add up", "scene: "]);
    refuse(
        &["merge", &a, &a, "--scene", "scenes/bench_cavity.json"],
        &["bench_cavity.json is not", "--scene"],
    );
    refuse(&["merge", &a, folder.path().to_str().unwrap()], &["tally.bin"]);
    assert!(!run(&["merge", &a]).status.success());
    refuse(&["trace", LENS, "--target-error", "1%", "--standard-error", "off"], &["--standard-error off"]);
}

// Places: whole, and of one run alone.

/// A scene of many detectors, whose results are many files.
fn many_detectors(folder: &Path) -> String {
    let detector = |index: usize| {
        format!(
            r#"{{"name": "D{index}", "type": "irradiance", "width": 4, "height": 4, "num_pixels_x": 4, "num_pixels_y": 4,
                "absorb": false, "cs": {{"x": 0, "y": 0, "z": {}, "rx": 0, "ry": 0, "rz": 0, "reference_cs": null}}}}"#,
            1 + index
        )
    };
    let detectors: Vec<String> = (0..6).map(detector).collect();
    let text = format!(
        r#"{{"nsq_schema_version": 1, "components": [], "detectors": [{}], "sources": [{{"name": "S", "type": "collimated",
            "total_flux": 1, "aperture_radius": 1, "spectrum": {{"wavelengths": [0.5], "weights": [1]}},
            "cs": {{"x": 0, "y": 0, "z": 0, "rx": 0, "ry": 0, "rz": 0, "reference_cs": null}}}}]}}"#,
        detectors.join(", ")
    );
    let path = folder.join("many.json");
    std::fs::write(&path, text).unwrap();
    path.to_str().unwrap().into()
}

/// Two parts of a trace with each seed: what is merged of them is the same bytes every time.
fn parts(folder: &Path, seeds: std::ops::Range<u64>) -> Vec<[String; 2]> {
    let scene = many_detectors(folder);
    let part = |seed: u64, first: &str| {
        let file = folder.join(format!("{seed}-{first}.tally")).to_str().unwrap().to_string();
        let seed = seed.to_string();
        let rays = ["-n", "500", "--first-ray", first, "--of-rays", "1000", "--seed", &seed];
        succeed(&trace(&scene, &[&rays[..], &["--checkpoint", &file]].concat()));
        file
    };
    seeds.map(|seed| [part(seed, "0"), part(seed, "500")]).collect()
}

fn merge_into(parts: &[String; 2], out: &Path) -> Command {
    command(&["merge", &parts[0], &parts[1], "--no-pictures", "-o", out.to_str().unwrap()])
}

fn raw(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    let files = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap());
    let files = files.filter(|entry| entry.file_type().unwrap().is_file());
    files
        .map(|entry| (entry.file_name().into_string().unwrap(), std::fs::read(entry.path()).unwrap()))
        .collect()
}

fn hidden(folder: &Path) -> usize {
    let entries = std::fs::read_dir(folder).unwrap();
    entries
        .filter(|entry| entry.as_ref().unwrap().file_name().to_string_lossy().starts_with(".nsq-gpu-"))
        .count()
}

/// Killed before each change of the file system in turn, a run leaves the old result whole or the new one; the next run
/// ends well and tidies up. Where a folder lies among the files they change places one by one: then a killed run may leave
/// files of one run without a report, and the next run first brings the old ones back.
#[cfg(debug_assertions)]
#[test]
fn a_killed_run_leaves_the_old_result_or_the_new_one() {
    let folder = tempfile::tempdir().unwrap();
    let parts = parts(folder.path(), 1..3);
    let whole: Vec<_> = parts
        .iter()
        .map(|parts| {
            let out = folder.path().join("whole");
            assert!(merge_into(parts, &out).output().unwrap().status.success());
            let files = raw(&out);
            std::fs::remove_dir_all(out).unwrap();
            files
        })
        .collect();
    let [old, new] = whole.as_slice() else { panic!("two results") };
    assert!(old.len() == new.len() && old["D0.npz"] != new["D0.npz"]);
    for has_folder in files::in_turn([false, true]) {
        let mut num_kills = 0;
        loop {
            let place = tempfile::tempdir_in(folder.path()).unwrap();
            let out = place.path().join("out");
            std::fs::create_dir(&out).unwrap();
            old.iter().for_each(|(name, bytes)| std::fs::write(out.join(name), bytes).unwrap());
            std::fs::write(out.join("notes.txt"), "mine").unwrap();
            if has_folder {
                std::fs::create_dir(out.join("more")).unwrap();
                std::fs::write(out.join("more/notes.txt"), "mine").unwrap();
            }
            let killed =
                merge_into(&parts[1], &out).env("NSQ_GPU_TEST_KILL_AT", num_kills.to_string()).output();
            let ended_well = killed.unwrap().status.success();
            let check = |expected: &[&BTreeMap<String, Vec<u8>>], may_be_part: bool| {
                let mut files = raw(&out);
                assert_eq!(files.remove("notes.txt").unwrap(), b"mine", "at {num_kills}");
                assert!(!has_folder || std::fs::read(out.join("more/notes.txt")).unwrap() == b"mine");
                let is = |expected: &&&BTreeMap<String, Vec<u8>>| {
                    let is_part = may_be_part && !files.contains_key("report.json");
                    files.iter().all(|file| expected.get(file.0) == Some(file.1))
                        && (is_part || files.len() == expected.len())
                };
                assert!(expected.iter().find(is).is_some(), "at {num_kills}: {:?}", files.keys());
            };
            check(&[old, new], has_folder);
            let output = merge_into(&parts[1], &out).output().unwrap();
            assert!(output.status.success(), "at {num_kills}: {}", stderr(&output));
            check(&[new], false);
            assert_eq!(hidden(place.path()) + hidden(&out), 0, "at {num_kills}");
            if ended_well {
                break;
            }
            num_kills += 1;
        }
        assert!(num_kills >= 50, "{num_kills}");
    }
}

/// A run looks at a folder while another run makes it.
#[test]
fn a_folder_that_another_run_makes_meanwhile_is_no_error() {
    let place = tempfile::tempdir().unwrap();
    for round in 0..1000 {
        let deep = place.path().join(round.to_string());
        let start = std::sync::Barrier::new(2);
        std::thread::scope(|scope| {
            scope.spawn(|| {
                start.wait();
                std::fs::create_dir(&deep).unwrap();
            });
            start.wait();
            nsq_gpu::result::output::check_writable(&deep.join("out")).unwrap();
        });
    }
}

#[test]
fn runs_at_once_into_one_folder_leave_one_result_whole() {
    let folder = tempfile::tempdir().unwrap();
    let parts = parts(folder.path(), 1..5);
    let whole: Vec<_> = parts
        .iter()
        .map(|parts| {
            let out = tempfile::tempdir_in(folder.path()).unwrap();
            assert!(merge_into(parts, out.path()).output().unwrap().status.success());
            raw(out.path())
        })
        .collect();
    for round in 0..20 {
        let place = tempfile::tempdir_in(folder.path()).unwrap();
        let out = place.path().join(if round % 2 == 0 { "out" } else { "deep/out" });
        if round % 4 >= 2 {
            std::fs::create_dir_all(&out).unwrap();
        }
        let runs: Vec<Child> = parts
            .iter()
            .map(|parts| {
                let mut command = merge_into(parts, &out);
                command.stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap()
            })
            .collect();
        for run in runs {
            let output = run.wait_with_output().unwrap();
            assert!(output.status.success(), "round {round}: {}", stderr(&output));
        }
        let left = raw(&out);
        assert!(whole.contains(&left), "round {round}: {:?}", left.keys());
        assert_eq!(hidden(place.path()) + hidden(&out), 0, "round {round}");
    }
}

/// So many rays take for ever: what is refused is refused before.
#[cfg(unix)]
#[test]
fn places_that_cannot_be_written_are_found_before_the_trace() {
    use std::os::unix::fs::symlink;
    let folder = tempfile::tempdir().unwrap();
    let place = |name: &str| folder.path().join(name);
    symlink(place("gone"), place("dangling")).unwrap();
    std::fs::write(place("file"), "mine").unwrap();
    for name in ["report", "map", "picture"] {
        std::fs::create_dir(place(name)).unwrap();
    }
    std::fs::create_dir(place("report/report.json")).unwrap();
    std::fs::write(place("map/D.npz"), "mine").unwrap();
    symlink(place("file"), place("picture/D.png")).unwrap();
    let scene = std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join(LENS)).unwrap();
    std::fs::write(place("scene.json"), &scene).unwrap();
    let before = raw(folder.path());
    let refused = |option: &str, name: &str, words: &[&str]| {
        let scene = place("scene.json");
        let output =
            run(&["trace", scene.to_str().unwrap(), "-n", "1e15", option, place(name).to_str().unwrap()]);
        assert_eq!(output.status.code(), Some(USAGE), "{name}: {}", stderr(&output));
        assert!(output.stdout.is_empty(), "{name}: it traced");
        for word in words {
            assert!(stderr(&output).contains(word), "{name}: no `{word}` in {}", stderr(&output));
        }
        assert!(raw(folder.path()) == before && hidden(folder.path()) == 0, "{name}");
    };
    refused("-o", "dangling", &["dangling", "leads nowhere"]);
    refused("-o", "dangling/below", &["dangling", "leads nowhere"]);
    refused("-o", "not there/../out", &["not there", ".."]);
    refused("-o", "file/below", &["file", "is not a folder"]);
    refused("-o", "report", &["report.json", "is a folder"]);
    refused("-o", "map", &["D.npz", "name another folder"]);
    refused("-o", "picture", &["D.png", "name another folder"]);
    refused("--checkpoint", "scene.json", &["scene.json", "no file of sums"]);
    refused("--checkpoint", "file", &["no file of sums"]);
    refused("--checkpoint", "dangling", &["is a link"]);
    refused("--checkpoint", "report", &["is a folder"]);
    refused("--checkpoint", "missing/c.tally", &["missing/c.tally", "No such file"]);
    refused("--checkpoint", "/dev/null", &["/dev/null", "no file of sums"]);
}

/// Where writing fails in the end, nothing is left of it, and the result is printed.
#[cfg(unix)]
#[test]
fn a_result_that_cannot_be_written_is_printed() {
    for option in ["-o", "--checkpoint"] {
        let folder = tempfile::tempdir().unwrap();
        let limited = r#"ulimit -f 8; cd "$1"; "$0" trace "$2" -n 20000 --progress never --json "$3" out"#;
        let scene = Path::new(env!("CARGO_MANIFEST_DIR")).join(LENS);
        let mut command = Command::new("sh");
        command
            .args(["-c", limited, env!("CARGO_BIN_EXE_nsq-gpu")])
            .arg(folder.path())
            .arg(scene)
            .arg(option);
        let output = command.env("MESA_SHADER_CACHE_DISABLE", "true").output().unwrap();
        assert_eq!(output.status.code(), Some(USAGE), "{}", stderr(&output));
        assert!(
            stderr(&output).contains("out") && stderr(&output).contains("File too large"),
            "{}",
            stderr(&output)
        );
        assert_eq!(stderr(&output).lines().count(), 1, "a line of its own: {}", stderr(&output));
        let report: Value = serde_json::from_slice(&output.stdout).unwrap();
        assert_eq!(report["num_rays_total"], 20000);
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0, "nothing is left");
    }
}

#[test]
fn merge_refuses_results_that_are_not_as_they_were_written() {
    let folder = tempfile::tempdir().unwrap();
    let place = |name: &str| folder.path().join(name).to_str().unwrap().to_string();
    let (a, b) = (place("a"), place("b"));
    succeed(&trace(LENS, &["-n", "1000", "--first-ray", "0", "-o", &a]));
    succeed(&trace(LENS, &["-n", "1000", "--first-ray", "1000", "-o", &b]));
    for name in ["report.json", "D.npz", "tally.bin"] {
        let path = Path::new(&a).join(name);
        let bytes = std::fs::read(&path).unwrap();
        let mut damaged = bytes.clone();
        let middle = damaged.len() / 2;
        damaged[middle] ^= 1;
        std::fs::write(&path, damaged).unwrap();
        refuse(&["merge", &a, &b], &[name, "damaged"]);
        std::fs::write(&path, bytes).unwrap();
    }
    succeed(&["merge", &a, &b, "--json"]);
}
