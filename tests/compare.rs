//! `nsq-gpu compare`: results that differ by chance agree, others do not.
#![allow(clippy::unwrap_used, clippy::panic, reason = "a test fails by panicking")]

mod command;

use command::{has_adapter, run, stderr};
use nsq_gpu::TraceResult;
use nsq_gpu::result::DetectorData;
use nsq_gpu::result::comparison::compare;
use serde_json::Value;
use std::path::{Path, PathBuf};

const TOLERANCE: i32 = 6;

/// A folder of results.
fn trace(folder: &Path, name: &str, scene: &str, more: &[&str]) -> PathBuf {
    let path = folder.join(name);
    let scene = format!("scenes/{scene}.json");
    let given = ["trace", &scene, "--standard-error", "on", "--no-pictures", "-o", path.to_str().unwrap()];
    let output = run(&[&given, more].concat());
    assert!(output.status.success(), "{}", stderr(&output));
    path
}

fn compared(a: &Path, b: &Path, more: &[&str]) -> (Option<i32>, Value) {
    let output = run(&[&["compare", a.to_str().unwrap(), b.to_str().unwrap(), "--json"], more].concat());
    let report = serde_json::from_slice(&output.stdout);
    (output.status.code(), report.unwrap_or_else(|_| panic!("{}", stderr(&output))))
}

#[test]
fn other_seeds_agree_and_other_scenes_do_not() {
    if !has_adapter("other_seeds_agree_and_other_scenes_do_not") {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    // Every kind of detector, each of them with what there is to compare.
    for scene in ["cooke_triplet", "telephoto_spectral", "cemented_achromat_auto", "split_ghosts"] {
        let [a, b] = ["0", "1"].map(|seed| {
            trace(folder.path(), &format!("{scene}_{seed}"), scene, &["-n", "50000", "--seed", seed])
        });
        let (code, report) = compared(&a, &b, &[]);
        assert_eq!((code, &report["agree"]), (Some(0), &Value::from(true)), "{scene}: {report:#}");
        let names = TraceResult::read(&a).unwrap().detectors.len();
        assert_eq!(report["detectors"].as_array().unwrap().len(), names);
        let (code, report) = compared(&a, &a, &[]);
        assert_eq!((code, report["same_draws"].as_bool()), (Some(0), Some(true)));
        let scores = report["detectors"].as_array().unwrap().iter().map(|d| d["total"]["score"].as_f64());
        assert!(scores.flatten().all(|score| score == 0.0));
    }
    let split = folder.path().join("split_ghosts_0");
    let (code, report) = compared(&folder.path().join("cooke_triplet_0"), &split, &[]);
    assert_eq!((code, &report["agree"]), (Some(TOLERANCE), &Value::from(false)));
}

/// One detector is 3 % too bright, or a patch of it: no more than many cells' errors, but not chance.
#[test]
fn a_planted_difference_is_found_and_nothing_else() {
    if !has_adapter("a_planted_difference_is_found_and_nothing_else") {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let rays = ["-n", "50000"];
    let [a, b] = ["0", "1"].map(|seed| {
        let more = [&rays, ["--seed", seed].as_slice()].concat();
        TraceResult::read(&trace(folder.path(), seed, "cooke_triplet", &more)).unwrap()
    });
    let found = compare(&a, &b, 5.0);
    assert!(found.agree, "{found:#?}");
    let image = found.detectors[0].map.as_ref().unwrap();
    assert!(image.num_cells > 100 && (image.rms_score - 1.0).abs() < 0.2, "{image:#?}");
    assert!(image.limit > 5.5 && image.largest_score.unwrap().abs() < image.limit);

    let mut brighter = a.clone();
    brighter.detectors[0].total_flux *= 1.03;
    let found = compare(&brighter, &b, 5.0);
    assert!(!found.agree && !found.detectors[0].agree && found.detectors[1].agree, "{found:#?}");

    let mut patched = a.clone();
    let DetectorData::Irradiance(map) = &mut patched.detectors[0].data else { panic!("image is a map") };
    let (cell, _) = map.hits.indexed_iter().max_by_key(|(_, hits)| **hits).unwrap();
    map.irradiance[cell] *= 3.0;
    let found = compare(&patched, &b, 5.0);
    assert!(!found.agree);
    assert_eq!(found.detectors[0].map.as_ref().unwrap().largest_at, [cell.0, cell.1]);

    let mut without = a.clone();
    without.detectors.remove(1);
    let found = compare(&without, &b, 5.0);
    assert_eq!(found.detectors[1].problem.as_deref(), Some("only B has it"));
    assert!(!found.agree && found.detectors[0].agree);
}

/// Of so few rays against so many, most cells that the many reach are dark, and no more than the first rows are kept.
#[test]
fn other_numbers_of_rays_agree() {
    if !has_adapter("other_numbers_of_rays_agree") {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    for (scene, few, split) in [
        ("cooke_triplet", "10000", "0"),
        ("telephoto_spectral", "20000", "0"),
        ("split_ghosts", "100000", "0"),
    ] {
        let a = trace(folder.path(), &format!("{scene}_few"), scene, &["-n", few, "--split-depth", split]);
        let b = trace(folder.path(), &format!("{scene}_many"), scene, &["-n", "300000", "--seed", "1"]);
        let (code, report) = compared(&a, &b, &[]);
        assert_eq!((code, &report["agree"]), (Some(0), &Value::from(true)), "{scene}: {report:#}");
    }
}

#[test]
fn people_get_a_table_and_a_reason() {
    if !has_adapter("people_get_a_table_and_a_reason") {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let a = trace(folder.path(), "a", "bench_lens", &["-n", "2000"]);
    let b = trace(folder.path(), "b", "bench_lens", &["-n", "2000", "--seed", "1", "--max-depth", "1"]);
    let output = run(&["compare", a.to_str().unwrap(), b.to_str().unwrap()]);
    assert_eq!(output.status.code(), Some(TOLERANCE));
    assert!(stderr(&output).contains("A and B disagree on 'D'"), "{}", stderr(&output));
    let table = String::from_utf8(output.stdout).unwrap();
    assert!(table.contains("A: ") && table.contains("sigmas") && table.contains("DISAGREE"), "{table}");
    let missing = folder.path().join("nothing");
    let output = run(&["compare", a.to_str().unwrap(), missing.to_str().unwrap()]);
    assert!(output.status.code() == Some(2) && stderr(&output).contains("nothing"), "{}", stderr(&output));
    let output = run(&["compare", a.to_str().unwrap(), b.to_str().unwrap(), "--sigmas", "0"]);
    assert!(output.status.code() == Some(2) && stderr(&output).contains("1..=30"), "{}", stderr(&output));
}
