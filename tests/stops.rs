//! No command writes over what is not its own, and every command that is stopped, or meets one bad point, keeps what it
//! computed.
#![cfg(unix)]
#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "clippy's exemption of tests does not reach their helpers"
)]

mod command;
#[path = "zoo/files.rs"]
mod files;

use command::{command, run, stderr};
use serde_json::Value;
use std::fs;
use std::os::unix::fs::{PermissionsExt, symlink};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};

const LENS: &str = "docs/example.json";
const USAGE: i32 = 2;
const SCENE: i32 = 3;
const INTERRUPTED: i32 = 130;
/// More rays than any test waits for.
const FOREVER: &str = "1e13";

fn json(bytes: &[u8]) -> Value {
    serde_json::from_slice(bytes)
        .unwrap_or_else(|error| panic!("{error}: {}", String::from_utf8_lossy(bytes)))
}

fn ends(arguments: &[&str], code: i32, words: &[&str]) -> Output {
    let output = run(arguments);
    assert_eq!(output.status.code(), Some(code), "{arguments:?}: {}", stderr(&output));
    for word in words {
        assert!(stderr(&output).contains(word), "{arguments:?}: no `{word}` in {}", stderr(&output));
    }
    output
}

/// A folder for files of one test, with a copy of the scene.
struct Place(tempfile::TempDir);

impl Place {
    fn new() -> Self {
        let place = Place(tempfile::tempdir().unwrap());
        let root = Path::new(env!("CARGO_MANIFEST_DIR"));
        fs::copy(root.join(LENS), place.path("scene.json")).unwrap();
        place
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    fn text(&self, name: &str) -> String {
        self.path(name).to_str().unwrap().into()
    }

    fn num_hidden(&self) -> usize {
        let entries = fs::read_dir(self.0.path()).unwrap();
        entries.filter(|entry| entry.as_ref().unwrap().file_name().to_string_lossy().starts_with('.')).count()
    }
}

// Outputs.

#[test]
fn no_output_takes_the_place_of_what_is_there() {
    let place = Place::new();
    let scene = place.text("scene.json");
    let text = fs::read_to_string(place.path("scene.json")).unwrap();
    for name in ["mine.csv", "mine.png"] {
        fs::write(place.path(name), "mine").unwrap();
    }
    symlink(place.path("mine.csv"), place.path("link.png")).unwrap();
    symlink(place.path("nowhere"), place.path("dangling.png")).unwrap();
    assert!(Command::new("mkfifo").arg(place.path("pipe.png")).status().unwrap().success());
    fs::create_dir(place.path("folder.png")).unwrap();
    let set = "L1.r1=50,60";
    let commands: [(&[&str], &str); 3] = [
        (&["sweep", &scene, "--set", set, "-n", FOREVER, "-o"], "mine.csv"),
        (&["sweep", &scene, "--tolerance", "L1.r1=1%", "-n", FOREVER, "-o"], "mine.csv"),
        (&["view", &scene, "-n", FOREVER, "--screenshot"], "mine.png"),
    ];
    for (arguments, mine) in commands {
        let refused = |name: &str, words: &[&str], more: &[&str]| {
            let path = place.text(name);
            ends(&[arguments, &[path.as_str()], more].concat(), USAGE, &[&[name], words].concat());
        };
        refused(mine, &["exists; --overwrite replaces it"], &[]);
        for more in [&[][..], &["--overwrite"]] {
            refused("link.png", &["is a link"], more);
            refused("dangling.png", &["is a link"], more);
            refused("pipe.png", &["is a pipe or a device"], more);
            refused("folder.png", &["is a folder"], more);
            refused("missing/new.png", &["No such file"], more);
        }
        if arguments[0] == "sweep" {
            refused("scene.json", &["is read by this command"], &["--overwrite"]);
        }
    }
    assert_eq!(fs::read_to_string(place.path("scene.json")).unwrap(), text);
    assert!(["mine.csv", "mine.png"].iter().all(|name| fs::read(place.path(name)).unwrap() == b"mine"));
    assert!(!place.path("nowhere").exists() && place.num_hidden() == 0);
    let points = ["sweep", &scene, "--set", set, "-n", "1000", "-o", &place.text("mine.csv"), "--overwrite"];
    ends(&points, 0, &["written: "]);
    assert_eq!(fs::read_to_string(place.path("mine.csv")).unwrap().lines().count(), 3);
}

/// Killed before each change of the file system in turn, a sweep leaves the old points or the new ones.
#[cfg(debug_assertions)]
#[test]
fn a_sweep_that_is_killed_while_it_writes_leaves_the_old_points_or_the_new_ones() {
    let place = Place::new();
    let (scene, points) = (place.text("scene.json"), place.text("points.csv"));
    let arguments = ["sweep", &scene, "--set", "L1.r1=50", "-n", "1000", "-o", &points, "--overwrite"];
    let mut num_kills = 0;
    loop {
        fs::write(&points, "old").unwrap();
        let killed = command(&arguments).env("NSQ_GPU_TEST_KILL_AT", num_kills.to_string()).output().unwrap();
        let found = fs::read_to_string(&points).unwrap();
        assert!(found == "old" || found.starts_with("L1.r1,") && found.lines().count() == 2, "{found}");
        if killed.status.success() {
            break;
        }
        num_kills += 1;
    }
    assert!(num_kills >= 3, "{num_kills}");
    assert_eq!(place.num_hidden(), 0, "the next run tidies up");
}

#[test]
fn a_file_that_cannot_be_written_keeps_the_old_one_and_the_points_are_printed() {
    let place = Place::new();
    fs::write(place.path("points.json"), "mine").unwrap();
    let limited =
        r#"ulimit -f 1; exec "$0" sweep "$1" --set L1.r1=50:60:11 -n 1000 -o "$2" --overwrite --json"#;
    let mut command = Command::new("sh");
    command.args(["-c", limited, env!("CARGO_BIN_EXE_nsq-gpu")]);
    command.arg(place.path("scene.json")).arg(place.path("points.json"));
    let output = command.env("MESA_SHADER_CACHE_DISABLE", "true").output().unwrap();
    assert_eq!(output.status.code(), Some(USAGE), "{}", stderr(&output));
    assert_eq!(json(&output.stdout)["points"].as_array().unwrap().len(), 11);
    assert_eq!(fs::read(place.path("points.json")).unwrap(), b"mine");
    assert_eq!(place.num_hidden(), 0);
}

#[test]
fn sums_of_another_trace_are_replaced_only_where_that_is_meant() {
    let place = Place::new();
    let (scene, file) = (place.text("scene.json"), place.text("run.tally"));
    let trace = |more: &[&str]| -> Vec<String> {
        let all = [&["trace", &scene, "--checkpoint", &file, "--precision", "f32"], more].concat();
        all.into_iter().map(String::from).collect()
    };
    let ends = |more: &[&str], code: i32, words: &[&str]| {
        let arguments = trace(more);
        ends(&arguments.iter().map(String::as_str).collect::<Vec<_>>(), code, words)
    };
    ends(&["-n", "20000"], 0, &[]);
    let before = fs::read(&file).unwrap();
    let other = ["another trace", "seed: 0 there, 5 here", "--overwrite"];
    ends(&["-n", "20000", "--seed", "5"], USAGE, &other);
    ends(&["-n", "30000"], USAGE, &["another trace", "rays: 20000 there, 30000 here"]);
    assert_eq!(fs::read(&file).unwrap(), before);
    ends(&["-n", "20000"], 0, &[]);
    assert_eq!(fs::read(&file).unwrap(), before, "the same trace gives the same sums");
    ends(&["-n", "20000", "--seed", "5", "--overwrite"], 0, &[]);
    assert!(fs::read(&file).unwrap() != before);
    // Eight bytes make no file of sums.
    fs::write(&file, "NSQTALLY, the notes of a user").unwrap();
    ends(&["-n", "20000"], USAGE, &["run.tally", "--overwrite"]);
    assert_eq!(fs::read(&file).unwrap(), b"NSQTALLY, the notes of a user");
    fs::write(&file, "notes").unwrap();
    ends(&["-n", "20000", "--overwrite"], USAGE, &["no file of sums"]);
    assert_eq!(fs::read(&file).unwrap(), b"notes");
}

#[test]
fn fewer_rays_of_a_trace_never_take_the_place_of_more() {
    let place = Place::new();
    let (scene, file) = (place.text("scene.json"), place.text("run.tally"));
    let trace = ["trace", &scene, "--checkpoint", &file, "--precision", "f32", "-n", "1e8"];
    let mut first = spawn(&[&trace[..], &["--batch-size", "1000"]].concat());
    stop(&mut first, Duration::from_secs(3), "INT");
    let output = first.wait_with_output().unwrap();
    let before = fs::read(&file).unwrap();
    let rays = nsq_gpu::run::checkpoint::Checkpoint::read(Path::new(&file)).unwrap().tally.launched.count;
    assert!(rays > 0 && rays < 100_000_000, "{rays}: {}", stderr(&output));
    // The same trace from its beginning, ended after its first batch: fewer rays, however slow the machine was before.
    let at_once = ["--batch-size", "10", "--time-limit", "1ms", "--checkpoint-interval", "1ms"];
    let again = [&trace[..], &at_once].concat();
    ends(&again, 0, &["run.tally stays", "--resume goes on from it"]);
    assert_eq!(fs::read(&file).unwrap(), before);
}

#[test]
fn sums_without_a_report_that_knows_them_are_somebodys_work() {
    let place = Place::new();
    let (scene, out) = (place.text("scene.json"), place.text("out"));
    fs::create_dir(&out).unwrap();
    let sums = format!("{out}/tally.bin");
    ends(&["trace", &scene, "-n", "1000", "--checkpoint", &sums], 0, &[]);
    let before = fs::read(&sums).unwrap();
    ends(&["trace", &scene, "-n", FOREVER, "-o", &out], USAGE, &["tally.bin", "move it away"]);
    let into = ["trace", &scene, "-n", FOREVER, "-o", &out, "--checkpoint", &sums];
    ends(&into, USAGE, &["tally.bin", "is the name of a file of the result"]);
    assert_eq!(fs::read(&sums).unwrap(), before);
}

/// While a result is written for a folder that nobody else may read, nobody else may read it either.
#[test]
fn results_for_a_private_folder_are_never_readable_by_others() {
    let place = Place::new();
    let (scene, out) = (place.text("scene.json"), place.path("out"));
    fs::create_dir(&out).unwrap();
    fs::set_permissions(&out, fs::Permissions::from_mode(0o700)).unwrap();
    let mut child = spawn(&["trace", &scene, "-n", "1000", "-o", out.to_str().unwrap()]);
    let (mut seen, mut open) = (0, Vec::new());
    while child.try_wait().unwrap().is_none() {
        for entry in fs::read_dir(place.0.path()).unwrap().flatten() {
            let name = entry.file_name().to_string_lossy().into_owned();
            if let (true, Ok(found)) = (name.starts_with(".nsq-gpu-"), entry.metadata()) {
                seen += 1;
                open.extend((found.permissions().mode() & 0o077 != 0).then_some(name));
            }
        }
    }
    assert!(child.wait().unwrap().success());
    assert!(seen > 0 && open.is_empty(), "{seen} seen, open to others: {open:?}");
    assert_eq!(out.metadata().unwrap().permissions().mode() & 0o777, 0o700);
    assert!(out.join("report.json").exists());
}

// Stops.

fn spawn(arguments: &[&str]) -> Child {
    command(arguments).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap()
}

/// Sends a signal after a time.
fn stop(child: &mut Child, after: Duration, signal: &str) {
    std::thread::sleep(after);
    let sent = Command::new("kill").args([&format!("-{signal}"), &child.id().to_string()]).status().unwrap();
    assert!(sent.success());
}

#[test]
fn every_command_that_is_stopped_keeps_what_is_done() {
    let place = Place::new();
    let scene = place.text("scene.json");
    let set = "L1.r1=50:60:100000";
    let commands: [(&[&str], &str); 7] = [
        (&["trace", &scene, "-n", FOREVER, "--json", "-o"], "report.json"),
        (&["trace", &scene, "-n", FOREVER, "--gradient", "L1.r1", "--json", "-o"], "gradients.npz"),
        (&["diff", &scene, "--set", "L1.r1=60", "-n", FOREVER, "--json", "-o"], "report.json"),
        (&["paths", &scene, "-n", FOREVER, "--json", "-o"], "paths.csv"),
        (&["sweep", &scene, "--set", set, "-n", "1000", "--json", "-o"], ".csv"),
        (
            &[
                "sweep",
                &scene,
                "--tolerance",
                "L1.r1=1%",
                "--samples",
                "100000",
                "-n",
                "1000",
                "--json",
                "-o",
            ],
            ".json",
        ),
        (&["view", &scene, "-n", FOREVER, "--screenshot"], ".png"),
    ];
    let stops =
        commands.iter().flat_map(|(arguments, kept)| ["INT", "TERM"].map(|signal| (arguments, kept, signal)));
    for (number, (arguments, kept, signal)) in files::in_turn(stops.enumerate()) {
        let name = format!("{number}{}", if kept.starts_with('.') { kept } else { "" });
        let out = place.text(&name);
        let mut child = spawn(&[arguments, &[out.as_str()][..]].concat());
        stop(&mut child, Duration::from_secs(6), signal);
        let start = Instant::now();
        let output = child.wait_with_output().unwrap();
        let said = format!("{arguments:?} {signal}: {}", stderr(&output));
        assert_eq!(output.status.code(), Some(INTERRUPTED), "{said}");
        // A quiet machine takes 2 s; this bound only finds a stop that is not heard.
        assert!(start.elapsed() < Duration::from_secs(20), "{said}");
        let file = if kept.starts_with('.') { PathBuf::from(&out) } else { Path::new(&out).join(kept) };
        assert!(file.metadata().is_ok_and(|found| found.len() > 0), "{said}");
        if arguments[0] != "view" {
            assert_eq!(json(&output.stdout)["partial"], true, "{said}");
        }
        if arguments[0] == "sweep" {
            let num = json(&output.stdout)["points"].as_array().unwrap().len();
            assert!(0 < num && num < 100_000, "{said}");
            assert!(fs::read_to_string(&file).unwrap().contains("partial"), "{said}");
        }
    }
}

#[test]
fn a_stopped_difference_is_of_rays_that_both_have_traced() {
    let place = Place::new();
    let (scene, out) = (place.text("scene.json"), place.text("out"));
    let mut child = spawn(&["diff", &scene, "--set", "L1.r1=60", "-n", FOREVER, "--json", "-o", &out]);
    stop(&mut child, Duration::from_secs(5), "INT");
    let stopped = json(&child.wait_with_output().unwrap().stdout);
    let num_rays = stopped["num_rays"].as_u64().unwrap();
    assert!(num_rays >= 4096);
    // Sums of integers: the same rays at once give the same difference.
    let shares = |report: &Value| {
        let image = &report["detectors"]["image"];
        ["a", "b"].map(|side| image[side].as_f64().unwrap())
    };
    let whole = run(&["diff", &scene, "--set", "L1.r1=60", "-n", &num_rays.to_string(), "--json"]);
    let whole = json(&whole.stdout);
    for (part, all) in shares(&stopped).into_iter().zip(shares(&whole)) {
        approx::assert_relative_eq!(part, all, max_relative = 1e-9);
    }
}

/// Pictures and maps of a second trace that was stopped would be of some of the rays.
#[test]
fn stopped_paths_have_no_maps_of_some_of_the_rays() {
    let place = Place::new();
    let (scene, out) = (place.text("scene.json"), place.path("out"));
    let mut child = spawn(&["paths", &scene, "-n", FOREVER, "-o", out.to_str().unwrap()]);
    stop(&mut child, Duration::from_secs(4), "INT");
    assert_eq!(child.wait().unwrap().code(), Some(INTERRUPTED));
    let names = fs::read_dir(&out).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap());
    let maps: Vec<_> = names.filter(|name| name.starts_with("path_")).collect();
    assert!(maps.is_empty() && out.join("paths.csv").exists(), "{maps:?}");
}

#[test]
fn an_ignored_signal_stays_ignored() {
    let place = Place::new();
    for signal in ["HUP", "INT"] {
        let out = place.text(signal);
        // As `nohup` does, and a shell with what it runs in the background.
        let ignoring =
            format!(r#"trap "" {signal}; exec "$0" trace "$1" -n 3e6 --time-limit 8s -o "$2" --json"#);
        let mut child = Command::new("sh")
            .args(["-c", &ignoring, env!("CARGO_BIN_EXE_nsq-gpu"), &place.text("scene.json"), &out])
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        stop(&mut child, Duration::from_secs(2), signal);
        let output = child.wait_with_output().unwrap();
        assert_eq!(output.status.code(), Some(0), "{signal}: {}", stderr(&output));
        assert!(json(&output.stdout)["stopped_by"] != "interrupt", "{signal}");
    }
}

// One bad point.

#[test]
fn a_bad_point_is_named_and_the_others_are_returned() {
    let place = Place::new();
    let (scene, points) = (place.text("scene.json"), place.text("points.csv"));
    let sweep = ["sweep", &scene, "--set", "L1.thickness=6,7,-1,8", "-n", "1000", "--precision", "f64"];
    let words = [
        "point 2 (L1.thickness = -1): ",
        "1 of 4 points cannot be traced: the first is point 2",
        "the other points are returned",
    ];
    let found = json(&ends(&[&sweep[..], &["--json", "-o", &points]].concat(), SCENE, &words).stdout);
    assert_eq!(
        (&found["num_points"], &found["num_refused"], &found["partial"]),
        (&4.into(), &1.into(), &false.into())
    );
    let all = found["points"].as_array().unwrap();
    assert!(all[2]["error"].as_str().unwrap().contains("`L1`") && all[2]["fluxes"].is_null());
    let good =
        run(&["sweep", &scene, "--set", "L1.thickness=6,7,8", "-n", "1000", "--precision", "f64", "--json"]);
    let good = json(&good.stdout);
    for (ours, theirs) in [0, 1, 3].into_iter().zip(good["points"].as_array().unwrap()) {
        assert_eq!(all[ours]["fluxes"], theirs["fluxes"]);
    }
    let text = fs::read_to_string(&points).unwrap();
    let lines: Vec<&str> = text.lines().collect();
    assert!(lines[0].ends_with(",problem") && lines[3].starts_with("-1.0,,") && lines.len() == 5, "{text}");
    assert!(String::from_utf8_lossy(&run(&sweep).stdout).lines().count() == 5);
    let all_bad = ["sweep", &scene, "--set", "L1.thickness=-1,-2", "-n", "1000"];
    assert!(ends(&all_bad, SCENE, &["point 0 (L1.thickness = -1): ", "2 of 2 points"]).stdout.is_empty());
}

#[test]
fn samples_that_cannot_be_are_left_out_and_change_no_other_sample() {
    let place = Place::new();
    let scene = place.text("scene.json");
    let mut tree = json(&fs::read(&scene).unwrap());
    tree["nsq_gpu"] = serde_json::json!({"version": 1, "surfaces": [{
        "name": "M", "interaction": "reflective", "reflectance": 0.99, "shape": {"type": "plane", "width": 9.0, "height": 9.0},
        "cs": {"x": 0.0, "y": 0.0, "z": 80.0, "rx": 0.0, "ry": 0.0, "rz": 0.0}}]});
    fs::write(&scene, tree.to_string()).unwrap();
    let tolerance = |size: &str| {
        let output = run(&[
            "sweep",
            &scene,
            "--tolerance",
            &format!("M.reflectance={size}"),
            "--samples",
            "40",
            "-n",
            "1000",
            "--json",
        ]);
        (output.status.code(), stderr(&output), json(&output.stdout))
    };
    let (code, said, wide) = tolerance("1%");
    assert_eq!(code, Some(SCENE), "{said}");
    let refused = wide["num_refused"].as_u64().unwrap();
    assert!(refused > 0 && said.contains(&format!("{refused} of 40 samples cannot be traced")), "{said}");
    assert!(said.contains("quantiles are of the other samples"), "{said}");
    let all = wide["points"].as_array().unwrap();
    assert_eq!(all.len(), 40);
    // The samples are those of a tolerance that leaves none out, ten times as far from the middle.
    let (code, _, narrow) = tolerance("0.1%");
    assert_eq!((code, &narrow["num_refused"]), (Some(0), &0.into()));
    for (far, near) in all.iter().zip(narrow["points"].as_array().unwrap()) {
        let [far_value, near_value] =
            [far, near].map(|point| point["set"]["M.reflectance"].as_f64().unwrap());
        approx::assert_relative_eq!(far_value - 0.99, 10.0 * (near_value - 0.99), epsilon = 1e-12);
        assert_eq!(far["error"].is_null(), far_value <= 1.0);
    }
    let minimum = wide["quantiles"]["image"]["minimum"].as_f64().unwrap();
    let fluxes = all.iter().filter_map(|point| point["fluxes"]["image"]["flux"].as_f64());
    assert_eq!(minimum, fluxes.fold(f64::INFINITY, f64::min));
}

#[test]
fn a_number_that_is_set_twice_is_refused() {
    let twice = [".r1` is set twice"];
    ends(&["sweep", LENS, "--set", "L1.r1=50,60", "--set", "\"L1\".r1=70", "-n", "1000"], USAGE, &twice);
    ends(&["diff", LENS, "--set", "L1.r1=50", "--set", "\"L1\".r1=70", "-n", "1000"], USAGE, &twice);
    ends(
        &["sweep", LENS, "--tolerance", "L1.r1=1%", "--tolerance", "\"L1\".r1=2%", "-n", "1000"],
        USAGE,
        &twice,
    );
    ends(&["sweep", LENS, "--set", "L1.r1=50,NaN", "-n", "1000"], USAGE, &["`NaN` is not finite"]);
    ends(&["sweep", LENS, "--set", "L1.r1=0:1:1e5", "--set", "L1.z=0:1:1e5"], USAGE, &["10000000000 points"]);
}

#[test]
fn what_is_added_up_is_not_written_over() {
    let place = Place::new();
    let (scene, a, b) = (place.text("scene.json"), place.text("a"), place.text("b"));
    for (out, first) in [(&a, "0"), (&b, "1000")] {
        ends(&["trace", &scene, "-n", "1000", "--first-ray", first, "-o", out], 0, &[]);
    }
    let before = fs::read(place.path("a/tally.bin")).unwrap();
    ends(&["merge", &a, &b, "-o", &a], USAGE, &["which is added up and would be lost"]);
    ends(
        &["merge", &format!("{a}/tally.bin"), &b, "-o", &a],
        USAGE,
        &["which is added up and would be lost"],
    );
    assert_eq!(fs::read(place.path("a/tally.bin")).unwrap(), before);
    ends(&["merge", &a, &b, "-o", &place.text("c")], 0, &[]);
}

#[test]
fn no_quantile_is_given_without_a_sample() {
    let place = Place::new();
    let scene = place.text("scene.json");
    let none =
        ["sweep", &scene, "--tolerance", "L1.front_aperture_radius=1e6", "--samples", "3", "-n", "1000"];
    let found = json(&ends(&[&none[..], &["--json"]].concat(), SCENE, &["3 of 3 samples"]).stdout);
    assert!(found["quantiles"]["image"]["50%"].is_null() && found["nominal"]["index"].is_null());
    let huge = ["sweep", &scene, "--tolerance", "L1.r1=1e308", "--samples", "3", "-n", "1000"];
    ends(&huge, SCENE, &["L1.r1: is inf; give a finite number"]);
}
