//! What must not change a result, and what must change it in a known way.
#![allow(clippy::unwrap_used, clippy::panic, reason = "clippy's exemption of tests does not reach their helpers")]

mod zoo;

use std::collections::BTreeMap;

use glam::{DMat3, DVec3};
use nsq_gpu::TraceOptions;
use nsq_gpu::ir::{
    Emitter, EmitterKind, Frame, Interaction, Medium, Outline, ReflectProb, Sampling, SceneIr, Sensor, SensorKind,
    Shape, Spectrum, Surface,
};
use nsq_gpu::program::Precision;
use nsq_gpu::result::{Booking, Tally};
use statrs::distribution::{ChiSquared, ContinuousCDF};

const PRECISIONS: [Precision; 2] = [Precision::F32, Precision::F64];

/// Mirrors with roulette, absorbing media born in, Gaussian splats, a ray database with several sources, spectral bins
/// with a capped database, far fields, deep paths.
const DIVERSE: [&str; 7] = [
    "kaleidoscope",
    "nested_media",
    "tessar_gaussian_beams",
    "filter_stack",
    "telephoto_spectral",
    "erfle_eyepiece",
    "stacked_plates_ghosts",
];

// The same bits.

/// Asserts that two ways to trace some rays give equal tallies, over the diverse scenes and both precisions.
fn assert_same_bits(num_rays: u64, change: impl Fn(&mut TraceOptions)) {
    for name in DIVERSE {
        let ir = zoo::load(name);
        for precision in PRECISIONS {
            let options = zoo::options(num_rays, 11, precision);
            let mut changed = options.clone();
            change(&mut changed);
            let same = zoo::trace(&ir, &options) == zoo::trace(&ir, &changed);
            assert!(same, "{name} in {precision:?}: other bits with {changed:?}");
        }
    }
}

#[test]
fn a_second_run_gives_the_same_bits() {
    assert_same_bits(5000, |_| ());
}

#[test]
fn batches_of_1000_rays_give_the_same_bits() {
    assert_same_bits(20_000, |options| options.batch_size = Some(1000));
}

#[test]
fn batches_of_16384_rays_give_the_same_bits() {
    assert_same_bits(20_000, |options| options.batch_size = Some(16_384));
}

#[test]
fn batches_of_a_million_rays_give_the_same_bits() {
    assert_same_bits(20_000, |options| options.batch_size = Some(1_000_000));
}

#[test]
fn workgroups_of_32_128_and_256_give_the_same_bits_as_of_64() {
    for size in [32, 128, 256] {
        assert_same_bits(3000, |options| options.workgroup_size = size);
    }
}

#[test]
fn dispatches_of_1_2_and_5_events_give_the_same_bits_as_of_16() {
    for events in [1, 2, 5] {
        assert_same_bits(3000, |options| options.events_per_dispatch = events);
    }
}

#[test]
fn pairs_of_32_bit_integers_give_the_same_bits_as_64_bit_ones() {
    assert!(zoo::gpu().int64, "lavapipe has 64-bit integers");
    assert!(!zoo::portable_gpu().int64);
    for name in DIVERSE {
        let ir = zoo::load(name);
        for precision in PRECISIONS {
            let options = zoo::options(3000, 11, precision);
            let portable = zoo::trace_on(zoo::portable_gpu(), &ir, &options);
            assert!(zoo::trace(&ir, &options) == portable, "{name} in {precision:?}: other bits");
        }
    }
}

#[test]
fn a_trace_that_stops_early_is_the_first_rays_of_the_whole() {
    for name in ["nested_media", "kaleidoscope"] {
        let ir = zoo::load(name);
        let options =
            TraceOptions { batch_size: Some(1000), ..zoo::options(50_000, 11, Precision::F64) };
        let mut tracer = nsq_gpu::Tracer::new(zoo::gpu(), &ir, &options).unwrap();
        let begun = tracer.trace(|_| false).unwrap();
        assert!(begun.launched.count < options.num_rays, "{name}: the trace stops early");
        assert!(tracer.trace(|_| true).unwrap() == zoo::trace(&ir, &options), "{name}: a tracer starts afresh");
        let mut whole = zoo::trace(&ir, &options);
        let before = whole.clone();
        whole += &begun;
        assert_eq!(whole.launched.count, before.launched.count + begun.launched.count);
        assert_eq!(whole.launched.quanta, before.launched.quanta + begun.launched.quanta);
    }
}

#[test]
fn another_seed_gives_other_bits() {
    for name in DIVERSE {
        let ir = zoo::load(name);
        let tallies = [1, 2].map(|seed| zoo::trace(&ir, &zoo::options(3000, seed, Precision::F32)));
        assert!(tallies[0] != tallies[1], "{name}");
    }
}

#[test]
fn f32_and_f64_give_other_bits() {
    for name in DIVERSE {
        let ir = zoo::load(name);
        let tallies = PRECISIONS.map(|precision| zoo::trace(&ir, &zoo::options(3000, 1, precision)));
        assert!(tallies[0] != tallies[1], "{name}: f32 was traced in f64, or f64 in f32");
    }
}

// Scenes compiled in or in tables.

/// The largest difference of two tallies of one scene, in units of the largest cell of the sensor or of the weight
/// launched; infinite where a count differs.
fn deviation(ours: &Tally, theirs: &Tally) -> f64 {
    if counts(ours) != counts(theirs) {
        return f64::INFINITY;
    }
    let launched = theirs.launched.quanta as f64;
    let totals = bookings(ours).zip(bookings(theirs));
    let totals = totals.map(|(mine, other)| mine.quanta.abs_diff(other.quanta) as f64 / launched);
    let maps = ours.sensors.iter().zip(&theirs.sensors).flat_map(|(mine, other)| {
        let peak = other.quanta.iter().copied().max().unwrap_or(0).max(1) as f64;
        mine.quanta.iter().zip(&other.quanta).map(move |(mine, other)| mine.abs_diff(*other) as f64 / peak)
    });
    totals.chain(maps).fold(0.0, f64::max)
}

fn bookings(tally: &Tally) -> impl Iterator<Item = Booking> {
    let whole = [
        tally.launched,
        tally.escaped,
        tally.depth_killed,
        tally.roulette_loss,
        tally.roulette_gain,
        tally.bulk,
        tally.importance_loss,
        tally.importance_gain,
    ];
    let surfaces = tally.surfaces.iter().map(|surface| surface.absorbed);
    whole.into_iter().chain(surfaces).chain(tally.sensors.iter().map(|sensor| sensor.total()))
}

/// Every count: of bookings, of hits in each cell, of surfaces reached, of underflows.
fn counts(tally: &Tally) -> Vec<u64> {
    let bookings = bookings(tally).map(|booking| booking.count);
    let hits = tally.sensors.iter().flat_map(|sensor| sensor.hits.iter().copied());
    let reached = tally.surfaces.iter().map(|surface| u64::from(surface.reached));
    let rest = [tally.medium_stack_underflows, tally.invalid_deposits];
    bookings.chain(hits).chain(reached).chain(rest).collect()
}

#[test]
fn scenes_in_tables_agree_with_scenes_compiled_in() {
    for name in zoo::scenes() {
        let ir = zoo::load(&name);
        let options = zoo::options(3000, 2, Precision::F64);
        let [baked, tables] = [true, false]
            .map(|baked| zoo::trace(&ir, &TraceOptions { baked: Some(baked), ..options.clone() }));
        let deviation = deviation(&tables, &baked);
        eprintln!("{name:28} {deviation:.1e}");
        let limit = if name == "mirror_ball_billiard" { 1e-6 } else { 1e-12 };
        assert!(deviation <= limit, "{name}: {deviation:e}");
    }
}

#[test]
fn a_count_or_a_bin_that_differs_is_told() {
    let tally = zoo::trace(&zoo::load("bench_lens"), &zoo::options(3000, 2, Precision::F64));
    assert_eq!(deviation(&tally, &tally), 0.0);
    let mut other = tally.clone();
    other.sensors[0].hits[7] += 1;
    assert_eq!(deviation(&other, &tally), f64::INFINITY);
    let mut other = tally.clone();
    let peak = tally.sensors[0].quanta.iter().copied().max().unwrap();
    other.sensors[0].quanta[7] += 2 * peak / 1_000_000_000_000;
    assert!(deviation(&other, &tally) > 1e-12);
    let mut other = tally.clone();
    other.escaped.quanta += tally.launched.quanta / 100_000_000_000;
    assert!(deviation(&other, &tally) > 1e-12);
}

// Scaling and motion.

#[test]
fn maps_scale_with_the_flux_of_the_sources() {
    for name in ["filter_stack", "tessar_gaussian_beams", "nested_media"] {
        let ir = zoo::load(name);
        let options = zoo::options(3000, 3, Precision::F64);
        let plain = zoo::result(&ir, &options);
        for scale in [1e30, 1e-30] {
            let mut scaled = ir.clone();
            scaled.emitters.iter_mut().for_each(|emitter| emitter.total_flux *= scale);
            let scaled = zoo::result(&scaled, &options);
            let deviation = scaled_deviation(&plain, &scaled, scale);
            assert!(deviation <= 1e-13, "{name} times {scale:e}: {deviation:e}");
            assert!(scaled_deviation(&plain, &scaled, scale * (1.0 + 1e-12)) > 1e-13, "the comparison is blind");
        }
    }
}

/// Largest deviation of the totals and of every detector's flux and map from `scale` times the plain ones.
fn scaled_deviation(plain: &nsq_gpu::TraceResult, scaled: &nsq_gpu::TraceResult, scale: f64) -> f64 {
    let relative = |mine: f64, other: f64, unit: f64| (mine / scale - other).abs() / unit;
    let launched = plain.total_flux_in;
    let mut worst = relative(scaled.total_flux_detected, plain.total_flux_detected, launched)
        .max(relative(scaled.total_flux_escaped, plain.total_flux_escaped, launched));
    for (mine, other) in scaled.detectors.iter().zip(&plain.detectors) {
        assert_eq!(mine.num_rays_hit, other.num_rays_hit, "{}", other.name);
        worst = worst.max(relative(mine.total_flux, other.total_flux, launched));
        let peak = values(other).into_iter().fold(1e-300, f64::max);
        let bins = values(mine).into_iter().zip(values(other));
        worst = bins.map(|(mine, other)| relative(mine, other, peak)).fold(worst, f64::max);
    }
    worst
}

/// The bins of a map, or the fluxes of rows.
fn values(detector: &nsq_gpu::result::Detector) -> Vec<f64> {
    use nsq_gpu::result::DetectorData;
    match &detector.data {
        DetectorData::Irradiance(map) => map.irradiance.iter().copied().collect(),
        DetectorData::Spectral(map) => map.irradiance.iter().copied().collect(),
        DetectorData::FarField(map) => map.intensity.iter().copied().collect(),
        DetectorData::RayDatabase(rays) => rays.flux.to_vec(),
    }
}

/// The scene turned about an axis of no symmetry, then shifted.
fn moved(ir: &SceneIr, rotation: DMat3, shift: DVec3) -> SceneIr {
    let mut ir = ir.clone();
    let move_frame = |frame: &mut Frame| {
        *frame = Frame { origin: rotation * frame.origin + shift, rotation: rotation * frame.rotation };
    };
    ir.surfaces.iter_mut().for_each(|surface| move_frame(&mut surface.frame));
    ir.emitters.iter_mut().for_each(|emitter| move_frame(&mut emitter.frame));
    ir.sensors.iter_mut().for_each(|sensor| move_frame(&mut sensor.frame));
    ir
}

#[test]
fn a_rigid_motion_changes_nothing() {
    let turn = DMat3::from_axis_angle(DVec3::new(1.0, -2.0, 0.5).normalize(), 0.7);
    let motions = [
        ("turned and shifted", turn, DVec3::new(30.0, -70.0, 110.0)),
        ("shifted far away", DMat3::IDENTITY, DVec3::new(1e6, -1e6, 1e6)),
    ];
    for name in DIVERSE {
        let ir = zoo::load(name);
        let options = zoo::options(10_000, 4, Precision::F64);
        let still = zoo::trace(&ir, &options);
        for (motion, rotation, shift) in motions {
            let tally = zoo::trace(&moved(&ir, rotation, shift), &options);
            let flips = count_changes(&tally, &still);
            let change = total_change(&tally, &still);
            eprintln!("{name:28} {motion}: {flips} count changes, totals {change:.1e}");
            assert_eq!(flips, 0, "{name} {motion}");
            assert!(change <= 1e-9, "{name} {motion}: {change:e}");
        }
    }
}

/// Events booked elsewhere, over all bookings.
fn count_changes(ours: &Tally, theirs: &Tally) -> u64 {
    bookings(ours).zip(bookings(theirs)).map(|(mine, other)| mine.count.abs_diff(other.count)).sum()
}

/// The largest difference of a booking, in units of the weight launched.
fn total_change(ours: &Tally, theirs: &Tally) -> f64 {
    let launched = theirs.launched.quanta as f64;
    let changes = bookings(ours).zip(bookings(theirs)).map(|(mine, other)| mine.quanta.abs_diff(other.quanta));
    changes.max().unwrap_or(0) as f64 / launched
}

#[test]
fn a_scene_whose_detector_stays_behind_is_no_rigid_motion() {
    let ir = zoo::load("erfle_eyepiece");
    let options = zoo::options(3000, 4, Precision::F64);
    let mut torn = moved(&ir, DMat3::IDENTITY, DVec3::new(1.0, 0.0, 0.0));
    torn.sensors = ir.sensors.clone();
    let (torn, still) = (zoo::trace(&torn, &options), zoo::trace(&ir, &options));
    assert!(deviation(&torn, &still) > 1e-9);
}

// The ledger.

const POLICIES: [ReflectProb; 4] =
    [ReflectProb::Fresnel, ReflectProb::Auto, ReflectProb::Constant(0.3), ReflectProb::Constant(0.02)];
/// Roulette almost never, and from four tenths of a new ray's weight on.
const ROULETTE_STARTS: [f64; 2] = [1e-3, 0.4];

fn assert_ledgers_close(precision: Precision, native: bool) {
    let gpu = if native { zoo::gpu() } else { zoo::portable_gpu() };
    for name in zoo::scenes() {
        let mut ir = zoo::load(&name);
        for (i, policy) in POLICIES.into_iter().enumerate() {
            for (j, start) in ROULETTE_STARTS.into_iter().enumerate() {
                // Half of the combinations with native integers, the other half with pairs of 32-bit ones.
                if native != ((i + j) % 2 == 0) {
                    continue;
                }
                ir.sampling.reflect_prob = policy;
                ir.sampling.rr_start_flux = start;
                let options = zoo::options(1500, 6, precision);
                let tally = zoo::trace_on(gpu, &ir, &options);
                let ledger = zoo::result_of(&ir, &options, &tally).ledger;
                let what = format!("{name}, {precision:?}, {policy:?}, roulette from {start}");
                assert_eq!(ledger.imbalance_quanta, 0, "{what}");
                assert_eq!(ledger.invalid_deposits, 0, "{what}");
            }
        }
    }
}

#[test]
fn every_ledger_closes_in_f32_with_native_integers() {
    assert_ledgers_close(Precision::F32, true);
}

#[test]
fn every_ledger_closes_in_f32_with_pairs_of_integers() {
    assert_ledgers_close(Precision::F32, false);
}

#[test]
fn every_ledger_closes_in_f64_with_native_integers() {
    assert_ledgers_close(Precision::F64, true);
}

#[test]
fn every_ledger_closes_in_f64_with_pairs_of_integers() {
    assert_ledgers_close(Precision::F64, false);
}

#[test]
fn a_single_quantum_astray_opens_the_ledger() {
    let ir = zoo::load("kaleidoscope");
    let options = zoo::options(1500, 6, Precision::F64);
    let tally = zoo::trace(&ir, &options);
    assert!(zoo::result_of(&ir, &options, &tally).ledger.closes());
    let mut other = tally.clone();
    other.roulette_gain.quanta += 1;
    assert_eq!(zoo::result_of(&ir, &options, &other).ledger.imbalance_quanta, 1);
}

// Chance.

/// Mean and the square of its standard error.
fn mean_and_variance(samples: &[f64]) -> (f64, f64) {
    let count = samples.len() as f64;
    let mean = samples.iter().sum::<f64>() / count;
    let squares: f64 = samples.iter().map(|sample| (sample - mean).powi(2)).sum();
    (mean, squares / (count - 1.0) / count)
}

/// How many standard errors two means of independent samples are apart.
fn z(a: &[f64], b: &[f64]) -> f64 {
    let ((mean_a, variance_a), (mean_b, variance_b)) = (mean_and_variance(a), mean_and_variance(b));
    (mean_a - mean_b).abs() / (variance_a + variance_b).sqrt().max(1e-300)
}

/// The flux of every detector, in independent runs.
fn fluxes(ir: &SceneIr, num_rays: u64, seeds: std::ops::Range<u64>) -> Vec<Vec<f64>> {
    let runs: Vec<nsq_gpu::TraceResult> =
        seeds.map(|seed| zoo::result(ir, &zoo::options(num_rays, seed, Precision::F64))).collect();
    let flux_of = |i: usize| runs.iter().map(|run| run.detectors[i].total_flux).collect();
    (0..ir.sensors.len()).map(flux_of).collect()
}

/// 32 runs a side; so far apart comes about by chance once in 10^4 (t of 62 degrees of freedom).
const MOST_STANDARD_ERRORS: f64 = 4.2;

#[test]
fn importance_sampling_is_unbiased() {
    for name in ["heliar_ghosts", "bench_lens", "ball_lens_ghosts"] {
        let mut ir = zoo::load(name);
        ir.sampling.reflect_prob = ReflectProb::Fresnel;
        let plain = fluxes(&ir, 4000, 0..32);
        for (i, policy) in POLICIES.into_iter().enumerate().skip(1) {
            ir.sampling.reflect_prob = policy;
            let seeds = 100 * i as u64..100 * i as u64 + 32;
            for (detector, (ours, plain)) in fluxes(&ir, 4000, seeds).iter().zip(&plain).enumerate() {
                let z = z(ours, plain);
                assert!(z < MOST_STANDARD_ERRORS, "{name}, {policy:?}, detector {detector}: {z} standard errors");
            }
        }
    }
}

#[test]
fn roulette_is_unbiased() {
    for name in ["kaleidoscope", "integrating_sphere"] {
        let mut ir = zoo::load(name);
        ir.sampling.rr_start_flux = 0.0;
        let plain = fluxes(&ir, 4000, 0..32);
        ir.sampling.rr_start_flux = 0.7;
        assert!(zoo::trace(&ir, &zoo::options(4000, 0, Precision::F64)).roulette_loss.count > 100, "{name}");
        for (detector, (ours, plain)) in fluxes(&ir, 4000, 100..132).iter().zip(&plain).enumerate() {
            let z = z(ours, plain);
            assert!(z < MOST_STANDARD_ERRORS, "{name}, detector {detector}: {z} standard errors");
        }
    }
}

#[test]
fn a_bias_of_two_percent_is_told_by_chance_tests() {
    let ir = zoo::load("bench_lens");
    let plain = fluxes(&ir, 4000, 0..32);
    let biased: Vec<f64> = fluxes(&ir, 4000, 100..132)[0].iter().map(|flux| 0.98 * flux).collect();
    assert!(z(&biased, &plain[0]) > MOST_STANDARD_ERRORS);
}

#[test]
fn the_error_falls_with_the_root_of_the_number_of_rays() {
    let (steps, runs) = ([250_u64, 1000, 4000, 16_000, 64_000], 24);
    let ir = zoo::load("bench_lens");
    let variances = steps.map(|num_rays| {
        let flux = &fluxes(&ir, num_rays, 1000 + num_rays..1000 + num_rays + runs)[0];
        mean_and_variance(flux).1 * runs as f64
    });
    let slope = slope_of_variances(&steps, &variances);
    // ln of a sample variance of n runs has a variance of about 2 / (n - 1).
    let spread = (2.0 / (runs as f64 - 1.0)).sqrt() / (4.0_f64.ln() * 10.0_f64.sqrt());
    eprintln!("the variance falls with N to the power {slope:.3} +- {spread:.3}");
    assert!((slope + 1.0).abs() < 4.0 * spread, "{slope} +- {spread}");

    let chi_squares = chi_squares(&ir, &steps, &variances, runs);
    let distribution = ChiSquared::new(runs as f64 - 1.0).unwrap();
    for (num_rays, chi_square) in steps.iter().zip(chi_squares) {
        let p = distribution.cdf(chi_square).min(distribution.sf(chi_square));
        assert!(p > 1e-4, "{num_rays} rays: chi-square {chi_square}, p = {p:e}");
    }
}

/// The exponent of N in a fit to variances at N, 4 N, 16 N and so on.
fn slope_of_variances(steps: &[u64; 5], variances: &[f64; 5]) -> f64 {
    let x = steps.map(|num_rays| (num_rays as f64).ln());
    let y = variances.map(f64::ln);
    let mean = |values: &[f64; 5]| values.iter().sum::<f64>() / 5.0;
    let (mean_x, mean_y) = (mean(&x), mean(&y));
    let products: f64 = x.iter().zip(&y).map(|(x, y)| (x - mean_x) * (y - mean_y)).sum();
    products / x.iter().map(|x| (x - mean_x).powi(2)).sum::<f64>()
}

/// Each sample variance in units of what a binomial draw has: without weights a ray is either detected or not.
fn chi_squares(ir: &SceneIr, steps: &[u64; 5], variances: &[f64; 5], runs: u64) -> [f64; 5] {
    let result = zoo::result(ir, &zoo::options(400_000, 1, Precision::F64));
    let p = result.detectors[0].num_rays_hit as f64 / result.num_rays_total as f64;
    std::array::from_fn(|i| {
        let expected = p * (1.0 - p) / steps[i] as f64 * result.total_flux_in.powi(2);
        variances[i] / expected * (runs as f64 - 1.0)
    })
}

#[test]
fn variances_that_fall_too_slowly_are_told() {
    let steps = [250, 1000, 4000, 16_000, 64_000];
    let variances = steps.map(|num_rays| (num_rays as f64).powf(-0.6));
    assert!((slope_of_variances(&steps, &variances) + 0.6).abs() < 1e-12);
}

// Physics.

/// A Lambertian rectangle on one side of a lens and a detector on the other, both off its axis. The source emits one
/// watt per area and so the same radiance whatever its size.
struct Ends {
    source: Rectangle,
    detector: Rectangle,
}

#[derive(Clone, Copy)]
struct Rectangle {
    centre: DVec3,
    width: f64,
    height: f64,
}

const NEAR: Rectangle = Rectangle { centre: DVec3::new(3.0, -2.0, -45.0), width: 14.0, height: 9.0 };
const FAR: Rectangle = Rectangle { centre: DVec3::new(-5.0, 4.0, 80.0), width: 16.0, height: 30.0 };

fn lens_between(ends: &Ends) -> SceneIr {
    let mut ir = zoo::load("bench_lens");
    let Ends { source, detector } = ends;
    let (emitter, sensor) = (&mut ir.emitters[0], &mut ir.sensors[0]);
    let area = Outline::Rectangle { width: source.width, height: source.height };
    emitter.kind = EmitterKind::Extended { area, half_angle: std::f64::consts::FRAC_PI_2 };
    emitter.total_flux = source.width * source.height;
    let towards_detector =
        if detector.centre.z > source.centre.z { DMat3::IDENTITY } else { DMat3::from_rotation_x(std::f64::consts::PI) };
    emitter.frame = Frame { origin: source.centre, rotation: towards_detector };
    sensor.frame = Frame { origin: detector.centre, rotation: DMat3::IDENTITY };
    if let SensorKind::Irradiance(grid) = &mut sensor.kind {
        (grid.width, grid.height) = (detector.width, detector.height);
    }
    ir
}

#[test]
fn light_takes_the_same_way_back() {
    let there = lens_between(&Ends { source: NEAR, detector: FAR });
    let mut back = lens_between(&Ends { source: FAR, detector: NEAR });
    let there = fluxes(&there, 40_000, 0..32).remove(0);
    let back_fluxes = fluxes(&back, 40_000, 100..132).remove(0);
    let (mean, variance) = mean_and_variance(&there);
    eprintln!("{mean:.4} +- {:.4} W there, {:.4} W back", variance.sqrt(), mean_and_variance(&back_fluxes).0);
    assert!(variance.sqrt() < 0.01 * mean, "the test can tell one percent");
    assert!(z(&there, &back_fluxes) < 4.0);

    back.surfaces[0].back = SceneIr::VACUUM;
    let broken = fluxes(&back, 40_000, 100..132).remove(0);
    assert!(z(&there, &broken) > 4.0, "a lens of one face takes another way");
}

/// A ball of glass in vacuum, a lamp in it near its rim, and a far field on one side.
fn lamp_in_a_ball() -> SceneIr {
    let at = |z: f64| Frame { origin: DVec3::new(0.0, 0.0, z), rotation: DMat3::IDENTITY };
    let medium = |name: &str, n: f64| Medium { name: name.into(), ambient: n == 1.0, n: vec![n], k: vec![0.0] };
    SceneIr {
        wavelengths: vec![0.55],
        media: vec![medium("vacuum", 1.0), medium("glass", 1.5)],
        surfaces: vec![Surface {
            name: "ball".into(),
            frame: at(0.0),
            shape: Shape::Sphere { radius: 10.0, aperture_radius: None },
            interaction: Interaction::Refractive,
            front: SceneIr::VACUUM,
            back: 1,
        }],
        emitters: vec![Emitter {
            name: "lamp".into(),
            frame: at(8.0),
            kind: EmitterKind::Point { half_angle: std::f64::consts::PI },
            total_flux: 1.0,
            spectrum: Spectrum { wavelengths: vec![0], cdf: vec![1.0] },
            medium: 1,
        }],
        sensors: vec![Sensor {
            name: "sky".into(),
            frame: at(20.0),
            kind: SensorKind::FarField { num_theta: 9, num_phi: 9 },
            absorb: true,
        }],
        sampling: Sampling { reflect_prob: ReflectProb::Fresnel, rr_start_flux: 0.0 },
    }
}

#[test]
fn a_source_born_in_glass_counts_one_underflow_for_every_ray_that_leaves() {
    let mut ir = lamp_in_a_ball();
    for precision in PRECISIONS {
        let options = zoo::options(20_000, 0, precision);
        let tally = zoo::trace(&ir, &options);
        let left = tally.escaped.count + tally.sensors[0].total().count;
        assert!(tally.depth_killed.count > 0, "some rays never leave");
        assert_eq!(left + tally.depth_killed.count, 20_000);
        assert_eq!(tally.medium_stack_underflows, left);
    }
    // The same lamp outside: every ray that leaves has entered.
    ir.emitters[0].medium = SceneIr::VACUUM;
    ir.emitters[0].frame.origin.z = 15.0;
    let tally = zoo::trace(&ir, &zoo::options(20_000, 0, Precision::F64));
    assert_eq!(tally.medium_stack_underflows, 0);
}

// The command in other circumstances.

/// The files of a trace by the command, by name; of the report without its timing.
fn files_of_command(scene: &str, precision: &str, threads: &str) -> BTreeMap<String, Vec<u8>> {
    let folder = tempfile::tempdir().unwrap();
    let status = std::process::Command::new(env!("CARGO_BIN_EXE_nsq-gpu"))
        .args(["trace", &format!("scenes/{scene}.json"), "-n", "20000", "--seed", "3", "--precision", precision])
        .args(["--json", "--progress", "never", "-o"])
        .arg(folder.path().join("results"))
        .current_dir(env!("CARGO_MANIFEST_DIR"))
        .env("LP_NUM_THREADS", threads)
        .output()
        .unwrap();
    assert!(status.status.success(), "{}", String::from_utf8_lossy(&status.stderr));
    let entries = std::fs::read_dir(folder.path().join("results")).unwrap();
    let mut files: BTreeMap<String, Vec<u8>> = entries
        .map(|entry| entry.unwrap().path())
        .map(|path| (path.file_name().unwrap().to_string_lossy().into(), std::fs::read(&path).unwrap()))
        .collect();
    for bytes in [files.get_mut("report.json").unwrap(), &mut { status.stdout }] {
        let mut report: serde_json::Value = serde_json::from_slice(bytes).unwrap();
        for timing in ["trace_time_sec", "rays_per_sec"] {
            report.as_object_mut().unwrap().remove(timing).expect("the report tells its timing");
        }
        *bytes = report.to_string().into_bytes();
    }
    files
}

#[test]
fn one_thread_and_two_write_the_same_bytes() {
    for scene in ["filter_stack", "kaleidoscope", "tessar_gaussian_beams"] {
        for precision in ["f32", "f64"] {
            let [one, two] = ["1", "2"].map(|threads| files_of_command(scene, precision, threads));
            assert!(one.len() > 2, "{scene}: {:?}", one.keys());
            for (name, bytes) in &one {
                assert!(two.get(name) == Some(bytes), "{scene} in {precision}: {name} differs");
            }
            assert_eq!(one.len(), two.len());
        }
    }
}

#[test]
fn files_of_another_precision_differ() {
    let [f32, f64] = ["f32", "f64"].map(|precision| files_of_command("kaleidoscope", precision, "2"));
    assert!(f32["eye.npz"] != f64["eye.npz"]);
    assert!(f32["report.json"] != f64["report.json"]);
}

// Ray ids.

#[test]
fn ray_ids_beyond_32_bits_reach_the_device_whole() {
    let ir = zoo::load("bench_lens");
    let tracer = nsq_gpu::Tracer::new(zoo::gpu(), &ir, &zoo::options(100, 0, Precision::F64)).unwrap();
    let program = tracer.program();
    let layout = nsq_gpu::program::records::StructLayout::of(&program.module, "Range").unwrap();
    let first = (7 << 32) + 5;
    let range = nsq_gpu::program::RayRange { first, count: 1, emitter: 0, weight: 1.0 };
    let bytes = program.range_bytes(&ir, &range).unwrap();
    let word = |field: &str| {
        let offset = layout.offset(field).unwrap();
        u32::from_le_bytes(bytes[offset..offset + 4].try_into().unwrap())
    };
    assert_eq!((word("first_lo"), word("first_hi")), (5, 7));
}
