//! Estimates that may differ by chance alone: importance sampling and roulette without bias, errors that fall with the
//! root of the number of rays, and light that takes the same way back.
#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "clippy's exemption of tests does not reach their helpers"
)]

mod zoo;

use glam::{DMat3, DVec3};
use nsq_gpu::model::{DetectorKind, Extended, Frame, Outline, ReflectProb, Sampling, SceneIr, SourceKind};
use nsq_gpu::program::Precision;
use nsq_gpu::result::Tally;
use statrs::distribution::{ChiSquared, ContinuousCDF, StudentsT};

/// Ways to draw reflection more often than it happens.
const POLICIES: [ReflectProb; 3] =
    [ReflectProb::Auto, ReflectProb::Constant(0.3), ReflectProb::Constant(0.02)];

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
    let options = zoo::options(num_rays, 0, Precision::F64);
    let mut tracer = zoo::tracer(ir, &options).unwrap();
    let runs: Vec<nsq_gpu::TraceResult> =
        zoo::tallies_of(&mut tracer, seeds).map(|tally| zoo::result_of(ir, &options, &tally)).collect();
    let flux_of = |i: usize| runs.iter().map(|run| run.detectors[i].total_flux).collect();
    (0..ir.detectors.len()).map(flux_of).collect()
}

/// 32 runs a side; so far apart comes about by chance once in 10^4 (t of 62 degrees of freedom).
const MOST_STANDARD_ERRORS: f64 = 4.2;

#[test]
fn importance_sampling_is_unbiased() {
    for name in ["heliar_ghosts", "bench_lens", "ball_lens_ghosts"] {
        let mut ir = zoo::load(name);
        ir.sampling.reflect_prob = ReflectProb::Fresnel;
        let plain = fluxes(&ir, 4000, 0..32);
        for (i, policy) in POLICIES.into_iter().enumerate() {
            ir.sampling.reflect_prob = policy;
            let first = 100 * (i as u64 + 1);
            let seeds = first..first + 32;
            for (detector, (ours, plain)) in fluxes(&ir, 4000, seeds).iter().zip(&plain).enumerate() {
                let z = z(ours, plain);
                assert!(
                    z < MOST_STANDARD_ERRORS,
                    "{name}, {policy:?}, detector {detector}: {z} standard errors"
                );
            }
        }
    }
}

/// The weight of every pixel of every detector, in independent runs.
fn pixels(ir: &SceneIr, num_rays: u64, seeds: std::ops::Range<u64>) -> Vec<Vec<f64>> {
    let quanta = |tally: &Tally| {
        tally
            .detectors
            .iter()
            .flat_map(|detector| detector.quanta.iter().map(|&quanta| quanta as f64))
            .collect()
    };
    let options = zoo::options(num_rays, 0, Precision::F64);
    let mut tracer = zoo::tracer(ir, &options).unwrap();
    let runs: Vec<Vec<f64>> = zoo::tallies_of(&mut tracer, seeds).map(|tally| quanta(&tally)).collect();
    (0..runs[0].len()).map(|pixel| runs.iter().map(|run| run[pixel]).collect()).collect()
}

/// Welch's t of every pixel that both sides light in most runs, with a Sidak bound over all of them: those beyond it.
fn differing_pixels(a: &[Vec<f64>], b: &[Vec<f64>]) -> (usize, usize) {
    const SIGNIFICANCE: f64 = 1e-3;
    let lit =
        |samples: &[f64]| 4 * samples.iter().filter(|sample| **sample > 0.0).count() > 3 * samples.len();
    let tested: Vec<_> = a.iter().zip(b).filter(|(a, b)| lit(a) && lit(b)).collect();
    let level = 1.0 - (1.0 - SIGNIFICANCE).powf(1.0 / tested.len() as f64);
    let freedom = a[0].len().min(b[0].len()) as f64 - 1.0;
    let distribution = StudentsT::new(0.0, 1.0, freedom).unwrap();
    let differ = tested.iter().filter(|(a, b)| 2.0 * distribution.sf(z(a, b)) < level).count();
    (differ, tested.len())
}

#[test]
fn splitting_is_unbiased_pixel_by_pixel_and_quiets_the_map() {
    const RUNS: u64 = 32;
    for name in ["stacked_plates_ghosts", "mesh_lens"] {
        let mut ir = zoo::load(name);
        let plain = pixels(&ir, 2000, 0..RUNS);
        let variance = |map: &[Vec<f64>]| map.iter().map(|pixel| mean_and_variance(pixel).1).sum::<f64>();
        for (i, (split_depth, split_budget)) in [(1, 4.0), (5, 2.5)].into_iter().enumerate() {
            ir.sampling = Sampling { split_depth, split_budget, ..ir.sampling };
            let first = 100 * (i as u64 + 1);
            let split = pixels(&ir, 2000, first..first + RUNS);
            let (differ, tested) = differing_pixels(&split, &plain);
            eprintln!("{name} split {split_depth}, {split_budget}: {tested} pixels");
            assert!(tested > 20, "{name}: {tested} pixels are lit");
            assert_eq!(differ, 0, "{name} split {split_depth}, {split_budget}: of {tested} pixels");
            assert!(variance(&split) < variance(&plain), "{name} split {split_depth}, {split_budget}");
            let biased: Vec<Vec<f64>> =
                split.iter().map(|pixel| pixel.iter().map(|value| 1.3 * value).collect()).collect();
            assert!(differing_pixels(&biased, &plain).0 > 0, "{name}: a third more is told");
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
fn a_bias_of_two_percent_is_seen_by_chance_tests() {
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
fn variances_that_fall_too_slowly_are_reported() {
    let steps = [250, 1000, 4000, 16_000, 64_000];
    let variances = steps.map(|num_rays| (num_rays as f64).powf(-0.6));
    assert!((slope_of_variances(&steps, &variances) + 0.6).abs() < 1e-12);
}

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
    let (source, detector) = (&mut ir.sources[0], &mut ir.detectors[0]);
    let area = Outline::Rectangle { width: ends.source.width, height: ends.source.height };
    source.kind = SourceKind::Extended(Extended { area, half_angle: std::f64::consts::FRAC_PI_2 });
    source.total_flux = ends.source.width * ends.source.height;
    let towards_detector = if ends.detector.centre.z > ends.source.centre.z {
        DMat3::IDENTITY
    } else {
        DMat3::from_rotation_x(std::f64::consts::PI)
    };
    source.frame = Frame { origin: ends.source.centre, rotation: towards_detector };
    detector.frame = Frame { origin: ends.detector.centre, rotation: DMat3::IDENTITY };
    if let DetectorKind::Irradiance(grid) = &mut detector.kind {
        (grid.width, grid.height) = (ends.detector.width, ends.detector.height);
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
