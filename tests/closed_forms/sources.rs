//! What sources emit: where, where to, and at which wavelength.

use crate::bench::{Bench, absorbed, at, disk, far_field, hits, irradiance, rows, spectral, tiers};
use crate::deviation::{binomial, chi_square, exact, integral};
use glam::DVec3;
use serde_json::json;
use std::f64::consts::PI;

const MILLION: u64 = 1_000_000;

/// The solid angle of a square of side a, seen from a distance d on its axis: 4 atan(a^2 / (2 d sqrt(4 d^2 + 2 a^2))).
fn square_solid_angle(side: f64, distance: f64) -> f64 {
    let a2 = side * side;
    4.0 * (a2 / (2.0 * distance * (4.0 * distance * distance + 2.0 * a2).sqrt())).atan()
}

#[test]
fn irradiance_of_a_point_falls_with_the_inverse_square() {
    const DISTANCES: [f64; 3] = [10.0, 20.0, 40.0];
    for tier in tiers("inverse square") {
        let mut bench = Bench::new().cone(DVec3::ZERO, DVec3::Z, 30.0);
        for distance in DISTANCES {
            let one_pixel = json!({
                "width": 2.0, "height": 2.0, "num_pixels_x": 1, "num_pixels_y": 1, "splat": "hard", "absorb": false,
            });
            bench = bench.detector("irradiance", &format!("{distance}"), at(0.0, 0.0, distance), one_pixel);
        }
        let result = bench.trace(&tier, MILLION);
        let cap = 2.0 * PI * (1.0 - 30f64.to_radians().cos());
        for distance in DISTANCES {
            let form = tier.name(&format!("inverse square at {distance} mm"));
            let count = hits(&result, &format!("{distance}"));
            binomial(&form, count, MILLION, square_solid_angle(2.0, distance) / cap).accepted();
        }
        let wrong = square_solid_angle(2.0, 10.0) / cap * 0.9;
        binomial("planted: inverse square", hits(&result, "10"), MILLION, wrong).rejected();
    }
}

/// E = I cos^4 / d^2 per watt of a small Lambertian source: the shares of square pixels, by quadrature.
fn lambertian_pixels(distance: f64, side: f64, num: usize, power: i32) -> Vec<f64> {
    let pitch = side / num as f64;
    let edge = |i: usize| i as f64 * pitch - side / 2.0;
    let density = |x: f64, y: f64| {
        let r2 = distance * distance + x * x + y * y;
        (distance / r2.sqrt()).powi(power) / (PI * distance * distance)
    };
    // Smooth over a pixel: three-point Gauss-Legendre on a 4 x 4 mesh of it.
    let nodes = [(-0.6f64.sqrt(), 5.0 / 18.0), (0.0, 8.0 / 18.0), (0.6f64.sqrt(), 5.0 / 18.0)];
    let over = |from: f64| -> Vec<(f64, f64)> {
        let step = pitch / 4.0;
        let cell = |c: usize| nodes.map(|(x, w)| (from + (c as f64 + 0.5 * (1.0 + x)) * step, w * step));
        (0..4).flat_map(cell).collect()
    };
    let pixel = |i: usize| {
        let (ys, xs) = (over(edge(i / num)), over(edge(i % num)));
        ys.iter().map(|(y, wy)| xs.iter().map(|(x, wx)| wx * wy * density(*x, *y)).sum::<f64>()).sum()
    };
    (0..num * num).map(pixel).collect()
}

#[test]
fn irradiance_of_a_small_lambertian_source_falls_with_cos4() {
    for tier in tiers("cos^4") {
        let source = json!({ "aperture_radius": 1e-3 });
        let bench = Bench::new().source("extended", at(0.0, 0.0, 0.0), source).pixels(
            "wall",
            at(0.0, 0.0, 10.0),
            40.0,
            16,
        );
        let result = bench.trace(&tier, MILLION);
        let counts: Vec<u64> = irradiance(&result, "wall").hits.iter().copied().collect();
        let expected = lambertian_pixels(10.0, 40.0, 16, 4);
        chi_square(&tier.name("cos^4 off axis"), &counts, &expected, MILLION).accepted();
        let wrong: Vec<f64> = expected
            .iter()
            .zip(lambertian_pixels(10.0, 40.0, 16, 3))
            .map(|(a, b)| 0.99 * a + 0.01 * b)
            .collect();
        chi_square("planted: 1 % of cos^3 in cos^4", &counts, &wrong, MILLION).rejected();
    }
}

/// The view factor from a disk of radius a to a coaxial disk of radius b at distance d: with X = 1 + (d^2 + b^2) / a^2,
/// (X - sqrt(X^2 - 4 b^2 / a^2)) / 2 (Siegel and Howell).
fn disk_to_disk(a: f64, b: f64, d: f64) -> f64 {
    let x = 1.0 + (d * d + b * b) / (a * a);
    0.5 * (x - (x * x - 4.0 * b * b / (a * a)).sqrt())
}

#[test]
fn a_lambertian_disk_lights_a_disk_by_the_view_factor_and_its_axis_by_sin2_theta() {
    for tier in tiers("view factor") {
        for (radius, form) in [(6.0, "view factor of disks"), (0.5, "pi L sin^2 theta on axis")] {
            let bench = Bench::new()
                .source("extended", at(0.0, 0.0, 0.0), json!({ "aperture_radius": 5.0 }))
                .absorber("stop", at(0.0, 0.0, 10.0), disk(radius));
            let count = absorbed(&bench.trace(&tier, MILLION), "stop");
            binomial(&tier.name(form), count, MILLION, disk_to_disk(5.0, radius, 10.0)).accepted();
        }
        // E = M sin^2 theta with M = 1 W / (pi 25 mm^2): the small disk's view factor to 2e-3 of itself.
        let sin2 = 25.0 / (25.0 + 100.0) * 0.25 / 25.0;
        exact(
            "sin^2 theta is the limit of the view factor",
            [(disk_to_disk(5.0, 0.5, 10.0) / sin2, 1.0)],
            2e-3,
        )
        .accepted();
    }
}

/// The share of the flux below a polar angle.
type Law = fn(f64) -> f64;

/// Probabilities of far-field bins, theta-major, where the flux below theta is `below(theta)` and azimuth is uniform.
fn polar_bins(num_theta: usize, num_phi: usize, below: impl Fn(f64) -> f64) -> Vec<f64> {
    let edge = |i: usize| 0.5 * PI * i as f64 / num_theta as f64;
    let bin = |i: usize| (below(edge(i / num_phi + 1)) - below(edge(i / num_phi))) / num_phi as f64;
    (0..num_theta * num_phi).map(bin).collect()
}

#[test]
fn directions_of_lambertian_and_uniform_sources_are_distributed_by_their_laws() {
    let sphere: Law = |theta| 1.0 - theta.cos();
    let cap: Law = |theta| ((1.0 - theta.cos()) / (1.0 - 60f64.to_radians().cos())).min(1.0);
    let lambert: Law = |theta| theta.sin() * theta.sin();
    for tier in tiers("directions of sources") {
        let wide = json!({ "half_angle_deg": 180.0 });
        let narrow = json!({ "half_angle_deg": 60.0 });
        let area = json!({ "width": 2.0, "height": 1.0 });
        let area_narrow = json!({ "width": 2.0, "height": 1.0, "half_angle_deg": 60.0 });
        // A full sphere about a far-field detector folds both hemispheres into one: 1 - cos theta of them together.
        let cases: [(&str, &str, _, Law); 4] = [
            ("uniform over the sphere", "point", wide, sphere),
            ("uniform in a cap", "point", narrow, cap),
            ("far field of a Lambertian area", "extended", area, lambert),
            ("uniform cap of an area", "extended", area_narrow, cap),
        ];
        for (form, kind, source, below) in cases {
            let bins = json!({ "num_bins_theta": 18, "num_bins_phi": 12 });
            let mut bench = Bench::new().source(kind, at(0.0, 0.0, 0.0), source).detector(
                "far_field",
                "up",
                at(0.0, 0.0, 1e-3),
                bins.clone(),
            );
            bench = bench.detector("far_field", "down", at(0.0, 0.0, -1e-3), bins);
            let result = bench.trace(&tier, MILLION);
            let (up, down) = (&far_field(&result, "up").hits, &far_field(&result, "down").hits);
            let counts: Vec<u64> = up.iter().zip(down).map(|(a, b)| a + b).collect();
            let all = polar_bins(18, 12, below);
            let (counts, expected): (Vec<u64>, Vec<f64>) =
                counts.into_iter().zip(all).filter(|(_, p)| *p > 0.0).unzip();
            chi_square(&tier.name(form), &counts, &expected, MILLION).accepted();
        }
    }
}

#[test]
fn a_truncated_gaussian_beam_has_its_encircled_energy() {
    const EDGES: [f64; 9] = [0.0, 0.25, 0.5, 0.75, 1.0, 1.25, 1.5, 1.75, 2.0];
    for tier in tiers("Gaussian beam") {
        let beam = json!({ "aperture_radius": 2.0, "profile": "gaussian", "gaussian_sigma": 0.8 });
        let mut bench = Bench::new().source("collimated", at(0.0, 0.0, 0.0), beam).absorber(
            "0",
            at(0.0, 0.0, 5.0),
            disk(EDGES[1]),
        );
        let quadrants = json!({
            "width": 4.0, "height": 4.0, "num_pixels_x": 2, "num_pixels_y": 2, "splat": "hard", "absorb": false,
        });
        bench = bench.detector("irradiance", "quadrants", at(0.0, 0.0, 1.0), quadrants);
        for ring in 1..8 {
            let shape =
                json!({ "type": "annulus", "inner_radius": EDGES[ring], "outer_radius": EDGES[ring + 1] });
            bench = bench.absorber(&format!("{ring}"), at(0.0, 0.0, 5.0), shape);
        }
        let result = bench.trace(&tier, MILLION);
        // F(r) = (1 - exp(-r^2 / 2 s^2)) / (1 - exp(-R^2 / 2 s^2)).
        let encircled = |r: f64, sigma: f64| {
            -(-r * r / (2.0 * sigma * sigma)).exp_m1() / -(-4.0 / (2.0 * sigma * sigma)).exp_m1()
        };
        let counts: Vec<u64> = (0..8).map(|ring| absorbed(&result, &format!("{ring}"))).collect();
        let shares = |sigma: f64| -> Vec<f64> {
            EDGES.windows(2).map(|e| encircled(e[1], sigma) - encircled(e[0], sigma)).collect()
        };
        chi_square(&tier.name("encircled energy of a Gaussian"), &counts, &shares(0.8), MILLION).accepted();
        chi_square("planted: sigma 0.805", &counts, &shares(0.805), MILLION).rejected();
        let quadrants: Vec<u64> = irradiance(&result, "quadrants").hits.iter().copied().collect();
        chi_square(&tier.name("quadrants of a Gaussian"), &quadrants, &[0.25; 4], MILLION).accepted();
    }
}

#[test]
fn a_pupil_is_filled_uniformly_and_its_rays_go_through_it() {
    for tier in tiers("pupil") {
        // At z = 10 mm a ray is at (1 + 5 p.x, 2 + 5 p.y), with p uniform in the unit disk.
        let source =
            json!({ "beam_radii": [3.0, 1.0], "chief": [1.0, 2.0, 10.0], "pupil_radii": [2.0, 4.0] });
        let mut bench = Bench::new().source("pupil", at(0.0, 0.0, 0.0), source);
        let edges: Vec<f64> = (0..=8).map(|ring| 5.0 * (f64::from(ring) / 8.0).sqrt()).collect();
        let quadrants = json!({
            "width": 14.0, "height": 18.0, "num_pixels_x": 2, "num_pixels_y": 2, "splat": "hard", "absorb": false,
        });
        // At z = 5 mm it is at (0.5 + 4 p.x, 1 + 3 p.y).
        bench = bench.detector("irradiance", "quadrants", at(0.5, 1.0, 5.0), quadrants);
        for ring in 0..8 {
            let inner = edges[ring];
            let shape = match ring {
                0 => disk(edges[1]),
                _ => json!({ "type": "annulus", "inner_radius": inner, "outer_radius": edges[ring + 1] }),
            };
            bench = bench.absorber(&format!("{ring}"), at(1.0, 2.0, 10.0), shape);
        }
        let result = bench.trace(&tier, MILLION);
        let counts: Vec<u64> = (0..8).map(|ring| absorbed(&result, &format!("{ring}"))).collect();
        chi_square(&tier.name("rings of a pupil"), &counts, &[0.125; 8], MILLION).accepted();
        let quadrants: Vec<u64> = irradiance(&result, "quadrants").hits.iter().copied().collect();
        chi_square(&tier.name("quadrants of a pupil"), &quadrants, &[0.25; 4], MILLION).accepted();
        chi_square(
            "planted: 2 % more in one ring",
            &counts,
            &[0.1275, 0.1225, 0.125, 0.125, 0.125, 0.125, 0.125, 0.125],
            MILLION,
        )
        .rejected();
    }
}

/// Shares of far-field bins, theta-major, of an intensity over polar angle and azimuth \[deg\], by midpoints.
fn bins_of_intensity(num_theta: usize, num_phi: usize, intensity: impl Fn(f64, f64) -> f64) -> Vec<f64> {
    const PARTS: usize = 40;
    let (d_theta, d_phi) = (90.0 / (num_theta * PARTS) as f64, 360.0 / (num_phi * PARTS) as f64);
    let bin = |i: usize| -> f64 {
        let (row, column) = ((i / num_phi * PARTS) as f64, (i % num_phi * PARTS) as f64);
        let parts = (0..PARTS * PARTS).map(|k| {
            let theta = (row + (k / PARTS) as f64 + 0.5) * d_theta;
            let phi = (column + (k % PARTS) as f64 + 0.5) * d_phi - 180.0;
            intensity(theta, phi) * theta.to_radians().sin()
        });
        parts.sum()
    };
    let all: Vec<f64> = (0..num_theta * num_phi).map(bin).collect();
    let total: f64 = all.iter().sum();
    all.into_iter().map(|share| share / total).collect()
}

/// A lamp's far field is its table, linear between the table's angles: with two planes of symmetry, with none, and with dark
/// angles between two rings of light.
#[test]
fn the_far_field_of_a_lamp_is_its_table() {
    let polar = [0.0, 20.0, 45.0, 50.0, 90.0];
    let quadrant =
        [[100.0, 80.0, 60.0, 0.0, 0.0], [100.0, 20.0, 10.0, 50.0, 5.0], [100.0, 60.0, 0.0, 10.0, 40.0]];
    let whole = [[9.0, 1.0, 0.0, 0.0, 3.0], [9.0, 4.0, 0.0, 0.0, 0.0], [9.0, 0.0, 0.0, 0.0, 8.0]];
    let between = |at: &[f64], x: f64| -> (usize, f64) {
        let i = at.partition_point(|edge| *edge <= x).clamp(1, at.len() - 1) - 1;
        (i, (x - at[i]) / (at[i + 1] - at[i]))
    };
    let value = |planes: &[f64], rows: &[[f64; 5]], theta: f64, azimuth: f64| {
        let ((i, x), (j, y)) = (between(planes, azimuth), between(&polar, theta));
        let row = |i: usize| rows[i][j] * (1.0 - y) + rows[i][j + 1] * y;
        row(i) * (1.0 - x) + row(i + 1) * x
    };
    let mirrored = |theta: f64, phi: f64| {
        let azimuth = phi.abs().min(180.0 - phi.abs());
        value(&[0.0, 30.0, 90.0], &quadrant, theta, azimuth)
    };
    let around = |theta: f64, phi: f64| {
        let rows = [whole[0], whole[1], whole[2], whole[0]];
        value(&[0.0, 100.0, 220.0, 360.0], &rows, theta, phi.rem_euclid(360.0))
    };
    let revolved = |theta: f64, _: f64| value(&[0.0, 360.0], &[whole[1]; 2], theta, 0.0);
    type Intensity<'a> = &'a dyn Fn(f64, f64) -> f64;
    let cases: [(&str, serde_json::Value, Intensity); 3] = [
        (
            "a lamp of four quarters",
            json!({ "azimuth_angles_deg": [0, 30, 90], "intensity": quadrant, "width": 2.0, "height": 3.0 }),
            &mirrored,
        ),
        (
            "a lamp without symmetry",
            json!({ "azimuth_angles_deg": [0, 100, 220, 360], "intensity": [whole[0], whole[1], whole[2], whole[0]],
                "radius": 2.0 }),
            &around,
        ),
        ("a lamp of revolution", json!({ "intensity": whole[1] }), &revolved),
    ];
    for tier in tiers("lamps") {
        for (form, mut source, intensity) in cases.clone() {
            source["polar_angles_deg"] = json!(polar);
            let bench = Bench::new().source("tabulated", at(0.0, 0.0, 0.0), source).detector(
                "far_field",
                "up",
                at(0.0, 0.0, 1e-3),
                json!({ "num_bins_theta": 18, "num_bins_phi": 12 }),
            );
            let result = bench.trace(&tier, MILLION);
            let hits = &far_field(&result, "up").hits;
            let all = bins_of_intensity(18, 12, intensity);
            let (counts, expected): (Vec<u64>, Vec<f64>) =
                hits.iter().copied().zip(all).filter(|(count, share)| *count > 0 || *share > 1e-9).unzip();
            chi_square(&tier.name(form), &counts, &expected, MILLION).accepted();
            let turned: Vec<f64> = expected.iter().cycle().skip(1).take(expected.len()).copied().collect();
            chi_square("planted: one bin further", &counts, &turned, MILLION).rejected();
        }
    }
}

#[test]
fn wavelengths_are_drawn_by_weight_and_land_in_their_bins() {
    for tier in tiers("spectrum") {
        // 0.3 and 0.9 lie outside of the detector's band, and count in its end bins.
        let spectrum = json!({ "wavelengths": [0.5, 0.62, 0.3, 0.9], "weights": [1.0, 2.0, 4.0, 9.0] });
        let grid = json!({
            "width": 2.0, "height": 2.0, "num_pixels_x": 1, "num_pixels_y": 1, "splat": "hard",
            "wl_min": 0.4, "wl_max": 0.7, "num_bins": 6,
        });
        let bench = Bench::new()
            .source("point", at(0.0, 0.0, 0.0), json!({ "half_angle_deg": 1.0, "spectrum": spectrum }))
            .detector("spectral", "spectrometer", at(0.0, 0.0, 1.0), grid);
        let result = bench.trace(&tier, MILLION);
        let counts: Vec<u64> = spectral(&result, "spectrometer").pixels.hits.iter().copied().collect();
        assert_eq!([counts[1], counts[3]], [0, 0], "no wavelength lies in [0.45, 0.5) nor in [0.55, 0.6)");
        // 0.5 is the upper bin's edge; rounded as linspace rounds it, the edge is 0.5 itself.
        let drawn = [counts[0], counts[2], counts[4], counts[5]];
        chi_square(&tier.name("spectrum by weight"), &drawn, &[0.25, 0.0625, 0.125, 0.5625], MILLION)
            .accepted();
        chi_square("planted: weights of a neighbour", &drawn, &[0.25, 0.125, 0.0625, 0.5625], MILLION)
            .rejected();
    }
}

#[test]
fn a_ray_budget_is_split_by_flux_and_each_source_keeps_its_own() {
    // One ray each; of 1000 more, 142.86, 285.71 and 571.43 by flux, the two left over to the largest remainders.
    const RAYS: [u64; 3] = [144, 287, 572];
    for tier in tiers("ray budget") {
        let mut bench = Bench::new();
        for (i, flux) in [1.0, 2.0, 4.0].into_iter().enumerate() {
            bench = bench.pencil(DVec3::new(i as f64, 0.0, 0.0), DVec3::Z, json!({ "total_flux": flux }));
        }
        let result = bench.database("all", at(0.0, 0.0, 1.0), 10.0, true).trace(&tier, 1003);
        let rows = rows(&result, "all");
        for (source, (count, flux)) in RAYS.into_iter().zip([1.0, 2.0, 4.0]).enumerate() {
            let own: Vec<_> = rows.iter().filter(|row| row.position.x.round() == source as f64).collect();
            assert_eq!(own.len() as u64, count, "rays of source {source}");
            let pairs = own.iter().map(|row| (row.flux, flux / count as f64));
            exact(&tier.name("flux of a source's rays"), pairs, tier.pick(1e-15, 1e-9)).accepted();
        }
        let total = result.detector("all").unwrap().total_flux;
        exact(&tier.name("flux of all sources"), [(total, 7.0)], tier.pick(1e-12, 1e-6)).accepted();
    }
}

#[test]
fn the_quadrature_of_the_tests_is_exact_where_the_answer_is_known() {
    exact("integral of sin", [(integral(0.0, PI, f64::sin), 2.0)], 1e-12).accepted();
    exact("cos^4 over the plane", [(lambertian_pixels(1e-2, 40.0, 512, 4).iter().sum(), 1.0)], 1e-2)
        .accepted();
    let quadrant: f64 = lambertian_pixels(10.0, 20.0, 8, 4).iter().sum();
    // Square on the axis of a small Lambertian source: F = 4 / pi A atan(A), A = h / sqrt(h^2 + d^2) (Siegel and Howell).
    let a = 0.5f64.sqrt();
    exact("view factor of a square", [(quadrant, 4.0 / PI * a * a.atan())], 1e-10).accepted();
}
