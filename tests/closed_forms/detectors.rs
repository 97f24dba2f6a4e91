//! What detectors make of a ray at a known place in a known direction.

use crate::bench::{Bench, Tier, at, far_field, hits, irradiance, plane, tiers, tilted};
use crate::deviation::exact;
use glam::DVec3;
use serde_json::{Value, json};
use std::f64::consts::PI;

/// The flux per pixel of one watt at (x, y), row by row, on 4 x 4 pixels of 1 mm about the origin.
fn splat(tier: &Tier, kind: &str, x: f64, y: f64) -> Vec<f64> {
    let grid = json!({
        "width": 4.0, "height": 4.0, "num_pixels_x": 4, "num_pixels_y": 4, "splat": kind, "splat_sigma": 0.7,
    });
    let bench = Bench::new().pencil(DVec3::new(x, y, 0.0), DVec3::Z, json!({})).detector(
        "irradiance",
        "screen",
        at(0.0, 0.0, 1.0),
        grid,
    );
    let result = bench.trace(tier, 8);
    exact(
        &tier.name(&format!("{kind} splat: total")),
        [(result.detector("screen").unwrap().total_flux, 1.0)],
        1e-15,
    )
    .accepted();
    irradiance(&result, "screen").irradiance.iter().copied().collect()
}

/// Sums the shares (pixel, share) of one axis, those beyond the edge in the edge pixel.
fn folded(shares: impl IntoIterator<Item = (i32, f64)>) -> [f64; 4] {
    let mut axis = [0.0; 4];
    shares.into_iter().for_each(|(i, share)| axis[i.clamp(0, 3) as usize] += share);
    axis
}

fn outer(y: [f64; 4], x: [f64; 4]) -> impl Iterator<Item = f64> {
    y.into_iter().flat_map(move |y| x.into_iter().map(move |x| y * x))
}

const POINTS: [(f64, f64); 5] = [(0.3, -0.2), (0.5, 0.5), (-1.9, 1.75), (1.6, -2.0), (0.0, 0.0)];

#[test]
fn a_bilinear_splat_shares_by_distance_from_pixel_centres() {
    // Centres are at i - 1.5: of a point at i + f pixels, 1 - f to pixel i, f to pixel i + 1.
    let axis = |x: f64| {
        let position = x + 1.5;
        let f = position - position.floor();
        folded([(position.floor() as i32, 1.0 - f), (position.floor() as i32 + 1, f)])
    };
    for tier in tiers("bilinear splat") {
        for (x, y) in POINTS {
            let pairs = splat(&tier, "bilinear", x, y).into_iter().zip(outer(axis(y), axis(x)));
            exact(&tier.name(&format!("bilinear splat at ({x}, {y})")), pairs, tier.pick(1e-12, 1e-6))
                .accepted();
        }
    }
}

#[test]
fn a_gaussian_splat_shares_by_the_normalised_gaussian() {
    // exp(-(i - position)^2 / (2 0.7^2)) over the pixels within ceil(3 sigma) = 3 of floor(position), normalised.
    let axis = |x: f64, sigma: f64| {
        let position = x + 1.5;
        let taps: Vec<i32> = (-3..=3).map(|i| position.floor() as i32 + i).collect();
        let share = |i: &i32| (-(f64::from(*i) - position).powi(2) / (2.0 * sigma * sigma)).exp();
        let sum: f64 = taps.iter().map(share).sum();
        folded(taps.iter().map(|i| (*i, share(i) / sum)))
    };
    for tier in tiers("Gaussian splat") {
        let tolerance = tier.pick(1e-12, 1e-6);
        for (x, y) in POINTS {
            let measured = splat(&tier, "gaussian", x, y);
            let pairs = |sigma: f64| measured.clone().into_iter().zip(outer(axis(y, sigma), axis(x, sigma)));
            exact(&tier.name(&format!("Gaussian splat at ({x}, {y})")), pairs(0.7), tolerance).accepted();
            exact("planted: sigma off by 1e-3", pairs(0.7007), tolerance).rejected();
        }
    }
}

#[test]
fn an_edge_belongs_to_the_upper_pixel_and_the_last_edge_to_the_last() {
    // Edges at -2, -1, 0, 1, 2.
    let pixels = [(-2.0, 0), (-1.0, 1), (0.0, 2), (1.0, 3), (2.0, 3), (-1.0000001, 0), (0.9999999, 2)];
    for tier in tiers("hard splat") {
        for (x, column) in pixels {
            for (y, row) in [(-2.0, 0), (0.0, 2), (2.0, 3)] {
                let shares = splat(&tier, "hard", x, y);
                assert_eq!(
                    shares[row * 4 + column],
                    1.0,
                    "{} ({x}, {y}): {shares:?}",
                    tier.name("hard splat")
                );
            }
        }
    }
}

/// Hits per (theta, phi) of rays through the origin, on 9 x 4 bins of 10 and 90 degrees.
fn directions(tier: &Tier, directions: &[DVec3]) -> Vec<(usize, usize)> {
    directions
        .iter()
        .map(|direction| {
            let bins = json!({ "num_bins_theta": 9, "num_bins_phi": 4 });
            let bench = Bench::new().pencil(-*direction, *direction, json!({})).detector(
                "far_field",
                "sky",
                at(0.0, 0.0, 0.0),
                bins,
            );
            let result = bench.trace(tier, 1);
            far_field(&result, "sky").hits.indexed_iter().find(|(_, hits)| **hits == 1).unwrap().0
        })
        .collect()
}

#[test]
fn far_field_bins_hold_the_pole_the_horizon_and_both_hemispheres() {
    let spherical = |theta: f64, phi: f64| {
        let (theta, phi) = (theta.to_radians(), phi.to_radians());
        DVec3::new(theta.sin() * phi.cos(), theta.sin() * phi.sin(), theta.cos())
    };
    for tier in tiers("far-field bins") {
        // Azimuth bins start at -180, -90, 0 and 90 degrees; a direction of N < 0 folds, and keeps its azimuth.
        let cases = [
            (spherical(9.999, 45.0), (0, 2)),
            (spherical(10.001, 45.0), (1, 2)),
            (spherical(35.0, 135.0), (3, 3)),
            (spherical(145.0, 135.0), (3, 3)),
            (spherical(55.0, -45.0), (5, 1)),
            (spherical(125.0, -135.0), (5, 0)),
            (spherical(89.999, -1.0), (8, 1)),
            (spherical(90.001, 1.0), (8, 2)),
        ];
        let found = directions(&tier, &cases.map(|(direction, _)| direction));
        for ((direction, bin), found) in cases.iter().zip(found) {
            assert_eq!(found, *bin, "{}", tier.name(&format!("{direction}")));
        }
        // At the pole the azimuth is rounding noise, the polar bin is not.
        let poles: Vec<usize> =
            directions(&tier, &[DVec3::Z, -DVec3::Z]).into_iter().map(|bin| bin.0).collect();
        assert_eq!(poles, [0, 0]);
    }
}

#[test]
fn far_field_intensity_is_flux_over_the_bins_solid_angle() {
    for tier in tiers("far-field intensity") {
        let bins = json!({ "num_bins_theta": 9, "num_bins_phi": 4 });
        let bench = Bench::new().pencil(DVec3::ZERO, tilted(0.7), json!({})).detector(
            "far_field",
            "sky",
            at(0.0, 0.0, 1.0),
            bins,
        );
        let result = bench.trace(&tier, 8);
        // sin(theta centre) d theta d phi, as the reference takes it: 45 degrees, 10 and 90 degrees wide.
        let solid_angle = 45f64.to_radians().sin() * 10f64.to_radians() * PI / 2.0;
        let intensity = far_field(&result, "sky").intensity.iter().copied().fold(0.0, f64::max);
        exact(&tier.name("far-field intensity"), [(intensity * solid_angle, 1.0)], 1e-14).accepted();
    }
}

#[test]
fn a_transmissive_detector_counts_a_ray_at_every_crossing() {
    for tier in tiers("tapped flux") {
        let tap = |kind: Value| {
            let mut more = json!({ "width": 4.0, "height": 4.0, "absorb": false });
            more.as_object_mut().unwrap().extend(kind.as_object().unwrap().clone());
            more
        };
        let pixels = json!({ "num_pixels_x": 1, "num_pixels_y": 1 });
        let bench = Bench::new()
            .beam(DVec3::ZERO, DVec3::Z, 1.0)
            .detector("irradiance", "tap", at(0.0, 0.0, 1.0), tap(pixels))
            .detector("ray_database", "rays", at(0.0, 0.0, 2.0), tap(json!({})))
            .mirror("mirror", at(0.0, 0.0, 3.0), plane(), 0.5)
            .pixels("end", at(0.0, 0.0, -1.0), 4.0, 1);
        let result = bench.trace(&tier, 1000);
        assert_eq!(["tap", "rays", "end"].map(|name| hits(&result, name)), [2000, 2000, 1000]);
        // One watt there, half a watt back.
        let flux = ["tap", "rays", "end"]
            .map(|name| result.detector(name).unwrap().total_flux)
            .into_iter()
            .zip([1.5, 1.5, 0.5]);
        exact(&tier.name("flux of a tap"), flux, 1e-15).accepted();
        exact(&tier.name("tapped flux"), [(result.total_flux_tapped, 3.0)], 1e-15).accepted();
        exact(&tier.name("energy of the reference"), [(result.flux_conservation_error, 0.5)], 1e-15)
            .accepted();
    }
}
