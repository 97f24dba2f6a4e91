//! Scattering and coatings against closed forms, and what is read of them from files. Parity with the reference, closing
//! ledgers and equal bits are tested over the scene collection, which has all kinds of them.
#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "clippy's exemption of tests does not reach their helpers"
)]

mod zoo;

use nsq_gpu::model::{
    Bsdf, BsdfTable, Coating, HarveyShack, KCorrelation, Lambertian, SceneIr, SimpleCoating, Tabulated,
};
use nsq_gpu::program::Precision;
use nsq_gpu::result::DetectorData;
use nsq_gpu::{Scene, TraceOptions, TraceResult};
use serde_json::{Value, json};
use statrs::distribution::{ChiSquared, ContinuousCDF};
use std::f64::consts::{FRAC_PI_2, PI};

const PRECISIONS: [Precision; 2] = [Precision::F32, Precision::F64];

/// A pencil of rays at an angle of incidence [deg] onto the plane z = 0, from below.
fn pencil(angle_deg: f64) -> Value {
    let angle = angle_deg.to_radians();
    json!({
        "type": "point", "name": "pencil", "total_flux": 1.0, "half_angle_deg": 0.0,
        "cs": { "x": -10.0 * angle.sin(), "z": -10.0 * angle.cos(), "ry": angle },
        "spectrum": { "wavelengths": [0.5], "weights": [1.0] },
    })
}

/// A plane z = 0 that does `finish`.
fn plane(finish: Value) -> Value {
    let mut surface = json!({ "name": "plane", "cs": {}, "shape": { "type": "plane" } });
    surface.as_object_mut().unwrap().extend(finish.as_object().unwrap().clone());
    surface
}

/// A mirror z = 0 that scatters every ray.
fn scatterer(bsdf: Value) -> Value {
    plane(json!({ "interaction": "reflective", "reflectance": 1.0, "bsdf": bsdf }))
}

/// A scene without roulette.
fn scene(source: Value, surfaces: &[Value], detectors: &[Value]) -> SceneIr {
    lowered(&json!({
        "nsq_schema_version": 1, "sources": [source], "detectors": detectors,
        "nsq_gpu": { "version": 1, "surfaces": surfaces, "sampling": { "rr_start_flux": 0.0 },
                     "media": { "tinted": { "type": "constant", "n": 1.5, "k": 1e-2 } } },
    }))
}

fn lowered(scene: &Value) -> SceneIr {
    Scene::from_json(&scene.to_string()).unwrap().lower().unwrap()
}

/// Directions on the near side of the plane; no ray gets round it.
fn sky(z: f64, num_theta: u32) -> Value {
    json!({ "type": "far_field", "name": "sky", "cs": { "z": z }, "num_bins_theta": num_theta, "num_bins_phi": 8 })
}

fn trace(ir: &SceneIr, num_rays: u64, precision: Precision) -> TraceResult {
    let options =
        TraceOptions { max_depth: 400, min_flux_fraction: 0.0, ..zoo::options(num_rays, 77, precision) };
    let result = zoo::result(ir, &options);
    assert!(result.ledger.closes(), "{:?}", result.ledger);
    result
}

fn flux(result: &TraceResult, detector: &str) -> f64 {
    result.detector(detector).unwrap().total_flux
}

/// Hits per bin of the far field's polar angle.
fn hits_by_theta(ir: &SceneIr, num_rays: u64, precision: Precision) -> Vec<f64> {
    let tally = zoo::trace(ir, &zoo::options(num_rays, 78, precision));
    tally.detectors[0].hits.chunks(8).map(|ring| ring.iter().sum::<u64>() as f64).collect()
}

/// The probability of counts as far from what is expected; bins with few are pooled.
fn probability(counts: &[f64], expected: &[f64]) -> f64 {
    const FEW: f64 = 20.0;
    let mut pools = vec![(0.0, 0.0)];
    for (count, expected) in counts.iter().zip(expected) {
        let last = pools.last_mut().unwrap();
        *last = (last.0 + count, last.1 + expected);
        if last.1 >= FEW {
            pools.push((0.0, 0.0));
        }
    }
    let rest = pools.pop().unwrap();
    let last = pools.last_mut().unwrap();
    *last = (last.0 + rest.0, last.1 + rest.1);
    let chi_square: f64 = pools.iter().map(|(count, expected)| (count - expected).powi(2) / expected).sum();
    ChiSquared::new(pools.len() as f64 - 1.0).unwrap().sf(chi_square)
}

// Lambertian

/// A disk that cuts a cap off a white sphere is lit by the cap's share f of the sphere at every reflection: a Lambertian
/// point of a sphere lights every other one alike. Of the light of a lamp in the middle, f / (1 - rho (1 - f)) goes
/// through it, and walls send on rho / (1 - rho (1 - f)) times what they get from the lamp: the sphere's multiplier.
#[test]
fn an_integrating_sphere_fills_its_port() {
    integrating_spheres(&[0.5, 0.9, 0.99], 100_000);
}

/// `cargo test --test bsdf -- --ignored` for the whole figure.
#[test]
#[ignore = "long"]
fn an_integrating_sphere_fills_its_port_with_1e7_rays() {
    integrating_spheres(&[0.9, 0.99], 10_000_000);
}

fn integrating_spheres(reflectances: &[f64], num_rays: u64) {
    let (radius, height) = (50.0, 40.0);
    let share = (1.0 - height / radius) / 2.0;
    let side = 2.0 * f64::sqrt(radius * radius - height * height);
    let port = json!({ "type": "irradiance", "name": "port", "cs": { "z": height }, "width": side, "height": side,
                       "num_pixels_x": 1, "num_pixels_y": 1, "splat": "hard" });
    let lamp = json!({ "type": "point", "name": "lamp", "total_flux": 1.0, "half_angle_deg": 180.0, "cs": {},
                       "spectrum": { "wavelengths": [0.5], "weights": [1.0] } });
    let cases = reflectances.iter().flat_map(|&rho| [(Precision::F64, rho), (Precision::F32, rho)]);
    for (precision, rho) in cases {
        let wall = json!({ "name": "wall", "cs": {}, "shape": { "type": "sphere", "radius": radius },
                           "interaction": "reflective", "reflectance": 1.0,
                           "bsdf": { "type": "lambertian", "reflectance_value": rho } });
        let result = trace(&scene(lamp.clone(), &[wall], std::slice::from_ref(&port)), num_rays, precision);
        let multiplier = rho / (1.0 - rho * (1.0 - share));
        let expected = share * multiplier / rho;
        // A weight between 0 and 1 varies no more than a yes or no of the same mean.
        let sigma = (expected * (1.0 - expected) / num_rays as f64).sqrt();
        let deviation = (flux(&result, "port") - expected) / sigma;
        eprintln!("{precision:?}, rho = {rho}: {expected:.4}, off by {deviation:.2} sigma");
        assert!(deviation.abs() < 4.0, "{precision:?}, rho = {rho}: {deviation} sigma");
        let scattered = result.ledger.bsdf.flux - result.ledger.bsdf_gain.flux;
        assert!((flux(&result, "port") + scattered - 1.0).abs() < 1e-6, "the walls took the rest");
        // The walls take 1 - rho of what they get, and send rho of it on.
        let measured = rho * scattered / (1.0 - rho) / (1.0 - share);
        let sigma_of_multiplier = sigma * rho / (1.0 - rho) / (1.0 - share);
        let deviation = (measured - multiplier) / sigma_of_multiplier;
        assert!(deviation.abs() < 4.0, "{precision:?}, rho = {rho}: multiplier off by {deviation} sigma");
    }
}

#[test]
fn a_lambertian_wall_scatters_by_the_cosine() {
    for precision in zoo::in_turn(PRECISIONS) {
        for (transmissive_fraction, z) in [(0.0, -20.0), (1.0, 20.0)] {
            let bsdf = json!({ "type": "lambertian", "reflectance_value": 0.5,
                               "transmissive_fraction": transmissive_fraction });
            let ir = scene(pencil(40.0), &[scatterer(bsdf)], &[sky(z, 30)]);
            let num_rays = 100_000;
            let counts = hits_by_theta(&ir, num_rays, precision);
            let edge = |i: usize| (FRAC_PI_2 * i as f64 / 30.0).sin().powi(2);
            let share = |i: usize| num_rays as f64 * (edge(i + 1) - edge(i));
            let p = probability(&counts, &(0..30).map(share).collect::<Vec<f64>>());
            assert!(p > 1e-4, "{precision:?}, transmissive {transmissive_fraction}: p = {p:e}");
            let uniform = vec![num_rays as f64 / 30.0; 30];
            assert!(probability(&counts, &uniform) < 1e-9, "the test is blind");
            assert!((flux(&trace(&ir, 5000, precision), "sky") - 0.5).abs() < 1e-5);
        }
    }
}

#[test]
fn rays_that_are_not_scattered_go_on_as_if_there_were_no_bsdf() {
    let bsdf = json!({ "type": "lambertian", "reflectance_value": 0.25 });
    let mirror = plane(json!({ "interaction": "reflective", "reflectance": 1.0, "bsdf": bsdf,
                               "scatter_fraction": 0.3 }));
    let ir = scene(pencil(40.0), &[mirror], &[sky(-20.0, 90)]);
    let num_rays = 100_000;
    let counts = hits_by_theta(&ir, num_rays, Precision::F64);
    let beam = counts[39] + counts[40];
    // What is scattered goes there too.
    let sin = |degrees: f64| degrees.to_radians().sin();
    let p = 0.7 + 0.3 * (sin(41.0).powi(2) - sin(39.0).powi(2));
    let sigma = (num_rays as f64 * p * (1.0 - p)).sqrt();
    assert!((beam - num_rays as f64 * p).abs() < 4.0 * sigma, "{beam}");
    let expected = 0.7 + 0.3 * 0.25;
    assert!((flux(&trace(&ir, num_rays, Precision::F64), "sky") - expected).abs() < 5e-3);
}

// Harvey-Shack

#[test]
fn the_harvey_shack_table_is_the_integral_of_the_lobe() {
    // For s = 2 the total is pi b0 l0^2 ln(1 + (2 / l0)^2).
    for (b0, l0) in [(1.0, 0.05), (0.3, 0.5), (10.0, 2.0)] {
        let (cdf, total) = HarveyShack { b0, l0, s: 2.0, transmissive_fraction: 0.0 }.distribution();
        let integral = |beta: f64| PI * b0 * l0 * l0 * (beta / l0).powi(2).ln_1p();
        assert!((total / integral(2.0) - 1.0).abs() < 1e-4, "l0 = {l0}: {total}");
        assert_eq!((cdf.len(), cdf[0], cdf[4095]), (4096, 0.0, 1.0));
        assert!(cdf.is_sorted());
        for knot in [10, 100, 1000, 4000] {
            let expected = integral(2.0 * f64::from(knot) / 4095.0) / integral(2.0);
            assert!((cdf[knot as usize] - expected).abs() < 1e-4, "l0 = {l0}, knot {knot}");
        }
    }
}

#[test]
fn a_harvey_shack_mirror_draws_the_lobe() {
    let (l0, num_theta, num_rays) = (0.1, 45, 100_000);
    let bsdf = json!({ "type": "harvey_shack", "b0": 1.0, "l0": l0, "s": 2.0 });
    let ir = scene(pencil(0.0), &[scatterer(bsdf)], &[sky(-20.0, num_theta)]);
    // At normal incidence the offset is the sine of the polar angle; what lies beyond 1 stays in the beam, weightless.
    let cdf = |theta: f64| (theta.sin() / l0).powi(2).ln_1p() / (2.0 / l0).powi(2).ln_1p();
    let edge = |i: u32| FRAC_PI_2 * f64::from(i) / f64::from(num_theta);
    let mut expected: Vec<f64> = (0..num_theta).map(|i| cdf(edge(i + 1)) - cdf(edge(i))).collect();
    let lost = 1.0 - cdf(FRAC_PI_2);
    expected[0] += lost;
    expected.iter_mut().for_each(|share| *share *= num_rays as f64);
    for precision in zoo::in_turn(PRECISIONS) {
        let p = probability(&hits_by_theta(&ir, num_rays, precision), &expected);
        assert!(p > 1e-4, "{precision:?}: p = {p:e}");
        let sigma = (lost * (1.0 - lost) / num_rays as f64).sqrt();
        let deviation = (1.0 - flux(&trace(&ir, num_rays, precision), "sky") - lost) / sigma;
        assert!(deviation.abs() < 4.0, "{precision:?}: {deviation} sigma");
    }
    expected.swap(0, 1);
    assert!(
        probability(&hits_by_theta(&ir, num_rays, Precision::F64), &expected) < 1e-9,
        "the test is blind"
    );
}

/// A lobe about Fresnel's reflected ray stays in the medium that the ray came from, whether it is called transmissive
/// or not: absorption in the glass behind takes nothing of it. (Optiland goes by the name.)
#[test]
fn a_scattered_ray_is_in_the_medium_of_its_side() {
    let bsdf =
        json!({ "type": "harvey_shack", "b0": 1.0, "l0": 0.01, "s": 4.0, "transmissive_fraction": 1.0 });
    let window = plane(json!({ "interaction": "refractive", "bsdf": bsdf,
                               "material_back": { "type": "medium", "name": "tinted" } }));
    let mut ir = scene(pencil(0.0), &[window], &[sky(-20.0, 9), sky_behind()]);
    ir.sampling.reflect_prob = nsq_gpu::model::ReflectProb::Constant(0.5);
    let result = trace(&ir, 20_000, Precision::F64);
    let reflected = flux(&result, "sky");
    assert!((reflected / 0.04 - 1.0).abs() < 0.03, "R = 0.04 at n = 1.5: {reflected}");
    assert!(flux(&result, "behind") < 1e-12, "the glass is black");
}

fn sky_behind() -> Value {
    json!({ "type": "far_field", "name": "behind", "cs": { "z": 20.0 }, "num_bins_theta": 9, "num_bins_phi": 8 })
}

// K-correlation

fn k_correlation(b0: f64, b: f64, s: f64) -> KCorrelation {
    KCorrelation { b0, b, s, transmissive_fraction: 0.0 }
}

/// Midpoints of equal steps in ln(1 + B beta), where the lobe is smooth.
#[test]
fn the_closed_form_of_a_k_correlation_lobe_is_its_integral() {
    for (b, s) in
        [(0.1, 3.0), (5.0, 0.0), (20.0, 1.0), (20.0, 2.0), (20.0, 2.0 + 1e-9), (500.0, 2.5), (1e4, 8.0)]
    {
        let lobe = k_correlation(0.25, b, s);
        for beta in [0.01, 0.5, 1.0, 2.0] {
            let steps = 20_000;
            let width = (b * beta).ln_1p() / f64::from(steps);
            let density = |i: u32| {
                let z = width * (f64::from(i) + 0.5);
                let beta = z.exp_m1() / b;
                0.25 / (1.0 + (b * beta).powi(2)).powf(0.5 * s) * 2.0 * PI * beta * z.exp() / b
            };
            let expected = (0..steps).map(density).sum::<f64>() * width;
            let found = lobe.scattered_within(beta);
            assert!(
                (found / expected - 1.0).abs() < 1e-6,
                "B = {b}, s = {s}, {beta}: {found}, not {expected}"
            );
        }
        for share in [1e-9, 1e-3, 0.2, 0.5, 0.9, 1.0 - 1e-6] {
            let found = lobe.scattered_within(lobe.offset(share)) / lobe.scattered_within(2.0);
            assert!((found / share - 1.0).abs() < 1e-11, "B = {b}, s = {s}, share {share}: {found}");
        }
    }
}

#[test]
fn a_k_correlation_mirror_draws_the_lobe() {
    let (b, num_theta, num_rays) = (10.0, 45, 100_000);
    for s in [0.0, 1.0, 2.0, 2.5, 6.0] {
        let bsdf = json!({ "type": "k_correlation", "b0": 1.0, "B": b, "s": s });
        let ir = scene(pencil(0.0), &[scatterer(bsdf)], &[sky(-20.0, num_theta)]);
        let lobe = k_correlation(1.0, b, s);
        let cdf = |theta: f64| lobe.scattered_within(theta.sin()) / lobe.scattered_within(2.0);
        let edge = |i: u32| FRAC_PI_2 * f64::from(i) / f64::from(num_theta);
        let mut expected: Vec<f64> = (0..num_theta).map(|i| cdf(edge(i + 1)) - cdf(edge(i))).collect();
        let lost = 1.0 - cdf(FRAC_PI_2);
        expected[0] += lost;
        expected.iter_mut().for_each(|share| *share *= num_rays as f64);
        for precision in zoo::in_turn([Precision::F32, Precision::Df64, Precision::F64]) {
            let p = probability(&hits_by_theta(&ir, num_rays, precision), &expected);
            assert!(p > 1e-4, "{precision:?}, s = {s}: p = {p:e}");
            let sigma = (lost * (1.0 - lost) / num_rays as f64).sqrt();
            let deviation = (1.0 - flux(&trace(&ir, num_rays, precision), "sky") - lost) / sigma.max(1e-9);
            assert!(deviation.abs() < 4.0, "{precision:?}, s = {s}: {deviation} sigma");
        }
        expected.swap(0, 1);
        let swapped = probability(&hits_by_theta(&ir, num_rays, Precision::F64), &expected);
        assert!(swapped < 1e-9, "the test is blind");
    }
}

/// Of 1e5 rays the last is drawn with 1e-5 left of 1, where f32 has lost digits that come back in the offset.
#[test]
fn f32_and_df64_draw_the_offsets_of_f64() {
    let database =
        json!({ "type": "ray_database", "name": "all", "cs": { "z": -20.0 }, "width": 1e9, "height": 1e9 });
    for (b, s) in [(0.5, 3.0), (30.0, 1.0), (30.0, 2.0), (30.0, 2.25), (1e3, 3.0), (1e6, 2.5), (50.0, 40.0)] {
        let bsdf = json!({ "type": "k_correlation", "b0": 1.0, "B": b, "s": s });
        let ir = scene(pencil(0.0), &[scatterer(bsdf)], std::slice::from_ref(&database));
        let offsets = |precision| {
            let tally = zoo::trace(&ir, &zoo::options(100_000, 79, precision));
            let mut rows = tally.detectors[0].rows.clone();
            rows.sort_by_key(|row| row.ray_id);
            rows.iter().map(|row| (row.weight, row.direction[0].hypot(row.direction[1]))).collect::<Vec<_>>()
        };
        let exact = offsets(Precision::F64);
        for (precision, limit) in [(Precision::F32, 3e-6), (Precision::Df64, 2e-13)] {
            let worst = offsets(precision)
                .iter()
                .zip(&exact)
                // At the rim of the unit disk rounding decides whether a direction lies in it.
                .filter(|(_, exact)| exact.0 > 0.0 && exact.1 < 0.999)
                .map(|(found, exact)| (found.1 - exact.1).abs() / exact.1)
                .fold(0.0, f64::max);
            eprintln!("B = {b}, s = {s}, {precision:?}: {worst:.1e}");
            assert!(worst < limit, "B = {b}, s = {s}, {precision:?}: {worst:e}");
        }
    }
}

// Levels

/// What scatters into a ring about the normal is the BSDF that is written, whatever the lobe.
#[test]
fn a_scatter_fraction_of_tis_gives_the_bsdf_its_own_level() {
    let (num_theta, num_rays) = (18, 400_000);
    let table = BsdfTable {
        theta_i: vec![0.0, 90.0],
        theta_s: vec![0.0, 30.0, 90.0],
        values: vec![0.2, 0.1, 0.0, 0.2, 0.1, 0.0],
    };
    let k = k_correlation(30.0, 30.0, 2.0);
    let cases: [(Value, &dyn Fn(f64) -> f64); 4] = [
        // A / (B + beta^g) with A = 0.01, B = 1e-3, g = 1.5.
        (json!({ "type": "harvey_shack", "b0": 10.0, "l0": 1e-2, "s": 1.5 }), &|sine| {
            0.01 / (1e-3 + sine.powf(1.5))
        }),
        (json!({ "type": "k_correlation", "b0": k.b0, "B": k.b, "s": k.s }), &|sine| {
            k.b0 / (1.0 + (k.b * sine).powi(2))
        }),
        (json!({ "type": "lambertian", "reflectance_value": 0.3 }), &|_| 0.3 / PI),
        (tabulated(&table, 0.0), &|sine| bilinear(&table, 0.0, sine.asin().to_degrees())),
    ];
    for (bsdf, value) in cases {
        let mirror = plane(
            json!({ "interaction": "reflective", "reflectance": 1.0, "bsdf": bsdf, "scatter_fraction": "tis" }),
        );
        let ir = scene(pencil(0.0), &[mirror], &[sky(-20.0, num_theta)]);
        let result = trace(&ir, num_rays, Precision::F64);
        let DetectorData::FarField(found) = &result.detector("sky").unwrap().data else { panic!() };
        for i in 1..num_theta as usize {
            let edges = [i, i + 1].map(|i| FRAC_PI_2 * i as f64 / f64::from(num_theta));
            let steps = 1000;
            let step = (edges[1] - edges[0]) / f64::from(steps);
            let light = |j: i32| {
                let theta = edges[0] + step * (f64::from(j) + 0.5);
                value(theta.sin()) * 2.0 * PI * theta.sin() * theta.cos() * step
            };
            let expected = (0..steps).map(light).sum::<f64>();
            let solid_angle = 2.0 * PI / 8.0 * (edges[0].cos() - edges[1].cos());
            let in_ring = found.intensity.row(i).sum() * solid_angle;
            // Weights stay below 2.
            let sigma = (2.0 * expected / num_rays as f64).sqrt();
            assert!(
                (in_ring - expected).abs() < 4.5 * sigma,
                "{bsdf}, ring {i}: {in_ring}, not {expected} +- {sigma}"
            );
        }
    }
}

/// `tis` is no more than a number, and a lobe of the total integrated scatter 1.
#[test]
fn tis_is_a_fraction_and_a_lobe() {
    let scatter = |bsdf: Value| {
        let mirror = plane(
            json!({ "interaction": "reflective", "reflectance": 1.0, "bsdf": bsdf, "scatter_fraction": "tis" }),
        );
        scene(pencil(0.0), &[mirror], &[sky(-20.0, 9)]).surfaces.remove(0).scatter.unwrap()
    };
    let lobe = HarveyShack { b0: 0.5, l0: 0.05, s: 2.0, transmissive_fraction: 0.25 };
    let found = scatter(
        json!({ "type": "harvey_shack", "b0": 0.5, "l0": 0.05, "s": 2.0, "transmissive_fraction": 0.25 }),
    );
    assert_eq!((found.fraction, found.bsdf), (lobe.distribution().1, Bsdf::HarveyShack(lobe)));
    let lobe = k_correlation(0.5, 20.0, 2.5);
    let found = scatter(json!({ "type": "k_correlation", "b0": 0.5, "B": 20.0, "s": 2.5 }));
    assert_eq!((found.fraction, found.bsdf), (lobe.scattered_within(2.0), Bsdf::KCorrelation(lobe)));
    let found =
        scatter(json!({ "type": "lambertian", "reflectance_value": 0.5, "transmissive_fraction": 0.25 }));
    let white = Lambertian { reflectance_value: 1.0, transmissive_fraction: 0.25 };
    assert_eq!((found.fraction, found.bsdf), (0.5, Bsdf::Lambertian(white)));
    let table = BsdfTable {
        theta_i: vec![0.0, 90.0],
        theta_s: vec![0.0, 90.0],
        values: vec![0.25 / PI, 0.25 / PI, 0.0, 0.5 / PI],
    };
    let found = scatter(tabulated(&table, 0.25));
    let Bsdf::Tabulated(level) = &found.bsdf else { panic!() };
    assert!((found.fraction - 0.25).abs() < 1e-15 && (level.table.albedo(0) - 1.0).abs() < 1e-15);
    assert_eq!((level.table.values[2], level.transmissive_fraction), (0.0, 0.25));
    assert!((level.table.values[3] - 2.0 / PI).abs() < 1e-15);
    let whole =
        BsdfTable { theta_i: vec![0.0, 90.0], theta_s: vec![0.0, 45.0, 90.0], values: vec![1.0 / PI; 6] };
    assert_eq!(scatter(tabulated(&whole, 0.0)).fraction, 1.0, "whatever the sum rounds to");
}

// Tabulated

/// Bilinear interpolation, as written here; 0 beyond the table.
fn bilinear(table: &BsdfTable, theta_i: f64, theta_s: f64) -> f64 {
    let place = |angles: &[f64], x: f64| {
        let i = angles.windows(2).position(|ends| (ends[0]..=ends[1]).contains(&x))?;
        Some((i, (x - angles[i]) / (angles[i + 1] - angles[i])))
    };
    let (Some((i, u)), Some((j, v))) = (place(&table.theta_i, theta_i), place(&table.theta_s, theta_s))
    else {
        return 0.0;
    };
    let value = |i: usize, j: usize| table.values[i * table.theta_s.len() + j];
    (1.0 - u) * ((1.0 - v) * value(i, j) + v * value(i, j + 1))
        + u * ((1.0 - v) * value(i + 1, j) + v * value(i + 1, j + 1))
}

fn peaked_table() -> BsdfTable {
    BsdfTable {
        theta_i: vec![5.0, 30.0, 90.0],
        theta_s: vec![0.0, 20.0, 50.0, 80.0],
        // Above 1 / pi, where Optiland would cut.
        values: vec![0.9, 0.2, 0.1, 0.05, 0.6, 0.5, 0.2, 0.1, 0.1, 0.2, 0.3, 0.7],
    }
}

fn tabulated(table: &BsdfTable, transmissive_fraction: f64) -> Value {
    let rows: Vec<&[f64]> = table.values.chunks(table.theta_s.len()).collect();
    json!({ "type": "tabulated", "theta_i": table.theta_i, "theta_s": table.theta_s, "bsdf": rows,
            "transmissive_fraction": transmissive_fraction })
}

/// Of rays drawn evenly over the projected hemisphere a share p = sin^2(5 deg) lies in this lobe and carries pi times its
/// height; the others have no weight, and hit the detector as well. So the relative error is sqrt((1 - p) / (p n)).
#[test]
fn rays_without_weight_do_not_make_errors_small() {
    const NUM_RAYS: u64 = 200_000;
    let rows = vec![40.0, 40.0, 0.0, 0.0, 40.0, 40.0, 0.0, 0.0];
    let table = BsdfTable { theta_i: vec![0.0, 90.0], theta_s: vec![0.0, 5.0, 5.001, 90.0], values: rows };
    let map = json!({ "type": "irradiance", "name": "map", "cs": { "z": -20.0 }, "width": 100.0, "height": 100.0,
                      "num_pixels_x": 16, "num_pixels_y": 16 });
    let p = 5_f64.to_radians().sin().powi(2);
    let expected = ((1.0 - p) / (p * NUM_RAYS as f64)).sqrt();
    for precision in zoo::in_turn(PRECISIONS) {
        let result = trace(
            &scene(pencil(0.0), &[scatterer(tabulated(&table, 0.0))], std::slice::from_ref(&map)),
            NUM_RAYS,
            precision,
        );
        let detector = result.detector("map").unwrap();
        let error = detector.total_flux_standard_error.unwrap() / detector.total_flux;
        assert!((error / expected - 1.0).abs() < 0.1, "{precision:?}: {error} instead of {expected}");
        let of_hits = 1.0 / (detector.num_rays_hit as f64).sqrt();
        assert!(of_hits < 0.15 * expected, "{of_hits}: most rays without weight miss the map");
    }
}

#[test]
fn a_tabulated_ray_carries_pi_times_the_table() {
    let table = peaked_table();
    for (precision, tolerance) in [(Precision::F64, 1e-12), (Precision::F32, 2e-5)] {
        for (angle, transmissive_fraction) in
            [(0.0, 0.0), (12.5, 0.0), (30.0, 0.0), (77.0, 0.0), (77.0, 1.0), (20.0, 1.0)]
        {
            let z = if transmissive_fraction > 0.0 { 20.0 } else { -20.0 };
            let database = json!({ "type": "ray_database", "name": "rays", "cs": { "z": z }, "width": 1e6, "height": 1e6 });
            let mirror = scatterer(tabulated(&table, transmissive_fraction));
            let num_rays = 3000;
            let result = trace(&scene(pencil(angle), &[mirror], &[database]), num_rays, precision);
            let DetectorData::RayDatabase(rays) = &result.detector("rays").unwrap().data else { panic!() };
            let rays = rays.columns().unwrap();
            assert!(rays.flux.len() > 2990, "nearly all rays meet the detector");
            for i in 0..rays.flux.len() {
                let theta_s = rays.direction[2][i].abs().acos().to_degrees();
                let expected = PI * bilinear(&table, angle, theta_s);
                let weight = rays.flux[i] * num_rays as f64 * (1.0 - 1e-6);
                // Near the table's end rounding decides between its last value and 0.
                if (theta_s - 80.0).abs() > 1e-3 {
                    let off = (weight - expected).abs();
                    assert!(off <= tolerance, "{precision:?}, {angle}, {theta_s}: {weight}, not {expected}");
                }
            }
        }
    }
}

#[test]
fn the_flux_of_a_table_is_its_albedo() {
    let table = peaked_table();
    let num_rays = 100_000;
    let ir = scene(pencil(30.0), &[scatterer(tabulated(&table, 0.0))], &[sky(-20.0, 9)]);
    let scattered = flux(&trace(&ir, num_rays, Precision::F64), "sky");
    let expected = table.albedo(1);
    assert!(
        (scattered - expected).abs() < 4.0 * PI * 0.6 / (num_rays as f64).sqrt(),
        "{scattered}, not {expected}"
    );
    let constant =
        BsdfTable { theta_i: vec![0.0, 90.0], theta_s: vec![0.0, 90.0], values: vec![1.0 / PI; 4] };
    assert!((constant.albedo(0) - 1.0).abs() < 1e-15, "a white Lambertian surface");
}

#[test]
fn a_file_of_a_table_means_what_the_table_means() {
    let table = peaked_table();
    let mut lines = vec!["# theta_i, theta_s, bsdf".to_string(), String::new()];
    for (i, theta_i) in table.theta_i.iter().enumerate() {
        for (j, theta_s) in table.theta_s.iter().enumerate() {
            lines.push(format!(
                "{theta_i},\t{theta_s:e}, {} # a comment",
                table.values[i * table.theta_s.len() + j]
            ));
        }
    }
    lines[2..].reverse();
    let folder = tempfile::tempdir().unwrap();
    std::fs::create_dir(folder.path().join("data")).unwrap();
    std::fs::write(folder.path().join("data/table.csv"), lines.join("\r\n")).unwrap();
    let bsdf = json!({ "type": "tabulated", "path": "data/table.csv", "transmissive_fraction": 0.5 });
    let text = json!({
        "nsq_schema_version": 1, "sources": [pencil(0.0)], "detectors": [sky(-20.0, 9)],
        "nsq_gpu": { "version": 1, "surfaces": [scatterer(bsdf)] },
    });
    let path = folder.path().join("scene.json");
    std::fs::write(&path, text.to_string()).unwrap();
    let read = Scene::from_path(&path).unwrap();
    let scatter = read.lower().unwrap().surfaces.remove(0).scatter.unwrap();
    assert_eq!(scatter.bsdf, Bsdf::Tabulated(Tabulated { table, transmissive_fraction: 0.5 }));
    let warned = |words: &str| read.warnings.iter().any(|warning| warning.contains(words));
    assert!(warned("angles of incidence from 5 to 90"), "{:?}", read.warnings);
    assert!(warned("angles of scatter from 0 to 80"), "{:?}", read.warnings);
}

#[test]
fn doubtful_finishes_are_warned_of() {
    let warnings = |surface: Value| {
        let scene = json!({
            "nsq_schema_version": 1, "sources": [pencil(0.0)], "detectors": [sky(-20.0, 9)],
            "nsq_gpu": { "version": 1, "surfaces": [surface] },
        });
        Scene::from_json(&scene.to_string()).unwrap().warnings.join("\n")
    };
    let bright = BsdfTable { theta_i: vec![0.0, 90.0], theta_s: vec![0.0, 90.0], values: vec![0.5; 4] };
    assert!(warnings(scatterer(tabulated(&bright, 0.0))).contains("1.5708 times what it gets"));
    let narrow = json!({ "type": "harvey_shack", "b0": 1.0, "l0": 5e-4, "s": 2.0 });
    assert!(warnings(scatterer(narrow)).contains("too narrow"));
    let black = plane(json!({ "interaction": "absorbing", "bsdf": { "type": "specular" } }));
    assert!(warnings(black).contains("the BSDF of \"plane\" is ignored"));
    let idle = plane(json!({ "interaction": "refractive", "scatter_fraction": 0.5 }));
    assert!(warnings(idle).contains("the scatter_fraction of \"plane\" changes nothing"));
    let behind = plane(json!({ "interaction": "absorbing", "material_back": "N-BK7" }));
    assert!(warnings(behind).contains("the material_back of \"plane\" is ignored"));
    let wide = json!({ "type": "harvey_shack", "b0": 1.0, "l0": 0.01, "s": 1.5 });
    assert!(
        warnings(scatterer(wide)).contains("32.0 % of what it scatters at normal incidence has no direction")
    );
    let needle = json!({ "type": "k_correlation", "b0": 1.0, "B": 1e8, "s": 3.0 });
    assert!(warnings(scatterer(needle)).contains("which `f32` cannot resolve"));
    let broad = json!({ "type": "k_correlation", "b0": 1.0, "B": 100.0, "s": 1.5 });
    assert!(warnings(scatterer(broad)).contains("a larger B or a larger s narrows it"));
    let haze =
        json!({ "type": "harvey_shack", "b0": 1.0, "l0": 0.01, "s": 4.0, "transmissive_fraction": 0.25 });
    assert_eq!(warnings(scatterer(haze.clone())), "");
    let hazy = plane(json!({ "interaction": "refractive", "bsdf": haze }));
    assert!(warnings(hazy).contains("75.0 % goes to the other side than Fresnel's branch"));
    assert_eq!(warnings(scatterer(json!({ "type": "lambertian" }))), "");
}

// Coatings

fn coating(reflectance: f64, transmittance: f64) -> Value {
    json!({ "type": "simple", "reflectance": reflectance, "transmittance": transmittance })
}

/// A plate of glass between two coated faces, seen from both sides.
fn coated_plate(reflectance: f64, transmittance: f64) -> SceneIr {
    let glass = json!({ "type": "medium", "name": "clear" });
    let face = |name: &str, z: f64, front: Value, back: Value| {
        json!({ "name": name, "cs": { "z": z }, "shape": { "type": "plane" }, "interaction": "refractive",
                "material_front": front, "material_back": back, "coating": coating(reflectance, transmittance) })
    };
    let faces = [face("in", 0.0, Value::Null, glass.clone()), face("out", 3.0, glass, Value::Null)];
    lowered(&json!({
        "nsq_schema_version": 1, "sources": [pencil(0.0)], "detectors": [sky(-20.0, 9), sky_behind()],
        "nsq_gpu": { "version": 1, "surfaces": faces, "sampling": { "rr_start_flux": 0.0 },
                     "media": { "clear": { "type": "constant", "n": 1.5 } } },
    }))
}

#[test]
fn a_coating_that_reflects_nothing_transmits_exactly_its_transmittance() {
    for (precision, tolerance) in [(Precision::F64, 1e-14), (Precision::F32, 1e-6)] {
        let result = trace(&coated_plate(0.0, 0.99), 1000, precision);
        assert!((flux(&result, "behind") - 0.99 * 0.99).abs() < tolerance);
        assert!((result.ledger.coating.flux - (1.0 - 0.99 * 0.99)).abs() < tolerance);
    }
}

/// A plate of faces R, T transmits T^2 / (1 - R^2) and reflects R (1 + T^2 / (1 - R^2)); its coatings take the rest.
#[test]
fn a_coated_plate_sums_its_internal_reflections() {
    let num_rays = 200_000;
    for policy in [
        nsq_gpu::model::ReflectProb::Fresnel,
        nsq_gpu::model::ReflectProb::Auto,
        nsq_gpu::model::ReflectProb::Constant(0.6),
    ] {
        for (r, t) in [(0.3, 0.6), (0.1, 0.9), (0.5, 0.2)] {
            let mut ir = coated_plate(r, t);
            ir.sampling.reflect_prob = policy;
            let result = trace(&ir, num_rays, Precision::F64);
            let transmitted = t * t / (1.0 - r * r);
            let reflected = r * (1.0 + transmitted);
            // Weights stay below 2.5 under each policy.
            let limit = 4.0 * 2.5 * 0.5 / (num_rays as f64).sqrt();
            for (what, found, expected) in [
                ("transmitted", flux(&result, "behind"), transmitted),
                ("reflected", flux(&result, "sky"), reflected),
                ("absorbed", result.ledger.coating.flux, 1.0 - transmitted - reflected),
            ] {
                assert!(
                    (found - expected).abs() < limit,
                    "{policy:?}, {r}, {t}, {what}: {found}, not {expected}"
                );
            }
        }
    }
}

#[test]
fn no_coating_breaks_total_reflection() {
    let face = plane(json!({ "interaction": "refractive", "coating": coating(0.01, 0.98),
                             "material_front": { "type": "medium", "name": "clear" } }));
    let mut source = pencil(60.0);
    source["medium"] = json!({ "type": "medium", "name": "clear" });
    let ir = lowered(&json!({
        "nsq_schema_version": 1, "sources": [source], "detectors": [sky(-20.0, 9), sky_behind()],
        "nsq_gpu": { "version": 1, "surfaces": [face], "sampling": { "reflect_prob": 0.3 },
                     "media": { "clear": { "type": "constant", "n": 1.5 } } },
    }));
    let result = trace(&ir, 1000, Precision::F64);
    assert_eq!((flux(&result, "sky"), result.ledger.coating.flux), (1.0, 0.0));
}

#[test]
fn coatings_by_wavelength_are_looked_up() {
    let mut ir = coated_plate(0.0, 0.0);
    ir.wavelengths = vec![0.5, 0.6];
    for medium in &mut ir.media {
        (medium.n, medium.k) = (vec![medium.n[0]; 2], vec![0.0; 2]);
    }
    ir.sources[0].spectrum = nsq_gpu::model::Spectrum { wavelengths: vec![0, 1], cdf: vec![0.5, 1.0] };
    for surface in &mut ir.surfaces {
        let coating = SimpleCoating { reflectance: vec![0.0, 1.0], transmittance: vec![0.5, 0.0] };
        surface.coating = Some(Coating::Simple(coating));
    }
    let result = trace(&ir, 40_000, Precision::F64);
    let hits = |name: &str| result.detector(name).unwrap().num_rays_hit as f64;
    assert!((hits("sky") - 20_000.0).abs() < 400.0 && hits("sky") + hits("behind") == 40_000.0);
    let through = flux(&result, "behind") / (hits("behind") / 40_000.0);
    assert!((through - 0.25).abs() < 1e-12, "{through}");
}

/// A table of equal columns takes the decisions of the simple coating.
#[test]
fn a_table_that_is_the_same_at_every_angle_is_a_simple_coating() {
    let simple = coated_plate(0.25, 0.5);
    let mut tabulated = simple.clone();
    for surface in &mut tabulated.surfaces {
        let table = surface.coating.as_ref().unwrap().tabulated();
        surface.coating = Some(Coating::Tabulated(table));
    }
    for precision in zoo::in_turn(PRECISIONS) {
        let [simple, tabulated] = [&simple, &tabulated].map(|ir| trace(ir, 10_000, precision));
        for name in ["sky", "behind"] {
            assert_eq!(flux(&simple, name), flux(&tabulated, name), "{name}, {precision:?}");
        }
    }
}

/// A simple coating takes nothing of what is totally reflected, whatever coatings other surfaces have.
#[test]
fn a_table_elsewhere_leaves_a_simple_coating_as_it_is() {
    let face = |name: &str, z: f64, coating: Value| {
        json!({ "name": name, "cs": { "z": z }, "shape": { "type": "plane" }, "interaction": "refractive", "coating": coating,
                "material_front": { "type": "medium", "name": "clear" } })
    };
    let table = json!({
        "type": "tabulated", "wavelengths": [0.5], "angles": [0.0, 90.0],
        "reflectance": [[0.5, 1.0]], "transmittance": [[0.25, 0.0]],
        "reflectance_back": [[0.5, 1.0]], "transmittance_back": [[0.25, 0.0]],
    });
    let mut source = pencil(60.0);
    source["medium"] = json!({ "type": "medium", "name": "clear" });
    for (coating_here, lost) in [(coating(0.25, 0.5), 0.0), (table.clone(), 1.0 - 0.75 - 0.25 * 0.5)] {
        let faces = [face("here", 0.0, coating_here), face("elsewhere", 1e3, table.clone())];
        let ir = lowered(&json!({
            "nsq_schema_version": 1, "sources": [source], "detectors": [sky(-20.0, 9), sky_behind()],
            "nsq_gpu": { "version": 1, "surfaces": faces, "media": { "clear": { "type": "constant", "n": 1.5 } },
                         "sampling": { "rr_start_flux": 0.0 } },
        }));
        let result = trace(&ir, 1000, Precision::F64);
        assert!((result.ledger.coating.flux - lost).abs() < 1e-12, "{} lost", result.ledger.coating.flux);
        assert!((flux(&result, "sky") - (1.0 - lost)).abs() < 1e-12);
    }
}

/// A coating by angle in a file: angles ascend there, and reflectances of a lossless film add up with transmittances.
#[test]
fn coatings_by_angle_are_read() {
    let rows = |values: [f64; 3]| json!([[0.0, 0.0, 0.0], values]);
    let coating = json!({
        "type": "tabulated", "wavelengths": [0.4, 0.5], "angles": [0.0, 60.0, 90.0],
        "reflectance": rows([0.25, 0.5, 1.0]), "transmittance": rows([0.5, 0.25, 0.0]),
        "reflectance_back": rows([0.125, 0.125, 0.125]), "transmittance_back": rows([0.25, 0.25, 0.25]),
    });
    let face = |interaction: &str| plane(json!({ "interaction": interaction, "coating": coating }));
    for (angle, reflected, transmitted) in [(0.0, 0.25, 0.5), (f64::acos(0.75).to_degrees(), 0.375, 0.375)] {
        let mut ir = scene(pencil(angle), &[face("refractive")], &[sky(-20.0, 9), sky_behind()]);
        ir.sampling.split_depth = 1;
        ir.sampling.split_budget = 2.0;
        let result = trace(&ir, 1000, Precision::F64);
        assert!((flux(&result, "sky") - reflected).abs() < 1e-12, "{}", flux(&result, "sky"));
        assert!((flux(&result, "behind") - transmitted).abs() < 1e-12);
        let mirror = scene(pencil(angle), &[face("reflective")], &[sky(-20.0, 9)]);
        let result = trace(&mirror, 1000, Precision::F64);
        assert!((flux(&result, "sky") - reflected).abs() < 1e-12);
    }
}

#[test]
fn a_mirror_reflects_what_its_coating_reflects() {
    let mirror = plane(json!({ "interaction": "reflective", "coating": coating(0.75, 0.1) }));
    let result = trace(&scene(pencil(20.0), &[mirror], &[sky(-20.0, 9)]), 1000, Precision::F64);
    assert_eq!(flux(&result, "sky"), 0.75);
    assert_eq!(result.ledger.surface.flux, 0.25, "a mirror's loss, not a coating's");
}

// Tiers

#[test]
fn f32_scatters_as_f64_does() {
    for name in ["lambertian_sphere", "scattering_telescope", "coated_projector", "opal_lamp"] {
        let ir = zoo::load(name);
        let [f32, f64] = PRECISIONS.map(|precision| trace(&ir, 20_000, precision));
        for (ours, exact) in f32.detectors.iter().zip(&f64.detectors) {
            let off = (ours.total_flux - exact.total_flux).abs() / exact.total_flux;
            eprintln!("{name:24} {:12} {off:.1e}", exact.name);
            assert!(off < 1e-3, "{name}, {}: {off:e}", exact.name);
        }
    }
}

// Measured

/// An asymmetrical table: by angle of incidence, azimuth and radial angle.
fn lopsided(scatter_type: &str) -> Value {
    let rows = |level: f64| {
        let row =
            |by: f64| json!([3.0 * level, 2.0 * level * by, 0.6 * level * by, 0.2 * level * by, 0.1 * level]);
        json!([row(1.0), row(0.4), row(0.9), row(1.6)])
    };
    json!({"type": "measured", "scatter_type": scatter_type, "angle_of_incidence_deg": [20, 60],
        "scatter_azimuth_deg": [0, 80, 180, 270], "scatter_radial_deg": [0, 10, 25, 60, 150],
        "values": [rows(0.2), rows(0.5)]})
}

/// The value of that table in a direction, as written here; not 0 below the surface.
fn lopsided_at(incidence: f64, azimuth: f64, radial: f64) -> f64 {
    let linear = |xs: &[f64], ys: &[f64], x: f64| {
        let i = xs.windows(2).position(|ends| (ends[0]..=ends[1]).contains(&x)).unwrap();
        ys[i] + (ys[i + 1] - ys[i]) * (x - xs[i]) / (xs[i + 1] - xs[i])
    };
    if radial > 150.0 {
        return 0.0;
    }
    let row =
        |by: f64| linear(&[0.0, 10.0, 25.0, 60.0, 150.0], &[3.0, 2.0 * by, 0.6 * by, 0.2 * by, 0.1], radial);
    let around = linear(
        &[0.0, 80.0, 180.0, 270.0, 360.0],
        &[row(1.0), row(0.4), row(0.9), row(1.6), row(1.0)],
        azimuth.rem_euclid(360.0),
    );
    around * linear(&[20.0, 60.0], &[0.2, 0.5], incidence.clamp(20.0, 60.0))
}

/// Of a slanted pencil, every direction gets what the table says of it.
#[test]
fn a_measured_table_gives_each_direction_its_own() {
    let (num_theta, num_phi, num_rays) = (9_usize, 8_usize, 400_000_u64);
    for (incidence, scatter_type, precision) in [
        (35.0, "BRDF", Precision::F64),
        (35.0, "BRDF", Precision::Df64),
        (75.0, "BRDF", Precision::F32),
        (50.0, "BTDF", Precision::F64),
        (10.0, "BTDF", Precision::F32),
    ] {
        let side = if scatter_type == "BRDF" { -1.0 } else { 1.0 };
        let wall = scatterer(lopsided(scatter_type));
        let ir = scene(pencil(incidence), &[wall], &[sky(20.0 * side, num_theta as u32)]);
        let result = trace(&ir, num_rays, precision);
        let DetectorData::FarField(found) = &result.detector("sky").unwrap().data else { panic!() };
        let (sine, cosine) = incidence.to_radians().sin_cos();
        let specular = glam::DVec3::new(sine, 0.0, side * cosine);
        let normal = glam::DVec3::new(0.0, 0.0, side);
        let towards = (normal - normal.dot(specular) * specular).normalize();
        let across = specular.cross(towards);
        let bsdf = |theta: f64, phi: f64| {
            let d = glam::DVec3::new(theta.sin() * phi.cos(), theta.sin() * phi.sin(), side * theta.cos());
            let radial = d.dot(specular).clamp(-1.0, 1.0).acos().to_degrees();
            lopsided_at(incidence, d.dot(across).atan2(d.dot(towards)).to_degrees(), radial)
        };
        let (step_theta, step_phi) = (FRAC_PI_2 / num_theta as f64, 2.0 * PI / num_phi as f64);
        let mut total = 0.0;
        for i in 0..num_theta {
            for j in 0..num_phi {
                let n = 40;
                let at = |k: i32, step: f64| step * (f64::from(k) + 0.5) / f64::from(n);
                let expected: f64 = (0..n * n)
                    .map(|k| {
                        let theta = i as f64 * step_theta + at(k / n, step_theta);
                        bsdf(theta, j as f64 * step_phi - PI + at(k % n, step_phi))
                            * theta.sin()
                            * theta.cos()
                    })
                    .sum::<f64>()
                    * step_theta
                    * step_phi
                    / f64::from(n * n);
                let edges = [i, i + 1].map(|i| i as f64 * step_theta);
                let seen = found.intensity[[i, j]] * step_phi * (edges[0].cos() - edges[1].cos());
                // No ray weighs more than 2.
                let sigma = (2.0 * expected / num_rays as f64).sqrt();
                assert!(
                    (seen - expected).abs() < 4.5 * sigma + 2e-3 * expected,
                    "{incidence} {scatter_type} {precision:?}, bin {i} {j}: {seen}, not {expected} +- {sigma}"
                );
                total += expected;
            }
        }
        let flux = flux(&result, "sky");
        assert!((flux / total - 1.0).abs() < 5e-3, "{flux} of {total}");
    }
}

/// Where a file states its TIS, so much scatters; `tis` as the fraction makes the rest a mirror's.
#[test]
fn a_measured_file_keeps_its_energy() {
    let mut table = lopsided("BRDF");
    table["tis"] = json!([0.3, 0.1]);
    for (incidence, share) in [(20.0, 0.3), (60.0, 0.1)] {
        let ir = scene(pencil(incidence), &[scatterer(table.clone())], &[sky(-20.0, 9)]);
        let seen = flux(&trace(&ir, 200_000, Precision::F64), "sky");
        assert!((seen / share - 1.0).abs() < 6e-3, "{seen} of {share} at {incidence}");
    }
    let mirror = plane(
        json!({ "interaction": "reflective", "reflectance": 1.0, "bsdf": table, "scatter_fraction": "tis" }),
    );
    let ir = scene(pencil(60.0), &[mirror], &[sky(-20.0, 9)]);
    assert!((ir.surfaces[0].scatter.as_ref().unwrap().fraction - 0.3).abs() < 1e-12);
    let seen = flux(&trace(&ir, 200_000, Precision::F64), "sky");
    assert!((seen - (0.7 + 0.1)).abs() < 2e-3, "{seen}");
}
