//! The first crossing of a ray with an asphere, by the shader's search, against a dense search in f64: random aspheres with
//! steep departures and inflections, rays from everywhere, in every precision.

#![allow(clippy::unwrap_used, clippy::print_stdout, reason = "helpers of tests, outside of #[test]")]

mod common;

use common::{Gpu, Storage, real_bytes, reals_of};
use glam::DVec3;
use nsq_gpu::model::Profile;
use nsq_gpu::model::shapes::Geometry;
use nsq_gpu::program::layout::rng::{Sampler, splitmix64};
use nsq_gpu::program::wgsl::library::{self, Integers, Real};
use std::f64::consts::TAU;

const NUM_ASPHERES: u64 = 48;
const RAYS_PER_ASPHERE: u64 = 48;
const NUM_ARGUMENTS: usize = 19;
/// Numbers of a ray: the arguments, a point, a direction, and whether the ray leaves the surface there.
const NUM_NUMBERS: usize = NUM_ARGUMENTS + 7;
const MISS: f64 = 1e37;

/// A ray and its asphere.
struct Case {
    profile: Profile,
    origin: DVec3,
    direction: DVec3,
    leaving: bool,
}

/// Random numbers in [0, 1).
fn uniform(state: &mut u64) -> f64 {
    *state = state.wrapping_add(1);
    (splitmix64(*state) >> 11) as f64 / (1u64 << 53) as f64
}

fn direction(state: &mut u64) -> DVec3 {
    let (z, turn) = (2.0 * uniform(state) - 1.0, TAU * uniform(state));
    let across = (1.0 - z * z).sqrt();
    DVec3::new(across * turn.cos(), across * turn.sin(), z)
}

/// What a number of the device is in f64.
fn rounded(real: Real, number: f64) -> f64 {
    if real == Real::F32 { f64::from(number as f32) } else { number }
}

fn cases(real: Real, step: u32) -> Vec<Case> {
    let mut state = 1000 * u64::from(step);
    let s = &mut state;
    let mut cases = Vec::new();
    for _ in 0..NUM_ASPHERES {
        let aperture = rounded(real, 2.0 + 18.0 * uniform(s));
        let radius = (1.3 + 10.0 * uniform(s)) * aperture * if uniform(s) < 0.5 { -1.0 } else { 1.0 };
        // Coefficients by what they add at the rim; some aspheres have a tip, or rise by their own radius.
        let rise = 0.3 * uniform(s) * aperture;
        let coefficients: Vec<f64> = (0..6)
            .map(|i| (2.0 * uniform(s) - 1.0) * rise / aperture.powi((step as usize * (i + 1)) as i32))
            .map(|coefficient| rounded(real, coefficient))
            .collect();
        let conic = 2.0 * uniform(s) - 1.5;
        let mut profile = Profile::new(radius, conic, aperture, step, &coefficients);
        profile.curvature = rounded(real, profile.curvature);
        let axial = rounded(real, (1.0 + profile.conic) * profile.curvature.powi(2));
        profile.conic = axial / profile.curvature.powi(2) - 1.0;
        for ray in 0..RAYS_PER_ASPHERE {
            let mut on = |share: f64| {
                let (r, turn) = (share * aperture, TAU * uniform(s));
                DVec3::new(r * turn.cos(), r * turn.sin(), profile.sag(r))
            };
            let (target, other) = (on(0.98), on(0.5));
            let leaving = ray % 3 == 0;
            let (origin, direction) = match ray % 3 {
                0 => (other, direction(s)),
                // Towards the surface, from near and from far.
                1 => {
                    let origin = target - direction(s) * aperture * 3.0 * uniform(s);
                    (origin, (other - origin).normalize())
                }
                _ => {
                    let way = direction(s);
                    (other - way * 1e3 * uniform(s), way)
                }
            };
            let round = |v: DVec3| DVec3::from_array(v.to_array().map(|x| rounded(real, x)));
            cases.push(Case { profile, origin: round(origin), direction: round(direction), leaving });
        }
    }
    cases
}

/// The distances that the shader finds.
fn searched(gpu: &Gpu, real: Real, step: u32, cases: &[Case]) -> Vec<f64> {
    let name = if step == 2 { "even_asphere" } else { "odd_asphere" };
    let arguments: String = (0..NUM_ARGUMENTS).map(|i| format!("numbers[at + {i}u], ")).collect();
    let at = NUM_ARGUMENTS;
    let entry = format!(
        "const MISS: real = 1e38;
        @group(0) @binding(5) var<storage, read> numbers: array<real>;
        @group(0) @binding(6) var<storage, read_write> distances: array<real>;
        @compute @workgroup_size(64)
        fn main(@builtin(global_invocation_id) id: vec3<u32>) {{
            if id.x >= arrayLength(&distances) {{ return; }}
            let at = id.x * {NUM_NUMBERS}u;
            let o = vec3<real>(numbers[at + {at}u], numbers[at + {}u], numbers[at + {}u]);
            let d = vec3<real>(numbers[at + {}u], numbers[at + {}u], numbers[at + {}u]);
            distances[id.x] = {name}_distance(o, d, {arguments}numbers[at + {}u] > 0.5);
        }}",
        at + 1,
        at + 2,
        at + 3,
        at + 4,
        at + 5,
        at + 6,
    );
    let shader = |path: &str| {
        std::fs::read_to_string(format!("{}/shaders/{path}", env!("CARGO_MANIFEST_DIR"))).unwrap()
    };
    let tier = match real {
        Real::F32 => "f32",
        Real::Df64 => "df64",
        Real::F64 => "f64",
    };
    let source = [
        library::source(real, Integers::Portable, Sampler::Pcg),
        shader("geometry/sag.search.wgsl"),
        shader(&format!("geometry/sag_rounding.{tier}.wgsl")),
        shader(&format!("shapes/{name}.wgsl")),
        entry,
    ]
    .concat();
    let numbers: Vec<f64> = cases
        .iter()
        .flat_map(|case| {
            let mut numbers = case.profile.arguments();
            numbers.extend(case.origin.to_array());
            numbers.extend(case.direction.to_array());
            numbers.push(f64::from(u8::from(case.leaving)));
            numbers
        })
        .collect();
    let storages = [Storage::reals(5, real, &numbers), Storage::zeros(6, real_bytes(real) * cases.len())];
    let groups = [u32::try_from(cases.len().div_ceil(64)).unwrap(), 1, 1];
    reals_of(real, &gpu.run(&source, &storages, groups)[0])
}

/// Compares with the dense search; returns how many rays met the surface.
fn check(real: Real, step: u32) -> Option<(usize, f64)> {
    // Half a unit in the last place, relative; pairs and f32 round the numbers of the ray as well.
    let unit: f64 = match real {
        Real::F32 => 6e-8,
        Real::Df64 => 2e-14,
        Real::F64 => 1.2e-16,
    };
    let gpu = Gpu::open("lib_sag", real, Integers::Portable)?;
    let cases = cases(real, step);
    let mut num_met = 0;
    let mut largest = 0.0f64;
    for (i, (case, &found)) in cases.iter().zip(&searched(&gpu, real, step, &cases)).enumerate() {
        let Case { profile, origin, direction, leaving } = case;
        let level = |t: f64| profile.level(*origin + t * *direction).unwrap();
        let rate = |t: f64| level(t).gradient.dot(*direction);
        let size = origin.length() + profile.aperture_radius;
        // Where a ray grazes, one crossing more or less is chance; nor can the start of a ray that leaves be told from a
        // crossing next to it.
        let near = if *leaving { 1e3 * unit.max(1e-12) * size + 1e-5 * size } else { 0.0 };
        let mut crossings: Vec<f64> = profile.crossings(*origin, *direction);
        crossings.sort_by(f64::total_cmp);
        let is_doubtful = crossings.windows(2).any(|pair| pair[1] - pair[0] < 1e-3 * size)
            || crossings
                .iter()
                .any(|&t| rate(t).abs() < 1e-2 || (t.abs() < 2.0 * near && t.abs() > 0.5 * near))
            || *leaving && rate(0.0).abs() < 1e-2;
        let first = crossings.iter().copied().find(|&t| t > near);
        let at_rim = |t: f64| {
            ((*origin + t * *direction).truncate().length() - profile.aperture_radius).abs()
                < 1e-5 * profile.aperture_radius
        };
        if is_doubtful || first.is_some_and(at_rim) {
            continue;
        }
        match first {
            None => assert!(found > MISS, "{real:?} {step} case {i}: met at {found}, where there is nothing"),
            Some(t) => {
                let r = (*origin + t * *direction).truncate().length() / profile.aperture_radius;
                assert!(
                    found < MISS,
                    "{real:?} {step} case {i}: missed, crossed at {t} of {crossings:?}, {r} of the aperture, rate {}, bounds {:?} {origin:?} {direction:?}",
                    rate(t),
                    profile.bounds()
                );
                num_met += 1;
                let place = *origin + found * *direction;
                // A distance beside the surface, over the incidence's cosine, in units of the largest coordinate's last place.
                let size = if real == Real::F64 { place.abs().max_element() + (found * unit) } else { size };
                let off = level(found).value.abs() / level(found).gradient.length();
                largest = largest.max(off / (2.0 * unit * size.max(found.abs())));
                assert!(
                    (found - t).abs() < 1e-4 * size.max(1.0),
                    "{real:?} {step} case {i}: {found}, not {t}"
                );
            }
        }
    }
    Some((num_met, largest))
}

fn check_all(real: Real) {
    for step in [2, 1] {
        let Some((num_met, largest)) = check(real, step) else { continue };
        println!(
            "{real:?}, powers in steps of {step}: {num_met} rays met, {largest:.2} units in the last place"
        );
        assert!(num_met > 1000, "{num_met} rays met a surface");
        assert!(largest < 8.0, "{real:?}, step {step}: {largest} units in the last place");
    }
}

#[test]
fn the_first_crossing_of_random_aspheres_is_found() {
    check_all(Real::F64);
    check_all(Real::F32);
}

/// A ray along a surface that is flat but for its rim, and one that leaves a bowl's vertex along its tangent: both end, the
/// first within some hundred looks, at the first crossing that rounding does not hide.
#[test]
fn rays_along_a_surface_end_at_its_next_crossing() {
    let Some(gpu) = Gpu::open("lib_sag", Real::F64, Integers::Portable) else { return };
    let flat =
        Profile::new(f64::INFINITY, 0.0, 10.0, 2, &[0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 2e-20]);
    let ripple = Profile::new(f64::INFINITY, 0.0, 15.0, 2, &[0.01, -1e-4]);
    let along = |profile, origin, z: f64, leaving| Case {
        profile,
        origin,
        direction: DVec3::new((1.0 - z * z).sqrt(), 0.0, z),
        leaving,
    };
    let mut cases: Vec<Case> =
        [0.0, 1e-9, 1e-6, 1e-4].map(|z| along(flat, DVec3::new(-30.0, 0.0, z), 0.0, false)).into();
    cases.extend([0.0, 1e-7, 1e-5].map(|z| along(ripple, DVec3::ZERO, z, true)));
    let found = searched(&gpu, Real::F64, 2, &cases);
    for (case, &t) in cases.iter().zip(&found).skip(1).take(3) {
        let p = case.origin + t * case.direction;
        assert!((flat.sag(p.truncate().length()) - p.z).abs() < 1e-9 && p.x < 0.0, "met at {p}");
    }
    // z = 0.01 r^2 - 1e-4 r^4 is left at r = 0: at slope e it is crossed at e / 0.01, and else at 10.
    assert!((found[4] - 10.0).abs() < 1e-9, "{}", found[4]);
    assert!((found[5] - 1e-5).abs() < 1e-9, "{}", found[5]);
    assert!((found[6] - 1e-3).abs() < 1e-9, "{}", found[6]);
}

/// Where one face has ended, a ray that leaves another one of the same curve may still meet it.
#[test]
fn a_ray_that_leaves_beyond_the_rim_meets_the_face_plainly() {
    let Some(gpu) = Gpu::open("lib_sag", Real::F64, Integers::Portable) else { return };
    let inner = Profile::new(f64::INFINITY, 0.0, 5.0, 2, &[0.0, 1e-4]);
    let origin = DVec3::new(15.0, 0.0, inner.sag(15.0));
    let case = Case { profile: inner, origin, direction: -origin.normalize(), leaving: true };
    let t = searched(&gpu, Real::F64, 2, &[case])[0];
    assert!((t - origin.length()).abs() < 1e-9, "{t}");
}

/// Lavapipe compiles the search in pairs for a minute.
#[test]
#[ignore = "long"]
fn the_first_crossing_of_random_aspheres_is_found_in_pairs() {
    check_all(Real::Df64);
}
