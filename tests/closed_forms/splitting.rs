//! Splitting: both branches of the first hits, each with its share, and every family on its own draws.

use crate::bench::{Bench, Row, SEED, Tier, at, disk, plane, rows, tiers, tilted};
use crate::deviation::{binomial, exact, mean};
use glam::DVec3;
use nsq_gpu::TraceResult;
use nsq_gpu::model::ray_id;
use nsq_gpu::program::layout::rng;
use serde_json::json;
use std::collections::BTreeMap;

/// Slots of the draws, by the reference's numbers.
const FRESNEL_BRANCH: u32 = 5;
const ROULETTE: u32 = 9;

/// What one launched ray sends to a detector: fractions of its flux by the number of the child.
fn family(result: &TraceResult, detector: &str, launched: u64) -> BTreeMap<u32, f64> {
    let of = |row: &Row| ray_id::order(row.ray, true).0 == launched;
    let fraction =
        |row: Row| (ray_id::order(row.ray, true).1 as u32, row.flux * result.num_rays_total as f64);
    let rows: Vec<Row> = rows(result, detector).into_iter().filter(of).collect();
    let family: BTreeMap<u32, f64> = rows.iter().copied().map(fraction).collect();
    assert_eq!(family.len(), rows.len(), "ids are unique");
    family
}

fn assert_family(form: &str, found: &BTreeMap<u32, f64>, expected: &[(u32, f64)], tolerance: f64) {
    assert!(
        found.keys().eq(expected.iter().map(|(number, _)| number)),
        "{form}: {found:?}, not {expected:?}"
    );
    let pairs = found.values().zip(expected).map(|(found, (_, expected))| (found / expected, 1.0));
    exact(form, pairs, tolerance).accepted();
}

/// Every quantum that was launched is detected.
fn assert_nothing_lost(result: &TraceResult) {
    assert_eq!(result.ledger.detected.quanta, result.ledger.launched.quanta);
}

fn between_databases(bench: Bench) -> Bench {
    bench.database("reflected", at(0.0, 0.0, -20.0), 1e4, true).database(
        "transmitted",
        at(0.0, 0.0, 20.0),
        1e4,
        true,
    )
}

#[test]
fn a_split_sends_the_fresnel_reflectance_one_way_and_the_rest_the_other() {
    for tier in tiers("split at a boundary") {
        for (n1, n2, angle) in
            [(1.0, 1.5, 0.0), (1.0, 1.5, 1.2), (1.5, 1.0, 0.6), (1.0, 4.0, 1.55), (1.5, 1.6, 0.3)]
        {
            let bench = Bench::new()
                .medium("first", n1, 0.0)
                .medium("second", n2, 0.0)
                .boundary("boundary", at(0.0, 0.0, 0.0), plane(), "first", "second")
                .pencil(
                    -tilted(angle),
                    tilted(angle),
                    json!({ "medium": { "type": "medium", "name": "first" } }),
                );
            let result = between_databases(bench).split(1, 2.0).trace(&tier, 7);
            let (i, t) = (angle, (n1 / n2 * angle.sin()).asin());
            let r_s = (n1 * i.cos() - n2 * t.cos()) / (n1 * i.cos() + n2 * t.cos());
            let r_p = (n2 * i.cos() - n1 * t.cos()) / (n2 * i.cos() + n1 * t.cos());
            let r = 0.5 * (r_s * r_s + r_p * r_p);
            let form = tier.name(&format!("split {n1} to {n2} at {angle}"));
            for launched in 0..7 {
                // In f32 the smaller weight has as many digits as the larger one.
                assert_family(
                    &form,
                    &family(&result, "reflected", launched),
                    &[(0, r)],
                    tier.pick(1e-12, 1e-4),
                );
                assert_family(
                    &form,
                    &family(&result, "transmitted", launched),
                    &[(1, 1.0 - r)],
                    tier.pick(1e-12, 1e-5),
                );
            }
            assert_nothing_lost(&result);
            assert!(!result.diagnostics.split_budget_saturated, "{form}");
        }
    }
}

#[test]
fn total_reflection_splits_nothing_and_saturates_nothing() {
    for tier in tiers("split and total reflection") {
        let inside = json!({ "medium": { "type": "medium", "name": "glass" } });
        let bench = Bench::new()
            .medium("glass", 1.5, 0.0)
            .boundary("boundary", at(0.0, 0.0, 0.0), plane(), "glass", "")
            .pencil(-tilted(1.0), tilted(1.0), inside);
        for budget in [1.0, 4.0] {
            let result = between_databases(bench.clone()).split(3, budget).trace(&tier, 9);
            assert_eq!(rows(&result, "reflected").len(), 9);
            assert_eq!(rows(&result, "transmitted").len(), 0);
            assert!(!result.diagnostics.split_budget_saturated);
            assert_nothing_lost(&result);
        }
    }
}

/// A plate of index 4, R = 0.36, met at right angles.
fn plate(max_depth: u32) -> Bench {
    let bench = Bench::new()
        .medium("germanium", 4.0, 0.0)
        .max_depth(max_depth)
        .pencil(DVec3::ZERO, DVec3::Z, json!({}))
        .boundary("front", at(0.0, 0.0, 2.0), disk(5.0), "", "germanium")
        .boundary("back", at(0.0, 0.0, 3.0), disk(5.0), "germanium", "");
    between_databases(bench)
}

const R: f64 = 0.36;
const T: f64 = 0.64;

/// One ray for each way out, in the order of reflections inside, with the number that its lineage gives it: transmitted
/// at the entry, bit 0, and at its exit.
fn plate_series(depth: u32) -> [Vec<(u32, f64)>; 2] {
    let exit = |inside: u32| (1 | 1 << (inside + 1), T * T * R.powi(inside as i32));
    let mut reflected = vec![(0, R)];
    reflected.extend((1..depth - 1).filter(|inside| inside % 2 == 1).map(exit));
    [reflected, (0..depth - 1).filter(|inside| inside % 2 == 0).map(exit).collect()]
}

#[test]
fn a_split_plate_shows_each_ghost_once_with_its_exact_flux() {
    const DEPTH: u32 = 11;
    for tier in tiers("split plate") {
        let result = plate(DEPTH + 1).split(DEPTH, 16.0).trace(&tier, 100);
        let expected = plate_series(DEPTH);
        for launched in [0, 1, 99] {
            for (detector, expected) in ["reflected", "transmitted"].iter().zip(&expected) {
                let form = tier.name(&format!("split plate, {detector}"));
                assert_family(&form, &family(&result, detector, launched), expected, tier.pick(1e-11, 1e-2));
            }
        }
        // What is still inside after the last split was drawn once more, and ended at the depth limit.
        let left = [(result.ledger.depth.flux, T * R.powi(DEPTH as i32 - 1))];
        exact(&tier.name("split plate, depth limit"), left, tier.pick(1e-14, 1e-7)).accepted();
        assert!(!result.diagnostics.split_budget_saturated);
        let rows = rows(&result, "transmitted");
        assert!(rows.is_sorted_by_key(|row| ray_id::order(row.ray, true)), "families stand together");
        exact("planted: a ghost of another flux", [(expected[1][1].1, T * T * R)], 1e-2).rejected();
    }
}

#[test]
fn a_coat_takes_its_loss_from_the_transmitted_branch() {
    for tier in tiers("split at a lossy coat") {
        let bench =
            Bench::new().pencil(DVec3::ZERO, DVec3::Z, json!({})).coat("coat", at(0.0, 0.0, 1.0), 0.3, 0.6);
        let result = between_databases(bench).split(1, 2.0).trace(&tier, 50);
        let tolerance = tier.pick(1e-13, 1e-6);
        assert_family(&tier.name("coat"), &family(&result, "reflected", 3), &[(0, 0.3)], tolerance);
        assert_family(&tier.name("coat"), &family(&result, "transmitted", 3), &[(1, 0.6)], tolerance);
        exact(&tier.name("coat, loss"), [(result.ledger.coating.flux, 0.1)], tolerance).accepted();
    }
}

#[test]
fn a_faint_branch_is_rounded_without_bias() {
    const FAINT: f64 = 1e-6;
    const RAYS: u64 = 100_000;
    for tier in tiers("split off faint branches") {
        let bench = Bench::new().pencil(DVec3::ZERO, DVec3::Z, json!({})).coat(
            "coat",
            at(0.0, 0.0, 1.0),
            FAINT,
            1.0 - FAINT,
        );
        let result = between_databases(bench).split(1, 2.0).trace(&tier, RAYS);
        let mut samples = vec![0.0; RAYS as usize];
        rows(&result, "reflected")
            .into_iter()
            .for_each(|row| samples[row.ray as usize] = row.flux * RAYS as f64);
        let form = tier.name("split off a millionth");
        if samples.iter().all(|sample| sample == &samples[0]) {
            exact(&form, [(samples[0], FAINT)], 1e-9 * FAINT).accepted();
        } else {
            mean(&form, &samples, FAINT).accepted();
            // Eight steps of 2^-23: to the nearest they would always be too few.
            mean("planted: rounded to the nearest", &samples, (FAINT * 8_388_608.0).round() / 8_388_608.0)
                .rejected();
        }
        assert_nothing_lost(&result);
    }
}

/// A coat that halves the light, a coat on either side that halves it again, and what passes those.
fn halves(max_depth: u32) -> Bench {
    let bench = Bench::new()
        .max_depth(max_depth)
        .pencil(DVec3::ZERO, DVec3::Z, json!({}))
        .coat("middle", at(0.0, 0.0, 1.0), 0.5, 0.5)
        .coat("left", at(0.0, 0.0, -1.0), 0.5, 0.5)
        .coat("right", at(0.0, 0.0, 3.0), 0.5, 0.5);
    between_databases(bench)
}

fn launched(rows: Vec<Row>) -> Vec<u64> {
    rows.into_iter().map(|row| ray_id::order(row.ray, true).0).collect()
}

/// The launched rays whose member of this number draws below p, or not.
fn drawn(num_rays: u64, number: u32, slot: u32, p: f64, below: bool) -> Vec<u64> {
    let draws = |launched: &u64| {
        let bits = rng::draw(SEED, ray_id::of(*launched, number), 1, slot);
        (f64::from(bits) < p * 4294967296.0) == below
    };
    (0..num_rays).filter(draws).collect()
}

#[test]
fn either_branch_draws_the_numbers_of_its_own_id() {
    for tier in tiers("draws of split rays") {
        let result = halves(3).split(1, 2.0).trace(&tier, 1000);
        assert_eq!(launched(rows(&result, "reflected")), drawn(1000, 0, FRESNEL_BRANCH, 0.5, false));
        assert_eq!(launched(rows(&result, "transmitted")), drawn(1000, 1, FRESNEL_BRANCH, 0.5, false));
        // Roulette after the split: weights of 1/2 below a threshold of 0.8 survive with 5/8.
        let bench =
            Bench::new().pencil(DVec3::ZERO, DVec3::Z, json!({})).coat("coat", at(0.0, 0.0, 1.0), 0.5, 0.5);
        let result = between_databases(bench).split(1, 2.0).roulette_below(0.8).trace(&tier, 1000);
        assert_eq!(launched(rows(&result, "reflected")), drawn(1000, 0, ROULETTE, 0.625, true));
        assert_eq!(launched(rows(&result, "transmitted")), drawn(1000, 1, ROULETTE, 0.625, true));
    }
}

#[test]
fn a_budget_that_is_used_up_leaves_the_means_and_is_reported() {
    const RAYS: u64 = 20_000;
    for tier in tiers("split with little budget") {
        for budget in [1.0, 1.5, 2.0, 3.0] {
            let result = plate(40).split(9, budget).trace(&tier, RAYS);
            assert!(result.diagnostics.split_budget_saturated, "{budget}");
            assert!(result.diagnostics.warnings.iter().any(|warning| warning.contains("split_budget")));
            let mut samples = vec![0.0; RAYS as usize];
            for row in rows(&result, "transmitted") {
                samples[ray_id::order(row.ray, true).0 as usize] += row.flux * RAYS as f64;
            }
            let form = tier.name(&format!("plate, split_budget {budget}"));
            mean(&form, &samples, T * T / (1.0 - R * R)).accepted();
            mean("planted: 5 % less", &samples, 0.95 * T * T / (1.0 - R * R)).rejected();
        }
        let whole = plate(40).split(9, 10.0).trace(&tier, 100);
        assert!(!whole.diagnostics.split_budget_saturated);
    }
}

/// With a budget of b rays the reflected branch is split b - 1 times, the transmitted one as often as it likes.
#[test]
fn the_budget_is_spent_on_reflections() {
    for tier in tiers("split_budget") {
        let result = plate(40).split(9, 3.0).trace(&tier, 10);
        let ways_out = ["reflected", "transmitted"].map(|detector| family(&result, detector, 4));
        let mut found: Vec<f64> = ways_out.iter().flat_map(|family| family.values().copied()).collect();
        found.sort_by(f64::total_cmp);
        // Off the front, through, and after one reflection inside; one ray carries what is left after two.
        let expected = [T * R * R, T * T * R, R, T * T];
        assert_eq!(found.len(), expected.len(), "{ways_out:?}");
        exact(&tier.name("split_budget 3"), found.into_iter().zip(expected), tier.pick(1e-12, 1e-6))
            .accepted();
    }
}

#[test]
fn a_fraction_of_a_ray_is_given_to_that_share_of_the_families() {
    const RAYS: u64 = 100_000;
    for tier in tiers("fractional split_budget") {
        let bench =
            Bench::new().pencil(DVec3::ZERO, DVec3::Z, json!({})).coat("coat", at(0.0, 0.0, 1.0), 0.5, 0.5);
        let result = between_databases(bench).split(3, 1.25).trace(&tier, RAYS);
        let children =
            rows(&result, "transmitted").iter().filter(|row| ray_id::order(row.ray, true).1 > 0).count();
        binomial(&tier.name("families of two"), children as u64, RAYS, 0.25).accepted();
    }
}

/// The family of one launched ray, from birth to death; a child begins with the hit at which it was split off.
#[test]
fn paths_of_children_begin_where_they_were_split_off() {
    for tier in tiers("paths of split rays") {
        let result = plate(4).split(2, 4.0).record_paths().trace(&tier, 2);
        let paths = result.ray_paths.as_ref().unwrap().columns().unwrap();
        let told: Vec<(u64, u64, String)> = (0..paths.ray_id.len())
            .map(|i| {
                let (launched, number) = ray_id::order(paths.ray_id[i] as u64, true);
                (launched, number, format!("{} {}", paths.event_type[i], paths.component_name[i]))
            })
            .collect();
        let of = |launched: u64, number: u64| -> Vec<&str> {
            told.iter().filter(|row| (row.0, row.1) == (launched, number)).map(|row| row.2.as_str()).collect()
        };
        for launched in [0, 1] {
            assert_eq!(of(launched, 0), ["birth source 0", "hit front", "hit reflected"]);
            assert_eq!(of(launched, 3), ["hit back", "hit transmitted"]);
            assert_eq!(of(launched, 1)[..3], ["hit front", "hit back", "hit front"]);
        }
        assert!(told.is_sorted_by_key(|row| (row.0, row.1)));
        let births = paths.event_type.iter().filter(|kind| **kind == "birth").count();
        assert_eq!(births, 2, "a child is not born");
    }
}

/// Two facets of glass at right angles, one mesh: the light that one reflects meets the other, before that which it
/// transmits goes on. Vertical light on a facet of 45 degrees is refracted by asin(sin 45 / n).
#[test]
fn a_ray_that_waited_on_a_mesh_leaves_the_triangle_that_it_met() {
    let facets = json!({
        "type": "mesh",
        "vertices": [[-10, -10, 10], [0, -10, 0], [0, 10, 0], [-10, 10, 10], [10, -10, 10], [10, 10, 10]],
        "faces": [[0, 3, 2], [0, 2, 1], [1, 2, 5], [1, 5, 4]],
    });
    for tier in tiers("split on a mesh") {
        let bench = Bench::new()
            .medium("glass", 1.5, 0.0)
            .boundary("facets", at(0.0, 0.0, 0.0), facets.clone(), "", "glass")
            .pencil(DVec3::new(-3.0, 0.1, 15.0), -DVec3::Z, json!({}))
            .database("below", at(0.0, 0.0, -20.0), 1e4, true);
        let result = bench.split(1, 2.0).trace(&tier, 5);
        let s = std::f64::consts::FRAC_1_SQRT_2;
        let bend = std::f64::consts::FRAC_PI_4 - (s / 1.5).asin();
        let children: Vec<DVec3> = rows(&result, "below")
            .iter()
            .filter(|row| ray_id::order(row.ray, true).1 == 1)
            .map(|row| row.direction)
            .collect();
        assert_eq!(children.len(), 5);
        // Towards the normal of the left facet, which points down and to the left.
        let expected = DVec3::new(-bend.sin(), 0.0, -bend.cos());
        let pairs = children.iter().map(|direction| ((*direction - expected).length(), 0.0));
        exact(&tier.name("refracted by the left facet"), pairs, tier.pick(1e-12, 1e-6)).accepted();
    }
}

fn unsplit_variance(tier: &Tier, bench: Bench) -> f64 {
    const RAYS: u64 = 5_000;
    let result = bench.trace(tier, RAYS);
    let mut samples = vec![0.0; RAYS as usize];
    for row in rows(&result, "reflected") {
        samples[ray_id::order(row.ray, true).0 as usize] += row.flux * RAYS as f64;
    }
    crate::deviation::mean_and_variance(&samples).1
}

#[test]
fn splitting_quiets_ghosts() {
    for tier in tiers("variance with splitting") {
        let [plain, one, three, all] = [(0, 4.0), (1, 4.0), (3, 4.0), (9, 16.0)]
            .map(|(depth, budget)| unsplit_variance(&tier, plate(40).split(depth, budget)));
        assert!(one < 0.5 * plain && three < 0.5 * one && all < 1e-3 * three, "{plain} {one} {three} {all}");
    }
}
