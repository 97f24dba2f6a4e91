//! Scenes where tracers fail (`benches/stability/cases.json`): every tier hits what its numbers allow.
//!
//! `cargo test --test stability -- --nocapture` prints the table of `nsq-bench --stability`.

#![allow(clippy::unwrap_used, clippy::panic, clippy::print_stdout, reason = "a test fails by panicking")]

#[path = "../benches/src/stability.rs"]
mod stability;
mod zoo;

use nsq_gpu::TraceResult;
use nsq_gpu::cpu::Override;
use nsq_gpu::gpu::Gpu;
use nsq_gpu::program::Precision;
use nsq_gpu::result::DetectorData;
use stability::{Row, StabilityCase, cases, faults, table};
use zoo::forced::{Asked, Forced};

fn precisions(gpu: &Gpu) -> Vec<Precision> {
    let doubles = gpu.f64.then_some(Precision::F64);
    [Precision::F32, Precision::Df64].into_iter().chain(doubles).collect()
}

fn measured() -> Vec<Row> {
    let gpu = zoo::gpu();
    let precisions = precisions(gpu);
    let measure = |case: StabilityCase| {
        let outcomes = precisions.iter().map(|&p| (p, case.measure(gpu, p).unwrap())).collect();
        Row { case, outcomes }
    };
    zoo::in_turn(cases().unwrap()).map(measure).collect()
}

#[test]
fn every_tier_is_as_right_as_its_numbers_allow() {
    let rows = measured();
    println!("{}", table(&rows));
    let faults = faults(&rows);
    assert!(faults.is_empty(), "{} faults:\n{}", faults.len(), faults.join("\n"));
}

/// What a seventh of the rays gets at birth: numbers made at run time, so that no compiler can fold them away.
const PLANTED: &str = "
fn planted_nan() -> real { return sqrt(-real(range.count)); }
fn planted_infinity() -> real { return 1.0 / real(range.first_hi); }
";

/// Traces a scene with this statement done to every seventh ray.
fn with_plant(scene: &str, precision: Precision, baked: bool, plant: &str) -> TraceResult {
    let ir = zoo::load(scene);
    let mut options = Forced::from(zoo::options(7_000, 3, precision));
    options.baked = Some(baked);
    // Rays that keep their weight do not log it; where the device adds up, it looks at it.
    if scene == "bench_lens" && plant.contains("weight") {
        options.overrides.deferred_splats = Override::Never;
    }
    let edit = |wgsl: String| {
        let born = "ray = generate(index);";
        assert_eq!(wgsl.matches(born).count(), 1);
        PLANTED.to_string() + &wgsl.replace(born, &format!("{born} if index % 7u == 3u {{ {plant} }}"))
    };
    let tally = options.tracer_with(zoo::gpu(), &ir, edit).unwrap().trace(|_| true).unwrap();
    zoo::result_of(&ir, &options, &tally)
}

#[test]
fn what_is_no_number_reaches_no_sum_and_is_reported() {
    let plants = [
        "ray.weight = planted_nan();",
        "ray.weight = planted_infinity();",
        "ray.weight = -planted_infinity();",
        "ray.position.x = planted_nan();",
        "ray.position.z = planted_infinity();",
        "ray.direction = vec3<real>(planted_nan());",
        "ray.direction.y = -planted_infinity();",
    ];
    let precisions = precisions(zoo::gpu());
    let scenes = [("bench_lens", true), ("tessar_gaussian_beams", false), ("searchlight", true)];
    for &precision in &precisions {
        for (scene, baked) in zoo::in_turn(scenes) {
            // The seventh's rays gone at once: what the others bring.
            let others = with_plant(scene, precision, baked, "ray.fate = ESCAPED;");
            assert!(others.ledger.closes());
            for plant in plants {
                let name = format!("{scene}, {}: {plant}", precision.name());
                let result = with_plant(scene, precision, baked, plant);
                assert!(
                    result.ledger.invalid_deposits >= 1_000,
                    "{name}: {:?}",
                    result.ledger.invalid_deposits
                );
                let warning = &result.diagnostics.warnings;
                assert!(warning.iter().any(|w| w.starts_with("INVALID DEPOSITS")), "{name}: {warning:?}");
                for (ours, theirs) in result.detectors.iter().zip(&others.detectors) {
                    assert_eq!(ours.total_flux, theirs.total_flux, "{name}: {}", ours.name);
                }
            }
        }
    }
}

#[test]
fn powers_of_two_scale_every_map_exactly() {
    for name in ["filter_stack", "tessar_gaussian_beams", "nested_media"] {
        let ir = zoo::load(name);
        let options = zoo::options(3_000, 3, Precision::F32);
        let plain = zoo::result(&ir, &options);
        for scale in [2_f64.powi(100), 2_f64.powi(-100)] {
            let mut scaled = ir.clone();
            scaled.sources.iter_mut().for_each(|source| source.total_flux *= scale);
            let scaled = zoo::result(&scaled, &options);
            assert_eq!(scaled.total_flux_detected, scale * plain.total_flux_detected, "{name}");
            for (ours, theirs) in scaled.detectors.iter().zip(&plain.detectors) {
                let (ours, theirs) = (values(&ours.data), values(&theirs.data));
                assert!(ours.iter().zip(&theirs).all(|(a, b)| *a == scale * b), "{name} times {scale:e}");
                assert!(theirs.iter().any(|value| *value > 0.0), "{name}");
            }
        }
    }
}

fn values(data: &DetectorData) -> Vec<f64> {
    match data {
        DetectorData::Irradiance(map) => map.irradiance.iter().copied().collect(),
        DetectorData::Spectral(map) => map.pixels.irradiance.iter().copied().collect(),
        DetectorData::FarField(pattern) => pattern.intensity.iter().copied().collect(),
        DetectorData::RayDatabase(rows) => rows.columns().unwrap().flux.to_vec(),
    }
}
