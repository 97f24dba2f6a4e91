//! `nsq-bench` on tiny counts: what it writes, what it refuses, how it compares. No clock decides anything here.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test fails by panicking")]

use assert_cmd::Command;
use nsq_bench::peers::PeerRun;
use nsq_bench::report::CSV_COLUMNS;
use nsq_bench::runner::{Measurement, PeerMeasurement, PerRay};
use nsq_bench::{CaseResult, Counts, Summary};
use nsq_gpu::result::Ledger;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::io::Write;
use std::path::Path;
use std::process::Output;

/// True where some adapter can trace; else says on stderr what is skipped.
fn has_adapter(test: &str) -> bool {
    let found = !nsq_gpu::gpu::list_adapters().is_empty();
    if !found {
        let _ = writeln!(std::io::stderr(), "SKIPPED: {test}: no adapter");
    }
    found
}

/// Measures some cases with 500 rays and two runs.
fn bench(arguments: &[&str]) -> Output {
    let tiny = ["--max-rays", "500", "--runs", "2", "--json"];
    Command::cargo_bin("nsq-bench").unwrap().args(tiny).args(arguments).output().unwrap()
}

fn stderr(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

fn report(output: &Output) -> Value {
    assert_eq!(output.status.code(), Some(0), "{}", stderr(output));
    serde_json::from_slice(&output.stdout).unwrap()
}

fn read(folder: &Path, name: &str) -> Vec<u8> {
    std::fs::read(folder.join(name)).unwrap()
}

#[test]
fn the_files_hold_what_was_measured() {
    if !has_adapter("bench files") {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let scenes = "rays,depth_32,lens_3,surfaces_50,spheres_100,cold_start,cooke_triplet";
    let note = "a \"note\", with a comma";
    let out = folder.path().to_str().unwrap();
    let output = bench(&["--scenes", scenes, "--note", note, "-o", out]);
    let printed = report(&output);
    let written: Value = serde_json::from_slice(&read(folder.path(), "bench.json")).unwrap();
    assert_eq!(written, printed);
    assert_eq!(
        (&printed["schema"], &printed["num_runs"], &printed["note"]),
        (&json!(1), &json!(2), &json!(note))
    );
    let command = format!("nsq-bench --scenes {scenes} --runs 2 --max-rays 500");
    assert_eq!(printed["command"], json!(command));
    for field in ["version", "build", "date"] {
        assert!(printed[field].is_string(), "{field}");
    }
    assert!(printed["adapter"]["name"].is_string() && printed["adapter"]["driver"].is_string());
    assert!(printed["machine"]["num_cores"].as_u64().unwrap() >= 1);
    let cases = printed["cases"].as_array().unwrap();
    assert_eq!(cases.len(), 7);
    cases.iter().for_each(assert_case);

    let csv = String::from_utf8(read(folder.path(), "bench.csv")).unwrap();
    let columns = |line: &str| line.split(',').count();
    assert_eq!(csv.lines().next().unwrap(), CSV_COLUMNS.join(","));
    assert!(csv.lines().all(|line| columns(line) == CSV_COLUMNS.len()), "{csv}");
    let measured: usize = cases.iter().map(|case| case["measurements"].as_array().unwrap().len()).sum();
    assert_eq!(csv.lines().count(), 1 + measured);
}

#[test]
#[ignore = "long"]
fn frames_of_the_viewer_are_measured() {
    if !has_adapter("frames_of_the_viewer_are_measured") {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().to_str().unwrap();
    let tiny = ["--scenes", "viewer", "--runs", "1", "--json", "-o", out];
    let printed = report(&Command::cargo_bin("nsq-bench").unwrap().args(tiny).output().unwrap());
    assert_eq!(printed["cases"], json!([]));
    assert!(folder.path().join("bench.json").exists());
    let states = printed["viewer"].as_array().unwrap();
    let names: Vec<&str> = states.iter().map(|state| state["name"].as_str().unwrap()).collect();
    assert_eq!(names, ["viewer_small", "viewer_large", "viewer_tracing", "viewer_shared"]);
    assert_eq!(states[1]["cells"], 4096);
    for state in states {
        let seconds = |part: &str, key: &str| state[part][key].as_f64().unwrap();
        assert!(
            0.0 < seconds("host_sec", "min")
                && seconds("host_sec", "median") <= seconds("frame_sec", "median")
        );
        let traces = ["viewer_tracing", "viewer_shared"].contains(&state["name"].as_str().unwrap());
        assert_eq!(state["rays_per_sec"].as_f64().is_some_and(|rate| rate > 0.0), traces, "{state}");
    }
}

fn assert_case(case: &Value) {
    let measurements = case["measurements"].as_array().unwrap();
    assert!(!measurements.is_empty());
    for ours in measurements {
        let counts = &ours["counts"];
        let detected = counts["detected"].as_u64().unwrap();
        assert!(detected <= 500);
        assert_eq!(
            counts,
            &json!({"requested": 500, "launched": 500, "counted": 500, "detected": detected, "closed": true})
        );
        assert_eq!(ours["runs_sec"].as_array().unwrap().len(), 2);
        let rate = |key: &str| ours["rays_per_sec"][key].as_f64().unwrap();
        assert!(0.0 < rate("min") && rate("min") <= rate("median") && rate("median") <= rate("max"));
        let per_ray = |key: &str| ours["per_ray"][key].as_f64().unwrap();
        assert!(per_ray("casts") >= 1.0 && per_ray("casts") >= per_ray("interactions"), "{case}");
        // A command reads the scene and compiles as well.
        let ready = ours["ready_sec"].as_f64();
        assert_eq!(ready.is_some(), case["kind"] == "trace");
        assert!(ours["first_rays_sec"].as_f64().unwrap() > ready.unwrap_or(0.0), "{case}");
    }
    // Between two mirrors every event is an interaction, and the depth limit ends all rays.
    if case["name"] == "depth_32" {
        assert_eq!(measurements[0]["per_ray"], json!({"casts": 32.0, "interactions": 32.0}));
    }
}

#[test]
fn people_get_a_table() {
    if !has_adapter("bench table") {
        return;
    }
    let tiny = ["--max-rays", "500", "--runs", "1", "--scenes", "depth_2", "--precision", "f32"];
    let output = Command::cargo_bin("nsq-bench").unwrap().args(tiny).output().unwrap();
    let table = String::from_utf8(output.stdout.clone()).unwrap();
    assert!(table.contains("M rays/s"), "{table}{}", stderr(&output));
    let lines = table.lines().filter(|line| line.starts_with("depth_2"));
    assert_eq!(lines.count(), 1);
}

#[test]
fn what_cannot_be_measured_is_a_usage_error() {
    for (arguments, word) in [(&["--scenes", "rays,nothing"][..], "`nothing`"), (&["--runs", "0"], "--runs")]
    {
        let output = bench(arguments);
        assert_eq!(output.status.code(), Some(2), "{arguments:?}");
        assert!(stderr(&output).contains(word), "{}", stderr(&output));
    }
    if has_adapter("bench without its peer") {
        let output = bench(&["--scenes", "rays", "--against", "optiland", "--python", "no-such-python"]);
        assert_eq!(output.status.code(), Some(2));
        assert!(stderr(&output).contains("no-such-python"));
    }
}

// Launched = counted.

fn counts() -> Counts {
    Counts { requested: 100, launched: 100, counted: 100, detected: 10, closed: true }
}

#[test]
fn a_lost_ray_fails_the_benchmark() {
    assert_eq!(counts().check("case"), Ok(()));
    for lost in [
        Counts { launched: 99, counted: 99, ..counts() },
        Counts { counted: 99, ..counts() },
        Counts { counted: 101, ..counts() },
        Counts { closed: false, ..counts() },
    ] {
        let error = lost.check("case").unwrap_err();
        assert_eq!(error.exit_code(), 1, "{lost:?}");
        assert!(error.to_string().contains("case"));
    }
}

#[test]
fn counts_are_those_of_ledger_and_report() {
    let mut ledger = Ledger::default();
    ledger.launched.count = 100;
    let ends = [
        (&mut ledger.detected, 10),
        (&mut ledger.absorbed, 20),
        (&mut ledger.escaped, 30),
        (&mut ledger.depth, 25),
        (&mut ledger.roulette_loss, 15),
    ];
    ends.into_iter().for_each(|(entry, count)| entry.count = count);
    assert_eq!(Counts::of_ledger(100, &ledger), counts());
    let report = json!({"ledger": ledger});
    assert_eq!(Counts::of_report(100, &report), counts());

    ledger.escaped.count -= 1;
    ledger.imbalance_quanta = -7;
    let lost = Counts { counted: 99, closed: false, ..counts() };
    assert_eq!(Counts::of_ledger(100, &ledger), lost);
    assert_eq!(Counts::of_report(100, &json!({"ledger": ledger})), lost);
    assert_eq!(
        Counts::of_report(100, &json!({})),
        Counts { launched: 0, counted: 0, detected: 0, closed: false, ..counts() }
    );
}

#[test]
fn a_peer_that_traces_another_scene_fails_the_benchmark() {
    let ours = Counts { requested: 10_000, launched: 10_000, counted: 10_000, detected: 3000, closed: true };
    let check = |num_rays, detected| {
        ours.check_peer("case", "peer", &PeerRun { precision: "f32", num_rays, seconds: 1.0, detected })
    };
    // One standard deviation is 0.0065 for as many rays, and 0.0152 for a thousand.
    for (num_rays, detected) in [(10_000, 3000), (10_000, 3250), (10_000, 2750), (1000, 380)] {
        assert_eq!(check(num_rays, Some(detected)), Ok(()), "{detected} of {num_rays}");
    }
    for (num_rays, detected) in [(10_000, 3450), (10_000, 2550), (1000, 400), (1000, 0)] {
        let error = check(num_rays, Some(detected)).unwrap_err();
        assert_eq!(error.exit_code(), 1);
        assert!(error.to_string().contains("case: peer"), "{error}");
    }
    assert_eq!(check(10_000, None), Ok(()));
}

#[test]
fn where_every_ray_is_detected_a_peer_may_miss_few() {
    let all = Counts { requested: 1000, launched: 1000, counted: 1000, detected: 1000, closed: true };
    let run = |detected| PeerRun { precision: "f32", num_rays: 1000, seconds: 1.0, detected: Some(detected) };
    assert_eq!(all.check_peer("case", "peer", &run(1000)), Ok(()));
    assert!(all.check_peer("case", "peer", &run(900)).is_err());
}

// Ratios.

fn planted(precision: &'static str, runs_sec: &[f64]) -> Measurement {
    let rays_per_sec = Summary::of_rates(1000.0, runs_sec).unwrap();
    Measurement {
        precision: precision.into(),
        counts: counts(),
        runs_sec: runs_sec.to_vec(),
        rays_per_sec,
        casts_per_sec: rays_per_sec.times(3.0),
        per_ray: PerRay { casts: 3.0, interactions: 3.0 },
        ready_sec: None,
        first_rays_sec: None,
        ratios: BTreeMap::new(),
    }
}

#[test]
fn ratios_are_of_medians_in_the_same_precision_where_the_peer_has_it() {
    let run = |precision, num_rays, seconds| PeerRun { precision, num_rays, seconds, detected: None };
    let optiland = [run("f64", 100, 1.0), run("f64", 100, 2.0), run("f64", 100, 50.0)];
    let drjit = [run("f32", 1000, 0.1), run("f64", 1000, 0.2)];
    let peer = |name, precision, runs: &[PeerRun]| PeerMeasurement::of(name, precision, runs);
    let mut case = CaseResult {
        name: "planted".into(),
        axis: "rays".into(),
        kind: "trace".into(),
        num_rays: 1000,
        max_depth: 16,
        num_primitives: 3,
        load_average: None,
        measurements: vec![planted("f32", &[1.0, 0.5, 9.0]), planted("f64", &[2.0])],
        peers: [
            peer("optiland", "f64", &optiland),
            peer("drjit", "f32", &drjit),
            peer("drjit", "f64", &drjit),
        ]
        .into_iter()
        .flatten()
        .collect(),
    };
    assert_eq!(peer("optiland", "f32", &optiland), None);
    case.fill_ratios();
    let ratios = |i: usize| &case.measurements[i].ratios;
    // 1000 and 500 rays/s; Optiland 50 rays/s in f64 alone; Dr.Jit 10,000 and 5,000.
    assert_eq!(*ratios(0), BTreeMap::from([("optiland".into(), 20.0), ("drjit".into(), 0.1)]));
    assert_eq!(*ratios(1), BTreeMap::from([("optiland".into(), 10.0), ("drjit".into(), 0.1)]));
}

/// Peers that are shell scripts with planted timings, in the place of Python.
#[cfg(unix)]
mod planted_peers {
    use super::*;
    use nsq_bench::runner::measure;
    use nsq_bench::{Kind, Session, cases};
    use nsq_gpu::gpu::{AdapterChoice, Gpu};
    use nsq_gpu::program::Precision;
    use std::os::unix::fs::PermissionsExt;

    fn script(folder: &Path, name: &str, text: &str) -> String {
        let path = folder.join(name);
        std::fs::write(&path, format!("#!/bin/sh\n{text}\n")).unwrap();
        std::fs::set_permissions(&path, std::fs::Permissions::from_mode(0o755)).unwrap();
        path.to_str().unwrap().to_string()
    }

    /// Answers every request with the same number of rays in half a second.
    fn optiland(folder: &Path, num_rays: u64) -> String {
        let answer = json!({"num_rays": num_rays, "seconds": 0.5});
        let versions = json!({"optiland": "0.0"});
        script(folder, "optiland", &format!("echo '{versions}'; while read line; do echo '{answer}'; done"))
    }

    #[test]
    fn peers_are_run_and_compared() {
        if !has_adapter("bench against optiland") {
            return;
        }
        let folder = tempfile::tempdir().unwrap();
        let python = optiland(folder.path(), 500);
        let arguments = ["--scenes", "depth_2,cold_start", "--against", "optiland", "--python", &python];
        let printed = report(&bench(&arguments));
        assert_eq!(printed["peers"]["optiland"], json!({"optiland": "0.0"}));
        let case = &printed["cases"][0];
        assert_eq!(case["peers"][0]["rays_per_sec"], json!({"median": 1000.0, "min": 1000.0, "max": 1000.0}));
        assert_eq!(case["peers"][0]["runs_sec"], json!([0.5, 0.5]));
        let ours = case["measurements"][0]["rays_per_sec"]["median"].as_f64().unwrap();
        let ratio = case["measurements"][0]["ratios"]["optiland"].as_f64().unwrap();
        approx::assert_relative_eq!(ratio, ours / 1000.0, max_relative = 1e-12);
        // A whole command is timed here, not by the peer.
        let whole = &printed["cases"][1]["peers"][0]["runs_sec"];
        assert!(whole.as_array().unwrap().iter().all(|seconds| seconds.as_f64() != Some(0.5)));
    }

    #[test]
    fn mitsuba_is_held_to_the_detected_share() {
        if !has_adapter("bench against mitsuba") {
            return;
        }
        let folder = tempfile::tempdir().unwrap();
        let run = |detected: u64| {
            let answer = json!({"num_rays": 500, "seconds": 0.5, "detected": detected});
            let versions = json!({"mitsuba": "0.0"});
            let text = format!("echo '{versions}'; while read line; do echo '{answer}'; done");
            let python = script(folder.path(), "mitsuba", &text);
            // Mitsuba takes no part in the first.
            bench(&["--scenes", "depth_2,spheres_100", "--against", "mitsuba", "--python", &python])
        };
        let printed = report(&run(150));
        assert_eq!(printed["peers"]["mitsuba"], json!({"mitsuba": "0.0"}));
        let [cavity, spheres] = [0, 1].map(|case| &printed["cases"][case]["peers"]);
        assert_eq!(spheres[0]["rays_per_sec"]["median"], 1000.0);
        assert_eq!(*cavity, json!([]));
        let failed = run(400);
        assert_eq!(failed.status.code(), Some(1));
        assert!(stderr(&failed).contains("mitsuba detects 0.8"), "{}", stderr(&failed));
    }

    #[test]
    fn a_command_that_loses_rays_fails_the_benchmark() {
        if !has_adapter("bench of a command that loses rays") {
            return;
        }
        let gpu = Gpu::open(&AdapterChoice::default()).unwrap();
        let folder = tempfile::tempdir().unwrap();
        let mut case = cases::all(500).into_iter().find(|case| case.kind == Kind::Command).unwrap();
        case.num_rays = 500;
        let fails_with = |detected: u64| {
            let mut ledger = Ledger::default();
            (ledger.launched.count, ledger.detected.count) = (500, detected);
            let report = json!({"ledger": ledger});
            // Called as: trace SCENE -o DIR ...
            let text = format!("mkdir -p \"$4\"; echo '{report}' > \"$4/report.json\"");
            let program = script(folder.path(), "nsq-gpu", &text).into();
            let session = Session { gpu: &gpu, program, num_runs: 1, precisions: vec![Precision::F32] };
            measure(&case, &session, &mut []).err()
        };
        assert_eq!(fails_with(500), None);
        let error = fails_with(499).unwrap();
        assert_eq!(error.exit_code(), 1);
        assert!(error.to_string().contains("499 counted"), "{error}");
    }

    #[test]
    fn a_peer_that_loses_rays_fails_the_benchmark() {
        if !has_adapter("bench against a peer that loses rays") {
            return;
        }
        let folder = tempfile::tempdir().unwrap();
        let python = optiland(folder.path(), 499);
        let output = bench(&["--scenes", "depth_2", "--against", "optiland", "--python", &python]);
        assert_eq!(output.status.code(), Some(1));
        assert!(stderr(&output).contains("499 of 500"), "{}", stderr(&output));
    }

    #[test]
    fn what_was_measured_before_a_case_failed_is_kept() {
        if !has_adapter("bench against a peer that fails") {
            return;
        }
        let folder = tempfile::tempdir().unwrap();
        // A case takes three answers: of one run to warm up, and of two.
        let answer = json!({"num_rays": 500, "seconds": 0.5});
        let text = format!("echo '{{}}'; for i in 1 2 3; do read line; echo '{answer}'; done");
        let python = script(folder.path(), "optiland", &text);
        let written = folder.path().join("out");
        let output = bench(&[
            "--scenes",
            "depth_2,depth_4",
            "--against",
            "optiland",
            "--python",
            &python,
            "-o",
            written.to_str().unwrap(),
        ]);
        // The user's Python does not do what it should.
        assert_eq!(output.status.code(), Some(2));
        assert!(stderr(&output).contains("depth_4 failed"), "{}", stderr(&output));
        let kept: Value =
            serde_json::from_slice(&std::fs::read(written.join("bench.json")).unwrap()).unwrap();
        let names: Vec<&Value> = kept["cases"].as_array().unwrap().iter().map(|case| &case["name"]).collect();
        assert_eq!(names, [&json!("depth_2")]);
    }

    #[test]
    fn drjit_traces_the_lens_alone_in_either_precision() {
        if !has_adapter("bench against drjit") {
            return;
        }
        let folder = tempfile::tempdir().unwrap();
        let run = |detected: u64| {
            let answer = |seconds: f64| json!({"num_rays": 500, "seconds": seconds, "detected": detected});
            let text = format!(
                "echo '{{}}'; while read line; do case $line in *f32*) echo '{}';; *f64*) echo '{}';; esac; done",
                answer(0.25),
                answer(0.5)
            );
            let python = script(folder.path(), "drjit", &text);
            bench(&["--scenes", "rays_1e3,depth_2", "--against", "drjit", "--python", &python])
        };
        let printed = report(&run(461));
        let medians = |case: usize| {
            let peers = printed["cases"][case]["peers"].as_array().unwrap();
            peers.iter().map(|peer| peer["rays_per_sec"]["median"].as_f64().unwrap()).collect::<Vec<_>>()
        };
        assert_eq!(medians(0), [2000.0, 1000.0]);
        assert!(medians(1).is_empty());
        let failed = run(300);
        assert_eq!(failed.status.code(), Some(1));
        assert!(stderr(&failed).contains("drjit detects 0.6"), "{}", stderr(&failed));
    }
}
