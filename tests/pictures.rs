//! The options of pictures change pictures, and no number.
#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "clippy's exemption of tests does not reach their helpers"
)]

mod command;

use command::{run, stderr};
use std::collections::BTreeMap;
use std::path::Path;

const SCENE: &str = "docs/example.json";

/// The files of a folder but the report, whose times differ, and the fluxes that the report has.
fn files(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    let entries = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap());
    let name = |entry: &std::fs::DirEntry| entry.file_name().into_string().unwrap();
    entries.map(|entry| (name(&entry), std::fs::read(entry.path()).unwrap())).collect()
}

fn written(folder: &Path, name: &str, arguments: &[&str]) -> BTreeMap<String, Vec<u8>> {
    let out = folder.join(name);
    let output = run(&[arguments, &["-o", out.to_str().unwrap()]].concat());
    assert!(output.status.success(), "{arguments:?}: {}", stderr(&output));
    files(&out)
}

#[test]
fn scale_and_unit_change_pictures_alone() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let trace = ["trace", SCENE, "-n", "20000"];
    let plain = written(folder, "plain", &trace);
    for (name, more) in [("log", ["--scale", "log"]), ("unit", ["--unit", "mW/cm2"])] {
        let other = written(folder, name, &[&trace[..], &more].concat());
        assert_ne!(other["image.png"], plain["image.png"], "{name}");
        for file in ["image.npz", "tally.bin"] {
            assert_eq!(other[file], plain[file], "{name}: {file}");
        }
    }
    let linear = written(folder, "linear", &[&trace[..], &["--scale", "linear"]].concat());
    assert_eq!(linear["image.png"], plain["image.png"]);
    let merge = |name: &str, more: &[&str]| {
        let parts = ["0", "10000"].map(|first| {
            let part = format!("part_{name}_{first}");
            written(folder, &part, &["trace", SCENE, "-n", "10000", "--first-ray", first, "--no-pictures"]);
            folder.join(part).display().to_string()
        });
        written(folder, name, &[&["merge", &parts[0], &parts[1]], more].concat())
    };
    assert_eq!(merge("merged", &["--scale", "log"])["image.png"], files(&folder.join("log"))["image.png"]);
}

#[test]
fn paths_and_differences_take_them_too() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let paths = ["paths", SCENE, "-n", "20000", "--maps", "2"];
    let plain = written(folder, "paths", &paths);
    let log = written(folder, "paths_log", &[&paths[..], &["--scale", "log", "--unit", "W/m2"]].concat());
    assert_ne!(plain["path_2.png"], log["path_2.png"]);
    assert_eq!(plain["path_2.npz"], log["path_2.npz"]);
    let report: serde_json::Value = serde_json::from_slice(&plain["report.json"]).unwrap();
    // Titled by what its light did, without the faces that it passed.
    assert_eq!(
        report["detectors"]["path_2"]["title"],
        "beam > … > R filter.back > … > R L1.back > … > image"
    );
    let diff = ["diff", SCENE, "--set", "L1.r1=53", "-n", "20000"];
    let plain = written(folder, "diff", &diff);
    let unit = written(folder, "diff_unit", &[&diff[..], &["--unit", "W/m2"]].concat());
    assert_ne!(plain["image.png"], unit["image.png"]);
    assert_eq!(plain["image.npz"], unit["image.npz"]);
}

#[test]
fn what_cannot_be_drawn_is_refused_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out").display().to_string();
    for (arguments, expected) in [
        (&["trace", SCENE, "--unit", "lx", "-o", &out][..], "trace with --photometric"),
        (
            &["trace", SCENE, "--unit", "W/sr", "-o", &out],
            "no detector's map is in such a unit; give a unit such as W/mm2",
        ),
        (&["trace", SCENE, "--unit", "lux", "-o", &out], "`lux` is no unit of a map"),
        (&["trace", SCENE, "--photometric", "--unit", "cd", "-o", &out], "give a unit such as W/mm2 or lx"),
        (&["trace", SCENE, "--scale", "log"], "--output"),
        (&["diff", SCENE, "--set", "L1.r1=53", "--scale", "log", "-o", &out], "a difference has both signs"),
    ] {
        let output = run(arguments);
        let said = stderr(&output);
        assert!(output.status.code() == Some(2) && said.contains(expected), "{arguments:?}: {said}");
    }
    assert!(!Path::new(&out).exists());
}
