//! `nsq-gpu verify`: every damage is named, and what the scene does not give is told from what it gives.
#![allow(clippy::unwrap_used, clippy::panic, reason = "a test fails by panicking")]

mod command;
#[path = "zoo/files.rs"]
mod files;

use command::{command, has_adapter, run, stderr};
use nsq_gpu::run::checkpoint::Checkpoint;
use nsq_gpu::run::proof::Proof;
use nsq_gpu::run::verify::{Verdict, Verification, Verify};
use serde_json::{Value, json};
use sha2::{Digest, Sha256};
use std::fs;
use std::path::{Path, PathBuf};

const NO_RESULT: i32 = 3;
const DAMAGED: i32 = 6;
const USAGE: i32 = 2;

/// A folder of results of a scene of the repository.
fn trace(folder: &Path, name: &str, scene: &str, more: &[&str]) -> PathBuf {
    let path = folder.join(name);
    let scene = format!("scenes/{scene}.json");
    let output = run(&[&["trace", &scene, "-n", "20000", "-o", path.to_str().unwrap()], more].concat());
    assert!(output.status.success(), "{}", stderr(&output));
    path
}

/// What the command says of a result.
fn verified(result: &Path, more: &[&str]) -> (i32, Value) {
    let output = run(&[&["verify", result.to_str().unwrap(), "--json"], more].concat());
    let report = serde_json::from_slice(&output.stdout).unwrap_or_else(|_| panic!("{}", stderr(&output)));
    (output.status.code().unwrap(), report)
}

/// Changes the report of a result, and gives it hashes that fit: what somebody does who wants to deceive.
fn forge(result: &Path, change: impl FnOnce(&mut Value)) {
    let path = result.join("report.json");
    let mut report: Value = serde_json::from_str(&fs::read_to_string(&path).unwrap()).unwrap();
    change(&mut report);
    let files = report["meta"]["files"].as_object_mut().unwrap();
    for (name, hash) in files.iter_mut() {
        let bytes = fs::read(result.join(name)).unwrap();
        *hash = json!({"bytes": bytes.len(), "sha256": format!("{:x}", Sha256::digest(&bytes))});
    }
    let zeros = "0".repeat(64);
    report["meta"]["sha256"] = json!(zeros);
    let text = serde_json::to_string_pretty(&report).unwrap();
    let place = text.rfind(&zeros).unwrap();
    let hash = format!("{:x}", Sha256::digest(text.as_bytes()));
    fs::write(path, format!("{}{hash}{}", &text[..place], &text[place + 64..])).unwrap();
}

/// Numbers by xorshift, the same in each run.
struct Numbers(u64);

impl Numbers {
    fn below(&mut self, end: usize) -> usize {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        (self.0 % end as u64) as usize
    }
}

fn names(found: &Verification) -> Vec<&str> {
    found.findings.iter().map(|finding| finding.file.as_str()).collect()
}

#[test]
fn each_of_a_thousand_flipped_bytes_is_named() {
    if !has_adapter("each_of_a_thousand_flipped_bytes_is_named") {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let more = ["--paths", "on", "--record-paths", "20"];
    let result = trace(folder.path(), "out", "cemented_achromat_auto", &more);
    let mut files: Vec<String> = fs::read_dir(&result)
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .collect();
    files.sort();
    assert!(
        ["paths.csv", "ray_paths.npz", "report.json", "tally.bin"]
            .iter()
            .all(|name| files.contains(&(*name).into()))
    );
    let question = Verify::of(&result);
    assert_eq!(question.files().unwrap().verdict, Verdict::Whole);
    let mut numbers = Numbers(0x5EED_0055);
    for flip in 0..1000 {
        let name = &files[numbers.below(files.len())];
        let path = result.join(name);
        let bytes = fs::read(&path).unwrap();
        let mut changed = bytes.clone();
        let place = numbers.below(bytes.len());
        changed[place] ^= 1 << numbers.below(8);
        fs::write(&path, changed).unwrap();
        let found = question.files().unwrap();
        assert_eq!(
            (found.verdict, names(&found)),
            (Verdict::Damaged, vec![name.as_str()]),
            "flip {flip}: byte {place}"
        );
        // The command looks at the files first, in the same way.
        if flip < 12 {
            let (code, report) = verified(&result, &[]);
            assert_eq!((code, report["findings"][0]["file"].as_str()), (DAMAGED, Some(name.as_str())));
        }
        fs::write(&path, bytes).unwrap();
    }
    // A file that is gone, and one that is too long.
    fs::rename(result.join(&files[0]), folder.path().join("away")).unwrap();
    assert_eq!(names(&question.files().unwrap()), [files[0].as_str()]);
    fs::rename(folder.path().join("away"), result.join(&files[0])).unwrap();
    // What somebody has put there is none of the result's, and does no harm.
    fs::write(result.join("notes.txt"), "mine").unwrap();
    let found = question.files().unwrap();
    assert_eq!((found.verdict, found.files.others), (Verdict::Whole, vec!["notes.txt".to_string()]));
}

#[test]
fn results_of_every_kind_are_consistent_with_other_rays() {
    if !has_adapter("results_of_every_kind_are_consistent_with_other_rays") {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let cases: [(&str, &[&str]); 9] = [
        ("cooke_triplet", &[]),
        ("cooke_triplet", &["--seed", "7", "--precision", "f32", "--no-pictures"]),
        ("double_gauss", &["--where", "reflections == 2", "--paths", "on"]),
        ("telephoto_spectral", &["--sampler", "sobol", "--standard-error", "on"]),
        ("cemented_achromat_auto", &["--record-paths", "30", "--first-ray", "500"]),
        ("newtonian_telescope", &[]),
        ("split_ghosts", &["--split-depth", "2", "--rr-start-flux", "0.01"]),
        ("scattering_telescope", &["--reflect-prob", "0.25"]),
        ("integrating_sphere", &["-n", "2000000000", "--time-limit", "1s"]),
    ];
    for (number, (scene, more)) in files::in_turn(cases.into_iter().enumerate()) {
        let result = folder.path().join(number.to_string());
        let path = format!("scenes/{scene}.json");
        let rays: &[&str] = if more.contains(&"-n") { &[] } else { &["-n", "20000"] };
        let output = run(&[&["trace", &path, "-o", result.to_str().unwrap()], rays, more].concat());
        assert!(output.status.success(), "{}", stderr(&output));
        let (code, report) = verified(&result, &[]);
        assert_eq!((code, report["verdict"].as_str()), (0, Some("consistent")), "{scene}: {report:#}");
        assert_eq!(report["has_sums"], json!(true), "{scene}");
        assert!(report["other_rays"]["num_rays"].as_u64().unwrap() >= 65536);
        assert_eq!(report["other_rays"]["ledger"].as_array().unwrap().len(), 14);
    }
}

#[test]
fn a_number_that_the_sums_do_not_give_is_named_though_all_hashes_fit() {
    if !has_adapter("a_number_that_the_sums_do_not_give_is_named_though_all_hashes_fit") {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let result = trace(folder.path(), "out", "cooke_triplet", &[]);
    let report = fs::read(result.join("report.json")).unwrap();
    let detector = "image";
    let forged = |change: &dyn Fn(&mut Value)| {
        forge(&result, change);
        let (code, found) = verified(&result, &[]);
        fs::write(result.join("report.json"), &report).unwrap();
        let finding = &found["findings"][0];
        (
            code,
            [&finding["file"], &finding["place"]].map(|text| text.as_str().unwrap_or_default().to_string()),
        )
    };
    assert_eq!(forged(&|_| {}).0, 0, "a forgery that changes nothing");
    let at = |place: &str| (DAMAGED, ["report.json".to_string(), place.to_string()]);
    assert_eq!(forged(&|report| report["seed"] = json!(3)), at("seed"));
    assert_eq!(forged(&|report| report["ledger"]["escaped"]["quanta"] = json!("12")), at("ledger"));
    assert_eq!(
        forged(&|report| report["ledger"]["escaped"]["count"] = json!(12)),
        at("ledger.escaped.count")
    );
    assert_eq!(forged(&|report| report["num_rays_escaped"] = json!(12)), at("num_rays_escaped"));
    let flux = |report: &mut Value| report["detectors"][detector]["total_flux"] = json!(0.5);
    assert_eq!(forged(&flux), at(&format!("detectors.{detector}.total_flux")));
    assert_eq!(forged(&|report| report["diagnostics"]["medium_stack_underflows"] = json!(1)).0, DAMAGED);
    // One cell of a map, by 1 % of its last digits.
    let map = result.join(format!("{detector}.npz"));
    let bytes = fs::read(&map).unwrap();
    let mut changed = bytes.clone();
    let data = changed.windows(10).position(|window| window == b"irradiance").unwrap();
    let lit = (data..changed.len() - 8).find(|at| {
        let cell: [u8; 8] = changed[*at..at + 8].try_into().unwrap();
        (1e-9..1e3).contains(&f64::from_le_bytes(cell))
    });
    changed[lit.unwrap() + 4] ^= 1;
    fs::write(&map, changed).unwrap();
    let (code, [file, _]) = forged(&|_| {});
    assert_eq!((code, file), (DAMAGED, format!("{detector}.npz")));
    fs::write(&map, bytes).unwrap();
}

#[test]
fn what_the_scene_does_not_give_is_different() {
    if !has_adapter("what_the_scene_does_not_give_is_different") {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let result = trace(folder.path(), "out", "cooke_triplet", &[]);
    let (code, report) = verified(&result, &["--scene", "scenes/double_gauss.json"]);
    assert_eq!((code, report["verdict"].as_str()), (DAMAGED, Some("different")));
    assert!(report["findings"][0]["problem"].as_str().unwrap().contains("not the scene that was traced"));
    // The same without the sums, which have the hash of the scene: an eighth more light, and a ledger that closes.
    fs::remove_file(result.join("tally.bin")).unwrap();
    forge(&result, |report| {
        report["meta"]["files"].as_object_mut().unwrap().remove("tally.bin");
    });
    assert_eq!(verified(&result, &[]).0, 0);
    forge(&result, |report| {
        let quanta = |line: &Value| line["quanta"].as_str().unwrap().parse::<u128>().unwrap();
        let moved = quanta(&report["ledger"]["detected"]) / 8;
        for (line, sign) in [("detected", 1_i128), ("escaped", 0), ("absorbed", -1)] {
            let entry = &mut report["ledger"][line];
            let before = quanta(entry);
            let after = before.saturating_add_signed(sign * moved as i128);
            let flux = entry["flux"].as_f64().unwrap() * after as f64 / before.max(1) as f64;
            (entry["quanta"], entry["flux"]) = (json!(after.to_string()), json!(flux));
        }
    });
    let (code, report) = verified(&result, &[]);
    assert_eq!((code, report["verdict"].as_str()), (DAMAGED, Some("different")), "{report:#}");
    let places: Vec<_> = report["findings"]
        .as_array()
        .unwrap()
        .iter()
        .map(|finding| finding["place"].as_str().unwrap())
        .collect();
    assert!(places.contains(&"ledger: detected"), "{places:?}");
}

/// A trace of a part of the rays, or of all, that keeps a proof. The cells of the scene are few enough.
fn prove(folder: &Path, name: &str, more: &[&str]) -> PathBuf {
    let path = folder.join(name);
    let output =
        run(&[&["trace", SMALL, "--proof", "--no-pictures", "-o", path.to_str().unwrap()], more].concat());
    assert!(output.status.success(), "{}", stderr(&output));
    path
}

const SMALL: &str = "scenes/newtonian_telescope.json";

fn proof_of(result: &Path) -> Proof {
    Checkpoint::read(result).unwrap().proof.unwrap()
}

#[test]
fn ranges_of_a_proof_are_proven_to_the_bit() {
    if !has_adapter("ranges_of_a_proof_are_proven_to_the_bit") {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let whole = prove(folder.path(), "whole", &["-n", "100000"]);
    let (code, report) = verified(&whole, &["--sample", "5"]);
    assert_eq!((code, report["verdict"].as_str()), (0, Some("proven")), "{report:#}");
    let proof = &report["proof"];
    assert_eq!((&proof["num_ranges"], &proof["num_rays"]), (&json!(64), &json!(100_000)));
    let sampled = proof["sampled"].as_array().unwrap();
    assert!(sampled.len() == 5 && sampled.iter().all(|range| range["is_same"] == json!(true)));
    assert!(sampled.iter().all(|range| (1559..=1566).contains(&range["num_rays"].as_u64().unwrap())));
    // No result changes, and no proof is in a result that was not asked for one.
    let plain = folder.path().join("plain");
    assert!(
        run(&["trace", SMALL, "-n", "100000", "--no-pictures", "-o", plain.to_str().unwrap()])
            .status
            .success()
    );
    let [proven, plain] = [&whole, &plain].map(|result| Checkpoint::read(result).unwrap());
    assert!(proven.tally == plain.tally && plain.proof.is_none());
    // The same ranges whatever the batches, and with other shaders.
    let other = prove(folder.path(), "other", &["-n", "100000", "--batch-size", "777", "--portable"]);
    assert_eq!(proof_of(&other).parts[0].ranges, proof_of(&whole).parts[0].ranges);
}

#[test]
fn a_forged_sum_is_found_by_the_proof_and_a_forged_proof_by_its_rays() {
    if !has_adapter("a_forged_sum_is_found_by_the_proof_and_a_forged_proof_by_its_rays") {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let result = prove(folder.path(), "out", &["-n", "20000"]);
    let sums = Checkpoint::read(&result).unwrap();
    let forged = |change: &dyn Fn(&mut Checkpoint), more: &[&str]| {
        let mut changed = sums.clone();
        change(&mut changed);
        fs::write(result.join("tally.bin"), changed.to_bytes().unwrap()).unwrap();
        forge(&result, |_| {});
        verified(&result, more)
    };
    assert_eq!(forged(&|_| {}, &[]).1["verdict"], json!("proven"));
    // A range that has another hash, and one that ends elsewhere: all are looked at.
    let hash = |sums: &mut Checkpoint| sums.proof.as_mut().unwrap().parts[0].ranges[31].sha256[0] ^= 1;
    let (code, report) = forged(&hash, &["--sample", "64"]);
    assert_eq!((code, report["verdict"].as_str()), (DAMAGED, Some("different")));
    let finding = &report["findings"][0];
    assert_eq!(
        (finding["file"].as_str(), finding["place"].as_str()),
        (Some("tally.bin"), Some("part 0, range 31 of the proof"))
    );
    assert_eq!(report["findings"].as_array().unwrap().len(), 1);
    let end = |sums: &mut Checkpoint| sums.proof.as_mut().unwrap().parts[0].ranges[31].end += 1;
    assert_eq!(forged(&end, &["--sample", "64"]).1["findings"].as_array().unwrap().len(), 2);
    // Light that is moved from one line to another: the ledger closes, and the report has another one.
    let moved = |sums: &mut Checkpoint| {
        sums.tally.escaped.quanta -= 1 << 52;
        sums.tally.depth_killed.quanta += 1 << 52;
    };
    let (code, report) = forged(&moved, &[]);
    assert_eq!((code, report["verdict"].as_str()), (DAMAGED, Some("damaged")), "{report:#}");
    let absurd: [&dyn Fn(&mut Checkpoint); 4] = [
        &|sums| sums.proof.as_mut().unwrap().parts[0].num_rays = u64::MAX,
        &|sums| sums.proof.as_mut().unwrap().parts[0].first_ray = u64::MAX,
        &|sums| sums.proof.as_mut().unwrap().parts[0].of_rays = Some(0),
        &|sums| sums.proof.as_mut().unwrap().parts[0].ranges.reverse(),
    ];
    for change in absurd {
        let (code, report) = forged(change, &[]);
        assert_eq!((code, report["verdict"].as_str()), (DAMAGED, Some("damaged")), "{report:#}");
    }
    let checksum = |sums: &mut Checkpoint| sums.proof.as_mut().unwrap().parts[0].ranges[3].checksums[0] ^= 1;
    let (code, report) = forged(&checksum, &[]);
    assert_eq!((code, report["findings"][0]["place"].as_str()), (DAMAGED, Some("the ledger")));
}

#[test]
fn parts_and_resumed_traces_keep_their_proofs() {
    if !has_adapter("parts_and_resumed_traces_keep_their_proofs") {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_string();
    let [a, b] = [["0", "a"], ["20000", "b"]].map(|[first, name]| {
        prove(folder.path(), name, &["-n", "20000", "--first-ray", first, "--of-rays", "40000"])
    });
    let both = path("both");
    let merged = |parts: [&Path; 2], into: &str| {
        let [one, other] = parts.map(|part| part.to_str().unwrap());
        let output = run(&["merge", one, other, "--no-pictures", "-o", into]);
        assert!(output.status.success(), "{}", stderr(&output));
    };
    merged([&a, &b], &both);
    let both = PathBuf::from(both);
    let (code, report) = verified(&both, &["--sample", "20"]);
    assert_eq!((code, report["verdict"].as_str()), (0, Some("proven")), "{report:#}");
    assert_eq!(report["proof"]["num_ranges"], json!(128));
    let of_parts =
        report["proof"]["sampled"].as_array().unwrap().iter().map(|range| range["part"].as_u64().unwrap());
    assert!(of_parts.collect::<std::collections::BTreeSet<_>>().len() == 2);
    // A part without a proof: the others' ranges are looked at, and no more is claimed.
    let plain = path("plain");
    let second_half = |more: &[&str]| {
        let half = ["trace", SMALL, "-n", "20000", "--first-ray", "20000", "--of-rays", "40000"];
        run(&[&half, more].concat())
    };
    let output = second_half(&["--no-pictures", "-o", &plain]);
    assert!(output.status.success());
    let half = path("half");
    merged([&a, Path::new(&plain)], &half);
    let (code, report) = verified(Path::new(&half), &[]);
    assert_eq!((code, report["verdict"].as_str()), (0, Some("consistent")), "{report:#}");
    // Three sources share the rays in whole numbers.
    let num_rays = report["proof"]["num_rays"].as_u64().unwrap();
    assert!((19_997..=20_003).contains(&num_rays) && report["proof"]["num_ranges"] == json!(64));
    // A trace that is stopped by a time limit, and goes on: the range in which it stopped lies in two.
    let sums = path("sums.bin");
    let begun =
        run(&["trace", SMALL, "-n", "30000000", "--proof", "--checkpoint", &sums, "--time-limit", "200ms"]);
    assert!(begun.status.success(), "{}", stderr(&begun));
    let reached = Checkpoint::read(Path::new(&sums)).unwrap();
    assert!(reached.tally.launched.count < 30_000_000);
    let covered = reached.proof.unwrap().parts[0].end();
    assert!(covered.abs_diff(reached.tally.launched.count) <= 3);
    let resumed = path("resumed");
    let given = ["trace", SMALL, "-n", "30000000", "--resume", &sums, "--time-limit", "500ms"];
    let output = run(&[&given[..], &["--no-pictures", "-o", &resumed]].concat());
    assert!(output.status.success(), "{}", stderr(&output));
    let resumed = PathBuf::from(resumed);
    let ends: Vec<u64> = proof_of(&resumed).parts[0].ranges.iter().map(|range| range.end).collect();
    assert!(ends.contains(&covered), "{ends:?} {covered}");
    let (code, report) = verified(&resumed, &["--sample", "64"]);
    assert_eq!((code, report["verdict"].as_str()), (0, Some("proven")), "{report:#}");
    // Sums without a proof have none of their rays.
    let output = second_half(&["--resume", &plain, "--proof", "-o", &path("none")]);
    assert_eq!(output.status.code(), Some(USAGE));
    assert!(stderr(&output).contains("have no proof"), "{}", stderr(&output));
}

#[test]
fn a_proof_that_costs_more_than_the_trace_is_refused_by_name() {
    let refused = |arguments: &[&str], words: &str| {
        let output = run(arguments);
        assert_eq!(output.status.code(), Some(USAGE), "{arguments:?}");
        assert!(stderr(&output).contains(words), "{}", stderr(&output));
    };
    refused(&["trace", SMALL, "--proof"], "give -o DIR, or --checkpoint FILE");
    if !has_adapter("a_proof_that_costs_more_than_the_trace_is_refused_by_name") {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    let out = out.to_str().unwrap();
    refused(
        &["trace", "scenes/cooke_triplet.json", "-n", "100", "--proof", "-o", out],
        "--proof would cost more than the trace",
    );
    refused(&["trace", SMALL, "--proof", "--strict=off", "-o", out], "leave out --strict=off");
    assert!(!Path::new(out).exists());
}

#[test]
fn what_is_no_result_and_what_cannot_be_traced_has_its_exit_code() {
    let no_result = |path: &str, problem: &str| {
        let output = run(&["verify", path]);
        assert_eq!(output.status.code(), Some(NO_RESULT));
        assert!(stderr(&output).contains(path) && stderr(&output).contains(problem), "{}", stderr(&output));
    };
    no_result("resluts", "No such file");
    no_result("README.md", "is no folder");
    no_result("scenes", "holds no report.json");
    if !has_adapter("what_is_no_result_and_what_cannot_be_traced_has_its_exit_code") {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let result = trace(folder.path(), "out", "cooke_triplet", &["--no-pictures"]);
    // The scene is named from the repository's root, and not from elsewhere.
    let output = command(&["verify", result.to_str().unwrap()]).current_dir(folder.path()).output().unwrap();
    assert_eq!(output.status.code(), Some(USAGE));
    assert!(stderr(&output).contains("--scene names the scene"), "{}", stderr(&output));
    let moved = fs::canonicalize("scenes/cooke_triplet.json").unwrap();
    let arguments = ["verify", result.to_str().unwrap(), "--scene", moved.to_str().unwrap()];
    assert!(command(&arguments).current_dir(folder.path()).output().unwrap().status.success());
    let output = run(&["verify", result.to_str().unwrap(), "--scene", "scenes/coke.json"]);
    assert_eq!((output.status.code(), stderr(&output).contains("scenes/coke.json")), (Some(USAGE), true));
    // A result of an older version has no hashes; what contradicts its sums is still found.
    let path = result.join("report.json");
    let mut report: Value = serde_json::from_str(&fs::read_to_string(&path).unwrap()).unwrap();
    report.as_object_mut().unwrap().remove("meta");
    fs::write(&path, report.to_string()).unwrap();
    let (code, found) = verified(&result, &[]);
    assert_eq!((code, &found["files"]["has_hashes"]), (0, &json!(false)));
    assert!(found["notes"][0].as_str().unwrap().contains("without hashes"));
    report["num_rays_absorbed"] = json!(1);
    fs::write(&path, report.to_string()).unwrap();
    assert_eq!(verified(&result, &[]).0, DAMAGED);
    report["mete"] = json!({});
    fs::write(&path, report.to_string()).unwrap();
    let (code, found) = verified(&result, &[]);
    assert_eq!((code, found["findings"][0]["file"].as_str()), (DAMAGED, Some("report.json")));
}
