//! What has been summed up after any pass is a whole result, and parts add up to it.

use crate::zoo;
use crate::zoo::forced::{Asked, Forced};
use nsq_gpu::cpu::Override;
use nsq_gpu::program::Precision;
use nsq_gpu::result::{FluxUnit, Ledger, Tally};
use nsq_gpu::{Error, StandardError, TraceOptions};
use std::time::Duration;

/// One source and several; rays that outlive a dispatch; rows for the host.
const SCENES: [&str; 4] = ["nested_media", "tessar_gaussian_beams", "filter_stack", "kaleidoscope"];

fn options(num_rays: u64) -> TraceOptions {
    TraceOptions {
        batch_size: Some(1000),
        events_per_dispatch: 5,
        standard_error: StandardError::On,
        ..zoo::options(num_rays, 11, Precision::F64)
    }
}

/// The tallies after each pass, and at last that of the whole.
fn snapshots(name: &str, options: &TraceOptions) -> Vec<Tally> {
    let ir = zoo::load(name);
    let mut snapshots = Vec::new();
    let mut tracer = zoo::tracer(&ir, options).unwrap();
    let whole = tracer.go_on(tracer.empty_tally(), |progress| {
        snapshots.push(progress.tally()?.clone());
        assert_eq!(snapshots.last().unwrap().launched.count, progress.done);
        Ok(true)
    });
    snapshots.push(whole.unwrap());
    snapshots
}

#[test]
fn every_snapshot_closes_its_books_and_the_last_is_the_whole() {
    for name in SCENES {
        let ir = zoo::load(name);
        let options = options(20_000);
        let snapshots = snapshots(name, &options);
        assert!(snapshots.len() > 2, "{name}: {} snapshots", snapshots.len());
        for tally in &snapshots {
            let ledger = Ledger::new(&ir, tally, FluxUnit::new(1.0, tally.launched.count));
            assert!(ledger.closes(), "{name}: {ledger:?}");
        }
        assert!(*snapshots.last().unwrap() == zoo::trace(&ir, &options), "{name}: other bits");
    }
}

#[test]
fn a_snapshot_is_the_trace_of_its_rays() {
    let ir = zoo::load("ball_lens_ghosts");
    assert_eq!(ir.sources.len(), 1);
    for tally in snapshots("ball_lens_ghosts", &options(20_000)) {
        let num_rays = tally.launched.count;
        assert!(tally == zoo::trace(&ir, &options(num_rays)), "{num_rays} rays");
    }
}

#[test]
fn sources_take_turns() {
    let ir = zoo::load("tessar_gaussian_beams");
    assert!(ir.sources.len() > 1);
    for tally in snapshots("tessar_gaussian_beams", &options(20_000)) {
        let share = |source: usize| tally.rays.count_of(source) as f64 / tally.launched.count as f64;
        let whole: f64 = ir.sources.iter().map(|source| source.total_flux).sum();
        for (index, source) in ir.sources.iter().enumerate() {
            assert!((share(index) - source.total_flux / whole).abs() < 2e-3, "{index}: {}", share(index));
        }
    }
}

#[test]
fn a_trace_that_is_taken_up_again_has_the_same_bits() {
    for name in SCENES {
        let ir = zoo::load(name);
        let options = options(5_003);
        let whole = zoo::trace(&ir, &options);
        for begun in snapshots(name, &options).into_iter().step_by(3) {
            let done = begun.launched.count;
            let mut tracer = zoo::tracer(&ir, &options).unwrap();
            assert!(tracer.go_on(begun, |_| Ok(true)).unwrap() == whole, "{name} from ray {done}");
        }
    }
}

#[test]
fn another_seed_snapshots_and_timed_stages_have_the_same_bits() {
    // Rays that a path rejects; several sources; rays that outlive a dispatch; a tree in an image; a scattering bulk.
    for (name, hot_path) in [
        ("bench_lens", true),
        ("tessar_gaussian_beams", false),
        ("kaleidoscope", false),
        ("mesh_prism", false),
        ("opal_lamp", false),
    ] {
        let ir = zoo::load(name);
        for (precision, standard_error) in
            [(Precision::F32, StandardError::Off), (Precision::F64, StandardError::On)]
        {
            let options = TraceOptions { standard_error, precision, ..options(10_007) };
            let options = options.with(|overrides| overrides.hot_path = Override::forced(hot_path));
            let with_sides = options.with(|overrides| overrides.side_traces = Override::Always);
            let with_seed = |seed| Forced {
                options: TraceOptions { seed, ..options.options.clone() },
                overrides: options.overrides.clone(),
            };
            let mut tracer = with_sides.tracer(zoo::gpu(), &ir).unwrap();
            tracer.set_pass_time(Duration::ZERO);
            for seed in [options.seed, 12] {
                tracer.set_seed(seed);
                let tally = tracer.go_on(tracer.empty_tally(), |progress| {
                    if seed == 12 { progress.tally().map(|_| true) } else { Ok(true) }
                });
                let expected = zoo::trace(&ir, &with_seed(seed));
                assert!(tally.unwrap() == expected, "{name} in {precision:?}: other bits");
            }
            tracer.enable_profile().unwrap();
            let expected = zoo::trace(&ir, &with_seed(12));
            assert!(
                tracer.trace(|_| true).unwrap() == expected,
                "{name} in {precision:?}: other bits, timed"
            );
        }
    }
}

#[test]
fn rays_of_another_trace_are_no_beginning() {
    let ir = zoo::load("nested_media");
    let other = zoo::trace(&ir, &TraceOptions { first_ray: 7, ..options(3000) });
    let mut tracer = zoo::tracer(&ir, &options(10_000)).unwrap();
    assert!(matches!(tracer.go_on(other, |_| Ok(true)), Err(Error::Usage(_))));
}

#[test]
fn a_failure_of_the_caller_ends_the_trace_and_leaves_nothing_behind() {
    let ir = zoo::load("nested_media");
    for standard_error in [StandardError::Off, StandardError::On] {
        let options = TraceOptions { standard_error, ..options(10_000) };
        let mut tracer = zoo::tracer(&ir, &options).unwrap();
        tracer.set_pass_time(Duration::ZERO);
        let mut num_passes = 0;
        let failed = tracer.go_on(tracer.empty_tally(), |_| {
            num_passes += 1;
            if num_passes < 4 { Ok(true) } else { Err(Error::Tolerance("planted".into())) }
        });
        assert_eq!(failed.unwrap_err(), Error::Tolerance("planted".into()));
        assert!(tracer.trace(|_| true).unwrap() == zoo::trace(&ir, &options));
    }
}

#[test]
fn a_pass_ends_where_it_is_asked_to() {
    let ir = zoo::load("nested_media");
    let mut tracer = zoo::tracer(&ir, &options(10_000)).unwrap();
    let mut seen = Vec::new();
    let whole = tracer.go_on(tracer.empty_tally(), |progress| {
        seen.push(progress.position());
        progress.pause_at(seen[0] + 777);
        Ok(true)
    });
    assert!(seen.contains(&(seen[0] + 777)), "{seen:?}");
    assert!(whole.unwrap() == zoo::trace(&ir, &options(10_000)));
}

#[test]
fn parts_of_a_trace_add_up_to_it() {
    for name in SCENES {
        let ir = zoo::load(name);
        let num_rays = 10_007;
        let whole = zoo::trace(&ir, &options(num_rays));
        let cuts = [0, 1003, 5000, 9999, num_rays];
        let mut sum = Tally::zeros(&ir);
        for cut in cuts.windows(2).rev() {
            let part =
                TraceOptions { first_ray: cut[0], of_rays: Some(num_rays), ..options(cut[1] - cut[0]) };
            let mut tracer = zoo::tracer(&ir, &part).unwrap();
            let part = tracer.trace(|_| true).unwrap();
            assert_eq!(sum.rays.overlap(&part.rays), None);
            sum += &part;
        }
        sum.sort_rows(&ir);
        assert!(sum == whole, "{name}: other bits");
    }
}

#[test]
fn ray_ids_go_on_beyond_32_bits() {
    let ir = zoo::load("filter_stack");
    let lone = zoo::load("ball_lens_ghosts");
    for edge in [1 << 32, 1 << 40, (1 << 63) - 500_u64] {
        let part = |first_ray, num_rays| TraceOptions { first_ray, ..options(num_rays) };
        let whole = zoo::trace(&ir, &part(edge - 500, 1000));
        let mut halves = zoo::trace(&lone, &part(edge - 500, 500));
        halves += &zoo::trace(&lone, &part(edge, 500));
        assert!(halves == zoo::trace(&lone, &part(edge - 500, 1000)), "around ray {edge}");
        let ids = |tally: &Tally| -> Vec<u64> {
            tally.detectors.iter().flat_map(|detector| detector.rows.iter().map(|row| row.ray_id)).collect()
        };
        let found = ids(&whole);
        assert!(found.iter().all(|id| (edge - 500..edge + 500).contains(id)), "{edge}: {found:?}");
        assert!(found.iter().any(|id| *id >= edge) && found.iter().any(|id| *id < edge));
        // The upper word counts: the same lower words elsewhere draw other numbers.
        let hits = |first_ray| zoo::trace(&lone, &part(first_ray, 500)).detectors[0].hits.clone();
        assert!(hits(edge) != hits(edge & 0xffff_ffff));
    }
}

#[test]
fn parts_that_cannot_be_are_refused() {
    let ir = zoo::load("nested_media");
    for options in [
        TraceOptions { first_ray: 501, of_rays: Some(1000), ..options(500) },
        TraceOptions { first_ray: (1 << 63) - 499, ..options(500) },
        TraceOptions { first_ray: u64::MAX, ..options(500) },
    ] {
        assert!(matches!(zoo::tracer(&ir, &options), Err(Error::Usage(_))));
    }
}
