//! Standard errors mean what they say: intervals hold what they should hold, as often as they should.

use crate::zoo;
use nsq_gpu::model::ray_id::NUM_REPLICATES;
use nsq_gpu::model::{Bsdf, DetectorKind, FarField, Sampling, SceneIr, Spectral, Splat, Tabulated};
use nsq_gpu::program::{Precision, Sampler};
use nsq_gpu::result::{DetectorData, DetectorTally, RaySpan, RaySpans, RunInfo, Tally, TraceResult};
use nsq_gpu::{StandardError, TraceOptions};
use statrs::distribution::{Binomial, ContinuousCDF, Discrete, DiscreteCDF, StudentsT};

/// Half the width of the interval that holds a normal variable with a probability of 95 %, in standard deviations.
const Z95: f64 = 1.959963984540054;

/// The same of a variable whose standard deviation is estimated from the scrambles of Sobol's points.
fn t95() -> f64 {
    StudentsT::new(0.0, 1.0, f64::from(NUM_REPLICATES - 1)).unwrap().inverse_cdf(0.975)
}

/// Options of a trace with standard errors.
fn options(num_rays: u64, seed: u64, precision: Precision) -> TraceOptions {
    TraceOptions { standard_error: StandardError::On, ..zoo::options(num_rays, seed, precision) }
}

/// Values, standard errors and hits of a detector's cells.
fn cells(result: &TraceResult, detector: usize) -> Vec<(f64, f64, u64)> {
    let zip = |values: &mut dyn Iterator<Item = f64>, errors: Vec<f64>, hits: Vec<u64>| {
        values.zip(errors).zip(hits).map(|((value, error), hits)| (value, error, hits)).collect()
    };
    match &result.detectors[detector].data {
        DetectorData::Irradiance(map) => {
            let errors = map.standard_error.as_ref().unwrap().iter().copied().collect();
            zip(&mut map.irradiance.iter().copied(), errors, map.hits.iter().copied().collect())
        }
        DetectorData::Spectral(map) => {
            let map = &map.pixels;
            let errors = map.standard_error.as_ref().unwrap().iter().copied().collect();
            zip(&mut map.irradiance.iter().copied(), errors, map.hits.iter().copied().collect())
        }
        DetectorData::FarField(pattern) => {
            let errors = pattern.standard_error.as_ref().unwrap().iter().copied().collect();
            zip(&mut pattern.intensity.iter().copied(), errors, pattern.hits.iter().copied().collect())
        }
        DetectorData::RayDatabase(_) => Vec::new(),
    }
}

/// Options of a trace of Sobol points with standard errors.
fn sobol(num_rays: u64, seed: u64, precision: Precision) -> TraceOptions {
    TraceOptions { sampler: Sampler::Sobol, ..options(num_rays, seed, precision) }
}

/// A scene whose detectors have few pixels, so that many rays hit each.
fn coarse(name: &str, num: u32, splat: Option<Splat>) -> SceneIr {
    let mut ir = zoo::load(name);
    for detector in &mut ir.detectors {
        match &mut detector.kind {
            DetectorKind::Irradiance(grid) | DetectorKind::Spectral(Spectral { grid, .. }) => {
                (grid.num_pixels_x, grid.num_pixels_y) = (num, num);
                grid.splat = splat.unwrap_or(grid.splat);
            }
            DetectorKind::FarField(FarField { num_theta, num_phi, .. }) => {
                (*num_theta, *num_phi) = (num, num)
            }
            DetectorKind::RayDatabase(_) | DetectorKind::Apart(_) => {}
        }
    }
    ir
}

/// Tallies of blocks of `num_rays` rays each, one after the other of one trace: as independent as traces of other seeds,
/// because draws are keyed by the ray, and with no shader to compile for each.
fn blocks(ir: &SceneIr, num_rays: u64, num_blocks: u64) -> Vec<Tally> {
    let options = TraceOptions {
        batch_size: Some(num_rays as u32),
        ..options(num_rays * num_blocks, 7, Precision::F32)
    };
    let mut tracer = zoo::tracer(ir, &options).unwrap();
    let mut before = tracer.empty_tally();
    let mut blocks = Vec::new();
    tracer.pause_at(num_rays);
    let all = tracer.go_on(before.clone(), |progress| {
        // On a slow machine a pass ends before.
        if progress.position() % num_rays != 0 {
            return Ok(true);
        }
        progress.pause_at(progress.position() + num_rays);
        let now = progress.tally()?.clone();
        blocks.push(difference(&now, &before));
        before = now;
        Ok(true)
    });
    assert_eq!(all.unwrap().launched.count, num_rays * num_blocks);
    assert_eq!(blocks.len() as u64, num_blocks);
    blocks
}

/// What the later of two snapshots has more, of all that a detector's result is made from.
fn difference(later: &Tally, earlier: &Tally) -> Tally {
    let mut block = later.clone();
    block.launched.count -= earlier.launched.count;
    block.launched.quanta -= earlier.launched.quanta;
    block.rays = RaySpans::default();
    for span in later.rays.spans() {
        let source = span.source;
        let done = earlier.rays.count_of(source as usize);
        block.rays += RaySpan { first: span.first + done, count: span.count - done, source };
    }
    for (detector, before) in block.detectors.iter_mut().zip(&earlier.detectors) {
        let minus = |sums: &mut Vec<u128>, before: &[u128]| {
            sums.iter_mut().zip(before).for_each(|(sum, before)| *sum -= before);
        };
        // Squares are there from the first drain on.
        minus(&mut detector.quanta, &before.quanta);
        minus(&mut detector.squares, &before.squares);
        detector.hits.iter_mut().zip(&before.hits).for_each(|(sum, before)| *sum -= before);
        for (total, before) in detector.totals.iter_mut().zip(&before.totals) {
            total.quanta -= before.quanta;
            total.squares -= before.squares;
        }
        detector.recorded.count -= before.recorded.count;
        detector.recorded.quanta -= before.recorded.quanta;
    }
    block
}

/// The result of a block alone.
fn result_of(ir: &SceneIr, tally: &Tally) -> TraceResult {
    let run = RunInfo { num_rays: tally.launched.count, partial: true, ..RunInfo::default() };
    TraceResult::new(ir, &run, tally).unwrap()
}

/// A trace of so many rays that its errors hardly count.
fn converged(ir: &SceneIr, num_rays: u64) -> TraceResult {
    zoo::result(ir, &options(num_rays, 1 << 40, Precision::F32))
}

/// How many of the cells with at least 100 hits, pooled over tallies, lie within `width` errors of the converged value; and
/// how many there were.
fn coverage(
    ir: &SceneIr,
    converged: &TraceResult,
    width: f64,
    tallies: impl Iterator<Item = Tally>,
) -> (u64, u64) {
    let (mut within, mut all) = (0, 0);
    for tally in tallies {
        let result = result_of(ir, &tally);
        for detector in 0..ir.detectors.len() {
            let truth = cells(converged, detector);
            for ((value, error, hits), (truth, truth_error, _)) in cells(&result, detector).iter().zip(truth)
            {
                if *hits >= 100 {
                    all += 1;
                    within += u64::from((value - truth).abs() <= width * error.hypot(truth_error));
                }
            }
        }
    }
    (within, all)
}

/// Of blocks of random numbers.
fn block_coverage(ir: &SceneIr, num_rays: u64, num_blocks: u64) -> (u64, u64) {
    let blocks = blocks(ir, num_rays, num_blocks);
    coverage(ir, &converged(ir, 64 * num_rays), Z95, blocks.into_iter())
}

fn assert_covers(what: &str, ir: &SceneIr, num_rays: u64, num_blocks: u64) {
    assert_is_95_percent(what, block_coverage(ir, num_rays, num_blocks));
}

fn assert_is_95_percent(what: &str, (within, all): (u64, u64)) {
    let share = within as f64 / all as f64;
    println!("{what}: {:.2} % of {all} cells", 100.0 * share);
    assert!(all >= 3000, "{what}: only {all} cells");
    assert!((0.94..=0.96).contains(&share), "{what}: {share} of {all} cells lie within 95 %");
}

#[test]
fn intervals_of_pixels_hold_the_converged_value() {
    let gaussian = Some(Splat::Gaussian { sigma: 0.7 });
    // A disk of light on a detector that ends it: the hits say it all, or splats spread them.
    let disk = |splat| {
        let mut ir = coarse("bench_cavity", 16, splat);
        ir.detectors[0].absorb = true;
        ir.surfaces.clear();
        ir
    };
    assert_covers("hard", &disk(Some(Splat::Hard)), 15_000, 120);
    assert_covers("bilinear", &disk(Some(Splat::Bilinear)), 15_000, 120);
    assert_covers("Gaussian", &disk(gaussian), 15_000, 120);
    // The port of a sphere, after many lossy reflections and roulette.
    let mut port = coarse("lambertian_sphere", 3, None);
    port.detectors.retain(|detector| detector.absorb);
    assert_covers("losses and roulette", &port, 10_000, 500);
}

/// Sources that light cells unequally are pooled there: the interval is then too wide, and never too narrow.
#[test]
fn intervals_of_pixels_that_sources_light_unequally_are_not_too_narrow() {
    let (within, all) = block_coverage(&coarse("tessar_gaussian_beams", 10, None), 5_000, 100);
    println!("several sources: {within} of {all} cells");
    assert!(all >= 400 && within as f64 >= 0.94 * all as f64, "{within} of {all}");
}

#[test]
fn intervals_hold_where_rays_come_by_a_pixel_several_times() {
    // A transmissive detector in a cavity: no deposit is independent of the ray's others.
    for splat in zoo::in_turn([Splat::Hard, Splat::Bilinear, Splat::Gaussian { sigma: 0.7 }]) {
        let ir = coarse("bench_cavity", 4, Some(splat));
        assert!(!ir.detectors[0].absorb);
        assert_covers(&format!("{splat:?}, eight visits"), &ir, 1000, 1000);
    }
}

/// How often the interval about the number of hits, of `n` rays of one weight that hit with probability `p`, holds the
/// expected number: not exactly 95 %, because numbers are whole.
fn coverage_of_counts(n: u64, p: f64) -> f64 {
    let binomial = Binomial::new(p, n).unwrap();
    let holds = |&hits: &u64| {
        let found = hits as f64;
        let variance = found * (1.0 - found / n as f64) * n as f64 / (n - 1) as f64;
        (found - n as f64 * p).abs() <= Z95 * variance.sqrt()
    };
    (0..=n).filter(holds).map(|hits| binomial.pmf(hits)).sum()
}

/// Two-sided bounds that a binomial variable leaves with a probability of 1e-6.
fn binomial_bounds(n: u64, p: f64) -> std::ops::RangeInclusive<u64> {
    let binomial = Binomial::new(p, n).unwrap();
    binomial.inverse_cdf(0.5e-6)..=binomial.inverse_cdf(1.0 - 0.5e-6)
}

/// How many of the totals of so many seeds lie within `width` errors of the converged value, per detector.
fn coverage_of_totals(
    ir: &SceneIr,
    options: &TraceOptions,
    converged: &TraceResult,
    width: f64,
    num_seeds: u64,
) -> Vec<u64> {
    let mut tracer = zoo::tracer(ir, options).unwrap();
    let mut within = vec![0; ir.detectors.len()];
    for tally in zoo::tallies_of(&mut tracer, 0..num_seeds) {
        let result = result_of(ir, &tally);
        for ((found, truth), within) in result.detectors.iter().zip(&converged.detectors).zip(&mut within) {
            let error = found.total_flux_standard_error.unwrap();
            let error = error.hypot(truth.total_flux_standard_error.unwrap());
            *within += u64::from((found.total_flux - truth.total_flux).abs() <= width * error);
        }
    }
    within
}

/// Seeds of totals. Where tests of many cases take turns, they are fewer, and their bounds are wider.
fn num_seeds() -> u64 {
    if zoo::turn().is_none() { 2000 } else { 700 }
}

#[test]
fn intervals_of_totals_hold_the_converged_value() {
    const NUM_RAYS: u64 = 500;
    const CONVERGED: u64 = 200_000;
    let num_seeds = num_seeds();
    for name in zoo::in_turn(["bench_lens", "tessar_gaussian_beams"]) {
        let ir = zoo::load(name);
        let converged = converged(&ir, CONVERGED);
        let options = options(NUM_RAYS, 0, Precision::F32);
        let within = coverage_of_totals(&ir, &options, &converged, Z95, num_seeds);
        println!("{name}: {within:?} of {num_seeds}");
        for (detector, &within) in within.iter().enumerate() {
            // A detector that is hit, or missed, too seldom has no normal distribution yet.
            let share = converged.detectors[detector].num_rays_hit as f64 / CONVERGED as f64;
            let nominal = if name == "bench_lens" { coverage_of_counts(NUM_RAYS, share) } else { 0.95 };
            if share > 0.1 && share < 0.95 {
                assert!(
                    binomial_bounds(num_seeds, nominal).contains(&within),
                    "{name}, detector {detector}: {within} where {nominal} is expected"
                );
            }
        }
    }
}

#[test]
fn intervals_of_totals_of_sobol_points_hold_the_converged_value() {
    let (ir, num_seeds) = (zoo::load("bench_lens"), num_seeds());
    let options = sobol(4096, 0, Precision::F32);
    let converged = zoo::result(&ir, &sobol(1 << 22, 1 << 40, Precision::F32));
    let within = coverage_of_totals(&ir, &options, &converged, t95(), num_seeds);
    println!("{within:?} of {num_seeds}");
    for (detector, within) in within.into_iter().enumerate() {
        assert!(binomial_bounds(num_seeds, 0.95).contains(&within), "detector {detector}: {within}");
    }
}

#[test]
fn intervals_of_pixels_of_sobol_points_hold_the_converged_value() {
    let scenes = [("bench_cavity", 16, 40_000, 60), ("lambertian_sphere", 3, 20_000, 400)];
    for (name, num, num_rays, num_seeds) in zoo::in_turn(scenes) {
        for splat in [Splat::Hard, Splat::Bilinear] {
            let mut ir = coarse(name, num, Some(splat));
            ir.detectors.retain(|detector| detector.absorb || name == "bench_cavity");
            if name == "bench_cavity" {
                ir.detectors[0].absorb = true;
                ir.surfaces.clear();
            }
            let converged = zoo::result(&ir, &sobol(64 * num_rays, 1 << 40, Precision::F32));
            let mut tracer = zoo::tracer(&ir, &sobol(num_rays, 0, Precision::F32)).unwrap();
            let covered = coverage(&ir, &converged, t95(), zoo::tallies_of(&mut tracer, 0..num_seeds));
            assert_is_95_percent(&format!("{name}, {splat:?}"), covered);
        }
    }
}

/// The moments of every primary ray, seen alone: what the device must have summed.
#[test]
fn squares_are_those_of_whole_rays() {
    let weight = |quanta: u128| quanta as f64 / 2_f64.powi(52);
    for (name, num, splat) in [
        ("bench_cavity", 1, Splat::Hard),
        ("bench_cavity", 3, Splat::Bilinear),
        ("bench_cavity", 3, Splat::Gaussian { sigma: 0.7 }),
        ("ball_lens_ghosts", 3, Splat::Hard),
        ("bench_lens", 5, Splat::Bilinear),
        ("bench_lens", 5, Splat::Gaussian { sigma: 1.0 }),
    ] {
        let ir = coarse(name, num, Some(splat));
        let rays = blocks(&ir, 1, 200);
        let mut whole = Tally::zeros(&ir);
        rays.iter().for_each(|ray| whole += ray);
        for (index, detector) in whole.detectors.iter().enumerate() {
            let of_rays = |value: &dyn Fn(&Tally) -> u128| -> f64 {
                rays.iter().map(|ray| weight(value(ray)).powi(2)).sum()
            };
            assert_eq!(detector.squares.len(), detector.quanta.len());
            for (cell, &squares) in detector.squares.iter().enumerate() {
                let expected = of_rays(&|ray| ray.detectors[index].quanta[cell]);
                let difference = (weight(squares) - expected).abs();
                assert!(
                    difference <= 2e-5 * expected + 1e-9,
                    "{name} {splat:?} cell {cell}: {difference:e} of {expected}"
                );
            }
            let expected = of_rays(&|ray| ray.detectors[index].total().quanta);
            let found = weight(detector.totals[0].squares);
            assert!((found - expected).abs() <= 2e-5 * expected, "{name} {splat:?}: {found} for {expected}");
        }
    }
}

/// Beyond eight visits of a ray, what is said of its square is more than the truth, and never less.
#[test]
fn many_visits_are_bounded_from_above() {
    let ir = coarse("bench_cavity", 1, Some(Splat::Hard));
    let weight = |quanta: u128| quanta as f64 / 2_f64.powi(52);
    let options = TraceOptions { max_depth: 64, ..options(1, 0, Precision::F64) };
    let tally = zoo::trace(&ir, &options);
    let detector = &tally.detectors[0];
    assert!(detector.hits[0] > 16, "{} visits", detector.hits[0]);
    let (square, bound) = (weight(detector.quanta[0]).powi(2), weight(detector.squares[0]));
    assert!(square <= bound * (1.0 + 1e-12) && bound < 1.001 * square, "{square} and {bound}");
}

/// Of many visits to several detectors, what is said of a detector's total is the truth, and of its cells never less.
#[test]
fn squares_of_totals_are_exact_whatever_the_visits() {
    let mut family = coarse("split_ghosts", 3, Some(Splat::Hard));
    family.sampling = Sampling { split_depth: 6, split_budget: 8.0, ..family.sampling };
    // Twelve detectors, one behind the other.
    let mut row = coarse("bench_lens", 1, Some(Splat::Hard));
    let last = row.detectors[0].clone();
    row.detectors = vec![last; 12];
    for (detector, before_last) in row.detectors.iter_mut().rev().zip(0_u32..) {
        detector.name = format!("{before_last} before the last");
        detector.frame.origin.z -= 0.05 * f64::from(before_last);
        detector.absorb = before_last == 0;
    }
    let weight = |quanta: u128| quanta as f64 / 2_f64.powi(52);
    for (name, ir) in [("family", family), ("row", row)] {
        let rays = blocks(&ir, 1, 200);
        let visits = |ray: &Tally| ray.detectors.iter().map(|detector| detector.total().count).sum::<u64>();
        assert!(rays.iter().any(|ray| visits(ray) > 8), "{name}: all visits are remembered");
        let mut whole = Tally::zeros(&ir);
        rays.iter().for_each(|ray| whole += ray);
        for (index, detector) in whole.detectors.iter().enumerate() {
            let of_rays = |value: &dyn Fn(&Tally) -> u128| -> f64 {
                rays.iter().map(|ray| weight(value(ray)).powi(2)).sum()
            };
            let expected = of_rays(&|ray| ray.detectors[index].total().quanta);
            let found = weight(detector.totals[0].squares);
            assert!((found - expected).abs() <= 2e-5 * expected, "{name} {index}: {found} for {expected}");
            for (cell, &squares) in detector.squares.iter().enumerate() {
                let expected = of_rays(&|ray| ray.detectors[index].quanta[cell]);
                let found = weight(squares);
                assert!(
                    found >= (1.0 - 2e-5) * expected,
                    "{name} {index}, cell {cell}: {found} for {expected}"
                );
            }
        }
    }
}

#[test]
fn what_errors_are_made_from_has_the_same_bits_however_it_is_summed() {
    for name in ["bench_cavity", "tessar_gaussian_beams", "kaleidoscope", "filter_stack", "split_ghosts"] {
        let ir = zoo::load(name);
        for options in [options(10_000, 3, Precision::F32), sobol(10_000, 3, Precision::F32)] {
            let whole = zoo::trace(&ir, &options);
            let are_there =
                |detector: &DetectorTally| detector.totals.is_empty() != detector.replicates.is_empty();
            assert!(whole.detectors.iter().all(are_there));
            let batches = TraceOptions { batch_size: Some(777), workgroup_size: 32, ..options.clone() };
            assert!(zoo::trace(&ir, &batches) == whole, "{name}: other bits in other batches");
            assert!(
                zoo::trace_on(zoo::portable_gpu(), &ir, &options) == whole,
                "{name}: other bits, portable"
            );
        }
    }
}

/// Each scramble's sums add up to the detector's, and a trace is the sum of its parts wherever it is cut.
#[test]
fn scrambles_add_up_to_the_whole() {
    for name in ["bench_lens", "tessar_gaussian_beams", "cemented_achromat_auto", "split_ghosts"] {
        let ir = zoo::load(name);
        let options = TraceOptions { of_rays: Some(10_000), ..sobol(10_000, 3, Precision::F32) };
        let whole = zoo::trace(&ir, &options);
        for detector in &whole.detectors {
            let num_cells = detector.quanta.len().max(1);
            assert_eq!(detector.replicates.len(), num_cells * NUM_REPLICATES as usize);
            assert_eq!(detector.replicates.iter().sum::<u128>(), detector.total().quanta);
            for (cell, &quanta) in detector.quanta.iter().enumerate() {
                assert_eq!(detector.replicates.iter().skip(cell).step_by(num_cells).sum::<u128>(), quanta);
            }
        }
        let mut sum = Tally::zeros(&ir);
        for (first_ray, end) in [(0, 17), (17, 3333), (3333, 10_000)] {
            let part = TraceOptions { first_ray, num_rays: end - first_ray, ..options.clone() };
            sum += &zoo::tracer(&ir, &part).unwrap().trace(|_| true).unwrap();
        }
        sum.sort_rows(&ir);
        assert!(sum == whole, "{name}: the parts are not the whole");
    }
}

/// Mean square of the deviations between the totals of so many seeds, and mean square of their errors.
fn variances_of_totals(ir: &SceneIr, options: &TraceOptions, num_seeds: u64) -> (f64, Option<f64>) {
    let mut tracer = zoo::tracer(ir, options).unwrap();
    let results: Vec<TraceResult> =
        zoo::tallies_of(&mut tracer, 0..num_seeds).map(|tally| result_of(ir, &tally)).collect();
    let n = num_seeds as f64;
    let totals = || results.iter().map(|result| result.detectors[0].total_flux);
    let mean = totals().sum::<f64>() / n;
    let found = totals().map(|total| (total - mean).powi(2)).sum::<f64>() / (n - 1.0);
    let errors = results.iter().map(|result| result.detectors[0].total_flux_standard_error);
    (found, errors.map(|error| error.map(|error| error.powi(2) / n)).sum())
}

/// What the error of a trace is estimated to be is that between traces of other seeds; of Sobol points it is smaller, and
/// smaller still where they need not tell it.
#[test]
fn errors_are_those_between_seeds() {
    let num_seeds = if zoo::turn().is_none() { 400 } else { 160 };
    let ir = zoo::load("bench_lens");
    let off = TraceOptions { standard_error: StandardError::Off, ..sobol(1 << 14, 0, Precision::F32) };
    let all = [options(1 << 14, 0, Precision::F32), sobol(1 << 14, 0, Precision::F32), off];
    let [random, scrambles, whole] = all.map(|options| variances_of_totals(&ir, &options, num_seeds));
    println!("W^2: random numbers {random:?}, scrambles {scrambles:?}, whole {whole:?}");
    for (found, estimated) in [random, scrambles] {
        // The variance of a sample of 400 is known to sqrt(2/399) = 7 %, of 160 to 11 %: five times that.
        let most = 5.0 * (2.0 / (num_seeds as f64 - 1.0)).sqrt();
        assert!((estimated.unwrap() / found - 1.0).abs() < most, "{found} and {estimated:?}");
    }
    assert!(whole.1.is_none());
    assert!(whole.0 < scrambles.0 && scrambles.0 < 0.1 * random.0);
}

#[test]
fn sobol_points_tell_errors_only_where_asked() {
    let ir = coarse("bench_lens", 4, Some(Splat::Hard));
    for (asked, expected) in
        [(StandardError::On, true), (StandardError::Auto, false), (StandardError::Off, false)]
    {
        let options = TraceOptions { standard_error: asked, ..sobol(1000, 0, Precision::F32) };
        let result = zoo::result(&ir, &options);
        let known = result.detectors.iter().all(|detector| detector.total_flux_standard_error.is_some());
        assert_eq!(known, expected, "{asked:?}");
    }
}

#[test]
fn first_moments_are_the_same_bits_without_second_ones() {
    for name in ["bench_cavity", "tessar_gaussian_beams", "kaleidoscope", "filter_stack"] {
        let ir = zoo::load(name);
        let options = options(10_000, 3, Precision::F64);
        let mut with = zoo::trace(&ir, &options);
        let without =
            zoo::trace(&ir, &TraceOptions { standard_error: StandardError::Off, ..options.clone() });
        for detector in &mut with.detectors {
            detector.squares.clear();
            detector.totals.clear();
        }
        assert!(with == without, "{name}: the maps differ");
        let result = zoo::result_of(&ir, &options, &without);
        assert!(result.detectors.iter().all(|detector| detector.total_flux_standard_error.is_none()));
    }
}

/// A scattering table whose values are far too high multiplies weights: their squares leave what sums can hold, one by one
/// or all together. The device notices both.
#[test]
fn squares_that_no_sum_can_hold_are_not_given_as_errors() {
    let brightened = |factor: f64| {
        let mut ir = zoo::load("coated_projector");
        let mut num_tables = 0;
        for scatter in ir.surfaces.iter_mut().filter_map(|surface| surface.scatter.as_mut()) {
            if let Bsdf::Tabulated(Tabulated { table, .. }) = &mut scatter.bsdf {
                table.values.iter_mut().for_each(|value| *value *= factor);
                num_tables += 1;
            }
        }
        assert!(num_tables > 0);
        ir
    };
    for precision in [Precision::F32, Precision::F64] {
        for (factor, overflows) in [(10.0, false), (1e6, true), (1e9, true)] {
            let ir = brightened(factor);
            let options = options(20_000, 0, precision);
            for gpu in [zoo::gpu(), zoo::portable_gpu()] {
                let tally = zoo::trace_on(gpu, &ir, &options);
                let largest = tally.detectors.iter().map(|detector| detector.total().quanta).max().unwrap();
                println!("{factor:e}: {:e} units on a detector", largest as f64 / 2_f64.powi(52));
                assert_eq!(tally.moments_overflowed, overflows, "{factor:e}, {precision:?}");
                let result = zoo::result_of(&ir, &options, &tally);
                let unknown = |detector: &nsq_gpu::result::Detector| {
                    detector.total_flux_standard_error.unwrap().is_nan()
                        && detector.total_flux_relative_error().is_none_or(f64::is_nan)
                };
                assert_eq!(result.detectors.iter().all(unknown), overflows);
                assert_eq!(result.relative_error.is_none(), overflows);
            }
        }
    }
}

/// Without being asked for, standard errors are there where they cost little.
#[test]
fn standard_errors_come_by_themselves_where_rays_end_in_one_cell() {
    let has_errors = |ir: &SceneIr| {
        let result = zoo::result(ir, &zoo::options(1000, 0, Precision::F32));
        result.detectors.iter().all(|detector| detector.total_flux_standard_error.is_some())
    };
    for (splat, expected) in
        [(Splat::Hard, true), (Splat::Bilinear, false), (Splat::Gaussian { sigma: 1.0 }, false)]
    {
        assert_eq!(has_errors(&coarse("bench_lens", 4, Some(splat))), expected, "{splat:?}");
    }
    assert!(has_errors(&coarse("tessar_gaussian_beams", 4, Some(Splat::Hard))));
    assert!(!has_errors(&coarse("bench_cavity", 4, Some(Splat::Hard))), "rays pass this one");
}
