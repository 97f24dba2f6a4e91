//! Boundaries between media: Fresnel, Snell, total reflection, Beer-Lambert, and sums over internal reflections.

use crate::bench::{Bench, Tier, WAVELENGTH, at, conic, disk, hits, plane, rows, tiers, tilted, turned};
use crate::deviation::{binomial, exact, integral, mean, mean_and_variance};
use glam::DVec3;
use serde_json::json;
use std::f64::consts::{FRAC_PI_2, PI};

const MILLION: u64 = 1_000_000;

/// Unpolarised reflectance by the sine and tangent laws, [sin^2(i - t) / sin^2(i + t) + tan^2(i - t) / tan^2(i + t)] / 2
/// (Born and Wolf, 1.5.2): not the form that the tracer evaluates.
fn fresnel(n1: f64, n2: f64, i: f64) -> f64 {
    let sin_t = n1 / n2 * i.sin();
    if sin_t >= 1.0 {
        return 1.0;
    }
    if i == 0.0 {
        return ((n1 - n2) / (n1 + n2)).powi(2);
    }
    let t = sin_t.asin();
    let r_s = (i - t).sin() / (i + t).sin();
    let r_p = (i - t).sin() * (i + t).cos() / ((i + t).sin() * (i - t).cos());
    0.5 * (r_s * r_s + r_p * r_p)
}

const RAYS_PER_ANGLE: u64 = 64;

/// Pencils at every angle onto one boundary, reflected and transmitted with equal probability: then the weight of a
/// reflected ray is 2 R, of a transmitted one 2 (1 - R), exactly.
fn sweep(tier: &Tier, n1: f64, n2: f64, angles: &[f64]) -> nsq_gpu::TraceResult {
    let mut bench = Bench::new()
        .medium("first", n1, 0.0)
        .medium("second", n2, 0.0)
        .reflect_prob(0.5)
        .boundary("boundary", at(0.0, 0.0, 0.0), plane(), "first", "second")
        .database("reflected", at(0.0, 0.0, -2.0), 1e6, true)
        .database("transmitted", at(0.0, 0.0, 1.0), 1e6, true);
    for angle in angles {
        bench = bench.pencil(
            -tilted(*angle),
            tilted(*angle),
            json!({ "medium": { "type": "medium", "name": "first" } }),
        );
    }
    bench.trace(tier, RAYS_PER_ANGLE * angles.len() as u64)
}

fn check_sweep(tier: &Tier, n1: f64, n2: f64, angles: &[f64]) {
    let result = sweep(tier, n1, n2, angles);
    let angle_of = |ray: u64| angles[(ray / RAYS_PER_ANGLE) as usize];
    let (reflected, transmitted) = (rows(&result, "reflected"), rows(&result, "transmitted"));
    // Half of the weight is the fraction; a totally reflected ray keeps all of its weight.
    let fraction = |flux: f64| 0.5 * flux * RAYS_PER_ANGLE as f64;
    let total = |angle: f64| n1 / n2 * angle.sin() > 1.0;
    let r = reflected.iter().map(|row| {
        let angle = angle_of(row.ray);
        let expected = fresnel(n1, n2, angle);
        (fraction(row.flux) * if total(angle) { 2.0 } else { 1.0 }, expected)
    });
    exact(&tier.name(&format!("Fresnel R, {n1} to {n2}")), r, tier.pick(1e-12, 3e-6)).accepted();
    let t = transmitted.iter().map(|row| (fraction(row.flux), 1.0 - fresnel(n1, n2, angle_of(row.ray))));
    exact(&tier.name(&format!("Fresnel T, {n1} to {n2}")), t, tier.pick(1e-12, 3e-6)).accepted();
    let snell = transmitted.iter().map(|row| (row.direction.x, n1 / n2 * angle_of(row.ray).sin()));
    exact(&tier.name(&format!("Snell, {n1} to {n2}")), snell, tier.pick(1e-12, 3e-6)).accepted();
    for (i, angle) in angles.iter().enumerate() {
        let count = |rows: &[crate::bench::Row]| {
            rows.iter().filter(|row| row.ray / RAYS_PER_ANGLE == i as u64).count()
        };
        assert!(count(&reflected) > 0, "no ray was reflected at {angle}");
        assert_eq!(count(&transmitted) == 0, total(*angle), "transmitted rays at {angle}");
    }
    let wrong = reflected.iter().map(|row| (fraction(row.flux), fresnel(n1, n2 * 1.001, angle_of(row.ray))));
    exact("planted: n off by 1e-3", wrong, tier.pick(1e-12, 3e-6)).rejected();
}

#[test]
fn fresnel_and_snell_hold_from_normal_through_brewster_to_grazing_incidence() {
    for tier in tiers("Fresnel sweep") {
        let mut angles: Vec<f64> =
            [0.0, 1e-3, 10.0, 30.0, 45.0, 60.0, 75.0, 85.0, 89.0, 89.99].map(f64::to_radians).to_vec();
        angles.push(1.5f64.atan()); // Brewster: tan i = n2 / n1
        check_sweep(&tier, 1.0, 1.5, &angles);
        let critical = (1.0f64 / 1.5).asin();
        let near = tier.pick(0.01, 1.0f64).to_radians();
        let mut angles: Vec<f64> =
            [0.0, 1e-3, 10.0, 20.0, 30.0, 45.0, 60.0, 89.99].map(f64::to_radians).to_vec();
        angles.extend([(1.0f64 / 1.5).atan(), critical - near, critical + near]);
        check_sweep(&tier, 1.5, 1.0, &angles);
    }
}

#[test]
fn light_at_brewsters_angle_reflects_half_of_the_s_reflectance() {
    // R_p = 0 and R_s = ((n^2 - 1) / (n^2 + 1))^2 there, a closed form with no angle in it.
    for tier in tiers("Brewster") {
        let result = sweep(&tier, 1.0, 1.5, &[1.5f64.atan()]);
        let expected = 0.5 * (1.25f64 / 3.25).powi(2);
        let pairs = rows(&result, "reflected")
            .into_iter()
            .map(|row| (0.5 * row.flux * RAYS_PER_ANGLE as f64, expected));
        exact(&tier.name("Brewster's angle"), pairs, tier.pick(1e-12, 1e-6)).accepted();
    }
}

/// A plate of index 4 (R = 0.36, so that internal reflections matter) between two planes.
fn window(max_depth: u32, z: f64, thickness: f64) -> Bench {
    Bench::new()
        .medium("germanium", 4.0, 0.0)
        .max_depth(max_depth)
        .pencil(DVec3::ZERO, DVec3::Z, json!({}))
        .boundary("front", at(0.0, 0.0, z), disk(5.0), "", "germanium")
        .boundary("back", at(0.0, 0.0, z + thickness), disk(5.0), "germanium", "")
        .pixels("behind", at(0.0, 0.0, 10.0), 10.0, 1)
}

#[test]
fn a_window_transmits_the_sum_over_its_internal_reflections() {
    const R: f64 = 0.36; // ((4 - 1) / (4 + 1))^2
    for tier in tiers("window") {
        // All of them: (1 - R)^2 / (1 - R^2) = 2 n / (n^2 + 1). At depth 64 the rest is below R^62.
        let all = hits(&window(64, 2.0, 1.0).trace(&tier, MILLION), "behind");
        binomial(&tier.name("window, all reflections"), all, MILLION, 8.0 / 17.0).accepted();
        binomial("planted: window of n = 4.1", all, MILLION, 8.2 / (4.1 * 4.1 + 1.0)).rejected();
        // k pairs of reflections take 2 + 2 k events, and a ray lives on while it has had fewer than max_depth.
        let truncated = window(5, 2.0, 1.0).trace(&tier, MILLION);
        let expected = (1.0 - R).powi(2) * (1.0 + R * R);
        binomial(&tier.name("window, depth 5"), hits(&truncated, "behind"), MILLION, expected).accepted();
        // Alive after five events: entered, reflected three times, and met the front once more, whatever came of that.
        let lost = (1.0 - R) * R.powi(3);
        binomial(&tier.name("window, cut at depth 5"), truncated.num_rays_depth_killed, MILLION, lost)
            .accepted();
    }
}

#[test]
fn a_plate_a_picometre_thick_transmits_as_any_other() {
    // The reference takes no hit within 1e-9 mm, so it never meets the second face. Here a ray knows which surface it
    // leaves, and any distance that the precision resolves counts: at the scene's centre f32 resolves this one.
    for tier in tiers("thin plate") {
        // Away from the centre f32 does not resolve it, and its faces count as in contact (program::contact).
        for z in [2.0, 5.0, 8.0] {
            let count = hits(&window(64, z, 1e-9).trace(&tier, MILLION), "behind");
            binomial(&tier.name("plate of 1e-9 mm"), count, MILLION, 8.0 / 17.0).accepted();
        }
    }
}

/// [`two_plates`] with everything turned about x by `tilt`.
fn two_plates_turned(gap: f64, tilt: f64, half_angle_deg: f64) -> Bench {
    let axis = DVec3::new(0.0, -tilt.sin(), tilt.cos());
    let place = |z: f64| turned(z * axis, tilt, 0.0, 0.0);
    Bench::new()
        .medium("germanium", 4.0, 0.0)
        .max_depth(200)
        .cone(DVec3::ZERO, axis, half_angle_deg)
        .boundary("1 front", place(2.0), disk(500.0), "", "germanium")
        .boundary("1 back", place(3.0), disk(500.0), "germanium", "")
        .boundary("2 front", place(3.0 + gap), disk(500.0), "", "germanium")
        .boundary("2 back", place(4.0 + gap), disk(500.0), "germanium", "")
        .pixels("behind", place(10.0), 1000.0, 1)
}

/// Two plates of index 4, the second `gap` behind the first, lit by a cone of this half-angle.
fn two_plates(gap: f64, half_angle_deg: f64) -> Bench {
    Bench::new()
        .medium("germanium", 4.0, 0.0)
        .max_depth(200)
        .cone(DVec3::ZERO, DVec3::Z, half_angle_deg)
        .boundary("1 front", at(0.0, 0.0, 2.0), disk(500.0), "", "germanium")
        .boundary("1 back", at(0.0, 0.0, 3.0), disk(500.0), "germanium", "")
        .boundary("2 front", at(0.0, 0.0, 3.0 + gap), disk(500.0), "", "germanium")
        .boundary("2 back", at(0.0, 0.0, 4.0 + gap), disk(500.0), "germanium", "")
        .pixels("behind", at(0.0, 0.0, 10.0), 1000.0, 1)
}

#[test]
fn two_plates_transmit_the_sum_over_all_reflections_between_them() {
    // Four boundaries of reflectance R, in any order of reflections: (1 - R) / (1 + 3 R) (Stokes).
    const TRANSMITTED: f64 = 0.64 / (1.0 + 3.0 * 0.36);
    for tier in tiers("two plates") {
        let apart = hits(&two_plates(0.5, 0.0).trace(&tier, MILLION), "behind");
        binomial(&tier.name("two plates apart"), apart, MILLION, TRANSMITTED).accepted();
        let close = hits(&two_plates(tier.pick(1e-9, 1e-6), 0.0).trace(&tier, MILLION), "behind");
        binomial(&tier.name("two plates nearly in contact"), close, MILLION, TRANSMITTED).accepted();
    }
}

/// What two plates of index 4 transmit with no gap, at a tilt of the whole, lit by a cone: the rays behind.
fn plates_in_contact(tier: &Tier, tilt: f64, half_angle_deg: f64) -> u64 {
    hits(&two_plates_turned(0.0, tilt, half_angle_deg).trace(tier, MILLION), "behind")
}

// Two faces in one place are crossed both, in their order (program::contact): the limit of a vanishing gap. Optiland
// never meets the second one: it reads (1 - R) / (1 + 2 R) = 0.372 at normal incidence.
#[test]
fn two_plates_in_contact_transmit_as_two_plates_apart() {
    const TRANSMITTED: f64 = 0.64 / (1.0 + 3.0 * 0.36);
    for tier in tiers("plates in contact") {
        let upright = plates_in_contact(&tier, 0.0, 0.0);
        binomial(&tier.name("plates in contact"), upright, MILLION, TRANSMITTED).accepted();
        // However the whole is turned.
        let tables = two_plates(0.0, 0.0).in_tables().trace(&tier, MILLION);
        assert_eq!(hits(&tables, "behind"), upright, "{}", tier.name("in tables"));
        let reversed = plates_in_contact(&tier, PI, 0.0);
        binomial(&tier.name("plates in contact, reversed"), reversed, MILLION, TRANSMITTED).accepted();
        let apart = hits(&two_plates(1e-3, 40.0).trace(&tier, MILLION), "behind") as f64 / MILLION as f64;
        for tilt in [0.0, 0.3, PI] {
            let oblique = plates_in_contact(&tier, tilt, 40.0);
            // Both are samples.
            let sigma = (2.0 * apart * (1.0 - apart) / MILLION as f64).sqrt();
            let difference = (oblique as f64 / MILLION as f64 - apart) / sigma;
            assert!(difference.abs() < 4.0, "{}: {difference} sigma at tilt {tilt}", tier.name("cone"));
        }
    }
}

#[test]
fn no_ray_between_plates_in_contact_is_in_the_wrong_medium() {
    for tier in tiers("plates in contact") {
        for tilt in [0.0, 0.3, PI] {
            let joined = two_plates_turned(0.0, tilt, 40.0).trace(&tier, 100_000);
            assert_eq!(
                joined.diagnostics.medium_stack_underflows,
                0,
                "{} at {tilt}",
                tier.name("underflows")
            );
        }
    }
}

#[test]
fn a_cone_in_glass_leaves_within_the_critical_angle() {
    for tier in tiers("TIR cut-off") {
        let bench = Bench::new()
            .medium("glass", 1.5, 0.0)
            .source(
                "point",
                at(0.0, 0.0, 0.0),
                json!({
                    "half_angle_deg": 60.0, "medium": { "type": "medium", "name": "glass" },
                }),
            )
            .boundary("exit", at(0.0, 0.0, 1.0), plane(), "glass", "")
            .detector("far_field", "out", at(0.0, 0.0, 1.001), json!({}));
        let result = bench.trace(&tier, MILLION);
        // Transmitted share: int_0^critical (1 - R) sin / (1 - cos 60). With theta = critical (1 - s^2) the square root
        // at the critical angle becomes smooth.
        let transmitted = |n: f64| {
            let critical = (1.0 / n).asin();
            let integrand = |s: f64| {
                let theta = critical * (1.0 - s * s);
                (1.0 - fresnel(n, 1.0, theta)) * theta.sin() * 2.0 * s * critical
            };
            integral(0.0, 1.0, integrand) / (1.0 - 60f64.to_radians().cos())
        };
        binomial(&tier.name("TIR cut-off of a cone"), hits(&result, "out"), MILLION, transmitted(1.5))
            .accepted();
        binomial("planted: n = 1.51", hits(&result, "out"), MILLION, transmitted(1.51)).rejected();
    }
}

#[test]
fn an_absorbing_slab_obeys_beer_and_lambert() {
    const K: f64 = 1e-5;
    const LENGTH: f64 = 10.0;
    for tier in tiers("Beer-Lambert") {
        let bench = Bench::new()
            .medium("smoke", 1.0, K)
            .pencil(DVec3::ZERO, DVec3::Z, json!({}))
            .pencil(-20.0 * tilted(PI / 3.0), tilted(PI / 3.0), json!({}))
            .boundary("front", at(0.0, 0.0, 1.0), plane(), "", "smoke")
            .boundary("back", at(0.0, 0.0, 1.0 + LENGTH), plane(), "smoke", "")
            .database("behind", at(0.0, 0.0, 20.0), 1e3, true);
        let rows = rows(&bench.trace(&tier, 4), "behind");
        assert_eq!(rows.len(), 4, "index 1 reflects nothing");
        // exp(-4 pi k L / lambda), L in um, longer by 1 / cos at an angle; two rays a source of one watt.
        let transmitted = |k: f64, row: &crate::bench::Row| {
            (-4.0 * PI * k * LENGTH * 1e3 / row.direction.z / WAVELENGTH).exp()
        };
        let pairs =
            |k: f64| rows.iter().map(move |row| (2.0 * row.flux, transmitted(k, row))).collect::<Vec<_>>();
        exact(&tier.name("absorbing slab"), pairs(K), tier.pick(1e-12, 1e-6)).accepted();
        exact("planted: k off by 1e-3", pairs(K * 1.001), tier.pick(1e-12, 1e-6)).rejected();
        let oblique = rows.iter().find(|row| row.direction.x > 0.1).unwrap();
        exact(&tier.name("no refraction at index 1"), [(oblique.direction.z, 0.5)], tier.pick(1e-14, 1e-7))
            .accepted();
    }
}

/// A prism of apex `apex` whose faces stand at +apex/2 and -apex/2 about z, entered at angle of incidence `incidence`.
fn prism(bench: Bench, apex: f64, incidence: f64, more: serde_json::Value) -> Bench {
    // The front face's normal is tilted by +apex/2 from z; the ray comes from `incidence` below it.
    let incoming = tilted(0.5 * apex - incidence);
    let foot = DVec3::new(0.0, 0.0, -5.0);
    bench
        .reflect_prob(0.0)
        .pencil(foot - 10.0 * incoming, incoming, more)
        .boundary("front", turned(foot, 0.0, 0.5 * apex, 0.0), disk(6.0), "", "glass")
        .boundary("back", turned(-foot, 0.0, -0.5 * apex, 0.0), disk(8.0), "glass", "")
        .database("screen", at(0.0, 0.0, 20.0), 100.0, true)
}

/// delta = i + asin(sin A sqrt(n^2 - sin^2 i) - cos A sin i) - A (Born and Wolf, 4.7.2).
fn prism_deviation(n: f64, apex: f64, i: f64) -> f64 {
    let exit = apex.sin() * (n * n - i.sin().powi(2)).sqrt() - apex.cos() * i.sin();
    i + exit.asin() - apex
}

#[test]
fn a_prism_deviates_least_where_the_passage_is_symmetric() {
    let apex = PI / 3.0;
    let symmetric = (1.5 * (0.5 * apex).sin()).asin();
    for tier in tiers("prism") {
        let deviation = |incidence: f64| {
            let result =
                prism(Bench::new().medium("glass", 1.5, 0.0), apex, incidence, json!({})).trace(&tier, 1);
            let row = rows(&result, "screen")[0];
            row.direction.x.atan2(row.direction.z) - (0.5 * apex - incidence)
        };
        let tolerance = tier.pick(1e-12, 1e-6);
        // 2 asin(n sin(A / 2)) - A.
        let least = deviation(symmetric);
        exact(&tier.name("minimum deviation"), [(least, 2.0 * symmetric - apex)], tolerance).accepted();
        let n_of = |deviation: f64| (0.5 * (deviation + apex)).sin() / (0.5 * apex).sin();
        exact("planted: n off by 1e-3", [(n_of(least), 1.501)], tolerance).rejected();
        let beside = [-0.05, 0.05]
            .map(|step| (deviation(symmetric + step), prism_deviation(1.5, apex, symmetric + step)));
        exact(&tier.name("deviation beside the minimum"), beside, tolerance).accepted();
        assert!(
            beside.iter().all(|(deviation, _)| *deviation > least),
            "the symmetric passage is the minimum"
        );
    }
}

#[test]
fn a_dispersive_prism_splits_two_wavelengths() {
    let apex = PI / 3.0;
    for tier in tiers("dispersive prism") {
        let spectrum = json!({ "wavelengths": [0.65, 0.45], "weights": [1.0, 1.0] });
        let bench = Bench::new().dispersive_medium("glass", &[0.45, 0.65], &[1.55, 1.5]);
        let result = prism(bench, apex, 0.8, json!({ "spectrum": spectrum })).trace(&tier, 64);
        let rows = rows(&result, "screen");
        let pairs = rows.iter().map(|row| {
            let n = if row.wavelength == 0.45 { 1.55 } else { 1.5 };
            (row.direction.x.atan2(row.direction.z) - (0.5 * apex - 0.8), prism_deviation(n, apex, 0.8))
        });
        exact(&tier.name("dispersive prism"), pairs, tier.pick(1e-12, 1e-6)).accepted();
        let blue = rows.iter().filter(|row| row.wavelength == 0.45).count();
        assert!(blue > 0 && blue < rows.len(), "both wavelengths were drawn");
    }
}

#[test]
fn a_light_pipe_conserves_flux_slope_and_skewness() {
    // Up to 40 degrees inside glass of 1.5 every wall is met beyond the critical angle, since asin(1 / 1.5) < 50.
    for tier in tiers("light pipe") {
        let glass = json!({ "half_angle_deg": 40.0, "medium": { "type": "medium", "name": "glass" } });
        let bench = Bench::new()
            .medium("glass", 1.5, 0.0)
            .max_depth(200)
            .source("point", at(3.0, 0.0, 0.0), glass)
            .boundary(
                "wall",
                at(0.0, 0.0, 0.0),
                json!({
                    "type": "frustum", "r_front": 5.0, "r_back": 5.0, "z_front": -1.0, "z_back": 101.0,
                }),
                "glass",
                "",
            )
            .database("start", at(0.0, 0.0, 1e-3), 10.0, false)
            .database("end", at(0.0, 0.0, 100.0), 10.0, true);
        let result = bench.trace(&tier, 2000);
        let (start, end) = (rows(&result, "start"), rows(&result, "end"));
        let arrived = result.detector("end").unwrap().total_flux;
        exact(&tier.name("light pipe: flux"), [(arrived, 1.0)], 1e-15).accepted();
        assert_eq!((start.len(), end.len()), (2000, 2000));
        let pairs = |value: fn(&crate::bench::Row) -> f64| {
            start.iter().zip(&end).map(move |(a, b)| (value(b), value(a)))
        };
        exact(&tier.name("light pipe: slope"), pairs(|row| row.direction.z), tier.pick(1e-12, 1e-5))
            .accepted();
        let skewness =
            |row: &crate::bench::Row| row.position.x * row.direction.y - row.position.y * row.direction.x;
        exact(&tier.name("light pipe: skewness"), pairs(skewness), tier.pick(1e-12, 1e-4)).accepted();
    }
}

/// Where rays at height h, parallel to the axis or from a point, cross the axis behind a lens: two heights give the
/// paraxial limit, since the aberration grows with h^2.
fn paraxial_crossing(tier: &Tier, bench: &Bench, source: DVec3, aim_z: f64, heights: [f64; 2]) -> f64 {
    let crossing = |height: f64| {
        let aim = DVec3::new(height, 0.0, aim_z);
        let from = if source.is_finite() { source } else { DVec3::new(height, 0.0, aim_z - 1.0) };
        let bench = bench.clone().pencil(from, (aim - from).normalize(), json!({}));
        let row = rows(&bench.trace(tier, 1), "screen")[0];
        row.position.z - row.position.x * row.direction.z / row.direction.x
    };
    let [full, half] = heights.map(crossing);
    (4.0 * half - full) / 3.0
}

fn lens(n: f64, r1: f64, r2: f64, thickness: f64) -> Bench {
    Bench::new()
        .medium("glass", n, 0.0)
        .reflect_prob(0.0)
        .boundary("front", at(0.0, 0.0, 0.0), conic(r1, 0.0, 1.0), "", "glass")
        .boundary("back", at(0.0, 0.0, thickness), conic(r2, 0.0, 1.0), "glass", "")
        .database("screen", at(0.0, 0.0, thickness + 1.0), 10.0, true)
}

#[test]
fn a_thick_lens_focuses_at_the_lensmakers_back_focal_distance() {
    let (n, r1, r2, t) = (1.5, 50.0, -70.0, 8.0);
    for tier in tiers("thick lens") {
        let heights = tier.pick([0.02, 0.01], [0.2, 0.1]);
        let focus = paraxial_crossing(&tier, &lens(n, r1, r2, t), DVec3::NAN, -1.0, heights) - t;
        let expected = |n: f64| {
            let power = (n - 1.0) * (1.0 / r1 - 1.0 / r2 + (n - 1.0) * t / (n * r1 * r2));
            (1.0 - (n - 1.0) * t / (n * r1)) / power
        };
        let tolerance = expected(n) * tier.pick(1e-11, 1e-4);
        exact(&tier.name("lensmaker's equation"), [(focus, expected(n))], tolerance).accepted();
        exact("planted: n off by 1e-3", [(focus, expected(n * 1.001))], tolerance).rejected();
    }
}

#[test]
fn a_thin_lens_images_by_gauss_and_focuses_at_its_focal_length() {
    // A plano-convex lens, flat side first: its principal plane is the vertex of its back, so that 1/s + 1/s' = 1/f with
    // s' from there whatever the thickness, and s from the front counted as t / n.
    let (n, r, t) = (1.5, 50.0, 0.5);
    let f = r / (n - 1.0);
    for tier in tiers("thin lens") {
        let heights = tier.pick([0.02, 0.01], [0.2, 0.1]);
        let bench = lens(n, 0.0, -r, t);
        let focus = paraxial_crossing(&tier, &bench, DVec3::NAN, -1.0, heights) - t;
        exact(&tier.name("thin lens: focus"), [(focus, f)], f * tier.pick(1e-11, 1e-4)).accepted();
        let bench = lens(n, 0.0, -r, t);
        let s = 1.5 * f;
        let image = paraxial_crossing(&tier, &bench, DVec3::new(0.0, 0.0, t / n - s), 0.0, heights) - t;
        let expected = 1.0 / (1.0 / f - 1.0 / s);
        exact(&tier.name("thin lens: image"), [(image, expected)], expected * tier.pick(1e-11, 1e-4))
            .accepted();
    }
}

#[test]
fn a_ball_lens_focuses_at_its_focal_length_from_its_centre() {
    // f = n D / (4 (n - 1)) from the centre, paraxially.
    let (n, radius) = (1.5, 5.0);
    for tier in tiers("ball lens") {
        let bench = Bench::new()
            .medium("glass", n, 0.0)
            .reflect_prob(0.0)
            .boundary("ball", at(0.0, 0.0, 0.0), json!({ "type": "sphere", "radius": radius }), "", "glass")
            .database("screen", at(0.0, 0.0, 6.0), 10.0, true);
        let heights = tier.pick([2e-3, 1e-3], [0.02, 0.01]);
        let focus = paraxial_crossing(&tier, &bench, DVec3::NAN, -10.0, heights);
        let expected = n * 2.0 * radius / (4.0 * (n - 1.0));
        exact(&tier.name("ball lens"), [(focus, expected)], expected * tier.pick(1e-11, 1e-4)).accepted();
    }
}

#[test]
fn importance_sampling_is_unbiased_and_quiets_a_ghost() {
    // The first ghost of a tilted plate leaves beside the direct beam: T R R T of the flux.
    const RAYS: u64 = 40_000;
    let incidence = 0.5f64;
    let r = fresnel(1.5, 1.0, (incidence.sin() / 1.5).asin());
    let ghost = (1.0 - r).powi(2) * r * r;
    for tier in tiers("importance sampling") {
        let plate = Bench::new()
            .medium("glass", 1.5, 0.0)
            .max_depth(64)
            .pencil(-10.0 * tilted(incidence), tilted(incidence), json!({}))
            .boundary("front", at(0.0, 0.0, 0.0), disk(50.0), "", "glass")
            .boundary("back", at(0.0, 0.0, 5.0), disk(50.0), "glass", "")
            .database("behind", at(0.0, 0.0, 20.0), 500.0, true);
        // Each pair of internal reflections moves the exit by 2 t tan(theta_t).
        let shift = 10.0 * (incidence.sin() / 1.5).asin().tan();
        let samples = |policy: serde_json::Value| {
            let mut samples = vec![0.0; RAYS as usize];
            let result = plate.clone().reflect_prob(policy).trace(&tier, RAYS);
            let direct = 5.0 * (incidence.sin() / 1.5).asin().tan() + 15.0 * incidence.tan();
            for row in rows(&result, "behind") {
                if ((row.position.x - direct) / shift).round() == 1.0 {
                    samples[row.ray as usize] = row.flux * RAYS as f64;
                }
            }
            samples
        };
        let plain = samples("fresnel".into());
        mean(&tier.name("ghost, fresnel"), &plain, ghost).accepted();
        let (_, plain_variance) = mean_and_variance(&plain);
        for (name, policy) in
            [("auto", json!("auto")), ("0.1", json!(0.1)), ("0.5", json!(0.5)), ("0.9", json!(0.9))]
        {
            let samples = samples(policy);
            mean(&tier.name(&format!("ghost, {name}")), &samples, ghost).accepted();
            let (_, variance) = mean_and_variance(&samples);
            assert!(
                name == "0.9" || variance < 0.5 * plain_variance,
                "{name}: {variance} against {plain_variance}"
            );
            if name == "auto" {
                mean("planted: ghost of 1.2 times the flux", &samples, 1.2 * ghost).rejected();
            }
            // Every sample is (T / (1 - p))^2 (R / p)^2, exactly.
            let p: f64 = name.parse().unwrap_or(0.25);
            let expected = ((1.0 - r) / (1.0 - p) * r / p).powi(2);
            let pairs = samples.iter().filter(|flux| **flux > 0.0).map(|flux| (flux / expected, 1.0));
            exact(&tier.name(&format!("ghost's weight, {name}")), pairs, tier.pick(1e-12, 2e-5)).accepted();
        }
    }
}

#[test]
fn grazing_reflection_off_glass_approaches_one_linearly() {
    // R_s -> 1 - 4 cos i / sqrt(n^2 - 1), R_p -> 1 - 4 n^2 cos i / sqrt(n^2 - 1), to second order in cos i.
    for tier in tiers("grazing") {
        let angle = FRAC_PI_2 - 1e-5;
        let result = sweep(&tier, 1.0, 1.5, &[angle]);
        let slope = 2.0 * (1.0 + 2.25) / 1.25f64.sqrt();
        let pairs = rows(&result, "transmitted")
            .into_iter()
            .map(|row| (0.5 * row.flux * RAYS_PER_ANGLE as f64 / 1e-5, slope));
        exact(&tier.name("transmission at grazing incidence"), pairs, tier.pick(3e-4, 2e-2)).accepted();
    }
}
