//! The first crossing of a ray with an asphere or a freeform, by the shader's search, against a dense search in f64: with
//! steep departures and inflections, rays from everywhere, in every precision.

#![allow(clippy::unwrap_used, clippy::print_stdout, reason = "helpers of tests, outside of #[test]")]

mod common;
#[path = "zoo/files.rs"]
mod files;

use common::{Gpu, Storage, real_bytes, reals_of};
use glam::{DVec2, DVec3};
use nsq_gpu::model::ShapeKind;
use nsq_gpu::model::shapes::freeform::Polynomial;
use nsq_gpu::model::shapes::{Across, AsphereProfile, Biconic, Freeform, Shape, Toroidal};
use nsq_gpu::program::layout::bindings;
use nsq_gpu::program::layout::rng::{Sampler, splitmix64};
use nsq_gpu::program::wgsl::library::{self, Integers, Real};
use std::f64::consts::TAU;

/// Surfaces of a kind: in `make test`, and in the long tests.
const FEW_SURFACES: u64 = 16;
const MANY_SURFACES: u64 = 48;
const RAYS_PER_SURFACE: u64 = 48;
const MISS: f64 = 1e37;

/// A ray and its surface.
struct Case {
    shape: Shape,
    origin: DVec3,
    direction: DVec3,
    leaving: bool,
}

/// The kinds whose crossings are searched.
const KINDS: [ShapeKind; 5] = [
    ShapeKind::EvenAsphere,
    ShapeKind::OddAsphere,
    ShapeKind::Biconic,
    ShapeKind::Toroidal,
    ShapeKind::Freeform,
];

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

/// A random surface of a kind with a semi-diameter: of steep departures and inflections, some with a tip.
fn random_shape(s: &mut u64, real: Real, kind: ShapeKind, aperture: f64) -> Shape {
    let mut signed = |most: f64| (2.0 * uniform(s) - 1.0) * most;
    let [mut radius_x, mut radius_y] = [(), ()].map(|()| {
        let radius = (6.3 + signed(5.0)) * aperture;
        if signed(1.0) < 0.0 { -radius } else { radius }
    });
    let [mut conic_x, conic_y] = [signed(1.0) - 0.5, signed(1.0) - 0.5];
    let rise = 0.15 * (1.0 + signed(1.0)) * aperture;
    // The device has the numbers of its precision.
    let exact = |radius: f64, conic: f64| {
        let curvature = rounded(real, 1.0 / radius);
        let axial = rounded(real, (1.0 + conic) * curvature * curvature);
        (1.0 / curvature, axial / (curvature * curvature) - 1.0)
    };
    // Coefficients by what they add at the rim.
    let mut at_rim = |num: usize, step: i32| -> Vec<f64> {
        (1..=num).map(|i| signed(rise) / aperture.powi(step * i as i32)).collect()
    };
    (radius_x, conic_x) = exact(radius_x, conic_x);
    match kind {
        ShapeKind::EvenAsphere => {
            Shape::EvenAsphere(AsphereProfile::new(radius_x, conic_x, aperture, 2, &at_rim(6, 2)).into())
        }
        ShapeKind::OddAsphere => {
            Shape::OddAsphere(AsphereProfile::new(radius_x, conic_x, aperture, 1, &at_rim(6, 1)).into())
        }
        ShapeKind::Biconic => {
            let (radius_y, conic_y) = exact(radius_y, conic_y);
            let curvature = DVec2::new(1.0 / radius_x, 1.0 / radius_y);
            Shape::Biconic(
                Biconic { curvature, conic: DVec2::new(conic_x, conic_y), aperture_radius: aperture }.into(),
            )
        }
        ShapeKind::Toroidal => {
            // Not so steep that it is turned over.
            radius_y = 2.0 * radius_x.abs().copysign(radius_y);
            let coefficients = at_rim(3, 2).into_iter().map(|a| 0.3 * a).collect::<Vec<f64>>();
            let profile = AsphereProfile::new(radius_y, conic_y, aperture, 2, &coefficients);
            Shape::Toroidal(Toroidal { curvature_x: 1.0 / radius_x, profile }.into())
        }
        _ => {
            let terms = at_rim(15, 0);
            let value = |p: DVec2| {
                let p = p / aperture;
                let powers = (0..5).flat_map(|i| (0..5 - i).map(move |j| p.x.powi(i) * p.y.powi(j)));
                powers.zip(&terms).map(|(power, term)| 0.4 * power * term).sum()
            };
            let polynomial = Polynomial { powers: [4; 2], order: 4, value: &value, definition: vec![] };
            Shape::Polynomial(Freeform::new(radius_x, conic_x, aperture, &polynomial).into())
        }
    }
}

/// A point of the surface.
fn on(shape: &Shape, aperture: f64, share: f64, turn: f64) -> DVec3 {
    let across = DVec2::from_angle(TAU * turn) * (share * aperture);
    across.extend(-shape.level(across.extend(0.0)).unwrap().value)
}

fn cases(real: Real, kind: ShapeKind, num_surfaces: u64) -> Vec<Case> {
    let mut state = 1000 * u64::from(kind.code());
    let s = &mut state;
    let mut cases = Vec::new();
    for _ in 0..num_surfaces {
        let aperture = rounded(real, 2.0 + 18.0 * uniform(s));
        let shape = random_shape(s, real, kind, aperture);
        for ray in 0..RAYS_PER_SURFACE {
            let mut point = |share: f64| on(&shape, aperture, share, uniform(s));
            let (target, other) = (point(0.98), point(0.5));
            let leaving = ray % 4 == 0;
            let (origin, direction) = match ray % 4 {
                0 => (other, direction(s)),
                // Towards the surface, from near, from far, and from very far.
                1 => {
                    let origin = target - direction(s) * aperture * 3.0 * uniform(s);
                    (origin, (other - origin).normalize())
                }
                2 => {
                    let way = direction(s);
                    (other - way * 1e3 * uniform(s), way)
                }
                _ => {
                    let way = direction(s);
                    (other - way * if real == Real::F32 { 1e3 } else { 1e6 }, way)
                }
            };
            let round = |v: DVec3| DVec3::from_array(v.to_array().map(|x| rounded(real, x)));
            let (origin, direction) = (round(origin), round(direction));
            if ray % 4 == 1 {
                // The same line the other way: its last crossing comes first.
                let behind = round(origin + 6.0 * aperture * direction);
                cases.push(Case { shape: shape.clone(), origin: behind, direction: -direction, leaving });
            }
            cases.push(Case { shape: shape.clone(), origin, direction, leaving });
        }
    }
    cases
}

/// The distances that the shader finds.
fn searched(gpu: &Gpu, real: Real, kind: ShapeKind, cases: &[Case]) -> Vec<f64> {
    let name = kind.wgsl().name;
    let at = kind.num_arguments();
    // The arguments, a point, a direction, and whether the ray leaves the surface there.
    let num_numbers = at + 7;
    let arguments: String = (0..at).map(|i| format!("numbers[at + {i}u], ")).collect();
    let entry = format!(
        "const MISS: real = 1e38;
        const BINDING_TABLES: u32 = {}u;
        fn always_true() -> bool {{ return true; }}
        @group(0) @binding(5) var<storage, read> numbers: array<real>;
        @group(0) @binding(6) var<storage, read_write> distances: array<real>;
        @compute @workgroup_size(64)
        fn main(@builtin(global_invocation_id) id: vec3<u32>) {{
            if id.x >= arrayLength(&distances) {{ return; }}
            let at = id.x * {num_numbers}u;
            let o = vec3<real>(numbers[at + {at}u], numbers[at + {}u], numbers[at + {}u]);
            let d = vec3<real>(numbers[at + {}u], numbers[at + {}u], numbers[at + {}u]);
            distances[id.x] = {name}_distance(o, d, {arguments}numbers[at + {}u] > 0.5);
        }}",
        bindings::TABLES,
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
    let has_tables = cases[0].shape.table().is_some();
    let tables = match has_tables {
        true => shader("optics/tables.wgsl") + &shader("geometry/clip.table.wgsl"),
        false => shader("geometry/clip.none.wgsl"),
    };
    let source = [
        library::source(real, Integers::Portable, Sampler::Pcg),
        shader("geometry/sag.search.wgsl"),
        shader(&format!("geometry/sag_rounding.{tier}.wgsl")),
        tables,
        shader(&format!("shapes/{name}.wgsl")),
        entry,
    ]
    .concat();
    let mut numbers = Vec::new();
    let mut tables: Vec<f64> = Vec::new();
    for case in cases {
        let mut arguments = case.shape.arguments();
        if let Some(table) = case.shape.table() {
            arguments[0] = tables.len() as f64;
            tables.extend(table);
        }
        numbers.extend(arguments);
        numbers.extend(case.origin.to_array());
        numbers.extend(case.direction.to_array());
        numbers.push(f64::from(u8::from(case.leaving)));
    }
    let mut storages =
        vec![Storage::reals(5, real, &numbers), Storage::zeros(6, real_bytes(real) * cases.len())];
    if has_tables {
        storages.push(Storage::reals(bindings::TABLES, real, &tables));
    }
    let groups = [u32::try_from(cases.len().div_ceil(64)).unwrap(), 1, 1];
    let found = gpu.run(&source, &storages, groups);
    reals_of(real, found.last().unwrap())
}

/// Compares with the dense search; returns how many rays met the surface.
fn check(real: Real, kind: ShapeKind, num_surfaces: u64) -> Option<(usize, f64)> {
    // Half a unit in the last place, relative; pairs and f32 round the numbers of the ray as well.
    let unit: f64 = match real {
        Real::F32 => 6e-8,
        Real::Df64 => 2e-14,
        Real::F64 => 1.2e-16,
    };
    let gpu = Gpu::open("lib_sag", real, Integers::Portable)?;
    let cases = cases(real, kind, num_surfaces);
    let mut num_met = 0;
    let mut largest = 0.0f64;
    for (i, (case, &found)) in cases.iter().zip(&searched(&gpu, real, kind, &cases)).enumerate() {
        let Case { shape, origin, direction, leaving } = case;
        let Some(Across::Disk(aperture)) = shape.extent(&[]).map(|extent| extent.across) else { return None };
        let level = |t: f64| shape.level(*origin + t * *direction).unwrap();
        let rate = |t: f64| level(t).gradient.dot(*direction);
        let size = origin.length() + aperture;
        // Where a ray grazes, one crossing more or less is chance; nor can the start of a ray that leaves be told from a
        // crossing next to it.
        let near = if *leaving { 1e3 * unit.max(1e-12) * size + 1e-5 * size } else { 0.0 };
        let mut crossings: Vec<f64> = shape.crossings(*origin, *direction);
        crossings.sort_by(f64::total_cmp);
        let is_doubtful = crossings.windows(2).any(|pair| pair[1] - pair[0] < 1e-3 * size)
            || crossings
                .iter()
                .any(|&t| rate(t).abs() < 1e-2 || (t.abs() < 2.0 * near && t.abs() > 0.5 * near))
            || *leaving && rate(0.0).abs() < 1e-2;
        let first = crossings.iter().copied().find(|&t| t > near);
        let at_rim =
            |t: f64| ((*origin + t * *direction).truncate().length() - aperture).abs() < 1e-5 * aperture;
        if is_doubtful || first.is_some_and(at_rim) {
            continue;
        }
        match first {
            None => {
                assert!(found > MISS, "{real:?} {kind:?} case {i}: met at {found}, where there is nothing")
            }
            Some(t) => {
                let r = (*origin + t * *direction).truncate().length() / aperture;
                assert!(
                    found < MISS,
                    "{real:?} {kind:?} case {i}: missed, crossed at {t} of {crossings:?}, {r} of the aperture, rate {}, {shape:?} {origin:?} {direction:?}",
                    rate(t),
                );
                num_met += 1;
                let place = *origin + found * *direction;
                // A distance beside the surface, over the incidence's cosine, in units of the largest coordinate's last place.
                let largest_coordinate = place.abs().max_element().max(origin.abs().max_element());
                let size = if real == Real::F64 { largest_coordinate } else { size };
                let off = level(found).value.abs() / level(found).gradient.length();
                largest = largest.max(off / (2.0 * unit * size.max(found.abs())));
                assert!(
                    (found - t).abs() < 1e-4 * size.max(1.0),
                    "{real:?} {kind:?} case {i}: {found}, not {t}"
                );
            }
        }
    }
    Some((num_met, largest))
}

fn check_all(real: Real, num_surfaces: u64) {
    for kind in files::in_turn(KINDS) {
        let Some((num_met, largest)) = check(real, kind, num_surfaces) else { continue };
        println!("{real:?}, {kind:?}: {num_met} rays met, {largest:.2} units in the last place");
        assert!(num_met as u64 > 21 * num_surfaces, "{kind:?}: {num_met} rays met a surface");
        assert!(largest < 8.0, "{real:?}, {kind:?}: {largest} units in the last place");
    }
}

#[test]
fn the_first_crossing_of_random_surfaces_is_found_in_f64() {
    check_all(Real::F64, FEW_SURFACES);
}

#[test]
fn the_first_crossing_of_random_surfaces_is_found_in_f32() {
    check_all(Real::F32, FEW_SURFACES);
}

#[test]
#[ignore = "long"]
fn the_first_crossing_of_many_random_surfaces_is_found() {
    check_all(Real::F64, MANY_SURFACES);
    check_all(Real::F32, MANY_SURFACES);
}

/// A ray along a surface that is flat but for its rim, and one that leaves a bowl's vertex along its tangent: both end, the
/// first within some hundred looks, at the first crossing that rounding does not hide.
#[test]
fn rays_along_a_surface_end_at_its_next_crossing() {
    let Some(gpu) = Gpu::open("lib_sag", Real::F64, Integers::Portable) else { return };
    let flat = AsphereProfile::new(
        f64::INFINITY,
        0.0,
        10.0,
        2,
        &[0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 2e-20],
    );
    let ripple = AsphereProfile::new(f64::INFINITY, 0.0, 15.0, 2, &[0.01, -1e-4]);
    let along = |profile: AsphereProfile, origin, z: f64, leaving| Case {
        shape: Shape::EvenAsphere(profile.into()),
        origin,
        direction: DVec3::new((1.0 - z * z).sqrt(), 0.0, z),
        leaving,
    };
    let mut cases: Vec<Case> =
        [0.0, 1e-9, 1e-6, 1e-4].map(|z| along(flat, DVec3::new(-30.0, 0.0, z), 0.0, false)).into();
    cases.extend([0.0, 1e-7, 1e-5].map(|z| along(ripple, DVec3::ZERO, z, true)));
    let found = searched(&gpu, Real::F64, ShapeKind::EvenAsphere, &cases);
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
    let inner = AsphereProfile::new(f64::INFINITY, 0.0, 5.0, 2, &[0.0, 1e-4]);
    let origin = DVec3::new(15.0, 0.0, inner.sag(15.0));
    let case = Case {
        shape: Shape::EvenAsphere(inner.into()),
        origin,
        direction: -origin.normalize(),
        leaving: true,
    };
    let t = searched(&gpu, Real::F64, ShapeKind::EvenAsphere, &[case])[0];
    assert!((t - origin.length()).abs() < 1e-9, "{t}");
}

/// Lavapipe compiles the search in pairs for a minute.
#[test]
#[ignore = "long"]
fn the_first_crossing_of_random_surfaces_is_found_in_pairs() {
    check_all(Real::Df64, MANY_SURFACES);
}
