//! A run of the library gives what the command gives.

#![allow(clippy::unwrap_used, reason = "a test fails by panic")]

mod command;

use nsq_gpu::program::Precision;
use nsq_gpu::result::{Report, StoppedBy, report};
use nsq_gpu::run::precision::WantedPrecision;
use nsq_gpu::run::{Next, RowStorage, Saved};
use nsq_gpu::{Error, Run};
use serde_json::Value;
use std::time::Duration;

/// A report without times.
fn timeless(report: &str) -> Value {
    let mut report: Value = serde_json::from_str(report).unwrap();
    let entries = report.as_object_mut().unwrap();
    for time in ["trace_time_sec", "first_rays_sec", "rays_per_sec"] {
        assert!(entries.remove(time).is_some(), "the report has no {time}");
    }
    report
}

/// The report that the command prints, and the sums that it writes.
fn of_command(scene: &str, arguments: &[&str]) -> (Value, Vec<u8>) {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    let trace = [&["trace", scene, "--json"], arguments].concat();
    let written = command::run(&[&trace[..], &["-o", out.to_str().unwrap(), "--no-pictures"]].concat());
    assert!(written.status.success(), "{}", command::stderr(&written));
    let printed = command::run(&trace);
    (timeless(std::str::from_utf8(&printed.stdout).unwrap()), std::fs::read(out.join("tally.bin")).unwrap())
}

/// A run of this scene, as the command makes it without `-o`.
fn run(scene: &str) -> Run<'static> {
    Run::open(scene).unwrap().rows(RowStorage::Counted)
}

#[test]
fn a_run_gives_the_sums_and_the_report_of_the_command() {
    let scene = "scenes/bench_lens.json";
    let f32 = WantedPrecision::Exactly(Precision::F32);
    let cases: [(&[&str], Run); 3] = [
        (&["-n", "3e4"], run(scene).rays(3e4).unwrap()),
        (
            &["-n", "2e4", "--seed", "7", "--precision", "f32", "--max-depth", "9"],
            run(scene).rays(2e4).unwrap().seed(7).precision(f32).max_depth(9),
        ),
        (&["-n", "1e6", "--target-error", "5%"], run(scene).rays(1e6).unwrap().target_error(0.05).unwrap()),
    ];
    for (arguments, run) in cases {
        let (report, sums) = of_command(scene, arguments);
        let outcome = run.go().unwrap();
        let own = Report::new(&outcome.result, &report::Files::default()).to_json();
        assert_eq!(timeless(&own), report, "{arguments:?}");
        assert!(outcome.sums().unwrap() == sums, "{arguments:?}: the sums differ");
    }
}

#[test]
fn a_run_that_was_stopped_goes_on_to_the_same_sums() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("sums.bin");
    let run = || {
        let run = Run::open("scenes/bench_lens.json").unwrap().rays(2e5).unwrap();
        run.change_options(|options| options.batch_size = Some(1 << 14)).pass_time(Duration::from_millis(1))
    };
    let kept = run().checkpoint(&file, Duration::from_secs(30), false).unwrap();
    let stopped = kept.go_with(|_| Ok(Next::Stop)).unwrap();
    let info = &stopped.result.run;
    assert!(info.partial && info.stopped_by == Some(StoppedBy::Interrupt));
    assert_eq!(stopped.saved, Saved::Written);
    let done = stopped.result.num_rays_total;
    assert!(0 < done && done < 200_000, "{done}");
    let resumed = run().resume(&file).unwrap().go().unwrap();
    assert_eq!(resumed.result.run.num_rays_before, done);
    assert!(resumed.tally == run().go().unwrap().tally);
}

#[test]
fn a_run_that_was_cancelled_gives_nothing() {
    let cancelled = run("scenes/bench_lens.json").rays(1e5).unwrap().go_with(|_| Ok(Next::Cancel));
    assert_eq!(cancelled.unwrap_err(), Error::Interrupted);
}

#[test]
fn the_result_so_far_is_that_of_a_partial_trace() {
    let mut partial = Vec::new();
    let run = run("scenes/bench_lens.json").rays(3e5).unwrap().pass_time(Duration::from_millis(1));
    let outcome = run.go_with(|pass| {
        let so_far = pass.result()?;
        partial.push((so_far.num_rays_total, so_far.run.partial, so_far.ledger.closes()));
        Ok(Next::GoOn)
    });
    assert!(!outcome.unwrap().result.run.partial);
    assert!(partial.len() > 1, "{partial:?}");
    assert!(
        partial.iter().all(|(rays, partial, closes)| *partial == (*rays < 300_000) && *closes),
        "{partial:?}"
    );
}

#[test]
fn what_is_no_count_and_no_fraction_is_refused() {
    for rays in [-1.0, 1.5, 1e17, f64::NAN] {
        assert!(matches!(run("scenes/bench_lens.json").rays(rays), Err(Error::Usage(_))), "{rays}");
    }
    for target in [0.0, -0.1, 1.5, f64::NAN] {
        assert!(
            matches!(run("scenes/bench_lens.json").target_error(target), Err(Error::Usage(_))),
            "{target}"
        );
    }
}
