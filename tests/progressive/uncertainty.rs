//! Standard errors mean what they say: intervals hold what they should hold, as often as they should.

use crate::zoo;
use nsq_gpu::ir::{ReflectProb, SceneIr, SensorKind, Splat};
use nsq_gpu::program::Precision;
use nsq_gpu::result::{DetectorData, RaySet, RaySpan, RunInfo, Tally, TraceResult};
use nsq_gpu::{TraceOptions, Tracer};
use statrs::distribution::{Binomial, Discrete, DiscreteCDF};

/// Half the width of the interval that holds a normal variable with a probability of 95 %, in standard deviations.
const Z95: f64 = 1.959963984540054;

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

/// A scene whose detectors have few pixels, so that many rays hit each.
fn coarse(name: &str, num: u32, splat: Option<Splat>) -> SceneIr {
    let mut ir = zoo::load(name);
    for sensor in &mut ir.sensors {
        match &mut sensor.kind {
            SensorKind::Irradiance(grid) | SensorKind::Spectral { grid, .. } => {
                (grid.num_pixels_x, grid.num_pixels_y) = (num, num);
                grid.splat = splat.unwrap_or(grid.splat);
            }
            SensorKind::FarField { num_theta, num_phi } => (*num_theta, *num_phi) = (num, num),
            SensorKind::RayDatabase { .. } => {}
        }
    }
    ir
}

/// Tallies of blocks of `num_rays` rays each, one after the other of one trace: as independent as traces of other seeds,
/// because draws are keyed by the ray, and with no shader to compile for each.
fn blocks(ir: &SceneIr, num_rays: u64, num_blocks: u64) -> Vec<Tally> {
    let options = TraceOptions {
        batch_size: Some(num_rays as u32),
        ..zoo::options(num_rays * num_blocks, 7, Precision::F32)
    };
    let mut tracer = Tracer::new(zoo::gpu(), ir, &options).unwrap();
    let mut before = tracer.empty_tally();
    let mut blocks = Vec::new();
    tracer.pause_at(num_rays);
    let all = tracer.go_on(before.clone(), |progress| {
        assert_eq!(progress.position() % num_rays, 0);
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
    block.rays = RaySet::default();
    for span in later.rays.spans() {
        let emitter = span.emitter;
        let done = earlier.rays.count_of(emitter as usize);
        block.rays += RaySpan { first: span.first + done, count: span.count - done, emitter };
    }
    for (sensor, before) in block.sensors.iter_mut().zip(&earlier.sensors) {
        let minus = |sums: &mut Vec<u128>, before: &[u128]| {
            sums.iter_mut().zip(before).for_each(|(sum, before)| *sum -= before);
        };
        // Squares are there from the first drain on.
        minus(&mut sensor.quanta, &before.quanta);
        minus(&mut sensor.squares, &before.squares);
        sensor.hits.iter_mut().zip(&before.hits).for_each(|(sum, before)| *sum -= before);
        for (total, before) in sensor.totals.iter_mut().zip(&before.totals) {
            total.quanta -= before.quanta;
            total.squares -= before.squares;
        }
        sensor.recorded.count -= before.recorded.count;
        sensor.recorded.quanta -= before.recorded.quanta;
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
    zoo::result(ir, &zoo::options(num_rays, 1 << 40, Precision::F32))
}

/// How many of the cells with at least 100 hits, pooled over blocks of rays, lie within their 95 % interval about the
/// converged value; and how many there were.
fn coverage(ir: &SceneIr, num_rays: u64, num_blocks: u64) -> (u64, u64) {
    let converged = converged(ir, 64 * num_rays);
    let (mut within, mut all) = (0, 0);
    for block in blocks(ir, num_rays, num_blocks) {
        let result = result_of(ir, &block);
        for detector in 0..ir.sensors.len() {
            let truth = cells(&converged, detector);
            for ((value, error, hits), (truth, truth_error, _)) in cells(&result, detector).iter().zip(truth)
            {
                if *hits >= 100 {
                    all += 1;
                    within += u64::from((value - truth).abs() <= Z95 * error.hypot(truth_error));
                }
            }
        }
    }
    (within, all)
}

fn assert_covers(what: &str, ir: &SceneIr, num_rays: u64, num_blocks: u64) {
    let (within, all) = coverage(ir, num_rays, num_blocks);
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
        ir.sensors[0].absorb = true;
        ir.surfaces.clear();
        ir
    };
    assert_covers("hard", &disk(Some(Splat::Hard)), 15_000, 120);
    assert_covers("bilinear", &disk(Some(Splat::Bilinear)), 15_000, 120);
    assert_covers("Gaussian", &disk(gaussian), 15_000, 120);
    // The port of a sphere, after many lossy reflections and roulette.
    let mut port = coarse("lambertian_sphere", 3, None);
    port.sensors.retain(|sensor| sensor.absorb);
    assert_covers("losses and roulette", &port, 10_000, 500);
}

/// Sources that light cells unequally are pooled there: the interval is then too wide, and never too narrow.
#[test]
fn intervals_of_pixels_that_sources_light_unequally_are_not_too_narrow() {
    let (within, all) = coverage(&coarse("tessar_gaussian_beams", 10, None), 5_000, 100);
    println!("several sources: {within} of {all} cells");
    assert!(all >= 400 && within as f64 >= 0.94 * all as f64, "{within} of {all}");
}

#[test]
fn intervals_hold_where_rays_come_by_a_pixel_several_times() {
    // A transmissive detector in a cavity: no deposit is independent of the ray's others.
    for splat in [Splat::Hard, Splat::Bilinear, Splat::Gaussian { sigma: 0.7 }] {
        let ir = coarse("bench_cavity", 4, Some(splat));
        assert!(!ir.sensors[0].absorb);
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

#[test]
fn intervals_of_totals_hold_the_converged_value() {
    const BLOCKS: u64 = 2000;
    const NUM_RAYS: u64 = 500;
    const CONVERGED: u64 = 200_000;
    for name in ["bench_lens", "tessar_gaussian_beams"] {
        let ir = zoo::load(name);
        let converged = converged(&ir, CONVERGED);
        let mut within = vec![0; ir.sensors.len()];
        for block in blocks(&ir, NUM_RAYS, BLOCKS) {
            let result = result_of(&ir, &block);
            for ((found, truth), within) in result.detectors.iter().zip(&converged.detectors).zip(&mut within)
            {
                let error = found.total_flux_standard_error.unwrap();
                let error = error.hypot(truth.total_flux_standard_error.unwrap());
                *within += u64::from((found.total_flux - truth.total_flux).abs() <= Z95 * error);
            }
        }
        println!("{name}: {within:?} of {BLOCKS}");
        for (detector, &within) in within.iter().enumerate() {
            // A detector that is hit, or missed, too seldom has no normal distribution yet.
            let share = converged.detectors[detector].num_rays_hit as f64 / CONVERGED as f64;
            let nominal = if name == "bench_lens" { coverage_of_counts(NUM_RAYS, share) } else { 0.95 };
            if share > 0.1 && share < 0.95 {
                assert!(
                    binomial_bounds(BLOCKS, nominal).contains(&within),
                    "{name}, detector {detector}: {within} where {nominal} is expected"
                );
            }
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
        for (index, sensor) in whole.sensors.iter().enumerate() {
            let of_rays = |value: &dyn Fn(&Tally) -> u128| -> f64 {
                rays.iter().map(|ray| weight(value(ray)).powi(2)).sum()
            };
            assert_eq!(sensor.squares.len(), sensor.quanta.len());
            for (cell, &squares) in sensor.squares.iter().enumerate() {
                let expected = of_rays(&|ray| ray.sensors[index].quanta[cell]);
                let difference = (weight(squares) - expected).abs();
                assert!(
                    difference <= 2e-5 * expected + 1e-9,
                    "{name} {splat:?} cell {cell}: {difference:e} of {expected}"
                );
            }
            let expected = of_rays(&|ray| ray.sensors[index].total().quanta);
            let found = weight(sensor.totals[0].squares);
            assert!((found - expected).abs() <= 2e-5 * expected, "{name} {splat:?}: {found} for {expected}");
        }
    }
}

/// Beyond eight visits of a ray, what is said of its square is more than the truth, and never less.
#[test]
fn many_visits_are_bounded_from_above() {
    let ir = coarse("bench_cavity", 1, Some(Splat::Hard));
    let weight = |quanta: u128| quanta as f64 / 2_f64.powi(52);
    let options = TraceOptions { max_depth: 64, ..zoo::options(1, 0, Precision::F64) };
    let tally = zoo::trace(&ir, &options);
    let sensor = &tally.sensors[0];
    assert!(sensor.hits[0] > 16, "{} visits", sensor.hits[0]);
    let (square, bound) = (weight(sensor.quanta[0]).powi(2), weight(sensor.squares[0]));
    assert!(square <= bound * (1.0 + 1e-12) && bound < 1.001 * square, "{square} and {bound}");
}

#[test]
fn sums_of_squares_have_the_same_bits_however_they_are_summed() {
    for name in ["bench_cavity", "tessar_gaussian_beams", "kaleidoscope", "filter_stack"] {
        let ir = zoo::load(name);
        let options = zoo::options(10_000, 3, Precision::F32);
        let whole = zoo::trace(&ir, &options);
        assert!(whole.sensors.iter().all(|sensor| !sensor.totals.is_empty()));
        let batches = TraceOptions { batch_size: Some(777), workgroup_size: 32, ..options.clone() };
        assert!(zoo::trace(&ir, &batches) == whole, "{name}: other bits in other batches");
        assert!(zoo::trace_on(zoo::portable_gpu(), &ir, &options) == whole, "{name}: other bits, portable");
    }
}

#[test]
fn first_moments_are_the_same_bits_without_second_ones() {
    for name in ["bench_cavity", "tessar_gaussian_beams", "kaleidoscope", "filter_stack"] {
        let ir = zoo::load(name);
        let options = zoo::options(10_000, 3, Precision::F64);
        let mut with = zoo::trace(&ir, &options);
        let without = zoo::trace(&ir, &TraceOptions { standard_error: false, ..options.clone() });
        for sensor in &mut with.sensors {
            sensor.squares.clear();
            sensor.totals.clear();
        }
        assert!(with == without, "{name}: the maps differ");
        let result = zoo::result_of(&ir, &options, &without);
        assert!(result.detectors.iter().all(|detector| detector.total_flux_standard_error.is_none()));
    }
}

/// Reflection drawn almost never, or almost always, multiplies weights by up to 1e12 a surface: their squares leave what
/// sums can hold.
#[test]
fn squares_that_no_sum_can_hold_are_not_given_as_errors() {
    let mut ir = zoo::load("ball_lens_ghosts");
    for (weight_grows, probability) in [(false, 0.3), (true, 1.0 - 1e-9)] {
        ir.sampling.reflect_prob = ReflectProb::Constant(probability);
        // At so high a probability only chance transmits: enough rays for a few to do so.
        ir.emitters[0].total_flux = 1.0;
        let options = TraceOptions { standard_error: true, ..zoo::options(1000, 0, Precision::F64) };
        let mut tally = zoo::trace(&ir, &options);
        tally.moments_overflowed |= weight_grows;
        let result = zoo::result_of(&ir, &options, &tally);
        let unknown = |detector: &nsq_gpu::result::Detector| {
            detector.total_flux_standard_error.unwrap().is_nan()
                && detector.total_flux_relative_error().is_none_or(f64::is_nan)
        };
        assert_eq!(result.detectors.iter().all(unknown), weight_grows);
        assert_eq!(result.relative_error.is_none(), weight_grows);
    }
}
