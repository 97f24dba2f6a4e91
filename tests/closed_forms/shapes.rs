//! Where shapes begin and end, and that a ray never meets the surface it leaves.

use crate::bench::{
    Bench, Tier, absorbed, at, conic, disk, hits, irradiance, path_events, plane, rows, tiers, tilted,
};
use crate::deviation::{binomial, exact};
use glam::DVec3;
use serde_json::{Value, json};
use std::f64::consts::PI;

const MILLION: u64 = 1_000_000;

#[test]
fn an_annulus_takes_the_share_of_its_area() {
    for tier in tiers("annulus") {
        let ring = json!({ "type": "annulus", "inner_radius": 1.0, "outer_radius": 1.5, "z_offset": 2.0 });
        let bench = Bench::new()
            .beam(DVec3::ZERO, DVec3::Z, 2.0)
            .absorber("ring", at(0.0, 0.0, 1.0), ring)
            .absorber("hole", at(0.0, 0.0, 4.0), disk(1.0))
            .pixels("rest", at(0.0, 0.0, 5.0), 4.0, 1);
        let result = bench.trace(&tier, MILLION);
        // Areas over pi 2^2: (1.5^2 - 1) / 4, and 1 / 4 through the hole.
        binomial(&tier.name("annulus"), absorbed(&result, "ring"), MILLION, 0.3125).accepted();
        binomial(&tier.name("hole of the annulus"), absorbed(&result, "hole"), MILLION, 0.25).accepted();
        assert_eq!(absorbed(&result, "ring") + absorbed(&result, "hole") + hits(&result, "rest"), MILLION);
        assert_eq!(result.num_rays_absorbed, MILLION - hits(&result, "rest"));
        let flux = result.total_flux_absorbed + result.total_flux_detected;
        exact(&tier.name("flux of absorbers and detector"), [(flux, 1.0)], 1e-15).accepted();
    }
}

/// Absorbing parts of one curved face, each with what it leaves out: both take the shares of their areas.
#[test]
fn clipped_conics_take_the_shares_of_their_areas_and_what_they_leave_out_takes_the_rest() {
    let area = 100.0 * PI;
    let cases = [
        ("circle off the axis", "ellipse", [3.0, 3.0], [4.0, -5.0], 0.0, 9.0 * PI / area),
        ("ellipse with a hole", "ellipse", [7.0, 4.0], [0.5, 1.0], 2.0, (28.0 - 4.0) * PI / area),
        ("rectangle", "rectangle", [6.0, 2.0], [-1.0, 3.0], 0.0, 48.0 / area),
        ("rectangle with a hole", "rectangle", [5.0, 5.0], [0.0, 0.0], 3.0, (100.0 - 9.0 * PI) / area),
    ];
    for tier in tiers("clipped conics") {
        for (form, outline, [a, b], [x, y], hole, share) in cases {
            let shape = |inverted: bool| {
                json!({
                    "type": "clipped_conic", "radius": 40.0, "conic": -0.5, "aperture_radius": 10.0,
                    "aperture": {"outline": outline, "semi_axis_x": a, "semi_axis_y": b, "x": x, "y": y,
                        "hole_radius": hole, "inverted": inverted},
                })
            };
            let bench = Bench::new()
                .beam(DVec3::new(0.0, 0.0, -5.0), DVec3::Z, 10.0)
                .absorber("part", at(0.0, 0.0, 0.0), shape(false))
                .absorber("rest", at(0.0, 0.0, 0.0), shape(true));
            let result = bench.trace(&tier, MILLION);
            binomial(&tier.name(form), absorbed(&result, "part"), MILLION, share).accepted();
            binomial("planted: an area 5 % larger", absorbed(&result, "part"), MILLION, 1.05 * share)
                .rejected();
            assert_eq!(absorbed(&result, "part") + absorbed(&result, "rest"), MILLION, "{form}");
        }
    }
}

/// The far side of a face is met where the near side is cut away.
#[test]
fn the_far_crossing_of_a_clipped_conic_is_met_where_the_near_one_is_cut_away() {
    // Across a bowl z = x^2 / 20 at z = 5: it is crossed at x = -10 and at x = 10, and only the second is left.
    for tier in tiers("far crossing") {
        let shape = json!({
            "type": "clipped_conic", "radius": 10.0, "conic": -1.0, "aperture_radius": 20.0,
            "aperture": {"outline": "rectangle", "semi_axis_x": 5.0, "semi_axis_y": 5.0, "x": 12.0},
        });
        let bench = Bench::new()
            .pencil(DVec3::new(-50.0, 0.0, 5.0), DVec3::X, json!({}))
            .absorber("bowl", at(0.0, 0.0, 0.0), shape)
            .record_paths();
        let paths = bench.trace(&tier, 1).ray_paths.unwrap();
        let (position, _) = path_events(&paths, "hit", "bowl")[0];
        exact(&tier.name("far crossing"), [(position.x, 10.0)], tier.pick(1e-12, 1e-5)).accepted();
    }
}

#[test]
fn a_cone_deviates_a_ray_along_its_axis_by_twice_its_slope() {
    // Radius 2 at z = 0, 5 at z = 4: slope atan(3 / 4); a ray along -z leaves at twice that angle from -z, inwards.
    for tier in tiers("cone") {
        let cone = json!({ "type": "frustum", "r_front": 2.0, "r_back": 5.0, "z_front": 0.0, "z_back": 4.0 });
        let bench = Bench::new()
            .pencil(DVec3::new(2.5, 0.0, 10.0), -DVec3::Z, json!({}))
            .pencil(DVec3::new(1.999, 0.0, 10.0), -DVec3::Z, json!({}))
            .pencil(DVec3::new(5.001, 0.0, 10.0), -DVec3::Z, json!({}))
            .mirror("cone", at(0.0, 0.0, 0.0), cone, 1.0)
            .max_depth(1)
            .record_paths();
        let paths = bench.trace(&tier, 3).ray_paths.unwrap();
        assert_eq!(path_events(&paths, "hit", "cone").len(), 1, "the rays beside the cone miss it");
        let (position, direction) = path_events(&paths, "death", "depth_killed")[0];
        // tan = 3/4: sin 2 alpha = 24/25, cos 2 alpha = 7/25; met where the radius is 2.5, at z = 2/3.
        let turned = [(direction.x, -0.96), (direction.z, -0.28), (position.z, 2.0 / 3.0)];
        exact(&tier.name("cone: reflection"), turned, tier.pick(1e-12, 1e-6)).accepted();
    }
}

#[test]
fn an_unlimited_plane_is_met_far_off_axis() {
    for tier in tiers("unlimited plane") {
        let angle = 1.5706;
        let bench = Bench::new()
            .pencil(DVec3::new(0.0, 0.0, -1.0), tilted(angle), json!({}))
            .absorber("plane", at(0.0, 0.0, 0.0), plane())
            .record_paths();
        let paths = bench.trace(&tier, 1).ray_paths.unwrap();
        let (position, _) = path_events(&paths, "hit", "plane")[0];
        exact(&tier.name("unlimited plane"), [(position.x / angle.tan(), 1.0)], tier.pick(1e-12, 1e-6))
            .accepted();
    }
}

#[test]
fn a_sphere_is_met_within_its_aperture_only() {
    for tier in tiers("sphere") {
        let bench = Bench::new()
            .beam(DVec3::new(0.0, 0.0, -20.0), DVec3::Z, 4.0)
            .absorber(
                "cap",
                at(0.0, 0.0, 0.0),
                json!({ "type": "sphere", "radius": 5.0, "aperture_radius": 3.0 }),
            )
            .pixels("rest", at(0.0, 0.0, 20.0), 10.0, 1);
        let result = bench.trace(&tier, MILLION);
        binomial(&tier.name("sphere with an aperture"), absorbed(&result, "cap"), MILLION, 9.0 / 16.0)
            .accepted();
        assert_eq!(absorbed(&result, "cap") + hits(&result, "rest"), MILLION);
    }
}

/// Where pencils along z at these heights meet one absorbing surface.
fn meetings(tier: &Tier, shape: Value, heights: &[f64], from_z: f64) -> Vec<DVec3> {
    let sense = -from_z.signum();
    let mut bench = Bench::new().absorber("shape", at(0.0, 0.0, 0.0), shape).record_paths();
    for x in heights {
        bench = bench.pencil(DVec3::new(*x, 0.0, from_z), sense * DVec3::Z, json!({}));
    }
    let paths = bench.trace(tier, heights.len() as u64).ray_paths.unwrap();
    path_events(&paths, "hit", "shape").into_iter().map(|(position, _)| position).collect()
}

#[test]
fn of_a_hyperboloid_only_the_sheet_through_the_vertex_is_met() {
    // K = -4, R = 2: the sheet is z = (sqrt(R^2 + 3 x^2) - R) / 3; the other one, not met, has its vertex at -4/3.
    const HEIGHTS: [f64; 4] = [0.0, 0.5, 1.0, 1.5];
    for tier in tiers("hyperboloid") {
        for from_z in [-10.0, 10.0] {
            let met = meetings(&tier, conic(2.0, -4.0, 1.6), &HEIGHTS, from_z);
            assert_eq!(met.len(), HEIGHTS.len());
            let pairs = met.iter().map(|p| (p.z, ((4.0 + 3.0 * p.x * p.x).sqrt() - 2.0) / 3.0));
            exact(&tier.name("sheet of a hyperboloid"), pairs, tier.pick(1e-12, 2e-6)).accepted();
        }
    }
}

#[test]
fn of_a_closed_conic_only_the_half_at_the_vertex_is_met() {
    // A sphere of radius 2 as a conic: z = 2 - sqrt(4 - x^2) from both sides, never the far half at 2 + sqrt(4 - x^2).
    for tier in tiers("half sphere") {
        for from_z in [-10.0, 10.0] {
            let met = meetings(&tier, conic(2.0, 0.0, 1.9), &[0.0, 0.5, 1.0, 1.8], from_z);
            assert_eq!(met.len(), 4);
            let pairs = met.iter().map(|p| (p.z, 2.0 - (4.0 - p.x * p.x).sqrt()));
            exact(&tier.name("half of a sphere"), pairs, tier.pick(1e-12, 2e-6)).accepted();
        }
    }
}

#[test]
fn rims_belong_to_their_surfaces() {
    for tier in tiers("rims") {
        assert_eq!(meetings(&tier, disk(1.5), &[-1.5, 0.0, 1.5, 1.5001], -1.0).len(), 3);
        assert_eq!(meetings(&tier, conic(8.0, 0.0, 1.5), &[-1.5, 0.0, 1.5, 1.5001], -1.0).len(), 3);
        let ring = json!({ "type": "annulus", "inner_radius": 0.5, "outer_radius": 1.5 });
        assert_eq!(meetings(&tier, ring, &[0.4999, 0.5, 1.5, 1.5001], -1.0).len(), 2);
        let rectangle = json!({ "type": "plane", "width": 3.0, "height": 1.0 });
        assert_eq!(meetings(&tier, rectangle, &[-1.5001, -1.5, 1.5, 1.5001], -1.0).len(), 2);
    }
}

/// A ray that grazes along the inside of a mirror: `bounces` chords, each of which passes the axis at the same distance.
fn whisper(tier: &Tier, shape: &Value, origin: DVec3, direction: DVec3, bounces: u32) -> Vec<(DVec3, DVec3)> {
    let bench = Bench::new()
        .pencil(origin, direction, json!({}))
        .mirror("wall", at(0.0, 0.0, 0.0), shape.clone(), 1.0)
        .max_depth(bounces)
        .record_paths();
    let events = path_events(&bench.trace(tier, 1).ray_paths.unwrap(), "hit", "wall");
    assert_eq!(events.len(), bounces as usize, "the ray stays inside");
    events
}

#[test]
fn a_whispering_ray_keeps_its_radius_and_its_step() {
    const RADIUS: f64 = 10.0;
    // Chords at 0.02 rad from the tangent subtend 0.04 rad each: 200 of them turn the ray by 8 rad.
    let graze = 0.02f64;
    let shapes = [
        ("sphere", json!({ "type": "sphere", "radius": RADIUS })),
        (
            "cylinder",
            json!({ "type": "frustum", "r_front": RADIUS, "r_back": RADIUS, "z_front": -1.0, "z_back": 1.0 }),
        ),
    ];
    for tier in tiers("whispering gallery") {
        for (name, shape) in &shapes {
            let origin = DVec3::new(RADIUS * graze.cos(), 0.0, 0.0);
            let events = whisper(&tier, shape, origin, DVec3::Y, 200);
            let radii = events.iter().map(|(p, _)| (p.length(), RADIUS));
            exact(&tier.name(&format!("whispering in a {name}: radius")), radii, tier.pick(1e-10, 2e-4))
                .accepted();
            let passing = events.iter().map(|(p, d)| (p.cross(*d).length(), RADIUS * graze.cos()));
            exact(&tier.name(&format!("whispering in a {name}: caustic")), passing, tier.pick(1e-10, 2e-4))
                .accepted();
            let steps = events.windows(2).map(|w| (w[0].0.angle_between(w[1].0), 2.0 * graze));
            exact(&tier.name(&format!("whispering in a {name}: step")), steps, tier.pick(1e-10, 2e-4))
                .accepted();
        }
    }
}

#[test]
fn a_whispering_ray_in_a_conic_never_meets_the_point_it_leaves() {
    // A sphere as a conic: in its meridian 50 chords of 0.04 rad each lead from -1.2 rad through the vertex to 0.8 rad.
    for tier in tiers("concave conic") {
        let shape = conic(10.0, 0.0, 9.99);
        let start = 1.2f64;
        let on = |angle: f64| DVec3::new(10.0 * angle.sin(), 0.0, 10.0 - 10.0 * angle.cos());
        let (from, to) = (on(-start), on(-start + 0.04));
        let events = whisper(&tier, &shape, 0.5 * (from + to), (to - from).normalize(), 50);
        let centre = DVec3::new(0.0, 0.0, 10.0);
        let radii = events.iter().map(|(p, _)| ((*p - centre).length(), 10.0));
        exact(&tier.name("whispering in a conic: radius"), radii, tier.pick(1e-10, 2e-4)).accepted();
        let steps = events.windows(2).map(|w| ((w[0].0 - centre).angle_between(w[1].0 - centre), 0.04));
        exact(&tier.name("whispering in a conic: step"), steps, tier.pick(1e-10, 2e-4)).accepted();
    }
}

#[test]
fn a_scene_a_hundred_kilometres_off_gives_the_same_result() {
    // The reference loses most of the light there: its shortest hit, 1e-9 mm, is below the spacing of numbers.
    for tier in tiers("distant scene") {
        let scene = |origin: DVec3| {
            Bench::new()
                .within(at(origin.x, origin.y, origin.z))
                .medium("glass", 1.5, 0.0)
                .cone(DVec3::new(0.0, 0.0, -40.0), DVec3::Z, 10.0)
                .boundary("front", at(0.0, 0.0, 0.0), conic(30.0, 0.0, 8.0), "", "glass")
                .boundary("back", at(0.0, 0.0, 4.0), conic(-30.0, 0.0, 8.0), "glass", "")
                .pixels("screen", at(0.0, 0.0, 60.0), 20.0, 16)
                .trace(&tier, 100_000)
        };
        // Coordinates that f64 holds exactly: then the recentred scene is the same to the last bit.
        let (near, far) = (scene(DVec3::ZERO), scene(DVec3::new(1e8, -1e8, 1e8)));
        assert_eq!(irradiance(&near, "screen").hits, irradiance(&far, "screen").hits);
        assert_eq!(near.ledger, far.ledger);
        assert!(hits(&near, "screen") > 50_000);
    }
}

#[test]
fn rays_of_a_distant_database_are_where_they_are() {
    for tier in tiers("distant database") {
        let bench = Bench::new()
            .within(at(1e8, 0.0, 0.0))
            .pencil(DVec3::new(0.25, 0.5, 0.0), DVec3::Z, json!({}))
            .database("screen", at(0.0, 0.0, 4.0), 2.0, true);
        let position = rows(&bench.trace(&tier, 1), "screen")[0].position;
        assert_eq!(position, DVec3::new(1e8 + 0.25, 0.5, 4.0));
    }
}

/// A sphere is the conic part of an asphere with any K whose coefficients are the differences of both series. Here a paraboloid
/// is written as the sphere of its vertex, less what the sphere's series has beyond r^2.
#[test]
fn a_paraboloid_written_as_a_series_is_met_where_the_paraboloid_is() {
    const RADIUS: f64 = 40.0;
    // z = sum of a_i r^(2i) of the sphere: a_1 = 1 / (2 R), a_(i+1) = a_i (2 i - 1) / ((2 i + 2) R^2).
    let mut series = vec![1.0 / (2.0 * RADIUS)];
    for i in 1..10 {
        let factor = f64::from(2 * i - 1) / f64::from(2 * i + 2);
        series.push(series[i as usize - 1] * factor / (RADIUS * RADIUS));
    }
    let even: Vec<f64> = series.iter().enumerate().map(|(i, a)| if i == 0 { 0.0 } else { -a }).collect();
    let odd: Vec<f64> = (0..10).map(|i| if i % 2 == 1 { even[i / 2] } else { 0.0 }).collect();
    for tier in tiers("series of a paraboloid") {
        for (kind, coefficients) in [("even_asphere", even.clone()), ("odd_asphere", odd.clone())] {
            let asphere = json!({
                "type": kind, "radius": RADIUS, "conic": 0.0, "aperture_radius": 5.0, "coefficients": coefficients,
            });
            for from_z in [-30.0, 30.0] {
                let heights = [0.0, 0.7, 2.5, -4.9];
                let met = meetings(&tier, asphere.clone(), &heights, from_z);
                assert_eq!(met.len(), 4);
                // Ten powers of r leave out the term of r^12, which is 9.5e-12 mm at 4.9 mm.
                let tolerance = if kind == "even_asphere" { 4e-15 } else { 1.1e-11 };
                let pairs = met.iter().map(|p| (p.z, p.x * p.x / (2.0 * RADIUS)));
                exact(&tier.name(kind), pairs, tier.pick(tolerance, 1e-6)).accepted();
            }
            assert!(
                meetings(&tier, asphere, &[5.01, -5.1], -30.0).is_empty(),
                "beyond the aperture there is nothing"
            );
        }
    }
}
