//! Light by its path: the rows of a detector add up to its sums, whatever the table, the parts, and the filter.
#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "clippy's exemption of tests does not reach their helpers"
)]

mod zoo;

use nsq_gpu::TraceOptions;
use nsq_gpu::model::{End, SceneIr};
use nsq_gpu::program::Precision;
use nsq_gpu::result::{PathSum, PathTally, Tally};

fn with_table(num_rays: u64, precision: Precision) -> TraceOptions {
    TraceOptions { path_table: true, ..zoo::options(num_rays, 16, precision) }
}

fn sums(tally: &Tally) -> &PathTally {
    tally.path_sums.as_ref().unwrap()
}

/// Counts and quanta of every end are those of the ledger.
fn assert_rows_add_up(ir: &SceneIr, tally: &Tally, has_ends: bool, what: &str) {
    let sums = sums(tally);
    let check = |end: End, count: u64, quanta: u128| {
        let PathSum { count: of_paths, quanta: quanta_of_paths, .. } = sums.total(end);
        assert_eq!((of_paths, quanta_of_paths), (count, quanta), "{what}: {end:?}");
    };
    for (number, detector) in (0..).zip(&tally.detectors) {
        let total = detector.total();
        check(End::Detector(number), total.count, total.quanta);
    }
    if has_ends {
        for (number, surface) in (0..).zip(&tally.surfaces) {
            if ir.surfaces[number as usize].interaction == nsq_gpu::model::Interaction::Absorbing {
                check(End::Absorbed(number), surface.absorbed.count, surface.absorbed.quanta);
            }
        }
        check(End::Missed, tally.escaped.count, tally.escaped.quanta);
        check(End::DepthLimit, tally.depth_killed.count, tally.depth_killed.quanta);
        check(End::Roulette, tally.roulette_loss.count, tally.roulette_loss.quanta);
    }
}

#[test]
fn rows_add_up_to_what_detectors_and_ends_have_in_every_scene() {
    for (k, name) in zoo::scenes().into_iter().enumerate() {
        let ir = zoo::load(&name);
        let (gpu, precision) = match k % 4 {
            0 => (zoo::gpu(), Precision::F32),
            1 => (zoo::gpu(), Precision::F64),
            2 => (zoo::portable_gpu(), Precision::F32),
            _ => (zoo::portable_gpu(), Precision::F64),
        };
        eprintln!("{name}");
        let plain = zoo::trace_on(gpu, &ir, &zoo::options(3000, 16, precision));
        for has_ends in [false, true] {
            let options = TraceOptions { path_ends: has_ends, ..with_table(3000, precision) };
            let mut tally = zoo::trace_on(gpu, &ir, &options);
            let what = format!("{name}, {precision:?}");
            assert_rows_add_up(&ir, &tally, has_ends, &what);
            assert!(!sums(&tally).is_closed && sums(&tally).other.is_empty(), "{what}");
            tally.path_sums = None;
            assert_eq!(tally, plain, "{what}: other sums change");
        }
    }
}
