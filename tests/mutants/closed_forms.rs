//! Scenes whose results are known in closed form.

use crate::bench::{Bench, Setting};
use crate::checks::Outcome;
use glam::{DMat3, DVec3};
use nsq_gpu::TraceResult;
use nsq_gpu::ir::{
    Emitter, EmitterKind, Frame, Interaction, Medium, Outline, PixelGrid, ReflectProb, Sampling, SceneIr,
    Sensor, SensorKind, Shape, Spectrum, Splat, Surface,
};
use nsq_gpu::result::DetectorData;

/// The closed form of this name.
pub fn named(name: &str) -> Option<fn(&Bench) -> Outcome> {
    Some(match name {
        "window" => window,
        "window, importance" => window_by_importance,
        "total reflection" => total_reflection,
        "absorbing slab" => absorbing_slab,
        "mirrors and roulette" => mirrors_and_roulette,
        "roulette in passing" => roulette_in_passing,
        "cap" => cap,
        "lambertian" => lambertian,
        "extended cap" => extended_cap,
        "ties" => ties,
        "many faces" => many_faces,
        _ => return None,
    })
}

const INDEX: f64 = 1.5;

fn at(z: f64) -> Frame {
    Frame { origin: DVec3::new(0.0, 0.0, z), rotation: DMat3::IDENTITY }
}

fn plane(name: &str, z: f64, interaction: Interaction, front: usize, back: usize) -> Surface {
    let shape = Shape::Plane(Outline::Infinite);
    Surface { name: name.into(), frame: at(z), shape, interaction, front, back, coating: None, scatter: None }
}

fn pixels(name: &str, z: f64) -> Sensor {
    let grid = PixelGrid { width: 1e3, height: 1e3, num_pixels_x: 8, num_pixels_y: 8, splat: Splat::Hard };
    Sensor { name: name.into(), frame: at(z), kind: SensorKind::Irradiance(grid), absorb: true }
}

fn sky() -> Sensor {
    let kind = SensorKind::FarField { num_theta: 18, num_phi: 8 };
    Sensor { name: "sky".into(), frame: at(10.0), kind, absorb: true }
}

fn beam() -> EmitterKind {
    EmitterKind::CollimatedTophat { aperture_radius: 1.0 }
}

/// Media: vacuum, glass, and a vapour of index 1 that absorbs.
fn scene(kind: EmitterKind, surfaces: Vec<Surface>, sensors: Vec<Sensor>) -> SceneIr {
    let medium =
        |name: &str, n, k| Medium { name: name.into(), ambient: name == "vacuum", n: vec![n], k: vec![k] };
    SceneIr {
        wavelengths: vec![0.5],
        media: vec![medium("vacuum", 1.0, 0.0), medium("glass", INDEX, 0.0), medium("vapour", 1.0, 0.0)],
        surfaces,
        meshes: vec![],
        emitters: vec![Emitter {
            name: "lamp".into(),
            frame: at(0.0),
            kind,
            total_flux: 1.0,
            spectrum: Spectrum { wavelengths: vec![0], cdf: vec![1.0] },
            medium: SceneIr::VACUUM,
        }],
        sensors,
        sampling: Sampling { rr_start_flux: 0.0, ..Sampling::default() },
    }
}

fn trace(bench: &Bench, ir: &SceneIr, num_rays: u64) -> TraceResult {
    let mut setting = Setting::default();
    setting.options.num_rays = num_rays;
    setting.options.max_depth = 64;
    setting.options.events_per_dispatch = 64;
    setting.options.min_flux_fraction = 0.0;
    bench.result(ir, &setting)
}

/// A mean over rays of values up to `largest` is within five standard deviations of its expectation.
fn near(what: &str, mean: f64, expected: f64, num_rays: u64, largest: f64) -> Outcome {
    let sigma = (expected * (largest - expected).max(0.0) / num_rays as f64).sqrt();
    let limit = 5.0 * sigma + 1e-12;
    if (mean - expected).abs() <= limit {
        Ok(())
    } else {
        Err(format!("{what} is {mean} instead of {expected} +- {limit}"))
    }
}

fn window_scene() -> SceneIr {
    let surfaces = vec![
        plane("front", 5.0, Interaction::Refractive, 0, 1),
        plane("back", 6.0, Interaction::Refractive, 1, 0),
    ];
    scene(beam(), surfaces, vec![pixels("through", 10.0), pixels("back", -10.0)])
}

/// All orders of reflection between two faces at normal incidence: T = 2n / (n^2 + 1).
fn window(bench: &Bench) -> Outcome {
    let num_rays = 50_000;
    let result = trace(bench, &window_scene(), num_rays);
    let expected = 2.0 * INDEX / (INDEX * INDEX + 1.0);
    near("transmittance", result.detectors[0].total_flux, expected, num_rays, 1.0)?;
    near("reflectance", result.detectors[1].total_flux, 1.0 - expected, num_rays, 1.0)
}

/// The same with reflection drawn by other probabilities: the weights put it right.
fn window_by_importance(bench: &Bench) -> Outcome {
    let num_rays = 50_000;
    for probability in [ReflectProb::Auto, ReflectProb::Constant(0.4)] {
        let mut ir = window_scene();
        ir.sampling.reflect_prob = probability;
        let result = trace(bench, &ir, num_rays);
        let expected = 2.0 * INDEX / (INDEX * INDEX + 1.0);
        // Straight through weighs (T / (1 - p))^2, at most 2.6 for p = 0.4.
        near("transmittance", result.detectors[0].total_flux, expected, num_rays, 3.0)?;
    }
    Ok(())
}

/// At 60 degrees from within glass everything is reflected.
fn total_reflection(bench: &Bench) -> Outcome {
    let face = plane("face", 5.0, Interaction::Refractive, 1, 0);
    let mut ir = scene(beam(), vec![face], vec![pixels("inside", -10.0), pixels("outside", 10.0)]);
    ir.emitters[0].medium = 1;
    ir.emitters[0].frame.rotation = DMat3::from_rotation_x(60.0_f64.to_radians());
    let result = trace(bench, &ir, 10_000);
    near("flux inside", result.detectors[0].total_flux, 1.0, 10_000, 1.0)
}

/// exp(-4 pi k L / lambda), of every ray.
fn absorbing_slab(bench: &Bench) -> Outcome {
    let extinction = 1e-5;
    let surfaces = vec![
        plane("front", 5.0, Interaction::Refractive, 0, 2),
        plane("back", 9.0, Interaction::Refractive, 2, 0),
    ];
    let mut ir = scene(beam(), surfaces, vec![pixels("through", 10.0)]);
    ir.media[2].k[0] = extinction;
    let result = trace(bench, &ir, 10_000);
    let expected = (-4.0 * std::f64::consts::PI * extinction * 4e3 / 0.5_f64).exp();
    near("transmittance", result.detectors[0].total_flux, expected, 10_000, expected)
}

/// Between mirrors of R = 0.5 a detector reads R + R^2 in passing; roulette keeps the mean.
fn mirrors_and_roulette(bench: &Bench) -> Outcome {
    let num_rays = 50_000;
    let half = || Interaction::Reflective { reflectance: vec![0.5] };
    let surfaces = vec![plane("far", 5.0, half(), 0, 0), plane("near", -5.0, half(), 0, 0)];
    let mut middle = pixels("middle", 2.0);
    middle.absorb = false;
    let mut ir = scene(beam(), surfaces, vec![middle]);
    ir.sampling.rr_start_flux = 0.4;
    let result = trace(bench, &ir, num_rays);
    // 1 towards the far mirror and R back from it, then R^2 towards it, and so on: 1 / (1 - R).
    near("flux read", result.detectors[0].total_flux, 2.0, num_rays, 4.0)
}

/// In an absorbing medium a ray may fall below the threshold on its way to a transmissive detector.
fn roulette_in_passing(bench: &Bench) -> Outcome {
    let num_rays = 50_000;
    let mut passed = pixels("passed", 4.0);
    passed.absorb = false;
    let mut ir = scene(beam(), vec![], vec![passed, pixels("end", 8.0)]);
    ir.emitters[0].medium = 2;
    ir.media[2].k[0] = 1e-5;
    ir.sampling.rr_start_flux = 0.9;
    let result = trace(bench, &ir, num_rays);
    let survival = (-4.0 * std::f64::consts::PI * 1e-5 * 4e3 / 0.5_f64).exp() / 0.9;
    near("survivors", result.detectors[1].num_rays_hit as f64 / num_rays as f64, survival, num_rays, 1.0)
}

/// Shares of the flux within the first polar bins of the sky.
fn polar_shares(result: &TraceResult) -> Vec<(f64, f64)> {
    let DetectorData::FarField(pattern) = &result.detectors[0].data else { panic!("the sky is a far field") };
    let counts: Vec<f64> = pattern.hits.rows().into_iter().map(|row| row.sum() as f64).collect();
    let total: f64 = counts.iter().sum();
    let edge = |bins: usize| (bins as f64 * 90.0 / counts.len() as f64).to_radians();
    (1..=counts.len()).map(|bins| (edge(bins), counts[..bins].iter().sum::<f64>() / total)).collect()
}

fn compare_shares(bench: &Bench, kind: EmitterKind, share: impl Fn(f64) -> f64) -> Outcome {
    let num_rays = 50_000;
    let result = trace(bench, &scene(kind, vec![], vec![sky()]), num_rays);
    near("flux seen", result.detectors[0].total_flux, 1.0, num_rays, 1.0)?;
    polar_shares(&result).into_iter().try_for_each(|(angle, seen)| {
        near(&format!("share within {angle}"), seen, share(angle), num_rays, 1.0)
    })
}

const HALF_ANGLE: f64 = 1.0;

/// Uniform in solid angle: (1 - cos theta) / (1 - cos half angle).
fn share_of_cap(angle: f64) -> f64 {
    ((1.0 - angle.cos()) / (1.0 - HALF_ANGLE.cos())).min(1.0)
}

fn cap(bench: &Bench) -> Outcome {
    compare_shares(bench, EmitterKind::Point { half_angle: HALF_ANGLE }, share_of_cap)
}

fn extended_cap(bench: &Bench) -> Outcome {
    let area = Outline::Disk { radius: 1.0 };
    compare_shares(bench, EmitterKind::Extended { area, half_angle: HALF_ANGLE }, share_of_cap)
}

/// Lambert's law: sin^2 theta.
fn lambertian(bench: &Bench) -> Outcome {
    let area = Outline::Rectangle { width: 1.0, height: 2.0 };
    let half_angle = std::f64::consts::FRAC_PI_2;
    compare_shares(bench, EmitterKind::Extended { area, half_angle }, |angle| angle.sin().powi(2))
}

/// Of two surfaces at one place the first in the list takes every ray, and a surface takes it before a detector.
fn ties(bench: &Bench) -> Outcome {
    let stop = |name| plane(name, 5.0, Interaction::Absorbing, 0, 0);
    let ir = scene(beam(), vec![stop("first"), stop("second")], vec![pixels("there", 5.0)]);
    let result = trace(bench, &ir, 1_000);
    let taken: Vec<u64> = result.surfaces.iter().map(|surface| surface.num_rays_absorbed).collect();
    if taken == [1_000, 0] { Ok(()) } else { Err(format!("the surfaces took {taken:?} rays")) }
}

/// Through faces between media of one index a beam goes straight: it reaches each, and none behind the detector.
fn many_faces(bench: &Bench) -> Outcome {
    let face = |i: u32| plane("face", 5.0 + f64::from(i), Interaction::Refractive, 0, 2);
    let mut surfaces: Vec<Surface> = (0..40).map(face).collect();
    surfaces.push(plane("behind", 99.0, Interaction::Absorbing, 0, 0));
    let ir = scene(beam(), surfaces, vec![pixels("end", 50.0)]);
    let mut setting = Setting::default();
    setting.options.max_depth = 64;
    setting.options.baked = Some(true);
    let result = bench.result(&ir, &setting);
    let reached = result.surfaces.iter().filter(|surface| surface.reached).count();
    if reached == 40 && !result.surfaces[40].reached {
        Ok(())
    } else {
        Err(format!("{reached} faces are reached"))
    }
}
