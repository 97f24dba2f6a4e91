//! The command as users and programs meet it: exit codes, streams, files, messages.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test fails by panicking")]

use assert_cmd::Command;
use assert_cmd::cargo::CommandCargoExt;
use nsq_gpu::gpu::{AdapterChoice, AdapterInfo, Gpu};
use nsq_gpu::program::{PathSampling, Precision, Program, ProgramOptions, Sampler, SecondMoments};
use nsq_gpu::{Error, Scene, TraceOptions, Tracer};
use serde_json::Value;
use std::collections::BTreeMap;
use std::io::{Read, Write};
use std::path::{Path, PathBuf};
use std::process::{Output, Stdio};
use tempfile::TempDir;

const USAGE: i32 = 2;
const SCENE: i32 = 3;
const NO_ADAPTER: i32 = 4;
const DEVICE: i32 = 5;
const INTERRUPTED: i32 = 130;

fn scene_path(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes").join(format!("{name}.json"))
}

/// True where some adapter can trace; else says on stderr what is skipped.
fn has_adapter(test: &str) -> bool {
    let found = !nsq_gpu::gpu::list_adapters().is_empty();
    if !found {
        // Straight to the stream: the test runner hides what a passing test prints.
        let _ = writeln!(std::io::stderr(), "SKIPPED: {test}: no adapter");
    }
    found
}

/// Whether the widths of lavapipe's vectors can be told.
fn has_lavapipe(test: &str) -> bool {
    let is_lavapipe = |adapter: &AdapterInfo| adapter.name.contains("llvmpipe");
    let found = nsq_gpu::gpu::list_adapters().first().is_some_and(is_lavapipe);
    if !found {
        let _ = writeln!(std::io::stderr(), "SKIPPED: {test}: the adapter is not lavapipe");
    }
    found
}

/// What a command said.
struct Said {
    code: Option<i32>,
    stdout: String,
    stderr: String,
}

impl Said {
    fn of(output: &Output) -> Self {
        let text = |bytes: &[u8]| String::from_utf8(bytes.to_vec()).unwrap();
        let said =
            Said { code: output.status.code(), stdout: text(&output.stdout), stderr: text(&output.stderr) };
        assert!(
            !said.stderr.contains("panicked") && !said.stderr.contains("nsq-gpu: internal error"),
            "{}",
            said.stderr
        );
        assert!(!said.stderr.contains('\x1b') && !said.stdout.contains('\x1b'), "colour without a terminal");
        said
    }

    /// It failed with this code, printed nothing, and said all of this on stderr.
    fn refuses(&self, code: i32, words: &[&str]) {
        assert_eq!(self.code, Some(code), "{}", self.stderr);
        assert_eq!(self.stdout, "");
        for word in words {
            assert!(self.stderr.contains(word), "no `{word}` in: {}", self.stderr);
        }
    }

    fn succeeds(&self) -> &str {
        assert_eq!(self.code, Some(0), "{}", self.stderr);
        &self.stdout
    }

    fn json(&self) -> Value {
        serde_json::from_str(self.succeeds()).unwrap()
    }
}

fn command(arguments: &[&str]) -> Command {
    let mut command = Command::cargo_bin("nsq-gpu").unwrap();
    command.args(arguments);
    command
}

fn run(arguments: &[&str]) -> Said {
    Said::of(&command(arguments).output().unwrap())
}

/// Traces a scene of scenes/ with few rays.
fn trace(scene: &str, arguments: &[&str]) -> Said {
    let path = scene_path(scene);
    run(&[&["trace", path.to_str().unwrap(), "-n", "20000", "--precision", "f32"], arguments].concat())
}

/// A file with a scene in a folder of its own.
fn file_with(text: &str) -> (TempDir, String) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.json");
    std::fs::write(&path, text).unwrap();
    let path = path.to_str().unwrap().to_string();
    (folder, path)
}

fn text_of(scene: &str) -> String {
    std::fs::read_to_string(scene_path(scene)).unwrap()
}

/// Names and contents of a folder's files.
fn files_in(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    let entries = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap());
    entries.map(|e| (e.file_name().into_string().unwrap(), std::fs::read(e.path()).unwrap())).collect()
}

#[test]
fn json_is_one_document_with_the_fields_of_the_contract() {
    if !has_adapter("json") {
        return;
    }
    let said = trace("bench_cavity", &["--json", "--seed", "3"]);
    let report = said.json();
    let fields = [
        "schema",
        "seed",
        "precision",
        "adapter",
        "trace_time_sec",
        "first_rays_sec",
        "rays_per_sec",
        "num_rays_total",
        "num_rays_absorbed",
        "num_rays_escaped",
        "num_rays_flux_killed",
        "num_rays_depth_killed",
        "total_flux_in",
        "total_flux_detected",
        "total_flux_tapped",
        "total_flux_absorbed",
        "total_flux_bulk_absorbed",
        "total_flux_escaped",
        "total_flux_lost",
        "flux_conservation_error",
        "detectors",
        "ledger",
        "diagnostics",
    ];
    let missing: Vec<&str> = fields.into_iter().filter(|field| report[field].is_null()).collect();
    assert_eq!(missing, Vec::<&str>::new());
    assert_eq!((&report["seed"], &report["precision"]), (&Value::from(3), &Value::from("f32")));
    assert_eq!(report["num_rays_total"], 20_000);
    assert_eq!(report["ledger"]["imbalance_quanta"], "0");
    assert_eq!(report["detectors"]["D"]["kind"], "irradiance");
    assert!(report["detectors"]["D"]["num_rays_hit"].as_u64().unwrap() > 0);
    assert!(report["detectors"]["D"]["file"].is_null(), "no file was asked for");
    assert!(report["diagnostics"]["warnings"].is_array());
}

#[test]
fn text_report_names_detectors_and_ledger_on_stdout_alone() {
    if !has_adapter("text report") {
        return;
    }
    let said = trace("bench_lens", &[]);
    assert!(said.succeeds().contains('D') && said.stdout.contains("detected"), "{}", said.stdout);
    // A time that counts from the command's start and one that counts from the trace's start do not share a line.
    let times = |line: &&str| line.split([' ', ',', ';']).filter(|word| *word == "s").count();
    let counts: Vec<usize> =
        said.stdout.lines().map(|line| times(&line)).filter(|count| *count > 0).collect();
    assert_eq!(counts, [1, 1], "{}", said.stdout);
    assert_eq!(said.stderr, "");
}

#[test]
fn counts_read_as_people_write_them() {
    if !has_adapter("counts") {
        return;
    }
    let path = scene_path("bench_lens");
    for count in ["1e4", "10k", "10_000", "10000"] {
        let said = run(&["trace", path.to_str().unwrap(), "-n", count, "--json", "--precision", "f32"]);
        assert_eq!(said.json()["num_rays_total"], 10_000, "{count}");
    }
    for count in ["ten", "-5", "1.5", "1e30", ""] {
        let number = format!("--num-rays={count}");
        assert_eq!(run(&["trace", path.to_str().unwrap(), &number]).code, Some(USAGE), "{count}");
    }
}

#[test]
fn progress_in_json_is_lines_on_stderr_up_to_the_last_ray() {
    if !has_adapter("progress") {
        return;
    }
    let said = trace("bench_lens", &["--progress", "json", "--json"]);
    said.json();
    let lines: Vec<Value> = said.stderr.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    let last = lines.last().unwrap();
    assert_eq!((&last["rays"], &last["num_rays"]), (&Value::from(20_000), &Value::from(20_000)));
    let keys: Vec<&String> = last.as_object().unwrap().keys().collect();
    assert_eq!(keys, ["rays", "num_rays", "rays_per_sec", "eta_sec", "relative_error"]);
}

#[test]
fn output_folder_gets_report_and_two_files_a_detector() {
    if !has_adapter("output") {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("new/deep");
    let said = trace("newtonian_telescope", &["-o", out.to_str().unwrap(), "--json"]);
    let report = said.json();
    let files = files_in(&out);
    let names: Vec<&String> = files.keys().collect();
    assert_eq!(names, ["camera.npz", "camera.png", "pupil.npz", "pupil.png", "report.json", "tally.bin"]);
    assert_eq!(files["report.json"], said.stdout.as_bytes(), "what is printed is what is written");
    assert_eq!(report["detectors"]["camera"]["file"], "camera.npz");
    assert!(files["camera.npz"].starts_with(b"PK") && files["camera.png"].starts_with(b"\x89PNG"));
}

/// Names that are no file names, or that one file would have to share.
const NAMES: [&str; 16] = [
    "a/b",
    "a_b",
    "../up",
    "..",
    "",
    "Det 1: focus",
    "Image",
    "image",
    "con",
    "why?",
    " D ",
    "-n",
    ".hidden",
    "a\tb\u{1b}[2J",
    "report",
    "ray_paths",
];

#[test]
fn detectors_of_any_name_have_files_of_their_own() {
    if !has_adapter("detectors_of_any_name_have_files_of_their_own") {
        return;
    }
    let example = Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/example.json");
    let mut scene: Value = serde_json::from_str(&std::fs::read_to_string(example).unwrap()).unwrap();
    let long = ["y".repeat(300) + "1", "y".repeat(300) + "2"];
    let names: Vec<&str> = NAMES.into_iter().chain(long.iter().map(String::as_str)).collect();
    let detector = scene["detectors"][0].clone();
    let named = |(i, name): (usize, &&str)| {
        let mut detector = detector.clone();
        detector["name"] = Value::from(*name);
        detector["absorb"] = Value::from(false);
        detector["cs"]["z"] = Value::from(49 + i);
        detector
    };
    scene["detectors"] = names.iter().enumerate().map(named).collect();
    let (folder, path) = file_with(&scene.to_string());
    let out = folder.path().join("out");
    let said = run(&["trace", &path, "-n", "1000", "-o", out.to_str().unwrap(), "--record-paths", "3"]);
    assert!(!said.succeeds().contains(['\u{1b}', '\t']), "{}", said.stdout);
    let files = files_in(&out);
    let report: Value = serde_json::from_slice(&files["report.json"]).unwrap();
    let of_detectors = report["detectors"].as_object().unwrap();
    assert!(of_detectors.keys().eq(&names), "{:?}", of_detectors.keys());
    let mut seen = std::collections::BTreeSet::new();
    for (name, detector) in of_detectors {
        for key in ["file", "picture"] {
            let file = detector[key].as_str().unwrap();
            assert!(files.contains_key(file), "{name:?}: {file}");
            assert!(seen.insert(file.to_lowercase()), "{name:?}: {file}");
        }
    }
    // All that was written lies in the folder: two files a detector, the report, the sums and the paths.
    assert_eq!(files.len(), 2 * names.len() + 3);
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 2);
    let out = out.to_str().unwrap();
    let compared = run(&["compare", out, out]);
    assert!(!compared.succeeds().contains(['\u{1b}', '\t']), "{}", compared.stdout);
    assert!(!run(&["check", &path]).succeeds().contains(['\u{1b}', '\t']));
}

#[test]
fn nothing_is_written_where_something_fails() {
    if !has_adapter("failed output") {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let blocked = folder.path().join("file");
    std::fs::write(&blocked, "not a folder").unwrap();
    let said = trace("bench_lens", &["-o", blocked.join("below").to_str().unwrap()]);
    said.refuses(USAGE, &["file"]);
    // A folder stands where a file must go: the others must not appear.
    let out = folder.path().join("out");
    std::fs::create_dir_all(out.join("report.json")).unwrap();
    trace("bench_lens", &["-o", out.to_str().unwrap()]).refuses(USAGE, &["report.json"]);
    assert_eq!(std::fs::read_dir(&out).unwrap().count(), 1);
    assert_eq!(std::fs::read(&blocked).unwrap(), b"not a folder");
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 2, "nothing is left behind");
}

#[test]
fn invalid_scene_leaves_nothing() {
    let (folder, path) = file_with(&text_of("bench_lens").replace("\"thickness\"", "\"thicknes\""));
    let out = folder.path().join("out");
    let said = run(&["trace", &path, "-o", out.to_str().unwrap()]);
    said.refuses(SCENE, &["components[0].config", "thicknes", "thickness"]);
    assert!(!out.exists());
}

#[test]
fn scenes_that_cannot_be_traced_are_refused_with_their_place() {
    for (text, words) in [
        ("{", vec!["line"]),
        ("[]", vec![]),
        ("{\"nsq_schema_version\": 99}", vec!["99", "1"]),
        (r#"{"nsq_schema_version": 1, "components": [], "sources": [], "detectors": []}"#, vec!["sources"]),
    ] {
        let (_folder, path) = file_with(text);
        for subcommand in ["check", "trace"] {
            run(&[subcommand, &path]).refuses(SCENE, &words);
        }
    }
}

#[test]
fn missing_files_are_usage_errors_that_name_the_file() {
    for subcommand in ["check", "trace"] {
        run(&[subcommand, "no/such/scene.json"]).refuses(USAGE, &["no/such/scene.json"]);
    }
}

#[test]
fn misspelt_options_and_subcommands_get_suggestions() {
    run(&["trace", "scene.json", "--max-dept", "3"]).refuses(USAGE, &["--max-depth"]);
    let said = run(&["trace", "scene.json", "--rayz", "3"]);
    said.refuses(USAGE, &["--rayz", "--help"]);
    assert!(!said.stderr.contains("-- --rayz"), "{}", said.stderr);
    run(&["trac", "scene.json"]).refuses(USAGE, &["trace"]);
    run(&["trace", "scene.json", "--precision", "f16"]).refuses(USAGE, &["f32", "f64"]);
    run(&["trace", "scene.json", "--reflect-prob", "often"]).refuses(USAGE, &["fresnel", "auto"]);
    run(&[]).refuses(USAGE, &["Usage", "trace"]);
}

#[test]
fn options_without_sense_are_usage_errors() {
    if !has_adapter("senseless options") {
        return;
    }
    let refused: [&[&str]; 5] = [
        &["--max-depth", "0"],
        &["--batch-size", "0"],
        &["--min-flux-fraction", "2"],
        &["--rr-start-flux", "-1"],
        &["--rr-start-flux", "nan"],
    ];
    for options in refused {
        let assigned = format!("{}={}", options[0], options[1]);
        assert_eq!(trace("bench_lens", &[&assigned]).code, Some(USAGE), "{assigned}");
    }
    let path = scene_path("bench_lens");
    run(&["trace", path.to_str().unwrap(), "-n", "0"]).refuses(USAGE, &["0"]);
}

#[test]
fn check_tells_what_the_scene_holds_without_an_adapter() {
    let path = scene_path("cooke_triplet");
    let mut command = command(&["check", path.to_str().unwrap()]);
    let said = Said::of(&without_drivers(&mut command).output().unwrap());
    for name in ["L1.front", "image", "stray", "wavelengths"] {
        assert!(said.succeeds().contains(name), "{}", said.stdout);
    }
}

/// Points the loader at no driver and wgpu at Vulkan alone.
fn without_drivers(command: &mut Command) -> &mut Command {
    command
        .env("VK_DRIVER_FILES", "/nonexistent/icd.json")
        .env("VK_ICD_FILENAMES", "/nonexistent/icd.json")
        .env("WGPU_BACKEND", "vulkan")
}

#[test]
fn a_machine_without_adapter_says_how_to_get_one() {
    let path = scene_path("bench_lens");
    for arguments in [vec!["trace", path.to_str().unwrap()], vec!["adapters"]] {
        let said = Said::of(&without_drivers(&mut command(&arguments)).output().unwrap());
        said.refuses(
            NO_ADAPTER,
            &["no adapter was found; ", "VK_DRIVER_FILES is set to `/nonexistent/icd.json`"],
        );
        let first = said.stderr.lines().next().unwrap();
        assert!(first.contains("no adapter was found; ") && first.contains("lavapipe"), "{first}");
    }
}

#[test]
fn a_program_in_a_conda_environment_is_helped_by_conda() {
    let prefix = tempfile::tempdir_in(env!("CARGO_TARGET_TMPDIR")).unwrap();
    let program = prefix.path().join("bin/nsq-gpu");
    std::fs::create_dir(program.parent().unwrap()).unwrap();
    std::fs::hard_link(env!("CARGO_BIN_EXE_nsq-gpu"), &program).unwrap();
    for (conda, helps) in [(prefix.path(), true), (Path::new("/nonexistent"), false)] {
        let mut command = Command::new(&program);
        command.arg("adapters").env("CONDA_PREFIX", conda);
        let said = Said::of(&without_drivers(&mut command).output().unwrap());
        said.refuses(NO_ADAPTER, &["lavapipe"]);
        assert_eq!(
            said.stderr.contains("`conda install"),
            helps || !said.stderr.contains("apt-get"),
            "{}",
            said.stderr
        );
    }
}

#[test]
fn an_adapter_that_is_not_there_is_told_with_those_that_are() {
    if !has_adapter("wrong adapter") {
        return;
    }
    let there = nsq_gpu::gpu::list_adapters()[0].name.clone();
    trace("bench_lens", &["--adapter", "voodoo2"]).refuses(NO_ADAPTER, &["voodoo2", &there]);
    let named = trace("bench_lens", &["--adapter", &there.to_uppercase(), "--json"]);
    assert_eq!(named.json()["adapter"], there.as_str());
}

#[test]
fn adapters_lists_what_traces() {
    if !has_adapter("adapters") {
        return;
    }
    let said = run(&["adapters"]);
    for info in nsq_gpu::gpu::list_adapters() {
        assert!(said.succeeds().contains(&info.name));
    }
}

#[test]
fn maps_beyond_the_device_are_device_errors() {
    if !has_adapter("large map") {
        return;
    }
    let huge = text_of("bench_lens")
        .replace("\"num_pixels_x\": 64", "\"num_pixels_x\": 40000")
        .replace("\"num_pixels_y\": 64", "\"num_pixels_y\": 40000");
    let (folder, path) = file_with(&huge);
    run(&["check", &path]).succeeds();
    let out = folder.path().join("out");
    let said = run(&["trace", &path, "-n", "1000", "--precision", "f32", "-o", out.to_str().unwrap()]);
    said.refuses(DEVICE, &["bytes", "pixels"]);
    assert!(!out.exists());
}

#[cfg(unix)]
#[test]
fn interrupt_keeps_what_was_traced_and_marks_it() {
    if !has_adapter("interrupt") {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    let path = scene_path("bench_cavity");
    let mut child = std::process::Command::cargo_bin("nsq-gpu")
        .unwrap()
        .args([
            "trace",
            path.to_str().unwrap(),
            "-n",
            "1e13",
            "--precision",
            "f32",
            "--json",
            "--progress",
            "json",
        ])
        .args(["-o", out.to_str().unwrap()])
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    // The first line of progress: the trace runs, and Ctrl-C is handled.
    let mut stderr = child.stderr.take().unwrap();
    let mut byte = [0];
    while stderr.read(&mut byte).unwrap() == 1 && byte != *b"\n" {}
    let pid = child.id().to_string();
    assert!(std::process::Command::new("kill").args(["-INT", &pid]).status().unwrap().success());
    let mut rest = String::new();
    stderr.read_to_string(&mut rest).unwrap();
    let output = child.wait_with_output().unwrap();
    assert_eq!(output.status.code(), Some(INTERRUPTED), "{rest}");
    let report: Value = serde_json::from_slice(&output.stdout).unwrap();
    let traced = report["num_rays_total"].as_u64().unwrap();
    assert_eq!(report["partial"], true);
    assert!(traced > 0 && traced < 10_u64.pow(13), "{traced}");
    assert_eq!(report["ledger"]["imbalance_quanta"], "0");
    assert_eq!(files_in(&out)["report.json"], output.stdout);
    assert!(rest.contains("interrupted"), "{rest}");
}

#[cfg(unix)]
#[test]
fn a_closed_pipe_is_no_error() {
    for arguments in ["schema", "completions bash", "materials --search glass"] {
        let script = format!("\"$0\" {arguments} | head -1; echo ${{PIPESTATUS[0]}}");
        let binary = assert_cmd::cargo::cargo_bin("nsq-gpu");
        let output = std::process::Command::new("bash").arg("-c").arg(script).arg(binary).output().unwrap();
        let said = Said::of(&output);
        assert_eq!(said.stdout.lines().last(), Some("0"), "{arguments}: {}", said.stderr);
        assert_eq!(said.stderr, "", "{arguments}");
    }
}

#[test]
fn portable_traces_give_the_same_files() {
    if !has_adapter("portable") {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let files = |name: &str, options: &[&str]| {
        let out = folder.path().join(name);
        trace("newtonian_telescope", &[options, &["-o", out.to_str().unwrap()]].concat()).succeeds();
        let mut files = files_in(&out);
        let report: Value = serde_json::from_slice(&files.remove("report.json").unwrap()).unwrap();
        (files, report["ledger"].clone(), report["detectors"].clone())
    };
    assert!(files("native", &[]) == files("portable", &["--portable"]));
    assert!(files("batches", &["--batch-size", "777"]) == files("again", &[]));
}

#[test]
fn the_width_of_vectors_changes_no_bit() {
    if !has_lavapipe("the_width_of_vectors_changes_no_bit") {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let trace = |precision: &str, width: Option<&str>| {
        let out = folder.path().join(format!("{precision}-{width:?}"));
        let scene = scene_path("cooke_triplet");
        let mut command =
            command(&["trace", scene.to_str().unwrap(), "-n", "2e4", "--precision", precision, "-o"]);
        // A shader that the driver has kept would have the width that it was kept with.
        command.arg(&out).env("MESA_SHADER_CACHE_DISABLE", "true").env_remove("LP_NATIVE_VECTOR_WIDTH");
        command.envs(width.map(|width| ("LP_NATIVE_VECTOR_WIDTH", width)));
        Said::of(&command.output().unwrap()).succeeds();
        files_in(&out)
    };
    for precision in ["f32", "f64"] {
        let chosen = trace(precision, None);
        for width in ["128", "256", "512"] {
            let set = trace(precision, Some(width));
            for name in ["tally.bin", "image.npz"] {
                assert!(chosen[name] == set[name], "{name} in {precision}, {width} bits");
            }
        }
    }
}

/// Lavapipe would give shaders that it has kept in one width to a command that wants another.
#[test]
fn shaders_of_another_width_are_compiled_anew() {
    if !has_lavapipe("shaders_of_another_width_are_compiled_anew") {
        return;
    }
    let cache = tempfile::tempdir().unwrap();
    let num_kept = |width: &str| {
        let scene = scene_path("bench_lens");
        let mut command = command(&["trace", scene.to_str().unwrap(), "-n", "1e4", "--precision", "f64"]);
        command.env("MESA_SHADER_CACHE_DIR", cache.path()).env_remove("MESA_SHADER_CACHE_DISABLE");
        command.env("LP_NATIVE_VECTOR_WIDTH", width);
        Said::of(&command.output().unwrap()).succeeds();
        num_files(cache.path())
    };
    let [wide, again, narrow] = ["256", "256", "128"].map(num_kept);
    assert!(wide > 0);
    assert_eq!(wide, again, "what was kept is used");
    assert!(narrow > wide, "of another width");
}

/// Lavapipe would compile a stage anew for every range of rays, unless the first range began at ray 0.
#[test]
fn ranges_that_begin_elsewhere_compile_nothing_anew() {
    if !has_lavapipe("ranges_that_begin_elsewhere_compile_nothing_anew") {
        return;
    }
    let num_compiled = |first_ray: &str| {
        let cache = tempfile::tempdir().unwrap();
        let scene = scene_path("newtonian_telescope");
        let mut command = command(&["trace", scene.to_str().unwrap(), "-n", "9000", "--batch-size", "1000"]);
        command.args(["--sampler", "sobol", "--first-ray", first_ray]);
        command.env("MESA_SHADER_CACHE_DIR", cache.path()).env_remove("MESA_SHADER_CACHE_DISABLE");
        Said::of(&command.output().unwrap()).succeeds();
        num_files(cache.path())
    };
    let from_zero = num_compiled("0");
    assert!(from_zero > 0);
    assert_eq!(num_compiled("5"), from_zero);
}

fn num_files(folder: &Path) -> usize {
    let entries = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    entries.map(|path| if path.is_dir() { num_files(&path) } else { 1 }).sum()
}

#[test]
fn overrides_of_the_sampling_act() {
    if !has_adapter("overrides") {
        return;
    }
    let report = |options: &[&str]| trace("bench_lens", &[options, &["--json"]].concat()).json();
    let gain = |report: &Value| report["ledger"]["importance_gain"]["count"].as_u64().unwrap();
    assert_eq!(gain(&report(&["--reflect-prob", "fresnel"])), 0);
    assert!(gain(&report(&["--reflect-prob", "0.5"])) > 0);
    assert!(gain(&report(&["--reflect-prob", "auto"])) > 0);
    let killed = |x: &str| {
        let report = trace("bench_cavity", &["--json", "--rr-start-flux", x]).json();
        report["num_rays_flux_killed"].as_u64().unwrap()
    };
    assert_eq!(killed("0"), 0);
    assert!(killed("1") > 0);
    assert_ne!(report(&["--seed", "1"])["detectors"], report(&["--seed", "2"])["detectors"]);
    assert_eq!(report(&["--max-depth", "1"])["num_rays_depth_killed"], 20_000);
    let split = report(&["--split-depth", "5"]);
    assert_eq!(split["diagnostics"]["split_budget_saturated"], true);
    assert_eq!(report(&["--split-depth", "3"])["diagnostics"]["split_budget_saturated"], false);
    let ended = |report: &Value| {
        ["detected", "escaped"]
            .map(|bin| report["ledger"][bin]["count"].as_u64().unwrap())
            .iter()
            .sum::<u64>()
    };
    assert!(ended(&split) > 30_000 && ended(&report(&[])) <= 20_000);
    trace("bench_lens", &["--split-depth", "24"]).refuses(USAGE, &["--split-depth is 24", "0..=23"]);
}

#[test]
fn recorded_paths_are_written_with_the_result() {
    if !has_adapter("paths") {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let size = |number: &str| {
        let out = folder.path().join(number);
        let said = trace("bench_lens", &["--record-paths", number, "-o", out.to_str().unwrap(), "--json"]);
        assert_eq!(said.json()["ray_paths"], "ray_paths.npz");
        files_in(&out)["ray_paths.npz"].len()
    };
    let (some, all) = (size("100"), size("all"));
    assert!(some > 1_000 && all > 20 * some, "{some} and {all} bytes");
    trace("bench_lens", &["--record-paths", "many"]).refuses(USAGE, &["many"]);
}

/// A limit on the size of files stands in for a full disk.
#[cfg(unix)]
#[test]
fn rows_that_do_not_fit_the_disk_are_an_error_and_leave_nothing() {
    if !has_adapter("a full disk") {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    let scene = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes/bench_lens.json");
    // 2048 blocks of 512 bytes; the shell ignores the signal that would end the program.
    let limited =
        "trap '' XFSZ; ulimit -f 2048; exec \"$0\" trace \"$1\" -n 20000 --record-paths all -o \"$2\"";
    let said = std::process::Command::new("sh")
        .args(["-c", limited, env!("CARGO_BIN_EXE_nsq-gpu")])
        .args([&scene, &out])
        .output()
        .unwrap();
    let stderr = String::from_utf8_lossy(&said.stderr);
    assert_eq!(said.status.code(), Some(2), "{stderr}");
    assert!(stderr.contains("File too large") && stderr.contains("recorded rows of 80 bytes"), "{stderr}");
    assert!(stderr.contains(folder.path().to_str().unwrap()), "{stderr}");
    assert_eq!(
        std::fs::read_dir(folder.path()).unwrap().count(),
        0,
        "neither files nor hidden folders are left"
    );
}

#[test]
fn a_trace_may_end_with_whoever_started_it() {
    if !has_adapter("stdin") {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    let mut child = std::process::Command::new(env!("CARGO_BIN_EXE_nsq-gpu"))
        .args(["trace", "scenes/bench_lens.json", "-n", "1e15", "--watch-stdin", "--progress", "json", "-o"])
        .arg(&out)
        .current_dir(env!("CARGO_MANIFEST_DIR"))
        .stdin(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut begun = [0; 1];
    child.stderr.take().unwrap().read_exact(&mut begun).unwrap();
    assert!(child.try_wait().unwrap().is_none(), "it traces as long as stdin is open");
    drop(child.stdin.take());
    assert_eq!(child.wait().unwrap().code(), Some(130));
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0, "nothing is written");
}

/// The process that started a trace is killed, while another one holds the trace's stdin open.
#[cfg(target_os = "linux")]
#[test]
fn a_trace_ends_with_its_parent_though_a_fork_holds_stdin() {
    if !has_adapter("parent") {
        return;
    }
    let script = r#"exec 3<&0; "$0" trace scenes/bench_lens.json -n 1e15 --watch-stdin --progress never <&3 & echo $!; wait"#;
    let mut parent = std::process::Command::new("sh")
        .args(["-c", script, env!("CARGO_BIN_EXE_nsq-gpu")])
        .current_dir(env!("CARGO_MANIFEST_DIR"))
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let _held = parent.stdin.take();
    let mut stdout = parent.stdout.take().unwrap();
    let mut pid = String::new();
    let mut byte = [0];
    while stdout.read(&mut byte).unwrap() == 1 && byte != *b"\n" {
        pid.push(char::from(byte[0]));
    }
    // A zombie of another parent may be left; it no longer traces.
    let is_running = || {
        let status = std::fs::read_to_string(format!("/proc/{pid}/status")).unwrap_or_default();
        status.contains("State:") && !status.contains("State:\tZ")
    };
    std::thread::sleep(std::time::Duration::from_secs(1));
    assert!(is_running(), "it traces as long as its parent lives");
    parent.kill().unwrap();
    parent.wait().unwrap();
    let ends = (0..100).any(|_| {
        std::thread::sleep(std::time::Duration::from_millis(100));
        !is_running()
    });
    if !ends {
        let _ = std::process::Command::new("kill").args(["-KILL", &pid]).status();
    }
    assert!(ends, "it traces on");
}

/// Neither Mesa nor what it asks complains where no variable of a session is set.
#[cfg(unix)]
#[test]
fn drivers_say_nothing() {
    if !has_adapter("drivers") {
        return;
    }
    let path = std::env::var_os("PATH").unwrap();
    for arguments in
        [&["adapters"][..], &["trace", "scenes/bench_lens.json", "-n", "1000", "--progress", "never"]]
    {
        let mut command = command(arguments);
        command.env_clear().env("PATH", &path).current_dir(env!("CARGO_MANIFEST_DIR"));
        let said = Said::of(&command.output().unwrap());
        said.succeeds();
        assert_eq!(said.stderr, "", "{arguments:?}");
    }
}

#[test]
fn a_processor_is_called_one() {
    if !has_adapter("processor") {
        return;
    }
    let is_cpu = nsq_gpu::gpu::list_adapters().iter().all(|info| info.class.stands_in_for_gpu());
    let text = "no GPU was found: this is your processor";
    assert_eq!(run(&["adapters"]).succeeds().contains(text), is_cpu);
    assert_eq!(trace("bench_lens", &[]).succeeds().contains(text), is_cpu);
}

/// Bash asks the function of the script; where it finds nothing, bash completes files.
#[cfg(unix)]
#[test]
fn bash_completes_behind_the_subcommand() {
    let script = r#"
        source /dev/stdin
        complete -p nsq-gpu
        ask() {
            COMP_WORDS=("$@") COMP_CWORD=$(($# - 1)) COMPREPLY=()
            "$(complete -p nsq-gpu | sed 's/.*-F \([^ ]*\).*/\1/')" "$1" "${COMP_WORDS[COMP_CWORD]}" "${COMP_WORDS[COMP_CWORD-1]}"
            echo "$*: ${COMPREPLY[*]}"
        }
        ask nsq-gpu tra
        ask nsq-gpu trace --se
        ask /usr/bin/nsq-gpu trace scene.json --se
        ask nsq-gpu trace scene.json --precision d
        ask nsq-gpu view scene.json --resu
        ask nsq-gpu merge a b --sce
        ask nsq-gpu check scenes/bench_l
        ask nsq-gpu help comp"#;
    let mut bash = std::process::Command::new("bash")
        .args(["--norc", "-c", script])
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let completions = run(&["completions", "bash"]);
    bash.stdin.take().unwrap().write_all(completions.succeeds().as_bytes()).unwrap();
    let said = Said::of(&bash.wait_with_output().unwrap());
    let lines: Vec<&str> = said.stdout.lines().map(str::trim_end).collect();
    assert!(lines[0].contains("-o default"), "{lines:?}");
    let expected = [
        "nsq-gpu tra: trace",
        "nsq-gpu trace --se: --seed",
        "/usr/bin/nsq-gpu trace scene.json --se: --seed",
        "nsq-gpu trace scene.json --precision d: df64",
        "nsq-gpu view scene.json --resu:",
        "nsq-gpu merge a b --sce: --scene",
        "nsq-gpu check scenes/bench_l:",
        "nsq-gpu help comp: compare completions",
    ];
    assert_eq!(lines[1..], expected, "{}", said.stderr);
}

#[test]
fn an_editors_schema_is_no_unknown_key() {
    let text = text_of("filter_stack").replacen('{', r#"{"$schema": "nsq.schema.json","#, 1);
    let block = text.find("\"nsq_gpu\"").unwrap();
    let brace = block + text[block..].find('{').unwrap() + 1;
    let text = format!("{}\"$schema\": \"block.json\",{}", &text[..brace], &text[brace..]);
    let (_folder, path) = file_with(&text);
    run(&["check", &path]).succeeds();
    let schema: Value = serde_json::from_str(run(&["schema"]).succeeds()).unwrap();
    assert!(schema["properties"]["$schema"].is_object());
    assert!(schema["$defs"]["Block"]["properties"]["$schema"].is_object());
    let (_folder, path) = file_with(&text.replacen("nsq.schema.json\"", "a\", \"$schemas\": \"b\"", 1));
    run(&["check", &path]).refuses(SCENE, &["$schemas", "$schema"]);
}

#[test]
fn pictures_may_be_left_out() {
    if !has_adapter("pictures") {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let written = |options: &[&str]| {
        let out = folder.path().join(options.len().to_string());
        trace("bench_lens", &[&["-o", out.to_str().unwrap()], options].concat()).succeeds();
        files_in(&out)
    };
    let (all, numbers) = (written(&[]), written(&["--no-pictures"]));
    let pictures: Vec<&String> = all.keys().filter(|name| name.ends_with(".png")).collect();
    assert!(!pictures.is_empty());
    assert_eq!(numbers.len() + pictures.len(), all.len());
    assert!(numbers.iter().all(|(name, bytes)| name == "report.json" || all[name] == *bytes));
}

#[test]
fn materials_tell_what_a_name_stands_for() {
    let said = run(&["materials", "N-BK7", "--wavelengths", "0.5876"]);
    assert!(said.succeeds().contains("1.51679844"), "{}", said.stdout);
    run(&["materials", "N-BK77777"]).refuses(USAGE, &["N-BK7"]);
    run(&["materials", "N-BK7", "--wavelengths", "-1"]).refuses(USAGE, &["-1"]);
    assert!(run(&["materials", "--search", "calcium fluoride"]).succeeds().lines().count() > 0);
}

#[test]
fn schema_is_one_json_document() {
    let schema = run(&["schema"]).json();
    assert!(schema["properties"]["nsq_schema_version"].is_object(), "{schema}");
}

/// Each part of what is printed stands below its file's name, and is that file; and the whole is what a trace compiles.
#[test]
fn shader_prints_what_a_trace_compiles_and_where_it_comes_from() {
    if !has_adapter("shader") {
        return;
    }
    for precision in [Precision::F32, Precision::F64] {
        let name = "bench_lens";
        let said = run(&["shader", scene_path(name).to_str().unwrap(), "--precision", precision.name()]);
        let (head, printed) = said.succeeds().split_once('\n').unwrap();
        assert!(head.contains("bench_lens.json") && head.contains(precision.name()), "{head}");
        let mut num_files = 0;
        for part in printed.split("// ==== ").skip(1) {
            let (origin, text) = part.split_once('\n').unwrap();
            if let Some(path) = origin.strip_prefix("shaders/") {
                let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("shaders").join(path);
                assert_eq!(text, format!("{}\n", std::fs::read_to_string(file).unwrap()), "{path}");
                num_files += 1;
            } else {
                assert!(origin.starts_with("composed by "), "{origin}");
            }
        }
        assert!(num_files > 30, "{num_files} files");
        let ir = Scene::from_path(&scene_path(name)).unwrap().lower().unwrap();
        let gpu = Gpu::open(&AdapterChoice::default()).unwrap();
        let max_depth = nsq_gpu::model::depth::of_scene(&ir);
        let options = TraceOptions { max_depth, precision, ..Default::default() }.tuned(&gpu.info);
        let tracer = Tracer::new(&gpu, &ir, &options).unwrap();
        // Whoever runs the test may have set another width of lavapipe's vectors, with which one constant differs.
        let without_width = |text: &str| -> Vec<String> {
            text.lines()
                .filter(|line| !line.starts_with("const IMPOSSIBLE_COUNT"))
                .map(String::from)
                .collect()
        };
        assert_eq!(without_width(printed), without_width(&tracer.program().wgsl));
    }
}

#[test]
fn shader_refuses_what_is_no_scene() {
    let (_folder, path) = file_with("{}");
    run(&["shader", &path]).refuses(SCENE, &["scene.json"]);
}

#[test]
fn completions_know_every_subcommand() {
    for shell in ["bash", "zsh", "fish", "powershell", "elvish"] {
        let said = run(&["completions", shell]);
        for word in ["trace", "check", "adapters", "materials", "schema", "compare", "record-paths"] {
            assert!(said.succeeds().contains(word), "{shell}: {word}");
        }
    }
}

#[test]
fn help_names_the_exit_codes() {
    let said = run(&["--help"]);
    assert!(said.succeeds().contains("130 interrupted"), "{}", said.stdout);
    assert!(run(&["--version"]).succeeds().starts_with("nsq-gpu "));
}

/// Without colour in every setting that is no terminal; [`Said::of`] looks for escape codes.
#[test]
fn no_color_is_honoured() {
    for (name, value) in [("NO_COLOR", "1"), ("TERM", "dumb")] {
        let output = command(&["trace", "--nonsense"]).env(name, value).output().unwrap();
        Said::of(&output).refuses(USAGE, &["--nonsense"]);
    }
}

/// xorshift64*: a fixed sequence, so that a failure repeats.
struct Rng(u64);

impl Rng {
    fn below(&mut self, count: usize) -> usize {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        (self.0.wrapping_mul(0x2545_F491_4F6C_DD1D) >> 33) as usize % count
    }
}

/// A few bytes of a scene file replaced: digits half of the time, else anything printable.
fn damaged(text: &str, rng: &mut Rng) -> String {
    let mut bytes = text.as_bytes().to_vec();
    for _ in 0..=rng.below(3) {
        let at = rng.below(bytes.len());
        let digit = bytes[at..].iter().position(u8::is_ascii_digit).map(|offset| at + offset);
        match (rng.below(2), digit) {
            (0, Some(digit)) => bytes[digit] = b"0123456789e-."[rng.below(13)],
            _ => bytes[at] = b' ' + rng.below(95) as u8,
        }
    }
    String::from_utf8_lossy(&bytes).into_owned()
}

/// The library's part of a trace without a device: read, lower, compose, validate.
fn compose(text: &str) -> Result<(), Error> {
    let ir = Scene::from_json(text)?.lower()?;
    for (precision, baked) in [(Precision::F32, true), (Precision::F64, false)] {
        let options = ProgramOptions {
            precision,
            native: false,
            baked,
            tree: true,
            uniform_bytes: 1 << 14,
            texel_bytes: 1 << 24,
            max_depth: 16,
            roulette_threshold: 1e-3,
            events_per_dispatch: 4,
            workgroup_size: 64,
            paths: PathSampling::None,
            weights: vec![1.0; ir.sources.len()],
            sampler: Sampler::Pcg,
            most_rays_per_invocation: 1,
            vector_lanes: 0,
            copies_numbers: false,
            fixed_rays_per_invocation: None,
            has_long_loops: false,
            counts_wrong_sides: true,
            moments: SecondMoments::None,
            part_bytes: 1 << 27,
            live: false,
        };
        let program = Program::new(&ir, options, 0)?;
        naga::valid::Validator::new(naga::valid::ValidationFlags::all(), naga::valid::Capabilities::FLOAT64)
            .validate(&program.module)
            .unwrap_or_else(|error| panic!("{}", error.emit_to_string(&program.wgsl)));
    }
    Ok(())
}

#[test]
fn damaged_scenes_are_traced_or_refused_but_never_panic() {
    let names: Vec<PathBuf> = {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes");
        let mut paths: Vec<PathBuf> = std::fs::read_dir(folder).unwrap().map(|e| e.unwrap().path()).collect();
        paths.retain(|path| path.extension().is_some_and(|extension| extension == "json"));
        paths.sort();
        paths
    };
    let mut rng = Rng(20_240_917);
    let (mut accepted, mut refused) = (0, 0);
    for i in 0..300 {
        let text = damaged(&std::fs::read_to_string(&names[i % names.len()]).unwrap(), &mut rng);
        match compose(&text) {
            Ok(()) => accepted += 1,
            Err(Error::Scene { .. } | Error::Usage(_)) => refused += 1,
            Err(other) => panic!("{other:?} for {text}"),
        }
    }
    // Both happen often, or the damage would be too great or too small to find anything.
    assert!(accepted > 30 && refused > 30, "{accepted} accepted, {refused} refused");
}

/// The profile of a trace.
mod profile {
    use super::*;
    use nsq_gpu::engine::tuning::Tuning;
    use serde_json::json;

    fn stderr(output: &Output) -> String {
        String::from_utf8_lossy(&output.stderr).into_owned()
    }

    fn report(output: &Output) -> Value {
        assert_eq!(output.status.code(), Some(0), "{}", stderr(output));
        serde_json::from_slice(&output.stdout).unwrap()
    }

    /// Events of a ray in the cavity, which all come about.
    const DEPTH: u32 = 150;

    /// The report of the deep cavity, and what stood on stderr.
    fn trace_cavity(arguments: &[&str]) -> Output {
        let scene = scene_path("bench_cavity");
        let mut command = Command::cargo_bin("nsq-gpu").unwrap();
        command.args(["trace", scene.to_str().unwrap(), "-n", "3000", "--max-depth", &DEPTH.to_string()]);
        command
            .args(["--batch-size", "1000", "--precision", "f32", "--json"])
            .args(arguments)
            .output()
            .unwrap()
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
}

/// A ghost of the last face and the first passes all faces three times: `paths` follows rays farther than `trace`.
#[test]
fn paths_are_followed_as_far_as_ghosts_go() {
    if !has_adapter("paths_are_followed_as_far_as_ghosts_go") {
        return;
    }
    let scene = scene_path("double_gauss").display().to_string();
    let depth = |arguments: &[&str]| {
        let said = run(&[arguments, &["-n", "2000"]].concat());
        assert_eq!(said.code, Some(0), "{}", said.stderr);
        let number = said.stdout.split("max_depth ").nth(1).unwrap();
        number.split(|c: char| !c.is_ascii_digit()).next().unwrap().parse::<u32>().unwrap()
    };
    assert_eq!(depth(&["trace", &scene]), 20);
    assert_eq!(depth(&["paths", &scene]), 40);
    assert_eq!(depth(&["paths", &scene, "--max-depth", "24"]), 24);
    assert_eq!(depth(&["diff", &scene, &scene]), 20);
    assert_eq!(depth(&["diff", &scene, &scene, "--guide"]), 40);
}
