//! Mirrors and surfaces that image a point exactly.

use crate::bench::{Bench, at, conic, path_events, plane, rows, tiers, tilted, towards, turned};
use crate::deviation::exact;
use glam::{DMat3, DVec3};
use nsq_gpu::TraceResult;
use serde_json::json;
use std::f64::consts::FRAC_1_SQRT_2;

/// The largest distance of rays from a point, over those of a database that travel along +z or -z.
fn spot(result: &TraceResult, name: &str, point: DVec3, sense: f64) -> Vec<(f64, f64)> {
    let arriving: Vec<_> =
        rows(result, name).into_iter().filter(|row| row.direction.z * sense > 0.0).collect();
    assert!(arriving.len() > 500, "{} rays arrive", arriving.len());
    arriving.iter().map(|row| ((row.position - point).length(), 0.0)).collect()
}

#[test]
fn a_paraboloid_focuses_a_parallel_beam_to_a_point() {
    for tier in tiers("paraboloid") {
        // The focus of z = r^2 / (2 R) is at R / 2.
        let bench = |k: f64| {
            Bench::new()
                .beam(DVec3::new(0.0, 0.0, 200.0), -DVec3::Z, 40.0)
                .mirror("primary", at(0.0, 0.0, 0.0), conic(100.0, k, 45.0), 1.0)
                .database("focus", at(0.0, 0.0, 50.0), 1.0, false)
        };
        let focus = DVec3::new(0.0, 0.0, 50.0);
        let tolerance = tier.pick(1e-10, 1e-3);
        exact(
            &tier.name("paraboloid: spot"),
            spot(&bench(-1.0).trace(&tier, 1000), "focus", focus, 1.0),
            tolerance,
        )
        .accepted();
        exact("planted: K = -0.999", spot(&bench(-0.999).trace(&tier, 1000), "focus", focus, 1.0), tolerance)
            .rejected();
    }
}

#[test]
fn an_ellipsoid_images_one_focus_on_the_other() {
    // a = 50, e = 0.6: R = a (1 - e^2) = 32, K = -e^2, foci at a (1 -+ e) = 20 and 80 from the vertex.
    for tier in tiers("ellipsoid") {
        let bench = Bench::new()
            .cone(DVec3::new(0.0, 0.0, 20.0), -DVec3::Z, 80.0)
            .mirror("ellipsoid", at(0.0, 0.0, 0.0), conic(32.0, -0.36, 39.9), 1.0)
            .database("focus", at(0.0, 0.0, 80.0), 1.0, true);
        let spot = spot(&bench.trace(&tier, 1000), "focus", DVec3::new(0.0, 0.0, 80.0), 1.0);
        exact(&tier.name("ellipsoid: spot"), spot, tier.pick(1e-10, 1e-3)).accepted();
    }
}

#[test]
fn a_cassegrain_telescope_images_a_star_exactly() {
    // Primary: focus at 100. Secondary: foci at 100 and 5, vertex at 80; c = 47.5, a = 80 - 52.5 = 27.5,
    // R = (c^2 - a^2) / a, K = -(c / a)^2.
    let (c, a) = (47.5f64, 27.5f64);
    for tier in tiers("Cassegrain") {
        let bench = Bench::new()
            .beam(DVec3::new(0.0, 0.0, 150.0), -DVec3::Z, 30.0)
            .mirror("primary", at(0.0, 0.0, 0.0), conic(200.0, -1.0, 35.0), 1.0)
            .mirror("secondary", at(0.0, 0.0, 80.0), conic((c * c - a * a) / a, -(c / a).powi(2), 8.0), 1.0)
            .database("focus", at(0.0, 0.0, 5.0), 1.0, true);
        let spot = spot(&bench.trace(&tier, 1000), "focus", DVec3::new(0.0, 0.0, 5.0), -1.0);
        exact(&tier.name("Cassegrain: spot"), spot, tier.pick(1e-10, 2e-3)).accepted();
    }
}

#[test]
fn a_sphere_is_aplanatic_for_the_point_at_its_radius_over_n() {
    // From R / n beside the centre every ray leaves as if from n R (Weierstrass), up to any angle.
    let (n, radius) = (1.5, 10.0);
    for tier in tiers("aplanatic sphere") {
        let glass = json!({ "half_angle_deg": 80.0, "medium": { "type": "medium", "name": "glass" } });
        let bench = Bench::new()
            .medium("glass", n, 0.0)
            .reflect_prob(0.0)
            .source("point", at(0.0, 0.0, -radius / n), glass)
            .boundary("ball", at(0.0, 0.0, 0.0), json!({ "type": "sphere", "radius": radius }), "", "glass")
            .database("screen", at(0.0, 0.0, 11.0), 1e3, true);
        let rows = rows(&bench.trace(&tier, 1000), "screen");
        assert!(rows.len() > 900, "{} rays arrive", rows.len());
        let missed = |image: f64| {
            rows.iter().map(move |row| {
                ((row.position - DVec3::new(0.0, 0.0, image)).cross(row.direction).length(), 0.0)
            })
        };
        exact(&tier.name("aplanatic sphere"), missed(-n * radius), tier.pick(1e-10, 1e-3)).accepted();
        exact("planted: n off by 1e-3", missed(-1.001 * n * radius), tier.pick(1e-10, 1e-3)).rejected();
    }
}

#[test]
fn a_plane_mirror_shows_the_source_behind_it() {
    for tier in tiers("plane mirror") {
        let normal = tilted(0.3);
        let foot = DVec3::new(1.0, -2.0, 10.0);
        let bench = Bench::new()
            .cone(DVec3::ZERO, DVec3::Z, 20.0)
            .mirror("mirror", towards(foot, normal), plane(), 1.0)
            .database("screen", at(0.0, 0.0, -5.0), 100.0, true);
        // The mirror image 2 (foot . normal) normal of the origin.
        let image = 2.0 * foot.dot(normal) * normal;
        let pairs = rows(&bench.trace(&tier, 1000), "screen")
            .into_iter()
            .map(|row| ((row.position - image).cross(row.direction).length(), 0.0));
        exact(&tier.name("plane mirror: image"), pairs, tier.pick(1e-12, 2e-5)).accepted();
    }
}

#[test]
fn a_corner_cube_returns_every_ray_antiparallel() {
    // Reflection at three perpendicular planes is the point reflection -1, whatever their common orientation.
    for tier in tiers("corner cube") {
        let own = turned(DVec3::new(3.0, -4.0, 5.0), 0.3, 0.5, 0.7);
        let quarter = std::f64::consts::FRAC_PI_2;
        let bench = Bench::new()
            .within(own)
            .cone(DVec3::new(5.0, 6.0, 7.0), -DVec3::ONE.normalize(), 30.0)
            .mirror("floor", at(0.0, 0.0, 0.0), plane(), 1.0)
            .mirror("side", turned(DVec3::ZERO, quarter, 0.0, 0.0), plane(), 1.0)
            .mirror("wall", turned(DVec3::ZERO, 0.0, quarter, 0.0), plane(), 1.0)
            .record_paths();
        let paths = bench.trace(&tier, 1000).ray_paths.unwrap();
        let (born, escaped) = (path_events(&paths, "birth", ""), path_events(&paths, "death", "escaped"));
        assert_eq!((born.len(), escaped.len()), (1000, 1000));
        let pairs = born.iter().zip(&escaped).map(|(a, b)| ((a.1 + b.1).length(), 0.0));
        exact(&tier.name("corner cube"), pairs, tier.pick(1e-12, 1e-6)).accepted();
    }
}

#[test]
fn two_mirrors_turn_a_ray_by_twice_their_angle() {
    // Two reflections at planes of angle alpha rotate by 2 alpha about their edge; the y component stays.
    let alpha = 0.5f64;
    for tier in tiers("two mirrors") {
        let d = DVec3::new(-1.0, 0.2, -0.1).normalize();
        // The first plane is z = 0, met from above; the second is turned by alpha about y.
        let first = DVec3::new(6.0, 0.0, 0.0);
        let bench = Bench::new()
            .pencil(first - 0.5 * d, d, json!({}))
            .mirror("first", at(0.0, 0.0, 0.0), plane(), 1.0)
            .mirror("second", turned(DVec3::ZERO, 0.0, -alpha, 0.0), plane(), 1.0)
            .max_depth(2)
            .record_paths();
        let paths = bench.trace(&tier, 1).ray_paths.unwrap();
        assert_eq!(path_events(&paths, "hit", "first").len(), 1);
        assert_eq!(path_events(&paths, "hit", "second").len(), 1);
        let (_, out) = path_events(&paths, "death", "")[0];
        let expected = DMat3::from_rotation_y(-2.0 * alpha) * d;
        exact(&tier.name("two mirrors"), [((out - expected).length(), 0.0)], tier.pick(1e-12, 1e-6))
            .accepted();
    }
}

#[test]
fn a_right_angle_cone_returns_a_ray_along_its_axis() {
    // A cone whose wall stands at 45 degrees turns a ray parallel to its axis by 90 degrees, and again on the far wall.
    for tier in tiers("axicon") {
        let cone =
            json!({ "type": "frustum", "r_front": 1.0, "r_back": 11.0, "z_front": 0.0, "z_back": 10.0 });
        let direction = DVec3::new(FRAC_1_SQRT_2, FRAC_1_SQRT_2, 0.0);
        let bench = Bench::new()
            .pencil(4.0 * direction + 20.0 * DVec3::Z, -DVec3::Z, json!({}))
            .mirror("axicon", at(0.0, 0.0, 0.0), cone, 1.0)
            .database("screen", at(0.0, 0.0, 30.0), 100.0, true);
        let row = rows(&bench.trace(&tier, 1), "screen")[0];
        // Back along +z, on the other side of the axis at the same distance.
        let pairs = [
            ((row.direction - DVec3::Z).length(), 0.0),
            ((row.position - DVec3::new(-4.0 * direction.x, -4.0 * direction.y, 30.0)).length(), 0.0),
        ];
        exact(&tier.name("right-angle cone"), pairs, tier.pick(1e-12, 2e-5)).accepted();
    }
}
