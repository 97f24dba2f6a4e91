//! Where the flux goes: depth, roulette, mirrors.

use crate::bench::{Bench, Tier, at, disk, rows, tiers};
use crate::deviation::{binomial, exact, mean};
use glam::DVec3;
use serde_json::json;

/// Two mirrors face to face, and a ray between them.
fn cavity(reflectance: f64, max_depth: u32) -> Bench {
    Bench::new()
        .pencil(DVec3::ZERO, DVec3::Z, json!({}))
        .mirror("right", at(0.0, 0.0, 1.0), disk(1.0), reflectance)
        .mirror("left", at(0.0, 0.0, -1.0), disk(1.0), reflectance)
        .max_depth(max_depth)
}

#[test]
fn a_cavity_holds_a_geometric_series_until_the_depth_cuts_it() {
    for tier in tiers("cavity") {
        for depth in [1, 2, 17, 100] {
            let result = cavity(0.9, depth).trace(&tier, 32);
            let tolerance = tier.pick(1e-12, 1e-5);
            // In f32 each bounce rounds; in f64 what remains is the flux of a quantum, 2^-52 of a ray.
            let of_rest = tier.pick(1e-12, 1e-5 * 0.9f64.powi(depth as i32));
            let left = [(result.ledger.depth.flux, 0.9f64.powi(depth as i32))];
            exact(&tier.name(&format!("cavity of depth {depth}: R^depth")), left, of_rest).accepted();
            // 1 - R^depth stays in the mirrors; of it the right one, met first, has (1 - R) sum of R^(2 k).
            let right: f64 = (0..depth).step_by(2).map(|k| 0.1 * 0.9f64.powi(k as i32)).sum();
            let flux = result
                .surfaces
                .iter()
                .map(|surface| surface.total_flux_absorbed)
                .zip([right, 1.0 - 0.9f64.powi(depth as i32) - right]);
            exact(&tier.name(&format!("cavity of depth {depth}: mirrors")), flux, tolerance).accepted();
            assert_eq!(result.num_rays_depth_killed, 32);
            let wrong = [(result.ledger.depth.flux, 0.9f64.powi(depth as i32 + 1))];
            exact("planted: one bounce more", wrong, of_rest).rejected();
        }
    }
}

/// One mirror of a reflectance, roulette below 0.1, and every ray that comes back.
fn returned(tier: &Tier, reflectance: f64, num_rays: u64) -> Vec<f64> {
    let bench = Bench::new()
        .pencil(DVec3::ZERO, DVec3::Z, json!({}))
        .mirror("mirror", at(0.0, 0.0, 1.0), disk(1.0), reflectance)
        .database("back", at(0.0, 0.0, -1.0), 2.0, true)
        .roulette_below(0.1);
    let result = bench.trace(tier, num_rays);
    let mut samples = vec![0.0; num_rays as usize];
    rows(&result, "back").into_iter().for_each(|row| samples[row.ray as usize] = row.flux * num_rays as f64);
    samples
}

#[test]
fn roulette_keeps_the_mean_and_the_survivors_share() {
    const RAYS: u64 = 100_000;
    for tier in tiers("roulette") {
        // Survival is weight / threshold, never below 0.05; the survivor's weight is divided by it.
        for (reflectance, survival) in [(0.05, 0.5), (0.01, 0.1), (0.001, 0.05)] {
            let samples = returned(&tier, reflectance, RAYS);
            let survivors: Vec<f64> = samples.iter().copied().filter(|flux| *flux > 0.0).collect();
            let form = tier.name(&format!("roulette at R = {reflectance}"));
            binomial(&format!("{form}: survival"), survivors.len() as u64, RAYS, survival).accepted();
            mean(&format!("{form}: mean"), &samples, reflectance).accepted();
            let weights = survivors.iter().map(|flux| (flux * survival / reflectance, 1.0));
            exact(&format!("{form}: weight"), weights, tier.pick(1e-12, 1e-6)).accepted();
            mean("planted: mean off by 10 %", &samples, 1.1 * reflectance).rejected();
        }
        let spared = returned(&tier, 0.2, 1000);
        exact(
            &tier.name("no roulette above the threshold"),
            spared.into_iter().map(|flux| (flux, 0.2)),
            tier.pick(1e-15, 1e-7),
        )
        .accepted();
    }
}

#[test]
fn roulette_in_a_cavity_gains_what_it_loses() {
    const RAYS: u64 = 100_000;
    for tier in tiers("roulette in a cavity") {
        let plain = cavity(0.5, 60).trace(&tier, RAYS);
        let played = cavity(0.5, 60).roulette_below(0.3).trace(&tier, RAYS);
        // The right mirror takes (1 - R) / (1 - R^2) = 2/3.
        exact(
            &tier.name("cavity without roulette"),
            [(plain.surfaces[0].total_flux_absorbed, 2.0 / 3.0)],
            tier.pick(1e-12, 1e-6),
        )
        .accepted();
        // Every play is fair, so that gain and loss have the same mean; sigma is that of their difference over the rays.
        let gained = played.ledger.roulette_gain.flux - played.ledger.roulette_loss.flux;
        let variance = cavity_gain_variance();
        let z = gained / (variance / RAYS as f64).sqrt();
        exact(&tier.name("roulette in a cavity: gain less loss"), [(z / 4.0, 0.0)], 1.0).accepted();
    }
}

/// Variance of what roulette adds to one ray of the cavity: independent draws with mean 0, each of variance
/// w^2 (1 - p) / p where the ray has weight w and survives with p, times the probability to get that far.
fn cavity_gain_variance() -> f64 {
    let (mut weight, mut alive, mut variance) = (1.0f64, 1.0f64, 0.0);
    for _ in 1..60 {
        weight *= 0.5;
        let survival = (weight / 0.3).clamp(0.05, 1.0);
        variance += alive * weight * weight * (1.0 - survival) / survival;
        alive *= survival;
        weight /= survival;
    }
    variance
}

#[test]
fn absorbers_in_the_shade_of_others_are_told_as_unreached() {
    for tier in tiers("absorbers in the shade") {
        let bench = Bench::new()
            .beam(DVec3::ZERO, DVec3::Z, 2.0)
            .absorber("shade", at(0.0, 0.0, 1.0), disk(1.0))
            .absorber("shaded", at(0.0, 0.0, 2.0), disk(0.9))
            .absorber("wider", at(0.0, 0.0, 3.0), disk(1.5))
            .pixels("rest", at(0.0, 0.0, 5.0), 4.0, 1);
        let result = bench.trace(&tier, 10_000);
        assert_eq!(
            result.diagnostics.unreached_geometry,
            ["shaded"],
            "{}",
            tier.name("absorbers in the shade")
        );
    }
}
