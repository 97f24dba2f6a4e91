//! `nsq-gpu bench` on tiny counts: what it writes, what it refuses, how it compares. No clock decides anything here.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test fails by panicking")]

use assert_cmd::Command;
use nsq_gpu::bench::peers::PeerRun;
use nsq_gpu::bench::report::CSV_COLUMNS;
use nsq_gpu::bench::runner::{Measurement, PeerMeasurement, PerRay};
use nsq_gpu::bench::{CaseResult, Counts, Summary};
use nsq_gpu::engine::tuning::Tuning;
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
    let tiny = ["bench", "--max-rays", "500", "--runs", "2", "--json"];
    Command::cargo_bin("nsq-gpu").unwrap().args(tiny).args(arguments).output().unwrap()
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
    let command = format!("nsq-gpu bench --scenes {scenes} --runs 2 --max-rays 500");
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
    assert_eq!(&read(folder.path(), "bench.png")[..8], b"\x89PNG\r\n\x1a\n");
}

#[test]
#[cfg(feature = "viewer")]
fn frames_of_the_viewer_are_measured() {
    if !has_adapter("frames_of_the_viewer_are_measured") {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().to_str().unwrap();
    let tiny = ["bench", "--scenes", "viewer", "--runs", "1", "--json", "-o", out];
    let printed = report(&Command::cargo_bin("nsq-gpu").unwrap().args(tiny).output().unwrap());
    assert_eq!(printed["cases"], json!([]));
    assert!(folder.path().join("bench.json").exists() && !folder.path().join("bench.png").exists());
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
    let tiny = ["bench", "--max-rays", "500", "--runs", "1", "--scenes", "depth_2", "--precision", "f32"];
    let output = Command::cargo_bin("nsq-gpu").unwrap().args(tiny).output().unwrap();
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

// The profile of a trace.

/// Events of a ray in the cavity, which all come about.
const DEPTH: u32 = 150;

/// The report of the deep cavity, and what stood on stderr.
fn trace_cavity(arguments: &[&str]) -> Output {
    let scene = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes/bench_cavity.json");
    let mut command = Command::cargo_bin("nsq-gpu").unwrap();
    command.args(["trace", scene.to_str().unwrap(), "-n", "3000", "--max-depth", &DEPTH.to_string()]);
    command.args(["--batch-size", "1000", "--precision", "f32", "--json"]).args(arguments).output().unwrap()
}

#[test]
fn a_profile_names_the_stages_and_changes_no_bit() {
    if !has_adapter("profile") {
        return;
    }
    let profiled = trace_cavity(&["--profile"]);
    if stderr(&profiled).contains("no timestamps") {
        let _ = writeln!(std::io::stderr(), "SKIPPED: profile: no timestamps");
        return;
    }
    let (with, without) = (report(&profiled), report(&trace_cavity(&[])));
    assert_eq!(with["ledger"], without["ledger"]);
    assert_eq!(without["diagnostics"].get("stage_times"), None);
    let stages = with["diagnostics"]["stage_times"].as_array().unwrap();
    // Three batches, each of a round of new rays and so many more, until all events have come about.
    let tuning = Tuning::of(&nsq_gpu::gpu::list_adapters()[0]);
    let num_queued = 3 * (DEPTH.div_ceil(tuning.events_per_dispatch) - 1);
    assert!(num_queued > 0);
    let dispatches: Vec<_> = stages.iter().map(|s| (&s["stage"], &s["num_dispatches"])).collect();
    let expected = [("trace_new", 3), ("advance", num_queued), ("trace_queued", num_queued)]
        .map(|(stage, count)| (json!(stage), json!(count)));
    assert_eq!(dispatches, expected.each_ref().map(|(stage, count)| (stage, count)));
    for stage in stages {
        assert!(stage["time_sec"].as_f64().unwrap() >= 0.0);
        assert!(stderr(&profiled).contains(stage["stage"].as_str().unwrap()));
    }
}

#[test]
fn a_profile_without_timestamps_is_a_usage_error() {
    if !has_adapter("no profile") {
        return;
    }
    let output = trace_cavity(&["--profile", "--portable"]);
    assert_eq!(output.status.code(), Some(2), "{}", stderr(&output));
    assert!(stderr(&output).contains("no timestamps"));
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
    use nsq_gpu::bench::runner::measure;
    use nsq_gpu::bench::{Kind, Session, cases};
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

/// `nsq-gpu bench --accuracy`: that it runs, and that its numbers hang together.
mod accuracy {
    use super::*;
    use nsq_gpu::bench::accuracy::report::{CLAIM_COLUMNS, CURVE_COLUMNS, NUMERICAL_COLUMNS};

    fn bench_accuracy(arguments: &[&str]) -> Output {
        let quick = ["bench", "--accuracy", "--quick"];
        Command::cargo_bin("nsq-gpu").unwrap().args(quick).args(arguments).output().unwrap()
    }

    /// The rows of a CSV without commas in its cells, by column.
    fn rows(folder: &Path, name: &str, columns: &[&str]) -> Vec<BTreeMap<String, String>> {
        let text = String::from_utf8(read(folder, name)).unwrap();
        assert_eq!(text.lines().next().unwrap(), columns.join(","), "{name}");
        let row = |line: &str| {
            let cells = line.replace(", sobol", "; sobol");
            let cells: Vec<String> = cells.split(',').map(|cell| cell.trim_matches('"').into()).collect();
            assert_eq!(cells.len(), columns.len(), "{line}");
            columns.iter().map(|column| (*column).to_string()).zip(cells).collect()
        };
        text.lines().skip(1).map(row).collect()
    }

    fn number(row: &BTreeMap<String, String>, column: &str) -> f64 {
        row[column].parse().unwrap_or_else(|_| panic!("{column}: `{}`", row[column]))
    }

    /// Errors of a method's map and flux, from few rays to many.
    fn errors(rows: &[BTreeMap<String, String>], scene: &str, method: &str) -> Vec<(f64, f64, f64)> {
        let of = |row: &&BTreeMap<String, String>| row["scene"] == scene && row["method"] == method;
        let point = |row| (number(row, "num_rays"), number(row, "map_rms_error"), number(row, "flux_error"));
        rows.iter().filter(of).map(point).collect()
    }

    #[test]
    fn error_falls_and_tiers_agree() {
        if !has_adapter("bench --accuracy") {
            return;
        }
        let folder = tempfile::tempdir().unwrap();
        let output = bench_accuracy(&[
            "--scenes",
            "bench_lens,light_pipe,lamp",
            "-o",
            folder.path().to_str().unwrap(),
        ]);
        assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
        for chart in ["accuracy.png", "accuracy_flux.png", "numerical.png"] {
            assert_eq!(&read(folder.path(), chart)[..8], b"\x89PNG\r\n\x1a\n", "{chart}");
        }
        assert_eq!(read(folder.path(), "accuracy.txt"), output.stdout);
        assert_curves(&rows(folder.path(), "accuracy.csv", &CURVE_COLUMNS));
        assert_numerical(&rows(folder.path(), "numerical.csv", &NUMERICAL_COLUMNS));
        let claims = rows(folder.path(), "sobol.csv", &CLAIM_COLUMNS);
        assert!(claims.len() >= 4, "{claims:?}");
        for row in &claims {
            for what in ["map", "flux"] {
                let [value, low, high] =
                    ["", "_low", "_high"].map(|end| number(row, &format!("{what}_ratio{end}")));
                assert!(0.0 < low && low <= value && value <= high, "{row:?}");
                // Few traces prove nothing, and so nothing is claimed.
                assert_eq!(row[&format!("{what}_least")], "");
            }
        }
    }

    #[test]
    fn claims_alone_write_their_files_and_no_ratio_where_nothing_errs() {
        if !has_adapter("bench --accuracy --claims") {
            return;
        }
        let folder = tempfile::tempdir().unwrap();
        let scene = "bench_surface_count_50";
        let output = bench_accuracy(&["--claims", "--scenes", scene, "-o", folder.path().to_str().unwrap()]);
        assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
        let files = std::fs::read_dir(folder.path()).unwrap().map(|file| file.unwrap().file_name());
        let mut files: Vec<_> = files.collect();
        files.sort();
        assert_eq!(files, ["accuracy.txt", "sobol.csv"]);
        let row = &rows(folder.path(), "sobol.csv", &CLAIM_COLUMNS)[0];
        assert!(number(row, "map_ratio") > 1.0, "{row:?}");
        // Every ray ends on the detector.
        assert_eq!(row["flux_ratio"], "");
        assert!(String::from_utf8_lossy(&output.stdout).contains("no error"));
    }

    fn assert_curves(rows: &[BTreeMap<String, String>]) {
        for scene in ["bench_lens", "light_pipe"] {
            let f32 = errors(rows, scene, "f32");
            let sobol = errors(rows, scene, "sobol");
            assert!(f32.len() >= 2, "{scene}: a curve has points");
            for pair in f32.windows(2) {
                let ratio = pair[0].1 / pair[1].1;
                assert!(ratio > 1.0, "{scene}: the error falls by {ratio}");
                // Four times the rays halve the error: over some hundred pixels that are lit alike, to a few percent. At
                // the end of the pipe one pixel holds a beam, and most of the error.
                let is_even = scene == "bench_lens";
                assert!(!is_even || (1.7..2.3).contains(&ratio), "{scene}: the error falls by {ratio}");
            }
            let ours = sobol.last().unwrap();
            let random = f32.iter().find(|point| point.0 == ours.0).unwrap();
            assert!(ours.1 < random.1, "{scene}: Sobol points {} against {}", ours.1, random.1);
            // A splat moves flux between pixels alone.
            let bilinear = errors(rows, scene, "bilinear splat");
            let f64 = errors(rows, scene, "f64");
            for (splat, hard) in bilinear.iter().zip(&f64) {
                approx::assert_relative_eq!(splat.2, hard.2, max_relative = 1e-9);
            }
            // The same draws take the same paths: a pixel's error is the same to what few rays do otherwise.
            for (coarse, fine) in f32.iter().zip(&f64) {
                approx::assert_relative_eq!(coarse.1, fine.1, max_relative = 1e-2);
            }
        }
    }

    fn assert_numerical(rows: &[BTreeMap<String, String>]) {
        assert!(!rows.is_empty());
        for row in rows {
            let [rms, max] = ["position_rms_mm", "position_max_mm"].map(|column| number(row, column));
            assert!(rms <= max && max < 0.1, "{row:?}");
            assert!(number(row, "flux_rms") <= number(row, "flux_max"), "{row:?}");
            assert!((0.0..=0.01).contains(&number(row, "share_of_other_fate")), "{row:?}");
            assert!(number(row, "num_arrivals") > 1000.0, "{row:?}");
            let in_f32 = row["shader"].starts_with("f32");
            assert!(!in_f32 || row["against"].starts_with("f32") || rms > 1e-9, "f32 rounds: {row:?}");
            assert!(in_f32 || rms < 1e-10, "f64 against itself: {row:?}");
        }
    }

    #[test]
    fn unknown_scenes_and_peers_are_refused() {
        let output = bench_accuracy(&["--scenes", "cooke_tripler"]);
        assert_eq!(output.status.code(), Some(2));
        assert!(stderr(&output).contains("cooke_triplet"), "{}", stderr(&output));
        if !has_adapter("bench --accuracy against drjit") {
            return;
        }
        let output = bench_accuracy(&["--scenes", "lamp", "--against", "drjit"]);
        assert_eq!(output.status.code(), Some(2));
        assert!(stderr(&output).contains("optiland alone"), "{}", stderr(&output));
    }
}
