//! Files that mean harm, or are merely broken: each is refused with its place, and none garbles a terminal, fills the memory
//! or stops the program otherwise than with an error.
#![allow(clippy::unwrap_used, clippy::panic, reason = "a test fails by panicking")]

use std::io::Write;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;
use std::process::{Command, Output};
use std::time::Instant;

use nsq_gpu::Scene;
use nsq_gpu::gpu::{AdapterChoice, Gpu};
use nsq_gpu::model::SceneIr;
use nsq_gpu::model::sequence::{End, Sequence, Step, StepKind};
use nsq_gpu::result::report::{Files, Report};
use nsq_gpu::result::{
    FluxSum, FluxUnit, Moments, PathEvent, PathEventKind, PathSum, PathTally, RayRow, RaySpan, RunInfo,
    Tally, TraceResult, output,
};
use nsq_gpu::run::checkpoint::{Checkpoint, Identity, scene_hash};
use nsq_gpu::{TraceOptions, Tracer};
use serde_json::Value;

const USAGE: i32 = 2;
const SCENE: i32 = 3;

fn run(folder: &Path, arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_nsq-gpu")).args(arguments).current_dir(folder).output().unwrap()
}

fn texts(output: &Output) -> [String; 2] {
    [&output.stdout, &output.stderr].map(|bytes| String::from_utf8(bytes.clone()).unwrap())
}

/// Expects an error in one line that says all of `gist`.
#[track_caller]
fn refused(output: &Output, code: i32, gist: &[&str]) {
    let [_, stderr] = texts(output);
    assert_eq!(output.status.code(), Some(code), "{stderr}");
    assert_eq!(stderr.lines().count(), 1, "{stderr}");
    for words in gist {
        assert!(stderr.contains(words), "no `{words}` in {stderr}");
    }
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

/// Two sources, a lens face, a mirror, an absorber, and a detector of each kind; names are in the place of `NAME`.
const SMALL: &str = r#"{
  "nsq_schema_version": 1,
  "components": [],
  "sources": [
    {"type": "collimated", "name": "NAME1", "cs": {}, "total_flux": 1, "aperture_radius": 3,
     "spectrum": {"wavelengths": [0.5, 0.6], "weights": [1, 2]}},
    {"type": "point", "name": "NAME2", "cs": {}, "total_flux": 1, "half_angle_deg": 30,
     "spectrum": {"wavelengths": [0.5], "weights": [3]}}
  ],
  "detectors": [
    {"type": "irradiance", "name": "NAME3", "cs": {"z": 9}, "width": 4, "height": 4, "num_pixels_x": 3, "num_pixels_y": 2},
    {"type": "spectral", "name": "NAME4", "cs": {"z": 8}, "width": 4, "height": 4, "num_pixels_x": 2, "num_pixels_y": 2,
     "wl_min": 0.4, "wl_max": 0.7, "num_bins": 2, "absorb": false},
    {"type": "far_field", "name": "NAME5", "cs": {}, "num_bins_theta": 2, "num_bins_phi": 3},
    {"type": "ray_database", "name": "NAME6", "cs": {"z": 7}, "width": 4, "height": 4, "absorb": false}
  ],
  "nsq_gpu": {
    "version": 1,
    "media": {"glass": {"type": "constant", "n": 1.5}},
    "surfaces": [
      {"name": "NAME7", "cs": {"z": 2}, "shape": {"type": "plane", "aperture_radius": 2}, "interaction": "refractive",
       "material_back": {"type": "medium", "name": "glass"}},
      {"name": "NAME8", "cs": {"z": 12}, "shape": {"type": "plane", "aperture_radius": 2}, "interaction": "reflective",
       "reflectance": 0.5},
      {"name": "NAME9", "cs": {"z": -2}, "shape": {"type": "plane", "aperture_radius": 2}, "interaction": "absorbing"}
    ],
    "detectors": {"NAME6": {"max_rays": 3}}
  }
}"#;

// Sums

/// The sums of 200 of 1000 rays, as a trace of [`SMALL`] might leave them.
fn sums(ir: &SceneIr, begun: u64) -> Tally {
    let mut tally = Tally::zeros(ir);
    for (first, source) in [(begun, 0), (500 + begun, 1)] {
        tally.rays += RaySpan { first, count: 100, source };
    }
    let sum = |count: u64| FluxSum { count, quanta: u128::from(count) << 52 };
    tally.launched = sum(200);
    tally.escaped = sum(70);
    tally.roulette_gain = sum(3);
    tally.surfaces[2].absorbed = sum(40);
    let row = RayRow {
        ray_id: begun + 5,
        bounce: 1,
        wavelength: 1,
        position: [1.0, -1.0, 7.0],
        direction: [0.0, 0.0, 1.0],
        weight: 1.0,
    };
    for (detector, sums) in ir.detectors.iter().zip(&mut tally.detectors) {
        let cells = detector.num_cells();
        sums.quanta.iter_mut().step_by(2).for_each(|quanta| *quanta = 5 << 52);
        sums.hits.iter_mut().step_by(2).for_each(|hits| *hits = 5);
        sums.squares = vec![5 << 52; cells];
        sums.totals = vec![Moments { quanta: 40 << 52, squares: 41 << 52 }; 2];
        if cells == 0 {
            sums.recorded = sum(4);
            sums.rows = (0..4).map(|i| RayRow { ray_id: begun + i, ..row }).collect();
        }
    }
    let kinds = [PathEventKind::Birth(1), PathEventKind::Surface(2), PathEventKind::Detector(3)];
    tally.paths = kinds.map(|kind| PathEvent { ray: row, kind }).to_vec();
    let step = |surface| Step { kind: StepKind::Transmitted, surface };
    let sequence = |surface, end| Sequence { source: 1, steps: vec![step(surface), step(0)], end };
    let sequences = [sequence(0, End::Detector(3)), sequence(1, End::Absorbed(2)), sequence(1, End::Missed)];
    let of_path = PathSum { count: 7, quanta: 7 << 52, squares: 7 << 52 };
    let mut paths = PathTally::new(8);
    paths.rows = sequences.iter().map(|sequence| (sequence.clone(), of_path)).collect();
    paths.other = [(End::DepthLimit, of_path), (End::Detector(0), of_path)].into();
    paths.chosen = Some(sequences.to_vec());
    paths.is_closed = true;
    tally.path_sums = Some(paths);
    tally
}

fn checkpoint(ir: &SceneIr, tally: Tally) -> Checkpoint {
    let identity = Identity {
        version: env!("CARGO_PKG_VERSION").into(),
        scene: Some("scene.json".into()),
        scene_hash: scene_hash(ir),
        sampling: format!("{:?}", ir.sampling),
        num_rays: 1000,
        first_ray: 0,
        of_rays: None,
        seed: 0,
        max_depth: 16,
        min_flux_fraction: 1e-6,
        precision: "f32".into(),
        sampler: "pcg".into(),
        paths: "All".into(),
        path_table: "8 rows".into(),
        path_filter: "none".into(),
        standard_error: "on".into(),
        guide: None,
        adapter: "adapter".into(),
        driver: "driver".into(),
    };
    Checkpoint { identity, tally, proof: None }
}

/// The file of a body, with the length and the checksum that it should have.
fn sealed(header: &[u8], body: &[u8]) -> Vec<u8> {
    let (length, checksum) = (body.len() as u64, crc32fast::hash(body));
    [&header[..12], &length.to_le_bytes(), &checksum.to_le_bytes(), body].concat()
}

/// Draws from 0 to `end`, without its end.
struct Draws(u64);

impl Draws {
    fn below(&mut self, end: usize) -> usize {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 33) as usize % end
    }

    /// Changes bytes: a bit, a byte, one less, one more, or one that becomes the largest number of an encoding.
    fn craft(&mut self, body: &mut Vec<u8>) {
        for _ in 0..1 + self.below(3) {
            let at = self.below(body.len());
            match self.below(6) {
                0 => body[at] ^= 1 << self.below(8),
                1 => body[at] = [0, 1, 2, 127, 255][self.below(5)],
                2 => {
                    body.remove(at);
                }
                3 => body.insert(at, self.below(256) as u8),
                4 => {
                    body.splice(at..=at, [[0xff; 9].as_slice(), &[1]].concat());
                }
                _ => {
                    body.splice(at..=at, [[0xff; 18].as_slice(), &[3]].concat());
                }
            }
        }
    }
}

fn run_info(tally: &Tally) -> RunInfo {
    RunInfo { num_rays: tally.launched.count, sampler: "pcg".into(), ..RunInfo::default() }
}

/// What `merge` does with sums, and what writes their result.
fn merge(ir: &SceneIr, first: &Tally, second: &Checkpoint, folder: Option<&Path>) -> Result<(), String> {
    let mut tally = Tally::zeros(ir);
    for part in [first, &second.tally] {
        tally += part;
        tally.check_sums()?;
    }
    tally.sort_rows(ir);
    let result = TraceResult::new(ir, &run_info(&tally), &tally).map_err(|error| error.to_string())?;
    result.report();
    Report::new(&result, &Files::default()).to_json();
    let Some(folder) = folder else { return Ok(()) };
    let extras = output::Extras { pictures: Some(Default::default()), tally: None };
    output::write(folder, &result, &extras).map(|_| ()).map_err(|error| error.to_string())
}

#[test]
fn crafted_sums_are_refused_and_nothing_panics() {
    const NUM: u64 = 4000;
    let ir = Scene::from_json(SMALL).unwrap().lower().unwrap();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("crafted.tally");
    let other = sums(&ir, 100);
    let whole = checkpoint(&ir, sums(&ir, 0));
    whole.check(&path, &ir).unwrap();
    merge(&ir, &other, &whole, Some(&folder.path().join("whole"))).unwrap();
    let bytes = whole.to_bytes().unwrap();
    let gpu = has_adapter("crafted sums that a trace goes on from")
        .then(|| Gpu::open(&AdapterChoice::default()).unwrap());
    let options = TraceOptions {
        num_rays: 1000,
        collect: nsq_gpu::run::Collect::Paths { rows: 8, ends: false },
        ..TraceOptions::default()
    };
    let mut tracer = gpu.as_ref().map(|gpu| Tracer::new(gpu, &ir, &options).unwrap());
    let (mut num_refused, mut num_taken, mut num_resumed) = (0, 0, 0);
    for seed in 0..NUM {
        let mut body = bytes[24..].to_vec();
        Draws(seed).craft(&mut body);
        std::fs::write(&path, sealed(&bytes, &body)).unwrap();
        let used = catch_unwind(AssertUnwindSafe(|| {
            let crafted = Checkpoint::read(&path)?;
            crafted.check(&path, &ir)?;
            num_taken += 1;
            let out = folder.path().join("out");
            let _ = merge(&ir, &other, &crafted, (num_taken % 20 == 0).then_some(&out));
            if let Some(tracer) = &mut tracer
                && num_taken % 5 == 0
            {
                num_resumed += usize::from(tracer.go_on(crafted.tally, |_| Ok(false)).is_ok());
            }
            Ok::<_, nsq_gpu::Error>(())
        }));
        match used {
            Ok(Ok(())) => {}
            Ok(Err(error)) => {
                num_refused += 1;
                assert_eq!(error.exit_code(), USAGE as u8, "{seed}: {error}");
                assert!(error.to_string().contains("crafted.tally: "), "{seed}: {error}");
            }
            Err(_) => panic!("crafted sums {seed} make a panic"),
        }
    }
    assert!(num_refused > 1000 && num_taken > 500, "{num_refused} refused, {num_taken} taken");
    assert!(tracer.is_none() || num_resumed > 50, "{num_resumed}");
}

/// What each check refuses, by a change that fits the encoding.
#[test]
fn sums_that_are_not_of_the_scene_are_refused_with_what_is_wrong() {
    type Change<T> = fn(&mut T);
    let paths = |tally: &mut Tally, change: Change<PathTally>| change(tally.path_sums.as_mut().unwrap());
    let changes: [(Change<Tally>, &str); 22] = [
        (|t| t.detectors.truncate(3), "holds sums of 3 detectors; the scene has 4"),
        (|t| t.surfaces.push(Default::default()), "holds sums of 4 surfaces; the scene has 3"),
        (|t| t.detectors[0].quanta.push(0), "detector 0 that do not fit its 6 pixels or bins"),
        (|t| t.detectors[1].hits.truncate(7), "detector 1 that do not fit its 8 pixels"),
        (|t| t.detectors[2].squares.truncate(1), "detector 2 that do not fit"),
        (|t| t.detectors[2].totals.push(Moments::default()), "detector 2 that do not fit"),
        (|t| t.detectors[0].replicates = vec![0; 7], "detector 0 that do not fit"),
        (
            |t| t.rays += RaySpan { first: 50, count: 9, source: 0 },
            "holds 9 rays from ray 50 on, which overlap",
        ),
        (|t| t.rays += RaySpan { first: u64::MAX, count: 9, source: 0 }, "from ray 18446744073709551615 on"),
        (|t| t.rays += RaySpan { first: 900, count: 9, source: 2 }, "names source 2; the scene has 2"),
        (|t| t.launched.count += 1, "launched 201 rays, and names 200"),
        (
            |t| t.detectors[0].rows = t.detectors[3].rows.clone(),
            "holds rays of detector 0, which stores none",
        ),
        (|t| t.detectors[3].rows[2].wavelength = 2, "names wavelength 2; the scene has 2"),
        (|t| t.paths[0].ray.wavelength = u32::MAX, "names wavelength 4294967295; the scene has 2"),
        (|t| t.paths[0].kind = PathEventKind::Birth(2), "names source 2; the scene has 2"),
        (|t| t.paths[1].kind = PathEventKind::Surface(usize::MAX), "names surface 18446744073709551615"),
        (|t| t.paths[1].kind = PathEventKind::Detector(4), "names detector 4; the scene has 4"),
        (|t| t.escaped.count = 1 << 62, "sums that are larger than any trace's"),
        (|t| t.detectors[0].hits[1] = u64::MAX, "sums that are larger"),
        (|t| t.detectors[0].quanta[1] = u128::MAX, "sums that are larger"),
        (|t| t.detectors[0].squares[1] = u128::MAX, "sums that are larger"),
        (|t| t.detectors[3].recorded.quanta = u128::MAX, "sums that are larger"),
    ];
    let of_paths: [(Change<PathTally>, &str); 6] = [
        (|p| p.rows.values_mut().for_each(|sum| sum.count = u64::MAX), "sums that are larger"),
        (|p| p.other.extend([(End::Detector(4), PathSum::default())]), "names detector 4; the scene has 4"),
        (|p| p.other.extend([(End::Absorbed(3), PathSum::default())]), "names surface 3; the scene has 3"),
        (|p| p.chosen.iter_mut().flatten().for_each(|s| s.source = 9), "names source 9; the scene has 2"),
        (|p| p.chosen.iter_mut().for_each(|chosen| chosen.reverse()), "not chosen as this program does it"),
        (|p| p.chosen = None, "not chosen as this program does it"),
    ];
    let ir = Scene::from_json(SMALL).unwrap().lower().unwrap();
    let expect = |tally: &Tally, gist: &str| {
        let problem = tally.check(&ir).expect_err(gist);
        assert!(problem.contains(gist), "no `{gist}` in {problem}");
    };
    for (change, gist) in changes {
        let mut tally = sums(&ir, 0);
        change(&mut tally);
        expect(&tally, gist);
    }
    for (change, gist) in of_paths {
        let mut tally = sums(&ir, 0);
        paths(&mut tally, change);
        expect(&tally, gist);
    }
    // Each is small enough, but not both together.
    let mut large = sums(&ir, 0);
    large.escaped.quanta = 1 << 125;
    large.check(&ir).unwrap();
    let together = merge(&ir, &large, &checkpoint(&ir, large.clone()), None).unwrap_err();
    assert!(together.contains("sums that are larger"), "{together}");
}

#[test]
fn the_command_refuses_crafted_sums() {
    if !has_adapter("crafted sums and the command") {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    std::fs::write(at.join("scene.json"), SMALL).unwrap();
    let rays = ["trace", "scene.json", "-n", "200", "--progress", "never"];
    for (first, name) in [("0", "a.tally"), ("200", "b.tally")] {
        let part = ["--first-ray", first, "--of-rays", "400", "--checkpoint", name];
        assert!(run(at, &[&rays[..], &part].concat()).status.success());
    }
    let mut crafted = Checkpoint::read(&at.join("b.tally")).unwrap();
    crafted.tally.detectors[3].rows[0].wavelength = 7;
    std::fs::write(at.join("c.tally"), crafted.to_bytes().unwrap()).unwrap();
    let output = run(at, &["merge", "a.tally", "c.tally", "-o", "out"]);
    refused(&output, USAGE, &["c.tally: names wavelength 7; the scene has 2"]);
    let part = ["--first-ray", "200", "--of-rays", "400", "--resume", "c.tally"];
    refused(&run(at, &[&rays[..], &part].concat()), USAGE, &["names wavelength 7; the scene has 2"]);
    let mut bytes = std::fs::read(at.join("b.tally")).unwrap();
    bytes.extend([0, 0]);
    std::fs::write(at.join("d.tally"), sealed(&bytes, &bytes[24..])).unwrap();
    refused(&run(at, &["merge", "a.tally", "d.tally"]), USAGE, &["d.tally: is damaged: 2 bytes follow"]);
}

// Archives

/// However far the disk reaches, the error is this program's, in one line, and names what the system said.
#[cfg(target_os = "linux")]
#[test]
fn an_archive_that_cannot_be_written_is_told_in_one_line() {
    if !has_adapter("archives on a full disk") {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let pixels =
        SMALL.replace(r#""num_pixels_x": 3, "num_pixels_y": 2"#, r#""num_pixels_x": 64, "num_pixels_y": 64"#);
    std::fs::write(at.join("scene.json"), pixels).unwrap();
    for (first, name) in [("0", "a.tally"), ("200", "b.tally")] {
        let part = [
            "-n",
            "200",
            "--first-ray",
            first,
            "--of-rays",
            "400",
            "--checkpoint",
            name,
            "--progress",
            "never",
        ];
        assert!(run(at, &[&["trace", "scene.json"][..], &part].concat()).status.success());
    }
    let mut num_written = 0;
    for blocks in (0..40).chain((40..400).step_by(40)) {
        let limited = format!(r#"ulimit -f {blocks}; "$0" merge a.tally b.tally --no-pictures -o out"#);
        let mut command = Command::new("sh");
        command.args(["-c", &limited, env!("CARGO_BIN_EXE_nsq-gpu")]).current_dir(at);
        let output = command.output().unwrap();
        let [_, stderr] = texts(&output);
        assert!(!stderr.contains("ZipWriter"), "{blocks}: {stderr}");
        if output.status.success() {
            num_written += 1;
            continue;
        }
        let errors: Vec<&str> = stderr.lines().filter(|line| !line.starts_with("merged: ")).collect();
        let [error] = errors.as_slice() else { panic!("{blocks}: {stderr}") };
        assert!(error.starts_with("nsq-gpu: ") && error.contains("File too large"), "{blocks}: {error}");
    }
    assert!((1..40).contains(&num_written), "{num_written}");
}

// Characters

/// Moves the cursor, rings, turns the order of reading, breaks lines; each in JSON's words.
const ACTIVE: &str = "\u{1b}[2J\u{7}\u{7f}\u{9b}31m\u{202e}\u{2066}\u{200f}\u{2028}";

fn is_active(c: char) -> bool {
    c.is_control() && !matches!(c, '\n' | '\t') || ACTIVE.contains(c) && !"[2J31m".contains(c)
}

#[track_caller]
fn is_fit_for_a_terminal(output: &Output) {
    for text in texts(output) {
        assert!(!text.contains(is_active), "{text:?}");
    }
}

#[cfg(unix)]
#[test]
fn no_active_character_reaches_a_terminal_or_json() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let named = SMALL.replace("NAME", &serde_json::to_string(ACTIVE).unwrap().replace('"', ""));
    let scene = format!("{ACTIVE}.json");
    std::fs::write(at.join(&scene), &named).unwrap();
    let (mesh, missing) = (format!("{ACTIVE}.obj"), format!("{ACTIVE}missing.stl"));
    std::fs::write(at.join(&mesh), "f 1 2 3\n").unwrap();
    let output = run(at, &["check", &scene]);
    assert!(output.status.success());
    is_fit_for_a_terminal(&output);
    let shown = r"\u{1b}[2J\u{7}\u{7f}\u{9b}31m\u{202e}\u{2066}\u{200f}\u{2028}";
    assert!(texts(&output)[0].contains(shown), "{:?}", texts(&output)[0]);
    for path in [&mesh, &missing] {
        let plane = r#"{"type": "plane", "aperture_radius": 2}, "interaction": "absorbing""#;
        let with_mesh = named.replace(
            plane,
            &format!(
                r#"{{"type": "mesh", "path": {}}}, "interaction": "absorbing""#,
                serde_json::to_string(path).unwrap()
            ),
        );
        std::fs::write(at.join("mesh.json"), with_mesh).unwrap();
        let output = run(at, &["check", "mesh.json"]);
        refused(&output, USAGE, &[shown]);
        is_fit_for_a_terminal(&output);
    }
    for arguments in [
        &["check", &format!("no{ACTIVE}")][..],
        &["check", &scene, ACTIVE],
        &["check", &format!("--{ACTIVE}")],
        &["compare", ACTIVE, ACTIVE],
        &["merge", ACTIVE, ACTIVE],
        &["materials", ACTIVE],
        &["sweep", &scene, "--set", &format!("{ACTIVE}.x=1"), "-n", "10"],
        &["shader", &scene],
    ] {
        let output = run(at, arguments);
        assert!(arguments[0] == "shader" || !output.status.success(), "{arguments:?}");
        is_fit_for_a_terminal(&output);
    }
    if !has_adapter("active characters in results") {
        return;
    }
    let trace = ["trace", &scene, "-n", "300", "--paths", "on", "--progress", "never", "-o", "out"];
    let text = run(at, &trace);
    let json = run(at, &[&trace[..], &["--json"]].concat());
    let sweep = ["sweep", &scene, "--set", &format!("{ACTIVE}7.z=2,3"), "-n", "100"];
    for output in
        [&text, &json, &run(at, &["paths", &scene, "-n", "300"]), &run(at, &["compare", "out", "out"])]
    {
        assert!(output.status.success(), "{:?}", texts(output));
        is_fit_for_a_terminal(output);
    }
    is_fit_for_a_terminal(&run(at, &sweep));
    let report = std::fs::read_to_string(at.join("out/report.json")).unwrap();
    assert!(!report.contains(is_active) && report.contains(r"\u202e"));
    assert_eq!(report, texts(&json)[0]);
    let report: Value = serde_json::from_str(&report).unwrap();
    assert!(report["detectors"].get(format!("{ACTIVE}3")).is_some(), "names come back as they are");
    // The hashes are those of what was written.
    assert_eq!(TraceResult::read(&at.join("out")).unwrap().detectors.len(), 4);
}

#[test]
fn no_cell_of_a_table_is_a_formula() {
    if !has_adapter("formulas in tables") {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let named = SMALL.replace("NAME", r#"=HYPERLINK(\"x\",\"y\")"#);
    std::fs::write(at.join("scene.json"), named).unwrap();
    let output = run(at, &["paths", "scene.json", "-n", "1000", "--progress", "never", "-o", "out"]);
    assert!(output.status.success(), "{:?}", texts(&output));
    let table = std::fs::read_to_string(at.join("out/paths.csv")).unwrap();
    assert!(table.lines().count() > 1 && table.contains(r#""'=HYPERLINK(""x"",""y"")"#), "{table}");
    assert!(!table.contains(",=") && !table.contains(",\"="), "{table}");
}

// Numbers

#[test]
fn numbers_beyond_f64_are_refused_with_their_place() {
    let folder = tempfile::tempdir().unwrap();
    let check = |from: &str, to: &str| {
        std::fs::write(folder.path().join("scene.json"), SMALL.replacen(from, to, 1)).unwrap();
        run(folder.path(), &["check", "scene.json"])
    };
    let beyond = ["which is beyond the largest, 1.7976931348623157e308", "expected a finite number"];
    for number in ["1e309", "-1e309", "+1E+400", "1e309 /* Infinity */", &"9".repeat(400)] {
        let output = check(r#""height": 4"#, &format!(r#"/* 1e309 ' */ "height": {number}"#));
        refused(&output, SCENE, &[&["detectors[0].height: found the number"][..], &beyond].concat());
        let output = check("[1, 2]", &format!("[1, {number}]"));
        refused(&output, SCENE, &["sources[0].spectrum.weights[1]", beyond[0]]);
    }
    // A radius may be infinite, but not by a number that is too large.
    let conic = |radius: &str| {
        let shape = format!(r#"{{"type": "conic", "radius": {radius}, "aperture_radius": 2}}"#);
        check(r#"{"type": "plane", "aperture_radius": 2}"#, &shape)
    };
    for radius in ["Infinity", "-Infinity", "1e308", r#"Infinity, "conic": 0 /* 1e309 */"#] {
        assert!(conic(radius).status.success(), "{radius}: {:?}", texts(&conic(radius)));
    }
    refused(&conic("1e309"), SCENE, &["nsq_gpu.surfaces[0].shape.radius: found the number `1e309`"]);
    // In quotes it is a name like any other.
    let named = SMALL.replace("NAME1", "1e309").replacen(r#""cs": {}"#, r#""cs": {"x": Infinity}"#, 1);
    std::fs::write(folder.path().join("scene.json"), named).unwrap();
    refused(&run(folder.path(), &["check", "scene.json"]), SCENE, &["sources[0].cs.x: inf is out of range"]);
}

/// The least flux is that of which a quantum of a ray is a number of full precision, among as many rays as there can be, on a
/// pixel as large as can be.
#[test]
fn a_flux_that_would_be_rounded_away_is_refused() {
    let irradiance = |flux: f64| FluxUnit::new(flux, 1 << 63).watts(1) / 1e24;
    assert!(irradiance(1e-249).is_normal() && !irradiance(9e-250).is_normal());
    let folder = tempfile::tempdir().unwrap();
    let check = |flux: &str| {
        let text = SMALL.replacen(r#""total_flux": 1"#, &format!(r#""total_flux": {flux}"#), 1);
        std::fs::write(folder.path().join("scene.json"), text).unwrap();
        run(folder.path(), &["check", "scene.json"])
    };
    for flux in ["1e-249", "0", "1e-12", "1e100"] {
        assert!(check(flux).status.success(), "{flux}: {:?}", texts(&check(flux)));
    }
    for flux in ["9.9e-250", "1e-320", "5e-324"] {
        refused(
            &check(flux),
            SCENE,
            &["sources[0].total_flux: ", "too little", "give 0, or at least 1e-249 W"],
        );
    }
    refused(&check("1e101"), SCENE, &["sources[0].total_flux", "out of range"]);
}

// Files

/// A file of 3 GiB is not read, and what has no end is not opened.
#[cfg(target_os = "linux")]
#[test]
fn huge_files_and_what_is_no_file_are_refused_before_they_are_read() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let shape = r#""shape": {"type": "plane", "aperture_radius": 2}, "interaction": "absorbing""#;
    let of_mesh = |path: &str| {
        SMALL.replace(
            shape,
            &format!(r#""shape": {{"type": "mesh", "path": "{path}"}}, "interaction": "absorbing""#),
        )
    };
    let of_bsdf = |path: &str| {
        let bsdf = format!(r#""reflectance": 0.5, "bsdf": {{"type": "tabulated", "path": "{path}"}}"#);
        SMALL.replace(r#""reflectance": 0.5"#, &bsdf)
    };
    let sparse = |path: &Path| std::fs::File::create(path).unwrap().set_len(3 << 30).unwrap();
    let start = Instant::now();
    let limited = |path: &str| {
        // Half a GiB of memory: a file that is read does not fit.
        let mut command = Command::new("sh");
        command.args([
            "-c",
            r#"ulimit -v 2000000; exec timeout 20 "$0" check "$1""#,
            env!("CARGO_BIN_EXE_nsq-gpu"),
            path,
        ]);
        command.current_dir(at).output().unwrap()
    };
    for name in ["m.stl", "m.obj", "b.csv", "scene.json"] {
        sparse(&at.join(name));
        let fifo = at.join(format!("fifo.{}", name.rsplit_once('.').unwrap().1));
        assert!(Command::new("mkfifo").arg(&fifo).status().unwrap().success());
        let zero = at.join(format!("zero.{}", name.rsplit_once('.').unwrap().1));
        std::os::unix::fs::symlink("/dev/zero", &zero).unwrap();
        for (file, gist) in [(&at.join(name), "is longer than"), (&fifo, "no file"), (&zero, "no file")] {
            let file = file.file_name().unwrap().to_str().unwrap();
            let text = match name {
                "m.stl" | "m.obj" => Some(of_mesh(file)),
                "b.csv" => Some(of_bsdf(file)),
                _ => None,
            };
            let path = if let Some(text) = text {
                std::fs::write(at.join("uses.json"), text).unwrap();
                "uses.json"
            } else {
                file
            };
            let output = limited(path);
            let code = if name == "b.csv" { SCENE } else { USAGE };
            refused(&output, code, &[file, gist]);
        }
    }
    assert!(start.elapsed().as_secs() < 60, "{:?}", start.elapsed());
    let piped = r#"cat docs/example.json | "$0" check /dev/stdin"#;
    let mut command = Command::new("sh");
    command.args(["-c", piped, env!("CARGO_BIN_EXE_nsq-gpu")]).current_dir(env!("CARGO_MANIFEST_DIR"));
    assert!(command.output().unwrap().status.success(), "a stream that the caller opened is a scene");
}
