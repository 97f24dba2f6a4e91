//! Scenes whose results are known in closed form.

use crate::bench::{Bench, Setting};
use crate::checks::Outcome;
use crate::zoo;
use glam::{DMat3, DVec2, DVec3};
use nsq_gpu::guide::learn::Wanted;
use nsq_gpu::model::bsdfs::{self, harvey_shack};
use nsq_gpu::model::ray_id::{self, NUM_REPLICATES};
use nsq_gpu::model::scatter_sampling::{ScatterSampling, Target, TargetShape};
use nsq_gpu::model::shapes::aperture::{ApertureOutline, Axes};
use nsq_gpu::model::shapes::freeform::Polynomial;
use nsq_gpu::model::shapes::{Biconic, Freeform, SagSurface, Toroidal};
use nsq_gpu::model::sources::rays::{Bounds, FileRays, Order, RayGroup, RayStream, StreamedRay};
use nsq_gpu::model::sources::{self, Aim};
use nsq_gpu::model::{
    Aperture, AsphereProfile, Bsdf, BsdfTable, ClippedConic, Coating, CoatingRow, Collimated, Conic,
    Detector, DetectorKind, End, Extended, FarField, Frame, HarveyShack, Interaction, KCorrelation,
    Lambertian, Measured, MeasuredRow, MeasuredTable, Medium, Mesh, MeshId, Outline, PathFilter, PixelGrid,
    Point, PolarTable, Pupil, RayDatabase, ReflectProb, Sampling, Scatter, SceneIr, Shape, SimpleCoating,
    Source, SourceKind, Spectral, Spectrum, Splat, StepKind, Surface, Tabulated, TabulatedCoating,
};
use nsq_gpu::program::layout::rng;
use nsq_gpu::program::{Precision, Sampler};
use nsq_gpu::result::{DetectorData, Ledger, PathEvent, PathEventKind, RayRow, Tally};
use nsq_gpu::run::{Collect, RecordPaths};
use nsq_gpu::{StandardError, TraceResult};
use std::sync::Arc;

/// The closed form of this name.
pub fn named(name: &str) -> Option<fn(&Bench) -> Outcome> {
    Some(match name {
        "double words" => Bench::double_words,
        "window" => window,
        "window, importance" => window_by_importance,
        "total reflection" => total_reflection,
        "absorbing slab" => absorbing_slab,
        "mirrors and roulette" => mirrors_and_roulette,
        "roulette in passing" => roulette_in_passing,
        "cap" => cap,
        "lambertian" => lambertian,
        "extended cap" => extended_cap,
        "aspheres" => aspheres,
        "freeforms" => freeforms,
        "clipped" => clipped,
        "pupil" => pupil,
        "aimed" => aimed,
        "lamp" => lamp,
        "rays of a file" => rays_of_a_file,
        "uploaded rays" => uploaded_rays,
        "guided plate" => guided_plate,
        "guided ghost" => guided_ghost,
        "guided scatterers" => guided_scatterers,
        "guided scattering" => guided_scattering,
        "ties" => ties,
        "many faces" => many_faces,
        "points over an area" => points_over_an_area,
        "points over the sky" => points_over_the_sky,
        "points of a window" => points_of_a_window,
        "points of half mirrors" => points_of_half_mirrors,
        "points of scrambles" => points_of_scrambles,
        "coating by angle" => coating_by_angle,
        "simple coating beside a table" => simple_coating_beside_a_table,
        "scatter gain" => scatter_gain,
        "K-correlation" => k_correlation,
        "scatter towards targets" => scatter_towards_targets,
        "measured BSDF" => measured_bsdf,
        "split plate" => split_plate,
        "split faint" => split_faint,
        "split draws" => split_draws,
        "split saturation" => split_saturation,
        "split mesh" => split_mesh,
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

fn pixels(name: &str, z: f64) -> Detector {
    let grid = PixelGrid { width: 1e3, height: 1e3, num_pixels_x: 8, num_pixels_y: 8, splat: Splat::Hard };
    Detector { name: name.into(), frame: at(z), kind: DetectorKind::Irradiance(grid), absorb: true }
}

fn sky() -> Detector {
    let kind = DetectorKind::FarField(FarField { num_theta: 18, num_phi: 8, sphere: false });
    Detector { name: "sky".into(), frame: at(10.0), kind, absorb: true }
}

fn beam() -> SourceKind {
    SourceKind::Collimated(Collimated { aperture_radius: 1.0, sigma: None })
}

/// Media: vacuum, glass, and a vapour of index 1 that absorbs.
fn scene(kind: SourceKind, surfaces: Vec<Surface>, detectors: Vec<Detector>) -> SceneIr {
    let medium =
        |name: &str, n, k| Medium { name: name.into(), ambient: name == "vacuum", n: vec![n], k: vec![k] };
    SceneIr {
        wavelengths: vec![0.5],
        media: vec![medium("vacuum", 1.0, 0.0), medium("glass", INDEX, 0.0), medium("vapour", 1.0, 0.0)],
        surfaces,
        meshes: vec![],
        sources: vec![Source {
            name: "lamp".into(),
            frame: at(0.0),
            kind,
            total_flux: 1.0,
            spectrum: Spectrum { wavelengths: vec![0], cdf: vec![1.0] },
            medium: SceneIr::VACUUM,
        }],
        detectors,
        scatter_sampling: vec![],
        sampling: Sampling { rr_start_flux: 0.0, ..Sampling::default() },
        allowed: Default::default(),
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
    ir.sources[0].medium = 1;
    ir.sources[0].frame.rotation = DMat3::from_rotation_x(60.0_f64.to_radians());
    let result = trace(bench, &ir, 10_000);
    near("flux inside", result.detectors[0].total_flux, 1.0, 10_000, 1.0)
}

/// A face of glass, bare beside one that is coated by angle, and a mirror: each branch of a split carries what the table
/// says, from both sides, between its angles, at its second wavelength, and in total reflection.
fn coating_by_angle(bench: &Bench) -> Outcome {
    // Columns at the cosines 0, 1/2 and 1. They are dyadic, as their means are, and so the sums below are exact.
    let row = CoatingRow {
        reflectance: vec![1.0, 0.25, 0.125],
        transmittance: vec![0.0, 0.5, 0.75],
        reflectance_back: vec![0.75, 0.5, 0.25],
        transmittance_back: vec![0.125, 0.25, 0.5],
    };
    let dark = CoatingRow {
        reflectance: vec![0.0; 3],
        transmittance: vec![1.0; 3],
        reflectance_back: vec![0.0; 3],
        transmittance_back: vec![1.0; 3],
    };
    let table = TabulatedCoating { cosines: vec![0.0, 0.5, 1.0], rows: vec![dark, row] };
    let coating = Some(Coating::Tabulated(table));
    // The cosine, whether from the back, a mirror, coated, and what is reflected and transmitted.
    let bare = ((INDEX - 1.0) / (INDEX + 1.0)).powi(2);
    let cases = [
        (1.0, false, false, true, 0.125, 0.75),
        (0.75, false, false, true, 0.1875, 0.625),
        (0.25, false, false, true, 0.625, 0.25),
        (1.0, true, false, true, 0.25, 0.5),
        (0.875, true, false, true, 0.3125, 0.4375),
        // Beyond the critical angle, whose cosine is 0.745: R + T remains.
        (0.5, true, false, true, 0.75, 0.0),
        (0.25, true, false, true, 0.8125, 0.0),
        (0.75, false, true, true, 0.1875, 0.0),
        (0.75, true, true, true, 0.375, 0.0),
        (1.0, false, false, false, bare, 1.0 - bare),
        (1.0, false, true, false, 0.75, 0.0),
    ];
    for (cosine, from_back, is_mirror, is_coated, reflected, transmitted) in cases {
        let interaction = if is_mirror {
            Interaction::Reflective { reflectance: vec![0.75; 2] }
        } else {
            Interaction::Refractive
        };
        let mut face = plane("face", 5.0, interaction, 0, usize::from(!is_mirror));
        face.coating = coating.clone().filter(|_| is_coated);
        // No ray comes to it. Its table is the first, and the only one where the face is bare.
        let mut beside = plane("beside", 30.0, Interaction::Refractive, 0, 0);
        beside.coating = Some(Coating::Tabulated(TabulatedCoating {
            cosines: vec![0.0, 1.0],
            rows: vec![
                CoatingRow {
                    reflectance: vec![0.5; 2],
                    transmittance: vec![0.5; 2],
                    reflectance_back: vec![0.5; 2],
                    transmittance_back: vec![0.5; 2],
                };
                2
            ],
        }));
        let mut ir = split_scene(vec![beside, face], 1, 2.0);
        have_two_wavelengths(&mut ir);
        ir.sources[0].spectrum.wavelengths = vec![1];
        if from_back {
            ir.sources[0].frame.origin.z = 10.0;
            ir.sources[0].medium = usize::from(!is_mirror);
        }
        let turn = f64::acos(cosine) + if from_back { std::f64::consts::PI } else { 0.0 };
        ir.sources[0].frame.rotation = DMat3::from_rotation_x(turn);
        let (rows, ledger, _) = split_rows(bench, &ir, 16, Precision::F64);
        let flux = |below: bool| {
            let there = rows.iter().filter(|row| (row.position[2] < 5.0) == below);
            there.map(|row| row.weight).sum::<f64>() / SPLIT_RAYS as f64
        };
        let found = [flux(!from_back), flux(from_back)];
        let lost = if is_mirror { ledger.surface.flux } else { ledger.coating.flux };
        let expected = [reflected, transmitted, 1.0 - reflected - transmitted];
        for (found, expected) in [found[0], found[1], lost].into_iter().zip(expected) {
            if (found - expected).abs() > 1e-12 {
                return Err(format!(
                    "cosine {cosine}, from the back {from_back}, mirror {is_mirror}, coated {is_coated}: {found} instead of {expected}"
                ));
            }
        }
    }
    Ok(())
}

/// In total reflection a simple coating takes nothing, also where another surface has a table.
fn simple_coating_beside_a_table(bench: &Bench) -> Outcome {
    let mut face = plane("face", 5.0, Interaction::Refractive, 1, 0);
    face.coating = Some(Coating::Simple(SimpleCoating { reflectance: vec![0.25], transmittance: vec![0.5] }));
    let mut elsewhere = plane("elsewhere", 30.0, Interaction::Refractive, 0, 0);
    elsewhere.coating = face.coating.as_ref().map(|coating| Coating::Tabulated(coating.tabulated()));
    let mut ir = scene(beam(), vec![face, elsewhere], vec![pixels("inside", -10.0), pixels("outside", 10.0)]);
    ir.sources[0].medium = 1;
    ir.sources[0].frame.rotation = DMat3::from_rotation_x(60.0_f64.to_radians());
    let result = trace(bench, &ir, 1000);
    near("flux inside", result.detectors[0].total_flux, 1.0, 1000, 1.0)
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
    ir.sources[0].medium = 2;
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

fn compare_shares(bench: &Bench, kind: SourceKind, share: impl Fn(f64) -> f64) -> Outcome {
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
    compare_shares(bench, SourceKind::Point(Point { half_angle: HALF_ANGLE }), share_of_cap)
}

fn extended_cap(bench: &Bench) -> Outcome {
    let area = Outline::Disk { radius: 1.0 };
    compare_shares(bench, SourceKind::Extended(Extended { area, half_angle: HALF_ANGLE }), share_of_cap)
}

/// Lambert's law: sin^2 theta.
fn lambertian(bench: &Bench) -> Outcome {
    let area = Outline::Rectangle { width: 1.0, height: 2.0 };
    let half_angle = std::f64::consts::FRAC_PI_2;
    compare_shares(bench, SourceKind::Extended(Extended { area, half_angle }), |angle| angle.sin().powi(2))
}

/// Rays among mirrors that are aspheres, from a lamp between them and from beams along and across the axis: each meets the
/// first crossing that a dense search in f64 finds, within the aperture, and goes off as the normal there says.
fn aspheres(bench: &Bench) -> Outcome {
    let bowl =
        AsphereProfile::new(12.0, -1.6, 6.0, 2, &[1e-3, -4e-5, 2e-6, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 3e-16]);
    let wave = AsphereProfile::new(-30.0, 0.3, 6.0, 1, &[-0.15, 0.0, 0.012, -1.2e-3]);
    between_mirrors(bench, &[(Shape::EvenAsphere(bowl.into()), 10.0), (Shape::OddAsphere(wave.into()), 18.0)])
}

/// The same of shapes that are not round, each beside one that is.
fn freeforms(bench: &Bench) -> Outcome {
    let biconic = Biconic {
        curvature: DVec2::new(1.0 / 12.0, -1.0 / 20.0),
        conic: DVec2::new(-1.6, 0.8),
        aperture_radius: 6.0,
    };
    let toroid = Toroidal {
        curvature_x: -1.0 / 14.0,
        profile: AsphereProfile::new(
            20.0,
            -0.7,
            6.0,
            2,
            &[2e-3, -5e-5, 1e-6, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 3e-16],
        ),
    };
    between_mirrors(
        bench,
        &[(Shape::Biconic(biconic.into()), 10.0), (Shape::Toroidal(toroid.into()), 18.0)],
    )?;
    let value = |p: DVec2| {
        let (u, v) = (p.x / 6.0, p.y / 6.0);
        0.2 * u + 0.5 * u * u * v - 0.3 * v * v * v + 0.25 * u * u * u * u - 0.15 * u * v
    };
    let polynomial = Polynomial { powers: [4, 3], order: 4, value: &value, definition: vec![] };
    let one = Shape::Polynomial(Freeform::new(15.0, -0.6, 6.0, &polynomial).into());
    let value = |p: DVec2| 0.01 * p.y * p.y - 0.02 * p.x;
    let polynomial = Polynomial { powers: [1, 2], order: 2, value: &value, definition: vec![] };
    let other = Shape::Chebyshev(Freeform::new(-30.0, 0.0, 6.0, &polynomial).into());
    between_mirrors(bench, &[(one, 10.0), (other, 18.0)])
}

/// Rays among two mirrors at these heights meet what a dense search in f64 says, from a lamp between them and from both
/// sides.
fn between_mirrors(bench: &Bench, shapes: &[(Shape, f64); 2]) -> Outcome {
    let mirror = |shape, z| Surface {
        shape,
        ..plane("mirror", z, Interaction::Reflective { reflectance: vec![1.0] }, 0, 0)
    };
    let across = DMat3::from_cols(DVec3::Y, DVec3::Z, DVec3::X);
    let lamp = |kind, origin, rotation| (kind, Frame { origin, rotation });
    let wide = SourceKind::Point(Point { half_angle: 3.0 });
    let thick = SourceKind::Collimated(Collimated { aperture_radius: 5.0, sigma: None });
    for (kind, frame) in [
        lamp(wide, DVec3::new(1.0, 2.0, 14.0), DMat3::IDENTITY),
        lamp(thick.clone(), DVec3::new(0.0, 0.0, 16.5), DMat3::from_diagonal(DVec3::new(1.0, -1.0, -1.0))),
        lamp(thick, DVec3::new(-9.0, 0.0, 11.0), across),
    ] {
        let surfaces = shapes.iter().map(|(shape, z)| mirror(shape.clone(), *z)).collect();
        let mut ir = scene(kind, surfaces, vec![pixels("end", 99.0)]);
        ir.sources[0].frame = frame;
        let mut setting = Setting::default();
        setting.options.num_rays = 120;
        setting.options.max_depth = 6;
        setting.options.paths = RecordPaths::All;
        let events = bench.tally(&ir, &setting).paths;
        let mut paths: std::collections::BTreeMap<u64, Vec<&PathEvent>> = std::collections::BTreeMap::new();
        for event in &events {
            paths.entry(event.ray.ray_id).or_default().push(event);
        }
        for path in paths.values_mut() {
            path.sort_by_key(|event| (!matches!(event.kind, PathEventKind::Birth(_)), event.ray.bounce));
            check_path(path, shapes)?;
        }
    }
    Ok(())
}

/// Checks a path among the mirrors of [`between_mirrors`].
fn check_path(path: &[&PathEvent], shapes: &[(Shape, f64); 2]) -> Outcome {
    let mut place = DVec3::from_array(path[0].ray.position);
    let mut direction = DVec3::from_array(path[0].ray.direction);
    let mut left: Option<usize> = None;
    for event in &path[1..] {
        if !matches!(event.kind, PathEventKind::Surface(_) | PathEventKind::Escaped) {
            return Ok(());
        }
        let first = (0..2).flat_map(|i| {
            let (profile, z) = &shapes[i];
            let start = place - DVec3::new(0.0, 0.0, *z);
            let nearest = if left == Some(i) { 1e-3 } else { 1e-9 };
            let ahead = profile.crossings(start, direction).into_iter().filter(move |&t| t > nearest);
            ahead.map(move |t| (t, i))
        });
        let first = first.min_by(|a, b| a.0.total_cmp(&b.0));
        let PathEventKind::Surface(i) = event.kind else {
            let is_lost = first.is_some_and(|(t, i)| {
                let (profile, z) = &shapes[i];
                let p = place + t * direction - DVec3::new(0.0, 0.0, *z);
                let Some(level) = profile.level(p) else { return false };
                p.truncate().length() < 0.999 * 6.0
                    && level.gradient.normalize().dot(direction).abs() > 1e-2
                    && t > 1e-2
            });
            return if is_lost {
                Err(format!("a ray from {place} along {direction} meets nothing"))
            } else {
                Ok(())
            };
        };
        let (profile, z) = &shapes[i];
        let met = DVec3::from_array(event.ray.position);
        let p = met - DVec3::new(0.0, 0.0, *z);
        let Some(level) = profile.level(p) else { return Ok(()) };
        if level.value.abs() > 1e-9 || p.truncate().length() > 6.0 * (1.0 + 1e-9) {
            return Err(format!("a ray from {place} along {direction} meets {met}, which is on no mirror"));
        }
        let t = (met - place).length();
        let Some((expected, _)) = first else {
            return Err(format!("a ray from {place} along {direction} meets {met}, where nothing is"));
        };
        let grazes = level.gradient.normalize().dot(direction).abs() < 1e-2;
        if (t - expected).abs() > 1e-6 {
            // Two crossings of a ray that grazes are one to a dense search.
            return if grazes || t < 1e-2 {
                Ok(())
            } else {
                Err(format!("met after {t} mm, not {expected}, from {place} along {direction}"))
            };
        }
        let normal = level.gradient.normalize();
        direction -= 2.0 * direction.dot(normal) * normal;
        let (next, l) = (path.iter().find(|next| next.ray.bounce == event.ray.bounce + 1), left);
        left = Some(i);
        if let Some(next) = next {
            let found = DVec3::from_array(next.ray.direction);
            if (found - direction).length() > 1e-9 {
                return Err(format!("goes off along {found}, not {direction} (after {l:?})"));
            }
            direction = found;
        }
        place = met;
    }
    Ok(())
}

/// Parts of spheres take the rays that their apertures say, of a beam of 8 mm, and none elsewhere.
fn clipped(bench: &Bench) -> Outcome {
    let part = |outline| Aperture { outline, inverted: false };
    let both = |one, other| Box::new([one, other]);
    let axes =
        |middle: [f64; 2], semi_axes: [f64; 2]| Axes { middle: middle.into(), semi_axes: semi_axes.into() };
    let ellipse = part(ApertureOutline::Ellipse(axes([1.0, -2.0], [3.0, 1.5])));
    let rectangle = part(ApertureOutline::Rectangle(axes([-1.0, 1.0], [4.0, 2.0])));
    let hole = part(ApertureOutline::Ellipse(axes([-1.0, 1.0], [0.5, 0.5])));
    let corners = [[-4.0, -3.0], [3.0, -4.0], [1.0, 0.0], [4.0, 3.5], [-2.0, 1.0]];
    let polygon = part(ApertureOutline::Polygon(corners.map(DVec2::from).to_vec()));
    let without_hole = part(ApertureOutline::Difference(both(rectangle.clone(), hole)));
    let in_one = part(ApertureOutline::Union(both(polygon.clone(), ellipse.clone())));
    let in_both = part(ApertureOutline::Intersection(both(rectangle, in_one.clone())));
    let all_but = Aperture { inverted: true, ..without_hole.clone() };
    let lamp = SourceKind::Collimated(Collimated { aperture_radius: 8.0, sigma: None });
    let conic = Conic { curvature: -1.0 / 9.0, conic: 0.0, aperture_radius: 6.0 };
    let bowl = AsphereProfile::new(-9.0, 0.0, 6.0, 2, &[0.0, -1e-5]);
    let value = |p: DVec2| -1e-3 * p.x * p.y;
    let freeform = Freeform::new(
        -9.0,
        0.0,
        6.0,
        &Polynomial { powers: [1; 2], order: 2, value: &value, definition: vec![] },
    );
    for (i, aperture) in [ellipse, polygon, without_hole, in_one, in_both, all_but].into_iter().enumerate() {
        let mut shapes = vec![Shape::ClippedConic(ClippedConic::new(conic, aperture.clone()))];
        if i >= 4 {
            shapes.push(Shape::EvenAsphere(SagSurface::new(bowl, Some(aperture.clone()))));
            shapes.push(Shape::Polynomial(SagSurface::new(freeform.clone(), Some(aperture.clone()))));
        }
        for shape in shapes {
            // Behind it a surface without such an aperture takes the rest of the beam's middle.
            let rest = Shape::Polynomial(SagSurface::new(freeform.clone(), None));
            let rest = Surface { shape: rest, ..plane("rest", 45.0, Interaction::Absorbing, 0, 0) };
            let is_on = |p: DVec3| shape.level(p).is_some_and(|level| level.value.abs() < 1e-9);
            let part = Surface { shape: shape.clone(), ..plane("part", 20.0, Interaction::Absorbing, 0, 0) };
            let ir = scene(lamp.clone(), vec![part, rest], vec![pixels("behind", 60.0)]);
            let mut setting = Setting::default();
            setting.options.paths = RecordPaths::All;
            for event in &bench.tally(&ir, &setting).paths {
                let [x, y, z] = event.ray.position;
                let in_middle = x.hypot(y) <= 6.0;
                let on_part = aperture.holds(DVec2::new(x, y)) & in_middle;
                let is_right = match z {
                    z if z < 1.0 => true,
                    z if z < 13.0 => return Err(format!("a ray meets the far sheet at z = {z}")),
                    z if z < 30.0 => on_part & is_on(DVec3::new(x, y, z - 20.0)),
                    z if z < 50.0 => in_middle & !on_part,
                    _ => !in_middle,
                };
                if !is_right {
                    return Err(format!("a ray at ({x}, {y}) ends at z = {z} in {aperture:?}"));
                }
            }
        }
    }
    Ok(())
}

/// Rays through a pupil: at z = 10 mm all are in the disk of 5 mm about (1, 2), and their directions are unit vectors.
fn pupil(bench: &Bench) -> Outcome {
    let kind = SourceKind::Pupil(pupil_of([3.0, 1.0], [1.0, 2.0, 10.0], [2.0, 4.0], vec![]));
    let mut film = pixels("film", 10.0);
    film.kind = DetectorKind::RayDatabase(RayDatabase { width: 1e3, height: 1e3, max_rays: None });
    let tally = bench.tally(&scene(kind, vec![], vec![film]), &Setting::default());
    let (mut widest, mut reach) = (0.0f64, [0.0f64; 2]);
    for row in &tally.detectors[0].rows {
        let ([x, y, _], [l, m, n]) = (row.position, row.direction);
        widest = widest.max((x - 1.0).hypot(y - 2.0));
        reach = [reach[0].max((x - 1.0).abs()), reach[1].max((y - 2.0).abs())];
        let length = l.hypot(m).hypot(n);
        if (length - 1.0).abs() > 1e-5 {
            return Err(format!("a direction of length {length}"));
        }
    }
    match (4.9..5.0001).contains(&widest) && reach.iter().all(|&reach| reach > 4.8) {
        true => Ok(()),
        false => Err(format!("a disk of {widest} mm, {reach:?} along x and y")),
    }
}

/// Orders of a coated plate by guided rays: T1 T2 (R1 R2)^k after 2 k reflections. Roulette begins at the first face.
fn guided_plate(bench: &Bench) -> Outcome {
    plate_by_guide(bench, None, 0.0)
}

/// The same, where rays follow the first ghost alone.
fn guided_ghost(bench: &Bench) -> Outcome {
    plate_by_guide(bench, Some("reflections == 2"), 0.0)
}

/// A thousandth of the light scatters at either face, as at a mirror: light that a face transmits goes back.
fn guided_scatterers(bench: &Bench) -> Outcome {
    plate_by_guide(bench, None, 1e-3)
}

/// The same, where rays follow light alone that scatters at both faces and does nothing else.
fn guided_scattering(bench: &Bench) -> Outcome {
    plate_by_guide(bench, Some("scatterings == 2 and reflections == 0"), 1e-3)
}

fn plate_by_guide(bench: &Bench, filter: Option<&str>, scattered: f64) -> Outcome {
    const NUM_RAYS: u64 = 40_000;
    let faces = [(0.01, 0.5), (0.002, 0.4)];
    let mut surfaces = vec![
        plane("front", 5.0, Interaction::Refractive, 0, 1),
        plane("back", 6.0, Interaction::Refractive, 1, 0),
    ];
    for (surface, (r, t)) in surfaces.iter_mut().zip(faces) {
        let coating = SimpleCoating { reflectance: vec![r], transmittance: vec![t] };
        surface.coating = Some(Coating::Simple(coating));
        if scattered > 0.0 {
            surface.scatter = Some(Scatter { fraction: scattered, bsdf: Bsdf::Specular(bsdfs::Specular {}) });
        }
    }
    let mut ir = scene(beam(), surfaces, vec![pixels("through", 10.0)]);
    ir.sampling = Sampling::default();
    let filter = filter.map(|text| Arc::new(PathFilter::parse(text, &ir).unwrap()));
    let mut setting = Setting::default();
    setting.options.collect = Collect::paths();
    setting.options.num_rays = NUM_RAYS;
    setting.options.max_depth = 40;
    setting.options.min_flux_fraction = 0.9;
    setting.options.path_filter = filter.clone();
    let wanted = Wanted { top: 3, filter: filter.clone(), ..Wanted::default() };
    setting.options = zoo::guided(&ir, &setting.options, 1 << 16, &wanted);
    let tally = bench.path_tally(&ir, &setting)?;
    let imbalance = zoo::result_of(&ir, &setting.options, &tally).ledger.imbalance_quanta;
    if imbalance != 0 {
        return Err(format!("the ledger is off by {imbalance} quanta"));
    }
    let sums = tally.path_sums.as_ref().ok_or("no table")?;
    let [(r1, t1), (r2, t2)] = faces;
    let passes = 1.0 - scattered;
    // Reflections, scatterings, and the light.
    let ghost = |order: i32| {
        (2 * order as usize, 0, t1 * t2 * passes.powi(2) * f64::powi(r1 * r2 * passes.powi(2), order))
    };
    let scatters_back = (0, 2, t1 * passes * t2 * scattered * t1 * scattered * t2 * passes);
    let expected = match (filter.is_some(), scattered > 0.0) {
        (false, false) => vec![ghost(0), ghost(1), ghost(2)],
        (true, false) => vec![ghost(1)],
        (false, true) => vec![ghost(0), ghost(1)],
        (true, true) => vec![scatters_back],
    };
    // Rows to which few of the scattered rays come take rays from the others.
    let most = if scattered > 0.0 { 0.2 } else { 0.05 };
    for (order, (reflections, scatterings, exact)) in expected.into_iter().enumerate() {
        let row = sums.rows.iter().find(|(path, _)| {
            path.end == End::Detector(0)
                && path.reflections() == reflections
                && path.scatterings() == scatterings
                && path.steps.first().is_some_and(|step| step.kind == StepKind::Transmitted)
        });
        let [flux, error] =
            row.map_or([0.0; 2], |(_, sum)| zoo::sum_and_error(sum, NUM_RAYS).map(|x| x / NUM_RAYS as f64));
        // Where each ray follows the ghost, all weigh the same but for roulette. Squares of the faintest light have few quanta.
        if (flux - exact).abs() > 5.0 * error.max(1e-6 * exact) || order < 2 && error > most * exact {
            return Err(format!("order {order} has {flux} +- {error}, not {exact}"));
        }
    }
    Ok(())
}

/// A lamp behind one with another table: a share of its light in each quarter of azimuths and each of three rings, of which
/// intensity falls linearly along one angle.
fn lamp(bench: &Bench) -> Outcome {
    let table = |polar: &[f64], rows: Vec<Vec<f64>>| {
        let step = std::f64::consts::TAU / (rows.len() - 1) as f64;
        let azimuth = (0..rows.len()).map(|i| i as f64 * step).collect();
        PolarTable { polar: polar.to_vec(), azimuth, rows }
    };
    let lamp = |table| {
        SourceKind::Tabulated(sources::Tabulated {
            area: Outline::Disk { radius: 0.0 },
            table: Arc::new(table),
        })
    };
    // Along the azimuth from 0 to 4 and back; along the polar angle from 1 to 0.
    let rows = [0.0, 4.0, 4.0, 2.0, 0.0].map(|share| vec![share, 0.5 * share, 0.0]).to_vec();
    let half = std::f64::consts::FRAC_PI_2;
    let mut ir = scene(lamp(table(&[0.0, 1.0], vec![vec![1.0, 1.0]; 2])), vec![], vec![sky()]);
    ir.sources[0].frame = at(20.0);
    ir.sources.push(Source {
        name: "second".into(),
        kind: lamp(table(&[0.0, half / 2.0, half], rows)),
        frame: at(9.999),
        ..ir.sources[0].clone()
    });
    let mut setting = Setting::default();
    setting.options.num_rays = 200_000;
    let result = bench.result(&ir, &setting);
    let DetectorData::FarField(pattern) = &result.detectors[0].data else {
        return Err("no far field".into());
    };
    let num = pattern.hits.sum();
    // Means of the slope over each half of a quarter, of 20 together. Columns begin at -180 degrees.
    for (column, mean) in [3.5, 2.5, 1.5, 0.5, 1.0, 3.0, 4.0, 4.0].into_iter().enumerate() {
        let hits: u64 = (0..18).map(|i| pattern.hits[[i, column]]).sum();
        near("half a quarter", hits as f64 / num as f64, mean / 20.0, num, 1.0)?;
    }
    // (1 - theta / a) sin(theta), a = pi / 2, has the integral 1 - cos(t) + (t cos(t) - sin(t)) / a up to t, of 1 - 1 / a.
    let below = |t: f64| (1.0 - t.cos() + (t * t.cos() - t.sin()) / half) / (1.0 - 1.0 / half);
    for row in 0..18 {
        let edges = [row, row + 1].map(|edge| half * edge as f64 / 18.0);
        let hits: u64 = (0..8).map(|j| pattern.hits[[row, j]]).sum();
        near("a ring", hits as f64 / num as f64, below(edges[1]) - below(edges[0]), num, 1.0)?;
    }
    Ok(())
}

/// Gives a scene light of 0.4 and 0.5 um, for which its media are the same.
fn have_two_wavelengths(ir: &mut SceneIr) {
    ir.wavelengths = vec![0.4, 0.5];
    for medium in &mut ir.media {
        (medium.n, medium.k) = (vec![medium.n[0]; 2], vec![medium.k[0]; 2]);
    }
}

/// Five rays of two wavelengths: each comes as often as its share says, from where it starts. A source before it has rays of its own,
/// which go elsewhere.
fn rays_of_a_file(bench: &Bench) -> Outcome {
    const NUM_RAYS: u64 = 100_000;
    let group = |wavelength, rays: &[([f64; 3], [f64; 3], f64)]| RayGroup {
        wavelength: Some(wavelength),
        positions: rays.iter().map(|ray| ray.0).collect(),
        directions: rays.iter().map(|ray| ray.1).collect(),
        shares: rays.iter().map(|ray| ray.2).collect(),
    };
    let of = |groups| {
        let set = FileRays::held("0".into(), 1.0, groups);
        SourceKind::Rays(sources::Rays { set: Arc::new(set) })
    };
    let straight = [0.0, 0.0, 1.0];
    let blue = [
        ([1.0, 5.0, 0.0], straight, 6.0),
        ([2.0, 5.0, 0.5], [0.6, 0.0, 0.8], 1.0),
        ([3.0, 5.0, 0.0], straight, 2.0),
    ];
    let red = [([4.0, 5.0, 1.0], straight, 1.0), ([5.0, 5.0, -1.0], [0.0, -0.6, 0.8], 5.0)];
    let other = [([-1.0, -5.0, 0.0], straight, 1.0)];
    let mut ir = scene(of(vec![group(0.4, &other), group(0.5, &other)]), vec![], vec![database("end", 8.0)]);
    have_two_wavelengths(&mut ir);
    ir.sources[0].spectrum = Spectrum { wavelengths: vec![0, 1], cdf: vec![0.6, 1.0] };
    ir.sources[0].total_flux = 1e-3;
    ir.sources.push(Source {
        name: "second".into(),
        kind: of(vec![group(0.4, &blue), group(0.5, &red)]),
        total_flux: 1.0,
        ..ir.sources[0].clone()
    });
    let mut setting = Setting::default();
    setting.options.num_rays = NUM_RAYS;
    setting.options.precision = Precision::F64;
    let rows = bench.tally(&ir, &setting).detectors.swap_remove(0).rows;
    let rows: Vec<_> = rows.into_iter().filter(|row| row.position[1] > -4.0).collect();
    let num = rows.len() as u64;
    let mut found = 0;
    for (group, light) in [(&blue[..], 0.6), (&red[..], 0.4)] {
        let all: f64 = group.iter().map(|ray| ray.2).sum();
        for (start, direction, share) in group {
            let path = (8.0 - start[2]) / direction[2];
            let place = [0, 1].map(|axis| start[axis] + path * direction[axis]);
            let is_there = |row: &&RayRow| {
                (row.position[0] - place[0]).hypot(row.position[1] - place[1]) < 1e-9
                    && (0..3).all(|axis| (row.direction[axis] - direction[axis]).abs() < 1e-9)
            };
            let count = rows.iter().filter(is_there).count() as u64;
            near("a ray", count as f64 / num as f64, light * share / all, num, 1.0)?;
            found += count;
        }
    }
    if found == num { Ok(()) } else { Err(format!("{} rays are none of the file", num - found)) }
}

/// A stream in which the id of a ray says all of the ray. Every second one has a wavelength of its own.
#[derive(Debug)]
struct ById;

impl ById {
    fn ray(id: u64) -> StreamedRay {
        let [a, b, c] = [7, 3, 5].map(|period| (id % period) as f64);
        let direction = if id.is_multiple_of(3) { [0.6, 0.0, 0.8] } else { [0.0, -0.28, 0.96] };
        StreamedRay { wavelength: (id % 2 == 1).then_some(0.5), position: [a, -b, 0.25 * c], direction }
    }
}

impl RayStream for ById {
    fn rays(&self, _: u64, ids: &[u64], _: &dyn Fn(u64) -> u64) -> nsq_gpu::Result<Vec<StreamedRay>> {
        Ok(ids.iter().map(|id| ById::ray(*id)).collect())
    }

    fn order(&self) -> Order {
        Order::InOrder
    }
}

/// Rays that the host uploads begin as it says, each by its id. A ray without a wavelength of its own, and the rays of the source
/// before, draw theirs.
fn uploaded_rays(bench: &Bench) -> Outcome {
    const NUM_RAYS: u64 = 20_000;
    let set = FileRays::streamed("0".into(), 1.0, Arc::new(ById), Bounds::default());
    let held = RayGroup {
        wavelength: None,
        positions: vec![[0.0, 90.0, 0.0]; 2],
        directions: vec![[0.0, 0.0, 1.0]; 2],
        shares: vec![1.0; 2],
    };
    let of = |set| SourceKind::Rays(sources::Rays { set: Arc::new(set) });
    let mut ir = scene(of(FileRays::held("1".into(), 1.0, vec![held])), vec![], vec![database("end", 8.0)]);
    have_two_wavelengths(&mut ir);
    ir.sources[0].spectrum = Spectrum { wavelengths: vec![0, 1], cdf: vec![0.75, 1.0] };
    ir.sources.push(Source { name: "second".into(), kind: of(set), ..ir.sources[0].clone() });
    let mut setting = Setting::default();
    setting.options.num_rays = NUM_RAYS;
    setting.options.precision = Precision::F64;
    let rows = bench.tally(&ir, &setting).detectors.swap_remove(0).rows;
    let [mut found, mut drawn, mut red] = [0_u64; 3];
    let [mut of_other, mut red_of_other] = [0_u64; 2];
    for row in rows {
        if row.position[1] > 50.0 {
            of_other += 1;
            red_of_other += u64::from(row.wavelength);
            continue;
        }
        found += 1;
        let ray = ById::ray(row.ray_id);
        let path = (8.0 - ray.position[2]) / ray.direction[2];
        let place = [0, 1].map(|axis| ray.position[axis] + path * ray.direction[axis]);
        if (row.position[0] - place[0]).hypot(row.position[1] - place[1]) > 1e-9 {
            return Err(format!("ray {} ends at {:?}, not at {place:?}", row.ray_id, row.position));
        }
        match ray.wavelength {
            Some(_) if row.wavelength == 1 => {}
            Some(_) => return Err(format!("ray {} has not the wavelength of its own", row.ray_id)),
            None => (drawn, red) = (drawn + 1, red + u64::from(row.wavelength)),
        }
    }
    if found + of_other != NUM_RAYS {
        return Err(format!("{} rays are missing", NUM_RAYS - found - of_other));
    }
    near("a drawn wavelength", red as f64 / drawn as f64, 0.25, drawn, 1.0)?;
    near("of the other source", red_of_other as f64 / of_other as f64, 0.25, of_other, 1.0)
}

fn pupil_of(beam_radii: [f64; 2], chief: [f64; 3], pupil_radii: [f64; 2], aimed: Vec<Aim>) -> Pupil {
    Pupil { beam_radii, chief, pupil_radii, aimed: aimed.into() }
}

/// Rays that are aimed start where polynomials say of the places in the pupil that a plain source shows, by wavelength; and
/// a source behind one with a table of its own has its own.
fn aimed(bench: &Bench) -> Outcome {
    let [x, y] = [vec![vec![0.5, -0.25], vec![0.125, 0.0, 0.75]], vec![vec![], vec![0.0, 1.5]]];
    let [vector_x, vector_y] = [vec![vec![0.0, 0.0, 0.25]], vec![vec![0.5], vec![-0.5]]];
    let aim = |wavelength, scale: f64| {
        let scaled = |rows: &Vec<Vec<f64>>| {
            rows.iter().map(|row| row.iter().map(|number| scale * number).collect()).collect()
        };
        let [x, y, vector_x, vector_y] = [&x, &y, &vector_x, &vector_y].map(scaled);
        Aim { wavelength, x, y, vector_x, vector_y }
    };
    let value = |rows: &[Vec<f64>], [u, v]: [f64; 2]| {
        let rows = (0..)
            .zip(rows)
            .map(|(i, row)| (0..).zip(row).map(|(j, number)| number * u.powi(i) * v.powi(j)).sum::<f64>());
        rows.sum::<f64>()
    };
    let births = |aimed: Vec<Aim>, others: Vec<Aim>| {
        let of = |aimed| SourceKind::Pupil(pupil_of([1.0, 1.0], [0.5, 0.0, 2.0], [0.0, 0.0], aimed));
        let mut ir = scene(of(others), vec![], vec![pixels("end", 99.0)]);
        have_two_wavelengths(&mut ir);
        ir.sources[0].spectrum = Spectrum { wavelengths: vec![0, 1], cdf: vec![0.5, 1.0] };
        ir.sources.push(Source { name: "second".into(), kind: of(aimed), ..ir.sources[0].clone() });
        let mut setting = Setting::default();
        setting.options.num_rays = 400;
        setting.options.paths = RecordPaths::All;
        let mut births = bench.tally(&ir, &setting).paths;
        births.retain(|event| matches!(event.kind, PathEventKind::Birth(1)));
        births.sort_by_key(|event| event.ray.ray_id);
        births
    };
    let plain = births(vec![], vec![]);
    let found = births(vec![aim(0.4, 1.0), aim(0.5, 2.0)], vec![aim(0.5, 3.0)]);
    if plain.len() < 100 || plain.len() != found.len() {
        return Err(format!("{} and {} births", plain.len(), found.len()));
    }
    for (plain, found) in plain.iter().zip(&found) {
        let p = [plain.ray.position[0], plain.ray.position[1]];
        let scale = if found.ray.wavelength == 0 { 1.0 } else { 2.0 };
        let start = [p[0] + scale * value(&x, p), p[1] + scale * value(&y, p)];
        let vector =
            DVec3::new(0.5 + scale * value(&vector_x, p), scale * value(&vector_y, p), 2.0).normalize();
        let off = (found.ray.position[0] - start[0]).hypot(found.ray.position[1] - start[1]);
        let turned = (DVec3::from_array(found.ray.direction) - vector).length();
        if off > 1e-12 || turned > 1e-12 {
            return Err(format!("a ray is {off} mm and {turned} off at {p:?}, {}", found.ray.wavelength));
        }
    }
    Ok(())
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

/// The tally of so many Sobol points.
fn points(bench: &Bench, ir: &SceneIr, num_rays: u64) -> Tally {
    let mut setting = Setting::default();
    setting.options.num_rays = num_rays;
    setting.options.sampler = Sampler::Sobol;
    setting.options.seed = 3;
    bench.tally(ir, &setting)
}

/// All counts are this one: Sobol points lie evenly, exactly, over any net of 2^a x 2^b cells.
fn evenly(what: &str, counts: &[u64], expected: u64) -> Outcome {
    match counts.iter().find(|&&count| count != expected) {
        None => Ok(()),
        Some(count) => Err(format!("{count} rays {what} instead of {expected}")),
    }
}

/// Each of 32 x 32 pixels over an area gets one of 1024 rays.
fn points_over_an_area(bench: &Bench) -> Outcome {
    let area = Outline::Rectangle { width: 16.0, height: 16.0 };
    let grid =
        PixelGrid { width: 16.0, height: 16.0, num_pixels_x: 32, num_pixels_y: 32, splat: Splat::Hard };
    let kind = SourceKind::Extended(Extended { area, half_angle: 1e-9 });
    let mut film = pixels("film", 1.0);
    film.kind = DetectorKind::Irradiance(grid);
    let tally = points(bench, &scene(kind, vec![], vec![film]), 1024);
    evenly("in a pixel", &tally.detectors[0].hits, 1)
}

/// Each of several scrambles has 1024 rays of its own, one in each pixel, and puts them elsewhere within the pixels; and so
/// do the rays beyond 2^32.
fn points_of_scrambles(bench: &Bench) -> Outcome {
    let area = Outline::Rectangle { width: 16.0, height: 16.0 };
    let kind = SourceKind::Extended(Extended { area, half_angle: 1e-9 });
    let sums = |num_pixels: u32, first_ray: u64| {
        let grid = PixelGrid {
            width: 16.0,
            height: 16.0,
            num_pixels_x: num_pixels,
            num_pixels_y: num_pixels,
            splat: Splat::Hard,
        };
        let mut film = pixels("film", 1.0);
        film.kind = DetectorKind::Irradiance(grid);
        let mut setting = Setting::default();
        setting.options.first_ray = first_ray;
        setting.options.num_rays = 1024 * u64::from(NUM_REPLICATES);
        setting.options.sampler = Sampler::Sobol;
        setting.options.standard_error = StandardError::On;
        let tally = bench.tally(&scene(kind.clone(), vec![], vec![film]), &setting);
        let rays = tally.detectors[0].replicates.iter().map(|quanta| (quanta >> 52) as u64);
        rays.collect::<Vec<u64>>()
    };
    evenly("of a scramble in a pixel", &sums(32, 0), 1)?;
    let fine = [0, 1 << 32].map(|first_ray| sums(256, first_ray));
    let mut scrambles: Vec<&[u64]> = fine.iter().flat_map(|sums| sums.chunks(256 * 256)).collect();
    scrambles.sort_unstable();
    scrambles.dedup();
    evenly("are scrambles", &[scrambles.len() as u64], 2 * u64::from(NUM_REPLICATES))
}

/// Of a point's rays, and of an area's, each of eight azimuths gets the same number, and each of two wavelengths.
fn points_over_the_sky(bench: &Bench) -> Outcome {
    let azimuths = DetectorKind::FarField(FarField { num_theta: 1, num_phi: 8, sphere: false });
    let area = Outline::Disk { radius: 1.0 };
    for kind in [
        SourceKind::Point(Point { half_angle: 0.8 }),
        SourceKind::Extended(Extended { area, half_angle: 0.8 }),
    ] {
        let mut ir = scene(kind, vec![], vec![sky()]);
        ir.detectors[0].kind = azimuths.clone();
        let tally = points(bench, &ir, 1024);
        evenly("in an azimuth", &tally.detectors[0].hits, 128)?;
    }
    let mut ir = scene(beam(), vec![], vec![pixels("colours", 1.0)]);
    ir.wavelengths = vec![0.4, 0.5];
    ir.media.iter_mut().for_each(|medium| {
        medium.n.push(medium.n[0]);
        medium.k.push(medium.k[0]);
    });
    ir.sources[0].spectrum = Spectrum { wavelengths: vec![0, 1], cdf: vec![0.5, 1.0] };
    let grid = PixelGrid { width: 4.0, height: 4.0, num_pixels_x: 1, num_pixels_y: 1, splat: Splat::Hard };
    ir.detectors[0].kind = DetectorKind::Spectral(Spectral { grid, wavelength_edges: vec![0.3, 0.45, 0.6] });
    evenly("of a wavelength", &points(bench, &ir, 1024).detectors[0].hits, 512)
}

/// Two faces' reflections are a point of two dimensions, and all further ones nearly so: the transmittance is a tenth as
/// far from the truth as random numbers would bring it.
fn points_of_a_window(bench: &Bench) -> Outcome {
    let num_rays = 1 << 14;
    let tally = points(bench, &window_scene(), num_rays);
    let through: u64 = tally.detectors[0].hits.iter().sum();
    let expected = 2.0 * INDEX / (INDEX * INDEX + 1.0);
    let limit = 0.2 * (expected * (1.0 - expected) / num_rays as f64).sqrt();
    let mean = through as f64 / num_rays as f64;
    if (mean - expected).abs() <= limit {
        Ok(())
    } else {
        Err(format!("transmittance is {mean} instead of {expected} +- {limit}"))
    }
}

/// Of two faces that reflect a half, the first sends back a half of the rays, and of the others a half passes at once.
fn points_of_half_mirrors(bench: &Bench) -> Outcome {
    let mut ir = window_scene();
    for surface in &mut ir.surfaces {
        surface.coating = Some(simple_coating(0.5));
    }
    let mut setting = Setting::default();
    setting.options.num_rays = 1 << 14;
    setting.options.sampler = Sampler::Sobol;
    // No more than two faces and a detector.
    setting.options.max_depth = 3;
    let tally = bench.tally(&ir, &setting);
    let hits = |detector: usize| tally.detectors[detector].hits.iter().sum::<u64>();
    evenly("passed", &[hits(0)], 1 << 12)?;
    evenly("came back", &[hits(1)], 1 << 13)
}

/// A mirror whose table is higher than a Lambertian lobe gains pi times its value, less what came in.
fn scatter_gain(bench: &Bench) -> Outcome {
    let mut mirror = plane("mirror", 5.0, Interaction::Reflective { reflectance: vec![1.0] }, 0, 0);
    let table = BsdfTable { theta_i: vec![0.0, 90.0], theta_s: vec![0.0, 90.0], values: vec![0.5; 4] };
    mirror.scatter = Some(Scatter {
        fraction: 1.0,
        bsdf: Bsdf::Tabulated(Tabulated { table, transmissive_fraction: 0.0 }),
    });
    let ledger = trace(bench, &scene(beam(), vec![mirror], vec![pixels("back", -10.0)]), 1000).ledger;
    let expected = 0.5 * std::f64::consts::PI - 1.0;
    if (ledger.bsdf_gain.flux - expected).abs() < 1e-5 && ledger.closes() {
        Ok(())
    } else {
        Err(format!("gain {}, {} quanta missing", ledger.bsdf_gain.flux, ledger.imbalance_quanta))
    }
}

/// Of K-correlation lobes of each slope as many rays lie within each cone as the lobe's integral says, a half of them at
/// x > 0. And every single ray lies in f32 where it lies in f64.
fn k_correlation(bench: &Bench) -> Outcome {
    const NUM_RAYS: u64 = 50_000;
    let lobe = |s: f64| KCorrelation { b0: 1.0, b: 5.0, s, transmissive_fraction: 0.0 };
    for s in [1.0, 2.0, 2.5, 6.0] {
        let mut mirror = plane("mirror", 5.0, Interaction::Reflective { reflectance: vec![1.0] }, 0, 0);
        mirror.scatter = Some(Scatter { fraction: 1.0, bsdf: Bsdf::KCorrelation(lobe(s)) });
        let source = SourceKind::Point(Point { half_angle: 0.0 });
        let mut ir = scene(source, vec![mirror], vec![database("back", -10.0)]);
        let everywhere = RayDatabase { width: 1e9, height: 1e9, max_rays: None };
        ir.detectors[0].kind = DetectorKind::RayDatabase(everywhere);
        let offsets = |precision| {
            let mut setting = Setting::default();
            setting.options.num_rays = NUM_RAYS;
            setting.options.precision = precision;
            let tally = bench.tally(&ir, &setting);
            let rows = tally.detectors[0].rows.iter();
            let of_row = |row: &RayRow| (row.ray_id, DVec2::new(row.direction[0], row.direction[1]));
            rows.filter(|row| row.weight > 0.0).map(of_row).collect::<std::collections::BTreeMap<_, _>>()
        };
        let (exact, single) = (offsets(Precision::F64), offsets(Precision::F32));
        for beta in [0.02, 0.08, 0.2, 0.5, 0.999] {
            let drawn: Vec<&DVec2> = exact.values().filter(|offset| offset.length() <= beta).collect();
            let share = |count: usize| count as f64 / NUM_RAYS as f64;
            let expected = lobe(s).scattered_within(beta) / lobe(s).scattered_within(2.0);
            near(&format!("share within {beta} of slope {s}"), share(drawn.len()), expected, NUM_RAYS, 1.0)?;
            let right = drawn.iter().filter(|offset| offset.x > 0.0).count();
            near(&format!("a half within {beta} of slope {s}"), share(right), 0.5 * expected, NUM_RAYS, 1.0)?;
        }
        for (ray, offset) in &exact {
            // Next to the rim of the unit disk, rounding decides.
            let length = offset.length();
            let found =
                single.get(ray).map_or(if length > 0.9999 { length } else { 0.0 }, |found| found.length());
            if (found - length).abs() > 3e-6 * length {
                return Err(format!("ray {ray} of slope {s} lies at {found} in f32, at {length} in f64"));
            }
        }
    }
    Ok(())
}

fn database(name: &str, z: f64) -> Detector {
    let kind = DetectorKind::RayDatabase(RayDatabase { width: 1e4, height: 1e4, max_rays: None });
    Detector { name: name.into(), frame: at(z), kind, absorb: true }
}

/// Surfaces between two ray databases, and a pencil beam from z = 0; as many rays as are traced below have weight 1.
fn split_scene(surfaces: Vec<Surface>, split_depth: u32, split_budget: f64) -> SceneIr {
    let databases = vec![database("reflected", -20.0), database("transmitted", 20.0)];
    let mut ir = scene(SourceKind::Point(Point { half_angle: 0.0 }), surfaces, databases);
    ir.sampling = Sampling { split_depth, split_budget, ..ir.sampling };
    ir
}

/// The rows of both databases, the ledger, and whether the budget was used up.
fn split_rows(
    bench: &Bench,
    ir: &SceneIr,
    max_depth: u32,
    precision: Precision,
) -> (Vec<RayRow>, Ledger, bool) {
    let mut setting = Setting::default();
    setting.options.num_rays = SPLIT_RAYS;
    setting.options.max_depth = max_depth;
    setting.options.precision = precision;
    setting.options.min_flux_fraction = 0.0;
    let tally = bench.tally(ir, &setting);
    let ledger = bench.result(ir, &setting).ledger;
    let rows = tally.detectors.iter().flat_map(|detector| detector.rows.clone()).collect();
    (rows, ledger, tally.split_budget_saturated)
}

const SPLIT_RAYS: u64 = 500;

/// Each ghost of a plate of R = 0.04 once, with the number of its lineage and its exact weight.
fn split_plate(bench: &Bench) -> Outcome {
    const DEPTH: u32 = 6;
    let surfaces = vec![
        plane("front", 5.0, Interaction::Refractive, 0, 1),
        plane("back", 6.0, Interaction::Refractive, 1, 0),
    ];
    let (rows, ledger, saturated) =
        split_rows(bench, &split_scene(surfaces, DEPTH, 8.0), DEPTH + 1, Precision::F64);
    let exit = |inside: u32| (1 | 1 << (inside + 1), 0.96 * 0.96 * 0.04_f64.powi(inside as i32));
    let mut family: Vec<(u64, f64)> = (0..DEPTH - 1).map(exit).chain([(0, 0.04)]).collect();
    family.sort_by_key(|(number, _)| *number);
    let mut found: Vec<&RayRow> = rows.iter().collect();
    found.sort_by_key(|row| ray_id::order(row.ray_id, true));
    let mut expected =
        (0..SPLIT_RAYS).flat_map(|launched| family.iter().map(move |member| (launched, member)));
    let as_expected = found.iter().all(|row| {
        expected.next().is_some_and(|(launched, (number, weight))| {
            ray_id::order(row.ray_id, true) == (launched, *number) && (row.weight - weight).abs() < 1e-14
        })
    });
    // Inside, one ray a family meets the limit after it was split as often as it may.
    let one_left = ledger.depth.count == SPLIT_RAYS;
    if as_expected && expected.next().is_none() && one_left && ledger.closes() && !saturated {
        Ok(())
    } else {
        Err(format!("{} rows, the first families {:?}", found.len(), &found[..found.len().min(8)]))
    }
}

fn simple_coating(reflectance: f64) -> Coating {
    Coating::Simple(SimpleCoating { reflectance: vec![reflectance], transmittance: vec![1.0 - reflectance] })
}

fn coat(name: &str, z: f64, reflectance: f64) -> Surface {
    Surface { coating: Some(simple_coating(reflectance)), ..plane(name, z, Interaction::Refractive, 0, 0) }
}

/// In f32 a reflection of 2.3 times what the significand of 1 resolves is 2 or 3 times that, 2.3 on average.
fn split_faint(bench: &Bench) -> Outcome {
    let resolved = f64::from(f32::EPSILON);
    let ir = split_scene(vec![coat("coat", 5.0, 2.3 * resolved)], 1, 2.0);
    let (rows, ledger, _) = split_rows(bench, &ir, 16, Precision::F32);
    let reflected = rows.iter().filter(|row| row.position[2] < 0.0).map(|row| row.weight / resolved);
    let share = reflected.sum::<f64>() / SPLIT_RAYS as f64 - 2.0;
    near("share of threes", share, 0.3, SPLIT_RAYS, 1.0)?;
    if ledger.closes() { Ok(()) } else { Err("the ledger does not close".into()) }
}

/// Behind a split each branch meets a coat of R = 1/2 and is drawn by the numbers of its own id; so is its roulette.
fn split_draws(bench: &Bench) -> Outcome {
    const FRESNEL_BRANCH: u32 = 5;
    const ROULETTE: u32 = 9;
    let coats = vec![coat("middle", 5.0, 0.5), coat("left", -5.0, 0.5), coat("right", 10.0, 0.5)];
    let (rows, ..) = split_rows(bench, &split_scene(coats, 1, 2.0), 3, Precision::F64);
    same_ids(rows, |bits| bits >= 1 << 31, FRESNEL_BRANCH)?;
    let mut ir = split_scene(vec![coat("middle", 5.0, 0.5)], 1, 2.0);
    ir.sampling.rr_start_flux = 0.8;
    let (rows, ..) = split_rows(bench, &ir, 3, Precision::F64);
    same_ids(rows, |bits| f64::from(bits) < 0.625 * 4294967296.0, ROULETTE)
}

/// The rows are those of the launched rays and of their first children whose draw at bounce 1 is so.
fn same_ids(rows: Vec<RayRow>, goes_on: impl Fn(u32) -> bool, slot: u32) -> Outcome {
    let mut found: Vec<u64> = rows.into_iter().map(|row| row.ray_id).collect();
    found.sort_unstable();
    let ids = [0, 1].into_iter().flat_map(|number| (0..SPLIT_RAYS).map(move |ray| ray_id::of(ray, number)));
    let expected: Vec<u64> = ids.filter(|id| goes_on(rng::draw(0, *id, 1, slot))).collect();
    if found == expected {
        Ok(())
    } else {
        Err(format!("slot {slot}: {} rays, not {}", found.len(), expected.len()))
    }
}

/// The budget is used up by plates in it, of none by what is too deep or totally reflected; half a ray more is every
/// other family's.
fn split_saturation(bench: &Bench) -> Outcome {
    let plate = |depth, budget| {
        let back = plane("back", 6.0, Interaction::Refractive, 1, 0);
        let ir = split_scene(vec![plane("front", 5.0, Interaction::Refractive, 0, 1), back], depth, budget);
        split_rows(bench, &ir, 16, Precision::F64).2
    };
    let mut inside = split_scene(vec![plane("face", 5.0, Interaction::Refractive, 1, 0)], 3, 1.0);
    inside.sources[0].medium = 1;
    inside.sources[0].frame.rotation = DMat3::from_rotation_x(60.0_f64.to_radians());
    let totally_reflected = split_rows(bench, &inside, 16, Precision::F64).2;
    let found = [plate(4, 3.0), plate(4, 4.0), plate(2, 3.0), totally_reflected];
    if found != [true, false, false, false] {
        return Err(format!("saturated: {found:?}"));
    }
    let (rows, ..) =
        split_rows(bench, &split_scene(vec![coat("coat", 5.0, 0.5)], 2, 1.5), 16, Precision::F64);
    let families = rows.len() as f64 / SPLIT_RAYS as f64 - 1.0;
    near("families of two", families, 0.5, SPLIT_RAYS, 1.0)
}

/// A facet of 45 degrees reflects onto another one of the same mesh, and then transmits by its own normal.
fn split_mesh(bench: &Bench) -> Outcome {
    let corner = |x: f64, y: f64, z: f64| DVec3::new(x, y, z);
    // A valley that is open towards -z; its normals point from vacuum to glass.
    let vertices = vec![
        corner(-10.0, -10.0, -10.0),
        corner(0.0, -10.0, 0.0),
        corner(0.0, 10.0, 0.0),
        corner(-10.0, 10.0, -10.0),
        corner(10.0, -10.0, -10.0),
        corner(10.0, 10.0, -10.0),
    ];
    let faces = vec![[0, 1, 2], [0, 2, 3], [1, 4, 5], [1, 5, 2]];
    let valley =
        Surface { shape: Shape::Mesh(MeshId(0)), ..plane("valley", 15.0, Interaction::Refractive, 0, 1) };
    let mut ir = split_scene(vec![valley], 1, 2.0);
    ir.meshes.push(Mesh { vertices, faces });
    ir.sources[0].frame.origin = DVec3::new(-3.0, 0.1, 0.0);
    let (rows, ..) = split_rows(bench, &ir, 16, Precision::F64);
    let children: Vec<&RayRow> = rows.iter().filter(|row| row.ray_id >= SPLIT_RAYS).collect();
    let bend = std::f64::consts::FRAC_PI_4 - (0.5_f64.sqrt() / INDEX).asin();
    let refracted = |row: &&RayRow| {
        let [x, _, z] = row.direction;
        (x + bend.sin()).abs() < 1e-12 && (z - bend.cos()).abs() < 1e-12
    };
    if children.len() as u64 == SPLIT_RAYS && children.iter().all(refracted) {
        Ok(())
    } else {
        Err(format!(
            "{} children, the first goes {:?}",
            children.len(),
            children.first().map(|row| row.direction)
        ))
    }
}

/// Laws of scattering, and what share of the light they send within a distance of direction cosines from the axis, at normal
/// incidence.
type Law = (Bsdf, f64, Box<dyn Fn(f64) -> f64>);

fn laws() -> Vec<Law> {
    let through = 0.3;
    let harvey = HarveyShack { b0: 1.0, l0: 0.2, s: 1.5, transmissive_fraction: through };
    let within = {
        let (cumulative, _) = harvey.distribution();
        move |beta: f64| {
            let place = beta / harvey_shack::STEP;
            let knot = place.floor() as usize;
            cumulative[knot] + (place - place.floor()) * (cumulative[knot + 1] - cumulative[knot])
        }
    };
    // f = 0.6 - 0.4 theta / 90 degrees at normal incidence.
    let table =
        BsdfTable { theta_i: vec![0.0, 90.0], theta_s: vec![0.0, 90.0], values: vec![0.6, 0.2, 0.1, 0.1] };
    let of_table = |beta: f64| {
        let (end, steps) = (beta.asin(), 10_000);
        let width = end / f64::from(steps);
        let ring = |step: i32| {
            let theta = (f64::from(step) + 0.5) * width;
            (0.6 - 0.4 * theta / std::f64::consts::FRAC_PI_2)
                * std::f64::consts::PI
                * (2.0 * theta).sin()
                * width
        };
        (0..steps).map(ring).sum::<f64>()
    };
    let lambertian = Lambertian { reflectance_value: 0.8, transmissive_fraction: through };
    let mut laws: Vec<Law> = vec![
        (Bsdf::Lambertian(lambertian), through, Box::new(|beta: f64| 0.8 * beta * beta)),
        (Bsdf::HarveyShack(harvey), through, Box::new(within)),
        (Bsdf::Tabulated(Tabulated { table, transmissive_fraction: through }), through, Box::new(of_table)),
    ];
    for s in [1.0, 2.0, 2.5] {
        let lobe = KCorrelation { b0: 1.0, b: 5.0, s, transmissive_fraction: through };
        let shape = lobe.clone();
        let within = move |beta| shape.scattered_within(beta) / shape.scattered_within(2.0);
        laws.push((Bsdf::KCorrelation(lobe), through, Box::new(within)));
    }
    laws
}

/// With a target of each shape on either side, every law sends as much light within each cone, and to each side, as without: what
/// its integral says. Half of the rays that scatter were drawn.
fn scatter_towards_targets(bench: &Bench) -> Outcome {
    const NUM_RAYS: u64 = 60_000;
    const FRACTION: f64 = 0.25;
    let target = |share, shape| Target { share, shape };
    for (bsdf, through, within) in laws() {
        let mut mirror = plane("mirror", 5.0, Interaction::Reflective { reflectance: vec![1.0] }, 0, 0);
        mirror.scatter = Some(Scatter { fraction: FRACTION, bsdf });
        let source = SourceKind::Point(Point { half_angle: 0.0 });
        let mut ir = scene(source, vec![mirror], vec![database("back", -10.0), database("beyond", 20.0)]);
        for detector in &mut ir.detectors {
            detector.kind =
                DetectorKind::RayDatabase(RayDatabase { width: 1e9, height: 1e9, max_rays: None });
        }
        ir.scatter_sampling = vec![ScatterSampling {
            prob: Some(0.5),
            targets: vec![
                target(0.2, TargetShape::Cone { axis: [0.0, 0.6, -0.8], half_angle: 0.7 }),
                target(0.15, TargetShape::Sphere { center: [1.0, -3.0, -2.0], radius: 4.0 }),
                target(
                    0.15,
                    TargetShape::Rectangle {
                        center: [2.0, 1.0, 12.0],
                        half_sides: [[6.0, 0.0, 1.0], [0.0, 4.0, 0.0]],
                    },
                ),
                target(
                    0.15,
                    TargetShape::Disk {
                        center: [-1.0, 2.0, -4.0],
                        radii: [[5.0, 0.0, 0.0], [0.0, 5.0, 0.0]],
                    },
                ),
            ],
        }];
        let mut setting = Setting::default();
        setting.options.num_rays = NUM_RAYS;
        setting.options.precision = Precision::F64;
        let tally = bench.tally(&ir, &setting);
        for (detector, side) in [(0, 1.0 - through), (1, through)] {
            let rows = &tally.detectors[detector].rows;
            for beta in [0.05, 0.2, 0.5, 0.8, 0.999] {
                let weights = rows.iter().filter(|row| {
                    let offset = row.direction[0].hypot(row.direction[1]);
                    // Rays that do not scatter keep to the axis.
                    offset > 0.0 && offset <= beta
                });
                let (sum, squares) = weights.fold((0.0, 0.0), |(sum, squares), row| {
                    (sum + row.weight, squares + row.weight * row.weight)
                });
                let (share, error) = (sum / NUM_RAYS as f64, squares.sqrt() / NUM_RAYS as f64);
                let expected = FRACTION * side * within(beta);
                if (share - expected).abs() > 4.5 * error + 1e-6 {
                    return Err(format!(
                        "{:?}: detector {detector} has {share} ± {error} within {beta}, expected {expected}",
                        ir.surfaces[0].scatter
                    ));
                }
            }
        }
    }
    Ok(())
}

/// Azimuths of the table below.
const AZIMUTHS: u32 = 8;

/// 2.4 - r + 0.5 sin(2 a) + 0.4 cos(a) at the azimuths of the table, and linear between them.
fn wavy_at(azimuth: f64, radial: f64) -> f64 {
    let step = std::f64::consts::TAU / f64::from(AZIMUTHS);
    let place = (azimuth / step).floor();
    let at = |place: f64| 2.4 - radial + 0.5 * (2.0 * place * step).sin() + 0.4 * (place * step).cos();
    let part = azimuth / step - place;
    (1.0 - part) * at(place) + part * at(place + 1.0)
}

/// A table of these values at 60 degrees of incidence times 0.6, and at 20 degrees times 0.2.
fn wavy(transmits: bool) -> Bsdf {
    let azimuth: Vec<f64> =
        (0..=AZIMUTHS).map(|i| std::f64::consts::TAU * f64::from(i) / f64::from(AZIMUTHS)).collect();
    let row = |incidence_deg: f64, level: f64| {
        let polar = vec![0.0, 0.7, 1.3];
        let of = |azimuth: &f64| polar.iter().map(|radial| level * wavy_at(*azimuth, *radial)).collect();
        let rows = azimuth.iter().map(of).collect();
        MeasuredRow {
            incidence_deg,
            values: PolarTable { polar, azimuth: azimuth.clone(), rows },
            scattered: 1.0,
            measured: 1.0,
        }
    };
    let table = MeasuredTable { transmits, rows: vec![row(20.0, 0.2), row(60.0, 0.6)] };
    Bsdf::Measured(Measured { table: table.into(), level: 1.0 })
}

/// A slanted wall sends the light of a table along the axes about the specular direction, by its integrals over the directions above
/// the wall, whether rays follow the table or go towards targets.
fn measured_bsdf(bench: &Bench) -> Outcome {
    const NUM_RAYS: u64 = 60_000;
    const SLANT: f64 = 0.6;
    for (transmits, is_aimed) in [(false, false), (true, false), (false, true), (true, true)] {
        let mut wall = plane("wall", 5.0, Interaction::Reflective { reflectance: vec![1.0] }, 0, 0);
        wall.frame.rotation = DMat3::from_rotation_y(SLANT);
        wall.scatter = Some(Scatter { fraction: 1.0, bsdf: wavy(transmits) });
        let source = SourceKind::Point(Point { half_angle: 0.0 });
        let mut ir = scene(source, vec![wall], vec![database("back", -50.0), database("beyond", 60.0)]);
        for detector in &mut ir.detectors {
            detector.kind =
                DetectorKind::RayDatabase(RayDatabase { width: 1e9, height: 1e9, max_rays: None });
        }
        let incident = DVec3::Z;
        let facing = -(DMat3::from_rotation_y(SLANT) * DVec3::Z);
        let specular = if transmits { incident } else { incident - 2.0 * incident.dot(facing) * facing };
        let normal = if transmits { -facing } else { facing };
        let towards = (normal - normal.dot(specular) * specular).normalize();
        let axes = [specular, towards, specular.cross(towards)];
        if is_aimed {
            let axis = (specular + 0.3 * towards).normalize().to_array();
            let shape = TargetShape::Cone { axis, half_angle: 1.5 };
            let targets = vec![Target { share: 0.6, shape }];
            ir.scatter_sampling = vec![ScatterSampling { prob: None, targets }];
        }
        let mut setting = Setting::default();
        setting.options.num_rays = NUM_RAYS;
        setting.options.precision = Precision::F64;
        let tally = bench.tally(&ir, &setting);
        // Of the light, and of the light times the cosines with the axes and their product.
        let parts = |d: DVec3| {
            let [along, up, across] = axes.map(|axis| d.dot(axis));
            [1.0, along, up, across, up * across]
        };
        let (mut sums, mut squares) = ([0.0; 5], [0.0; 5]);
        for row in tally.detectors.iter().flat_map(|detector| &detector.rows) {
            for (i, part) in parts(DVec3::from_array(row.direction)).into_iter().enumerate() {
                sums[i] += row.weight * part;
                squares[i] += (row.weight * part).powi(2);
            }
        }
        let level = 0.2 + 0.4 * (SLANT.to_degrees() - 20.0) / 40.0;
        let (steps, mut expected) = (600, [0.0; 5]);
        let (step, turn) = (1.3 / f64::from(steps), std::f64::consts::TAU / f64::from(steps));
        for (i, j) in (0..steps).flat_map(|i| (0..steps).map(move |j| (i, j))) {
            let (radial, azimuth) = ((f64::from(i) + 0.5) * step, (f64::from(j) + 0.5) * turn);
            let d =
                radial.cos() * axes[0] + radial.sin() * (azimuth.cos() * axes[1] + azimuth.sin() * axes[2]);
            let value = level * wavy_at(azimuth, radial);
            let light = value * d.dot(normal).max(0.0) * radial.sin() * step * turn;
            parts(d).iter().zip(&mut expected).for_each(|(part, sum)| *sum += light * part);
        }
        for ((sum, squares), expected) in sums.into_iter().zip(squares).zip(expected) {
            let (found, error) = (sum / NUM_RAYS as f64, squares.sqrt() / NUM_RAYS as f64);
            if (found - expected).abs() > 4.5 * error + 1e-4 {
                return Err(format!(
                    "transmits: {transmits}, aimed: {is_aimed}: {found} ± {error}, expected {expected}"
                ));
            }
        }
    }
    Ok(())
}
