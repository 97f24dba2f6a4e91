//! From sums to results and files, on scenes and tallies built by hand, and against numbers that Optiland reported.

// Clippy's exemption of tests does not reach the helpers that tests share.
#![allow(clippy::unwrap_used, clippy::panic)]

use std::path::Path;

use approx::assert_relative_eq;
use glam::{DMat3, DVec3};
use nsq_gpu::Error;
use nsq_gpu::model::{
    Detector, DetectorKind, FarField, Frame, Interaction, Outline, PixelGrid, Point, RayDatabase, Sampling,
    SceneIr, Shape, Source, SourceKind, Spectral, Spectrum, Splat, Surface,
};
use nsq_gpu::result::output::{REPORT, check, file_names, write_all};
use nsq_gpu::result::report::{Files, Report};
use nsq_gpu::result::{
    DetectorData, DetectorTally, FluxSum, PathEvent, PathEventKind, RayRow, RaySpan, RaySpans, RunInfo,
    SurfaceTally, Tally, TraceResult,
};
use serde_json::Value;

const WEIGHT: u128 = 1 << 52;

fn frame(z: f64) -> Frame {
    Frame { origin: DVec3::new(0.0, 0.0, z), rotation: DMat3::IDENTITY }
}

fn surface(name: &str, interaction: Interaction) -> Surface {
    let shape = Shape::Plane(Outline::Infinite);
    Surface {
        name: name.into(),
        frame: frame(5.0),
        shape,
        interaction,
        coating: None,
        scatter: None,
        front: 0,
        back: 0,
    }
}

fn grid(width: f64, height: f64, num_pixels_x: u32, num_pixels_y: u32) -> PixelGrid {
    PixelGrid { width, height, num_pixels_x, num_pixels_y, splat: Splat::Hard }
}

fn detector(name: &str, kind: DetectorKind, absorb: bool) -> Detector {
    Detector { name: name.into(), frame: frame(10.0), kind, absorb }
}

fn scene(total_flux: f64, surfaces: Vec<Surface>, detectors: Vec<Detector>) -> SceneIr {
    let source = Source {
        name: "lamp".into(),
        frame: frame(0.0),
        kind: SourceKind::Point(Point { half_angle: 0.7 }),
        total_flux,
        spectrum: Spectrum { wavelengths: vec![0, 1], cdf: vec![0.25, 1.0] },
        medium: SceneIr::VACUUM,
    };
    SceneIr {
        wavelengths: vec![0.45, 0.62],
        media: Vec::new(),
        surfaces,
        meshes: vec![],
        sources: vec![source],
        detectors,
        sampling: Sampling::default(),
        scatter_sampling: Vec::new(),
        allowed: Default::default(),
    }
}

fn run(num_rays: u64) -> RunInfo {
    RunInfo {
        num_rays,
        seed: 7,
        adapter: "test adapter".into(),
        driver: "test driver".into(),
        trace_time_sec: 0.5,
        ..RunInfo::default()
    }
}

fn flux_sum(count: u64, weights: u128) -> FluxSum {
    FluxSum { count, quanta: weights * WEIGHT }
}

fn row(ray_id: u64, bounce: u32, weight: f64) -> RayRow {
    let position = [0.1 * ray_id as f64, -1.0, 10.0];
    RayRow { ray_id, bounce, wavelength: (ray_id % 2) as u32, position, direction: [0.0, 0.0, 1.0], weight }
}

/// A scene with one detector of each kind and one surface of each kind, and a tally of 1000 rays whose books close.
fn everything() -> (SceneIr, Tally) {
    let surfaces = vec![
        surface("stop", Interaction::Absorbing),
        surface("mirror", Interaction::Reflective { reflectance: vec![0.5, 0.5] }),
        surface("L1.front", Interaction::Refractive),
    ];
    let edges = vec![0.4, 0.5, 0.7];
    let detectors = vec![
        detector("map", DetectorKind::Irradiance(grid(4.0, 2.0, 4, 2)), true),
        detector(
            "colours",
            DetectorKind::Spectral(Spectral { grid: grid(2.0, 2.0, 2, 1), wavelength_edges: edges }),
            false,
        ),
        detector("sky", DetectorKind::FarField(FarField { num_theta: 3, num_phi: 4, sphere: false }), true),
        detector(
            "rays",
            DetectorKind::RayDatabase(RayDatabase { width: 2.0, height: 2.0, max_rays: Some(2) }),
            true,
        ),
    ];
    let ir = scene(2.0, surfaces, detectors);
    let mut tally = Tally::zeros(&ir);
    tally.launched = flux_sum(1000, 1000);
    (tally.detectors[0].quanta[6], tally.detectors[0].hits[6]) = (300 * WEIGHT, 300);
    (tally.detectors[1].quanta[3], tally.detectors[1].hits[3]) = (50 * WEIGHT, 50);
    (tally.detectors[2].quanta[5], tally.detectors[2].hits[5]) = (100 * WEIGHT, 100);
    tally.detectors[3].recorded = flux_sum(3, 3);
    tally.detectors[3].rows = vec![row(9, 2, 1.0), row(3, 1, 0.5), row(3, 4, 1.5)];
    tally.surfaces[0] =
        SurfaceTally { reached: true, absorbed: flux_sum(200, 200), ..SurfaceTally::default() };
    tally.surfaces[1] = SurfaceTally { reached: true, absorbed: flux_sum(80, 40), ..SurfaceTally::default() };
    tally.bulk = flux_sum(60, 10);
    tally.escaped = flux_sum(310, 310);
    tally.depth_killed = flux_sum(20, 20);
    tally.roulette_loss = flux_sum(40, 7);
    tally.roulette_gain = flux_sum(4, 5);
    tally.importance_loss = flux_sum(90, 30);
    tally.importance_gain = flux_sum(10, 15);
    tally.coating = flux_sum(6, 5);
    tally.bsdf_loss = flux_sum(7, 8);
    tally.bsdf_gain = flux_sum(3, 13);
    (ir, tally)
}

fn result_of_everything() -> TraceResult {
    let (ir, tally) = everything();
    TraceResult::new(&ir, &run(1000), &tally).unwrap()
}

#[test]
fn sums_become_the_fields_of_a_simulation_result() {
    let result = result_of_everything();
    // One unit of weight is 2 W / 1000.
    assert_eq!(result.num_rays_total, 1000);
    assert_eq!(result.num_rays_absorbed, 200);
    assert_eq!(result.num_rays_escaped, 310);
    assert_eq!(result.num_rays_flux_killed, 40);
    assert_eq!(result.num_rays_depth_killed, 20);
    assert_eq!(result.total_flux_in, 2.0);
    assert_eq!(result.total_flux_absorbed, 0.4);
    assert_eq!(result.total_flux_bulk_absorbed, 0.02);
    assert_eq!(result.total_flux_escaped, 0.62);
    assert_relative_eq!(result.total_flux_lost, 0.054);
    assert_eq!(result.total_flux_tapped, 0.1);
    // 300 + 50 + 100 rays, and the two rows kept of three: weights 1.5 and 1.
    assert_relative_eq!(result.total_flux_detected, 0.002 * 452.5);
    let unaccounted: f64 = 1000.0 - 402.5 - 200.0 - 10.0 - 310.0 - 27.0;
    assert_relative_eq!(result.flux_conservation_error, unaccounted / 1000.0, epsilon = 1e-12);
}

#[test]
fn the_ledger_closes_whatever_optilands_formula_says() {
    let result = result_of_everything();
    let ledger = &result.ledger;
    assert_eq!(ledger.imbalance_quanta, 0);
    assert!(ledger.closes());
    assert_eq!(ledger.detected.quanta, 403 * WEIGHT, "all rays, also the one that the database dropped");
    assert_eq!(ledger.tapped.quanta, 50 * WEIGHT);
    assert_eq!(ledger.surface.quanta, 40 * WEIGHT);
    assert_eq!(ledger.surface.flux, 0.08);
    assert!(result.report().contains("ledger closes: 0 quanta of 4503599627370496000"));
}

#[test]
fn a_planted_imbalance_is_reported_in_capitals() {
    for (extra, sign) in [(3, "-3"), (-2, "2")] {
        let (ir, mut tally) = everything();
        tally.escaped.quanta = tally.escaped.quanta.checked_add_signed(extra).unwrap();
        let result = TraceResult::new(&ir, &run(1000), &tally).unwrap();
        assert_eq!(result.ledger.imbalance_quanta, -extra);
        assert!(!result.ledger.closes());
        let warning = &result.diagnostics.warnings[0];
        assert!(warning.starts_with(&format!("THE LEDGER DOES NOT CLOSE: {sign} quanta")), "{warning}");
        assert!(result.report().contains("LEDGER DOES NOT CLOSE"));
        let json: Value = serde_json::from_str(&Report::new(&result, &Files::default()).to_json()).unwrap();
        assert_eq!(json["ledger"]["imbalance_quanta"], sign);
    }
}

#[test]
fn invalid_deposits_and_missing_rays_are_reported_in_capitals() {
    let (ir, mut tally) = everything();
    tally.invalid_deposits = 4;
    let result = TraceResult::new(&ir, &run(1001), &tally).unwrap();
    assert!(result.diagnostics.warnings[0].starts_with("INVALID DEPOSITS: 4"));
    assert!(result.diagnostics.warnings[1].starts_with("RAYS ARE MISSING: 1,000 launched, 1,001 requested"));
    assert!(!result.ledger.closes());
}

#[test]
fn a_partial_trace_is_scaled_to_all_that_the_sources_emit() {
    let (ir, tally) = everything();
    let result = TraceResult::new(&ir, &RunInfo { partial: true, ..run(4000) }, &tally).unwrap();
    assert_eq!(result.total_flux_in, 2.0);
    assert_eq!(result.num_rays_total, 1000);
    assert_eq!(result.detector("map").unwrap().total_flux, 0.6);
    assert!(result.diagnostics.warnings[0].starts_with("partial result: 1,000 of 4,000 rays"));
}

#[test]
fn a_tally_of_another_scene_is_refused() {
    let (ir, mut tally) = everything();
    tally.detectors[0].quanta.pop();
    assert!(matches!(TraceResult::new(&ir, &run(1000), &tally), Err(Error::Internal(_))));
    let (_, mut tally) = everything();
    tally.surfaces.pop();
    assert!(matches!(TraceResult::new(&ir, &run(1000), &tally), Err(Error::Internal(_))));
}

#[test]
fn maps_lie_as_the_tally_orders_them() {
    let result = result_of_everything();
    let DetectorData::Irradiance(map) = &result.detector("map").unwrap().data else { panic!("kind") };
    // Cell 6 of (ny, nx) = (2, 4) is row 1, column 2; a pixel is 1 mm by 1 mm.
    assert_eq!(map.irradiance[[1, 2]], 0.6);
    assert_eq!(map.irradiance.sum(), 0.6);
    assert_eq!(map.hits[[1, 2]], 300);
    assert_eq!(map.x_coords.to_vec(), [-1.5, -0.5, 0.5, 1.5]);
    assert_eq!(map.y_coords.to_vec(), [-0.5, 0.5]);
    let DetectorData::Spectral(map) = &result.detector("colours").unwrap().data else { panic!("kind") };
    // Cell 3 of (1, 2, 2) is column 1, bin 1; a pixel is 1 mm by 2 mm.
    assert_eq!(map.pixels.irradiance[[0, 1, 1]], 0.05);
    assert_eq!(map.spectrum.to_vec(), [0.0, 0.1]);
    assert_eq!(map.broadband()[[0, 1]], 0.05);
}

#[test]
fn a_ray_database_keeps_the_last_rows_in_an_order_that_batches_do_not_change() {
    let (ir, mut tally) = everything();
    let one = TraceResult::new(&ir, &run(1000), &tally).unwrap();
    tally.detectors[3].rows.reverse();
    let other = TraceResult::new(&ir, &run(1000), &tally).unwrap();
    assert_eq!(one, other);
    let detector = one.detector("rays").unwrap();
    let DetectorData::RayDatabase(rays) = &detector.data else { panic!("kind") };
    let rays = rays.columns().unwrap();
    assert_eq!(rays.ray_id.to_vec(), [3, 9], "events 1 and 4 of ray 3, then ray 9: the first is dropped");
    assert_eq!(rays.flux.to_vec(), [0.003, 0.002]);
    assert_eq!(rays.wavelength.to_vec(), [0.62, 0.62]);
    assert_eq!(detector.num_rays_hit, 3);
    assert_relative_eq!(detector.total_flux, 0.005);
    assert_eq!(one.diagnostics.detectors[3].num_rays_hit, 0, "Optiland's database keeps no count");
    assert!(one.diagnostics.warnings.iter().any(|warning| warning.contains("kept the last 2 of 3 rays")));
}

#[test]
fn unreached_surfaces_and_thin_sampling_are_warned_about() {
    let result = result_of_everything();
    assert_eq!(result.diagnostics.unreached_geometry, ["L1.front"]);
    let warned = |words: &str| result.diagnostics.warnings.iter().any(|warning| warning.contains(words));
    assert!(warned("no ray hit 1 surface(s): L1.front"));
    // 10 % from 100 hits in a cell, of twelve.
    assert!(!warned("'sky' is undersampled"));
    assert!(!warned("'map' is undersampled"));
    assert!(warned("2 % of the launched flux ended at the depth limit"));
    assert!(!warned("no ray reached"));
}

/// Gives the sky three cells of so many hits.
fn few_hits(tally: &mut Tally, hits: [u64; 3]) {
    for (cell, hits) in (5..).zip(hits) {
        (tally.detectors[2].quanta[cell], tally.detectors[2].hits[cell]) = (u128::from(hits) * WEIGHT, hits);
    }
}

/// From six hits nothing is promised; what they tell is a bound: chi squared of 2 (6 + 1) degrees, 23.685 / 2 rays of 2 mW.
#[test]
fn a_map_of_six_hits_promises_nothing() {
    let (ir, mut tally) = everything();
    few_hits(&mut tally, [1, 2, 3]);
    let result = TraceResult::new(&ir, &run(1000), &tally).unwrap();
    let few = result.detectors[2].few_rays.unwrap();
    assert_eq!(few.rests_on, 6);
    assert_relative_eq!(few.upper_bound_95, 23.6848 / 2.0 * 2e-3, max_relative = 1e-4);
    let warnings = &result.diagnostics.warnings;
    let expected = "the flux of detector 'sky' rests on 6 rays. It is below 0.024 W, with 95 % confidence. Trace more rays; how many \
                    cannot be said yet";
    assert!(warnings.contains(&expected.to_string()), "{warnings:?}");
    assert!(result.diagnostics.grave.contains(&expected.to_string()));
    assert!(!warnings.iter().any(|warning| warning.contains("undersampled")), "{warnings:?}");
    assert!(result.report().contains("≤ 0.024"), "{}", result.report());
}

#[test]
fn a_map_of_few_hits_says_what_it_takes() {
    let (ir, mut tally) = everything();
    few_hits(&mut tally, [2, 4, 6]);
    let diagnostics = TraceResult::new(&ir, &run(1000), &tally).unwrap().diagnostics;
    // (sqrt 2 + 2 + sqrt 6) / 12 is 49 %; 400 hits expected in each of three cells, for 4, would do but for the bias of roots.
    let expected = "detector 'sky' is undersampled: the standard errors of its cells add up to 49 % of what they hold, so that \
                    its map is mostly shot noise; about 100,000 rays would bring it to 5 %";
    assert!(diagnostics.warnings.contains(&expected.to_string()), "{:?}", diagnostics.warnings);
    assert!(diagnostics.grave.contains(&expected.to_string()), "{:?}", diagnostics.grave);
}

#[test]
fn light_that_the_depth_limit_took_is_reported_with_the_number_to_give() {
    let (mut ir, mut tally) = everything();
    let told = |ir: &SceneIr, tally: &Tally, max_depth: u32| {
        let run = RunInfo { max_depth, ..run(1000) };
        let grave = TraceResult::new(ir, &run, tally).unwrap().diagnostics.grave;
        grave.into_iter().find(|warning| warning.contains("depth limit")).unwrap_or_default()
    };
    assert_eq!(
        told(&ir, &tally, 16),
        "2 % of the launched flux ended at the depth limit of 16 events: paths with more events are missing; give \
         --max-depth 32, in Python NsqGpuBackend(max_depth=32)"
    );
    ir.surfaces.extend(std::iter::repeat_n(ir.surfaces[2].clone(), 20));
    tally.surfaces.extend(std::iter::repeat_n(tally.surfaces[2], 20));
    assert!(told(&ir, &tally, 16).contains("max_depth=44"), "twice a mirror and 21 refracting surfaces");
    assert!(told(&ir, &tally, 44).contains("max_depth=88"));
    // A dark detector may be dark for the little that is missing.
    tally.depth_killed = flux_sum(1, 0);
    tally.depth_killed.quanta = WEIGHT / 100;
    assert_eq!(told(&ir, &tally, 16), "");
    tally.detectors[0] = Tally::zeros(&ir).detectors[0].clone();
    assert!(told(&ir, &tally, 16).contains("missing, and map got no light; give --max-depth 44"));
    tally.depth_killed = flux_sum(0, 0);
    assert_eq!(told(&ir, &tally, 16), "");
}

#[test]
fn sources_without_a_ray_are_reported() {
    let (mut ir, mut tally) = everything();
    let source = ir.sources[0].clone();
    ir.sources = (0..12).map(|i| Source { name: format!("S{i}"), ..source.clone() }).collect();
    tally.rays += RaySpan { first: 0, count: 1000, source: 0 };
    tally.rays += RaySpan { first: 1000, count: 1, source: 11 };
    let told = |tally: &Tally, of_rays| {
        let run = RunInfo { of_rays, ..run(1000) };
        let grave = TraceResult::new(&ir, &run, tally).unwrap().diagnostics.grave;
        grave.into_iter().find(|warning| warning.contains("sources")).unwrap_or_default()
    };
    assert_eq!(
        told(&tally, None),
        "10 of 12 sources have no ray: S1, S2, S3, S4, S5, S6, S7, S8 and 2 more; their light is missing; launch at least \
         12 rays, and a thousand times as many for a result"
    );
    assert_eq!(told(&tally, Some(1_000_000)), "", "another part has them");
    (1..11).for_each(|source| tally.rays += RaySpan { first: 5000, count: 1, source });
    assert_eq!(told(&tally, None), "");
}

#[test]
fn a_detector_that_no_ray_reached_is_not_called_noisy() {
    let (ir, mut tally) = everything();
    tally.detectors[0] = Tally::zeros(&ir).detectors[0].clone();
    let name = &ir.detectors[0].name;
    let warnings = TraceResult::new(&ir, &run(1000), &tally).unwrap().diagnostics.warnings;
    let expected =
        format!("no ray reached 1 detector(s): {name}; check where they stand and how they are turned");
    assert!(warnings.contains(&expected), "{warnings:?}");
    assert!(
        !warnings.iter().any(|warning| warning.contains(&format!("'{name}' is undersampled"))),
        "{warnings:?}"
    );
}

// ---- against Optiland ----

/// The scene and the sums behind tests/data/result_oracle.json, which python/tools/result_oracle.py writes.
fn oracle() -> (Value, TraceResult) {
    let text = std::fs::read_to_string("tests/data/result_oracle.json").unwrap();
    let oracle: Value = serde_json::from_str(&text).unwrap();
    let surfaces = vec![
        surface("stop", Interaction::Absorbing),
        surface("spare", Interaction::Absorbing),
        surface("mirror", Interaction::Reflective { reflectance: vec![0.5, 0.5] }),
    ];
    let edges: Vec<f64> = (0..4).map(|edge| 0.4 + f64::from(edge) * ((0.7 - 0.4) / 3.0)).collect();
    let detectors = vec![
        detector("tap", DetectorKind::Irradiance(grid(8.0, 7.0, 6, 5)), false),
        detector(
            "spectral",
            DetectorKind::Spectral(Spectral { grid: grid(20.0, 19.0, 6, 5), wavelength_edges: edges }),
            true,
        ),
        detector("far", DetectorKind::FarField(FarField { num_theta: 9, num_phi: 8, sphere: false }), true),
        detector(
            "rays",
            DetectorKind::RayDatabase(RayDatabase { width: 25.0, height: 25.0, max_rays: Some(100) }),
            true,
        ),
    ];
    let ir = scene(oracle["result"]["total_flux_in"].as_f64().unwrap(), surfaces, detectors);
    let tally = oracle_tally(&ir, &oracle);
    let result = TraceResult::new(&ir, &run(2000), &tally).unwrap();
    (oracle, result)
}

fn oracle_tally(ir: &SceneIr, oracle: &Value) -> Tally {
    let halves = |name: &str| u128::from(oracle["half_units"][name].as_u64().unwrap()) * WEIGHT / 2;
    let count = |name: &str| oracle["result"][name].as_u64().unwrap();
    let mut tally = Tally::zeros(ir);
    tally.launched = flux_sum(2000, 2000);
    tally.escaped = FluxSum { count: count("num_rays_escaped"), quanta: halves("escaped") };
    tally.depth_killed = FluxSum { count: count("num_rays_depth_killed"), quanta: halves("depth") };
    let absorbed = FluxSum { count: count("num_rays_absorbed"), quanta: halves("stop") };
    tally.surfaces[0] = SurfaceTally { reached: true, absorbed, ..SurfaceTally::default() };
    tally.surfaces[2] = SurfaceTally {
        reached: true,
        absorbed: FluxSum { count: 0, quanta: halves("mirror") },
        ..SurfaceTally::default()
    };
    for (index, name) in ["tap", "spectral", "far"].into_iter().enumerate() {
        let cells = oracle["half_units"][name].as_array().unwrap();
        tally.detectors[index].quanta =
            cells.iter().map(|cell| u128::from(cell.as_u64().unwrap()) * WEIGHT / 2).collect();
        // The reference counts rays per detector, not per cell.
        tally.detectors[index].hits[0] =
            oracle["diagnostics"]["detectors"][index]["num_rays_hit"].as_u64().unwrap();
    }
    let recorded = oracle["rays_recorded"].as_u64().unwrap();
    tally.detectors[3].recorded = FluxSum { count: recorded, quanta: halves("rays") };
    tally.detectors[3].rows = (0..recorded).map(|ray_id| row(ray_id, 0, 1.0)).collect();
    tally
}

fn assert_floats<'a>(ours: impl IntoIterator<Item = &'a f64>, theirs: &Value, tolerance: f64) {
    fn flatten<'a>(value: &'a Value, numbers: &mut Vec<&'a Value>) {
        match value.as_array() {
            Some(items) => items.iter().for_each(|item| flatten(item, numbers)),
            None => numbers.push(value),
        }
    }
    let mut expected = Vec::new();
    flatten(theirs, &mut expected);
    let ours: Vec<f64> = ours.into_iter().copied().collect();
    assert_eq!(ours.len(), expected.len());
    for (our, their) in ours.iter().zip(expected) {
        assert_relative_eq!(*our, their.as_f64().unwrap(), max_relative = tolerance);
    }
}

#[test]
fn fields_and_diagnostics_are_optilands() {
    let (oracle, result) = oracle();
    let report = serde_json::to_value(Report::new(&result, &Files::default())).unwrap();
    for (name, expected) in oracle["result"].as_object().unwrap() {
        assert_relative_eq!(
            report[name].as_f64().unwrap(),
            expected.as_f64().unwrap(),
            max_relative = 1e-12,
            epsilon = 1e-12
        );
    }
    assert!(result.ledger.closes(), "the mirror's loss has a bin here: {:?}", result.ledger);
    let ours = &report["diagnostics"];
    for (name, expected) in oracle["diagnostics"].as_object().unwrap() {
        match expected.as_f64().filter(|_| !expected.is_u64()) {
            Some(expected) => {
                assert_relative_eq!(
                    ours[name].as_f64().unwrap(),
                    expected,
                    max_relative = 1e-12,
                    epsilon = 1e-12
                )
            }
            None => assert_eq!(&ours[name], expected, "{name}"),
        }
    }
    // Optiland takes what the mirror absorbs for an error of the books, which close here.
    assert!(ours["flux_conservation_error"].as_f64().unwrap() > 0.05);
    let warnings = &result.diagnostics.warnings;
    assert!(!warnings.iter().any(|warning| warning.contains("conservation")), "{warnings:?}");
}

#[test]
fn maps_are_optilands() {
    let (oracle, result) = oracle();
    let data = |name: &str| &result.detector(name).unwrap().data;
    let DetectorData::Irradiance(tap) = data("tap") else { panic!("kind") };
    assert_floats(&tap.irradiance, &oracle["tap"]["irradiance"], 1e-12);
    assert_floats(&tap.x_coords, &oracle["tap"]["x_coords"], 0.0);
    assert_floats(&tap.y_coords, &oracle["tap"]["y_coords"], 0.0);
    let DetectorData::Spectral(spectral) = data("spectral") else { panic!("kind") };
    assert_floats(&spectral.pixels.irradiance, &oracle["spectral"]["irradiance"], 1e-12);
    assert_floats(&spectral.pixels.x_coords, &oracle["spectral"]["x_coords"], 0.0);
    assert_floats(&spectral.pixels.y_coords, &oracle["spectral"]["y_coords"], 0.0);
    assert_floats(&spectral.wavelengths, &oracle["spectral"]["wavelengths"], 1e-15);
    let DetectorData::FarField(far) = data("far") else { panic!("kind") };
    assert_floats(&far.intensity, &oracle["far"]["intensity"], 1e-12);
    assert_floats(&far.theta, &oracle["far"]["theta"], 0.0);
    assert_floats(&far.phi, &oracle["far"]["phi"], 0.0);
    let DetectorData::RayDatabase(rays) = data("rays") else { panic!("kind") };
    assert_floats(&rays.columns().unwrap().flux, &oracle["rays"]["flux"], 1e-12);
}

// ---- files ----

fn listing(folder: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(folder).unwrap();
    let mut names: Vec<String> =
        entries.map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    names
}

fn with_paths() -> TraceResult {
    let (ir, mut tally) = everything();
    let event = |ray_id, bounce, kind| PathEvent { ray: row(ray_id, bounce, 1.0), kind };
    tally.paths = vec![
        event(5, 1, PathEventKind::Escaped),
        event(2, 1, PathEventKind::Detector(0)),
        event(5, 0, PathEventKind::Surface(1)),
        event(5, 0, PathEventKind::Birth(0)),
        event(2, 0, PathEventKind::Birth(0)),
    ];
    TraceResult::new(&ir, &run(1000), &tally).unwrap()
}

#[test]
fn a_folder_gets_every_file_and_nothing_else() {
    let parent = tempfile::tempdir().unwrap();
    let folder = parent.path().join("new").join("results");
    let paths = write_all(&folder, &with_paths()).unwrap();
    let expected = [
        "colours.npz",
        "colours.png",
        "map.npz",
        "map.png",
        "ray_paths.npz",
        "rays.npz",
        "rays.png",
        "report.json",
        "sky.npz",
        "sky.png",
    ];
    assert_eq!(listing(&folder), expected);
    assert_eq!(listing(parent.path()), ["new"], "nothing is left beside the folder");
    assert_eq!(paths.len(), expected.len());
    assert!(paths.iter().all(|path| path.is_file()));
    let text = std::fs::read_to_string(folder.join(REPORT)).unwrap();
    let report: Value = serde_json::from_str(&text).unwrap();
    assert_eq!(report["detectors"]["map"]["file"], "map.npz");
    assert_eq!(report["detectors"]["rays"]["num_rays_stored"], 2);
    assert_eq!(report["ray_paths"], "ray_paths.npz");
    assert_eq!(report["rays_per_sec"], 2000.0);
    assert_eq!(report["surfaces"][1]["total_flux_absorbed"], 0.08);
}

#[test]
fn equal_results_are_equal_files() {
    let parent = tempfile::tempdir().unwrap();
    let (one, two) = (parent.path().join("one"), parent.path().join("two"));
    write_all(&one, &with_paths()).unwrap();
    std::thread::sleep(std::time::Duration::from_millis(2100)); // A time in a zip archive has steps of two seconds.
    write_all(&two, &with_paths()).unwrap();
    for name in listing(&one) {
        let bytes = |folder: &Path| std::fs::read(folder.join(&name)).unwrap();
        assert!(bytes(&one) == bytes(&two), "{name}");
    }
}

#[test]
fn an_existing_folder_keeps_what_is_not_ours() {
    let folder = tempfile::tempdir().unwrap();
    let (notes, data) = (folder.path().join("notes.txt"), folder.path().join("data"));
    std::fs::write(&notes, "mine").unwrap();
    write_all(folder.path(), &with_paths()).unwrap();
    write_all(folder.path(), &result_of_everything()).unwrap();
    assert_eq!(std::fs::read_to_string(&notes).unwrap(), "mine");
    // A folder cannot be linked into another one: the files change places one by one.
    std::fs::create_dir(&data).unwrap();
    std::fs::write(data.join("more.txt"), "mine, too").unwrap();
    write_all(folder.path(), &with_paths()).unwrap();
    assert_eq!(TraceResult::read(folder.path()).unwrap().detectors.len(), 4);
    assert_eq!(std::fs::read_to_string(&notes).unwrap(), "mine");
    assert_eq!(std::fs::read_to_string(data.join("more.txt")).unwrap(), "mine, too");
    assert!(listing(folder.path()).iter().all(|name| !name.starts_with('.')));
}

/// Permissions of the folder stay, and a link to it stays one.
#[cfg(unix)]
#[test]
fn an_existing_folder_stays_what_it_was() {
    use std::os::unix::fs::PermissionsExt;
    let parent = tempfile::tempdir().unwrap();
    let (folder, link) = (parent.path().join("results"), parent.path().join("link"));
    std::fs::create_dir(&folder).unwrap();
    std::fs::set_permissions(&folder, PermissionsExt::from_mode(0o2750)).unwrap();
    std::os::unix::fs::symlink(&folder, &link).unwrap();
    std::os::unix::fs::symlink("/nowhere", folder.join("dangling")).unwrap();
    write_all(&link, &with_paths()).unwrap();
    assert!(link.is_symlink() && folder.join(REPORT).is_file());
    assert_eq!(folder.metadata().unwrap().permissions().mode() & 0o7777, 0o2750);
    assert_eq!(std::fs::read_link(folder.join("dangling")).unwrap(), Path::new("/nowhere"));
    assert_eq!(listing(parent.path()), ["link", "results"]);
}

#[test]
fn files_that_this_program_has_not_written_are_not_replaced() {
    let refused = |name: &str, plant: &dyn Fn(&Path)| {
        let folder = tempfile::tempdir().unwrap();
        plant(&folder.path().join(name));
        let before = contents(folder.path());
        for is_told_before in [true, false] {
            let error = if is_told_before {
                let names = ["colours", "map", "rays", "sky"].into_iter();
                check(folder.path(), &file_names(names, Some(&[]), true, false, false)).unwrap_err()
            } else {
                write_all(folder.path(), &with_paths()).unwrap_err()
            };
            assert!(matches!(&error, Error::File { path, .. } if path.ends_with(name)), "{name}: {error}");
            assert!(contents(folder.path()) == before, "{name}: something changed");
        }
    };
    let mine = |path: &Path| std::fs::write(path, "mine").unwrap();
    for name in [REPORT, "map.npz", "sky.png", "ray_paths.npz"] {
        refused(name, &mine);
        refused(name, &|path| std::fs::create_dir(path).unwrap());
        #[cfg(unix)]
        refused(name, &|path| std::os::unix::fs::symlink("/nowhere", path).unwrap());
    }
    // Files that somebody has worked on since are no longer this program's, the report included.
    for name in [REPORT, "map.npz", "sky.png"] {
        refused(name, &|path| {
            write_all(path.parent().unwrap(), &with_paths()).unwrap();
            let mut bytes = std::fs::read(path).unwrap();
            *bytes.last_mut().unwrap() ^= 1;
            std::fs::write(path, bytes).unwrap();
        });
    }
}

fn contents(folder: &Path) -> Vec<(String, Option<Vec<u8>>)> {
    listing(folder).into_iter().map(|name| (name.clone(), std::fs::read(folder.join(name)).ok())).collect()
}

#[test]
fn files_of_the_result_before_go_and_others_stay() {
    let parent = tempfile::tempdir().unwrap();
    let folder = parent.path().join("results");
    write_all(&folder, &with_paths()).unwrap();
    std::fs::write(folder.join("notes.npz"), "mine").unwrap();
    std::fs::write(parent.path().join("elsewhere.npz"), "mine").unwrap();
    let mut report: Value = serde_json::from_slice(&std::fs::read(folder.join(REPORT)).unwrap()).unwrap();
    // As older versions wrote it.
    report.as_object_mut().unwrap().remove("meta").unwrap();
    report["detectors"]["other"] = report["detectors"]["map"].clone();
    report["detectors"]["other"]["file"] = "../elsewhere.npz".into();
    std::fs::write(folder.join(REPORT), report.to_string()).unwrap();
    let mut smaller = result_of_everything();
    smaller.detectors.retain(|detector| detector.name == "map");
    nsq_gpu::result::output::write(
        &folder,
        &smaller,
        &nsq_gpu::result::output::Extras { pictures: None, tally: None },
    )
    .unwrap();
    assert_eq!(listing(&folder), ["map.npz", "notes.npz", "report.json"]);
    assert_eq!(listing(parent.path()), ["elsewhere.npz", "results"]);
}

#[test]
fn a_failure_leaves_an_existing_folder_as_it_was() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("notes.npz"), "old").unwrap();
    std::fs::create_dir(folder.path().join("sky.png")).unwrap();
    let error = write_all(folder.path(), &result_of_everything()).unwrap_err();
    assert_eq!(error, Error::file(folder.path().join("sky.png"), "is a folder"));
    assert_eq!(listing(folder.path()), ["notes.npz", "sky.png"]);
    assert_eq!(std::fs::read_to_string(folder.path().join("notes.npz")).unwrap(), "old");
}

#[test]
fn a_folder_that_cannot_be_made_leaves_nothing() {
    let parent = tempfile::tempdir().unwrap();
    let file = parent.path().join("file");
    std::fs::write(&file, "mine").unwrap();
    let error = write_all(&file.join("results"), &result_of_everything()).unwrap_err();
    assert_eq!(error, Error::file(&file, "is not a folder"));
    assert_eq!(listing(parent.path()), ["file"]);
    assert_eq!(std::fs::read_to_string(&file).unwrap(), "mine");
}

#[test]
fn rows_of_rays_beyond_2_40_keep_their_order() {
    let (ir, mut tally) = everything();
    let ids = [(1_u64 << 40) - 2, (1 << 40) - 1, 1 << 40, (1 << 40) + 1];
    tally.detectors[3].rows = ids.iter().rev().map(|&id| row(id, 0, 1.0)).collect();
    tally.paths = ids
        .iter()
        .rev()
        .map(|&id| PathEvent { ray: row(id, 0, 1.0), kind: PathEventKind::Birth(0) })
        .collect();
    let result = TraceResult::new(&ir, &run(1000), &tally).unwrap();
    let paths = result.ray_paths.unwrap().columns().unwrap();
    assert_eq!(paths.ray_id.to_vec(), ids.map(|id| id as i64));
    tally.sort_rows(&ir);
    let sorted: Vec<u64> = tally.detectors[3].rows.iter().map(|row| row.ray_id).collect();
    assert_eq!(sorted, ids);
}

/// 300 flipped bits a file: each is reported, or changes nothing that is read.
#[test]
fn flipped_bits_are_reported() {
    let folder = tempfile::tempdir().unwrap();
    let result = with_paths();
    write_all(folder.path(), &result).unwrap();
    let read = TraceResult::read(folder.path()).unwrap();
    let mut state = 1_u64;
    for name in [REPORT, "map.npz", "colours.npz", "sky.npz", "rays.npz"] {
        let path = folder.path().join(name);
        let bytes = std::fs::read(&path).unwrap();
        for _ in 0..300 {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            let (place, bit) = ((state >> 33) as usize % bytes.len(), state >> 61);
            let mut damaged = bytes.clone();
            damaged[place] ^= 1 << bit;
            std::fs::write(&path, damaged).unwrap();
            match TraceResult::read(folder.path()) {
                Err(Error::File { path: named, .. }) => assert_eq!(named, path),
                Err(other) => panic!("{name}: {other}"),
                // The name of the hashes' own field was hit, and it is told that there are none.
                Ok(mut other) => {
                    assert!(other.run.is_unchecked, "{name}: bit {bit} of byte {place}");
                    other.run.is_unchecked = false;
                    assert!(other == read, "{name}: bit {bit} of byte {place}");
                }
            }
        }
        std::fs::write(&path, bytes).unwrap();
    }
    assert!(TraceResult::read(folder.path()).unwrap() == read);
}

/// Files of one trace beside the report of another.
#[test]
fn a_mixture_of_two_results_is_reported() {
    let parent = tempfile::tempdir().unwrap();
    let (one, two) = (parent.path().join("one"), parent.path().join("two"));
    let (ir, mut tally) = everything();
    write_all(&one, &TraceResult::new(&ir, &run(1000), &tally).unwrap()).unwrap();
    tally.detectors[0].quanta[0] += 1;
    write_all(&two, &TraceResult::new(&ir, &run(1000), &tally).unwrap()).unwrap();
    std::fs::copy(two.join("map.npz"), one.join("map.npz")).unwrap();
    let error = TraceResult::read(&one).unwrap_err();
    assert!(
        matches!(&error, Error::File { path, problem } if path.ends_with("map.npz") && problem.contains("another trace"))
    );
}

/// Without hashes, as older versions wrote results, an archive that claims gigabytes is refused by its claims.
#[test]
fn archives_that_claim_more_than_they_hold_are_refused() {
    use std::io::Write;
    let folder = tempfile::tempdir().unwrap();
    write_all(folder.path(), &result_of_everything()).unwrap();
    let path = folder.path().join(REPORT);
    let mut report: Value = serde_json::from_slice(&std::fs::read(&path).unwrap()).unwrap();
    report.as_object_mut().unwrap().remove("meta").unwrap();
    std::fs::write(&path, report.to_string()).unwrap();
    assert!(TraceResult::read(folder.path()).unwrap().run.is_unchecked, "old results still open");
    let member = |shape: &str| {
        let dictionary = format!("{{'descr': '<f8', 'fortran_order': False, 'shape': {shape}, }}");
        let header = format!("{dictionary:<117}\n");
        let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
        bytes.extend((header.len() as u16).to_le_bytes());
        bytes.extend(header.as_bytes());
        bytes.extend([0; 64]);
        let mut archive = zip::ZipWriter::new(std::io::Cursor::new(Vec::new()));
        let stored =
            zip::write::SimpleFileOptions::default().compression_method(zip::CompressionMethod::Stored);
        archive.start_file("irradiance.npy", stored).unwrap();
        archive.write_all(&bytes).unwrap();
        archive.finish().unwrap().into_inner()
    };
    let problem = |bytes: &[u8]| {
        std::fs::write(folder.path().join("map.npz"), bytes).unwrap();
        TraceResult::read(folder.path()).unwrap_err().to_string()
    };
    for shape in ["(1099511627776, 8)", "(4294967296, 4294967296, 4294967296)"] {
        assert!(problem(&member(shape)).contains("claims more than"), "{}", problem(&member(shape)));
    }
    // Sizes of the unpacked member, in its own header and in the directory.
    let mut bytes = member("(2, 4)");
    let size = (64 + 128_u32).to_le_bytes();
    let places: Vec<usize> = (0..bytes.len() - 4).filter(|&at| bytes[at..at + 4] == size).collect();
    places.into_iter().for_each(|at| bytes[at..at + 4].copy_from_slice(&0x7FFF_0000_u32.to_le_bytes()));
    assert!(problem(&bytes).contains("would unpack to"), "{}", problem(&bytes));
}

#[test]
fn names_that_no_file_system_takes_become_safe_and_stay_distinct() {
    let names = ["a/b", "a b", "A_B", "..", "CON", "ray_paths", "Öl"];
    let kind = DetectorKind::Irradiance(grid(1.0, 1.0, 1, 1));
    let ir = scene(1.0, Vec::new(), names.map(|name| detector(name, kind.clone(), true)).into());
    let result = TraceResult::new(&ir, &run(0), &Tally::zeros(&ir)).unwrap();
    let folder = tempfile::tempdir().unwrap();
    write_all(folder.path(), &result).unwrap();
    let files: Vec<String> =
        listing(folder.path()).into_iter().filter(|name| name.ends_with(".npz")).collect();
    let expected = ["A_B_3.npz", "_...npz", "_CON.npz", "a_b.npz", "a_b_2.npz", "ray_paths_2.npz", "Öl.npz"];
    assert_eq!(files, expected);
}

mod npz {
    use super::*;
    use ndarray::{Array0, Array1, Array2, Array3};
    use ndarray_npy::NpzReader;
    use std::fs::File;

    fn open(folder: &Path, name: &str) -> NpzReader<File> {
        NpzReader::new(File::open(folder.join(name)).unwrap()).unwrap()
    }

    fn written() -> tempfile::TempDir {
        let folder = tempfile::tempdir().unwrap();
        write_all(folder.path(), &with_paths()).unwrap();
        folder
    }

    #[test]
    fn keys_shapes_and_types_are_optilands() {
        let folder = written();
        let mut map = open(folder.path(), "map.npz");
        assert_eq!(map.by_name::<_, _>("irradiance").map(|array: Array2<f64>| array.dim()).unwrap(), (2, 4));
        assert_eq!(map.by_name("x_coords").map(|array: Array1<f64>| array.len()).unwrap(), 4);
        assert_eq!(map.by_name("y_coords").map(|array: Array1<f64>| array.len()).unwrap(), 2);
        assert_eq!(map.by_name("total_flux").map(|array: Array0<f64>| array.into_scalar()).unwrap(), 0.6);
        assert_eq!(map.by_name("num_rays_hit").map(|array: Array0<i64>| array.into_scalar()).unwrap(), 300);
        assert_eq!(map.by_name("hits").map(|array: Array2<u64>| array.sum()).unwrap(), 300);
        let mut colours = open(folder.path(), "colours.npz");
        assert_eq!(colours.by_name("irradiance").map(|array: Array3<f64>| array.dim()).unwrap(), (1, 2, 2));
        assert_eq!(colours.by_name("hits").map(|array: Array3<u64>| array.dim()).unwrap(), (1, 2, 2));
        assert_eq!(
            colours.by_name("wavelengths").map(|array: Array1<f64>| array.to_vec()).unwrap(),
            [0.45, 0.6]
        );
        let mut sky = open(folder.path(), "sky.npz");
        assert_eq!(sky.by_name("intensity").map(|array: Array2<f64>| array.dim()).unwrap(), (3, 4));
        assert_eq!(
            sky.by_name("theta").map(|array: Array1<f64>| array.to_vec()).unwrap(),
            [15.0, 45.0, 75.0]
        );
        assert_eq!(sky.by_name("phi").map(|array: Array1<f64>| array.len()).unwrap(), 4);
        let mut rays = open(folder.path(), "rays.npz");
        for key in ["x", "y", "z", "L", "M", "N", "flux", "wavelength"] {
            assert_eq!(rays.by_name(key).map(|array: Array1<f64>| array.len()).unwrap(), 2, "{key}");
        }
    }

    #[test]
    fn paths_are_in_the_order_in_which_they_happened() {
        let folder = written();
        let mut paths = open(folder.path(), "ray_paths.npz");
        assert_eq!(
            paths.by_name("ray_id").map(|array: Array1<i64>| array.to_vec()).unwrap(),
            [2, 2, 5, 5, 5]
        );
        assert_eq!(
            paths.by_name("bounce").map(|array: Array1<i32>| array.to_vec()).unwrap(),
            [0, 1, 0, 0, 1]
        );
        let result = with_paths();
        let paths = result.ray_paths.as_ref().unwrap().columns().unwrap();
        assert_eq!(paths.event_type, ["birth", "hit", "birth", "hit", "death"]);
        assert_eq!(paths.component_name, ["lamp", "map", "lamp", "mirror", "escaped"]);
        assert_eq!(paths.flux.to_vec(), [0.002; 5]);
    }

    /// The one array that the reader above cannot read: `<U..` text, by its bytes.
    #[test]
    fn text_is_fixed_width_utf_32() {
        let folder = written();
        let bytes = std::fs::read(folder.path().join("ray_paths.npz")).unwrap();
        let find = |needle: &[u8]| bytes.windows(needle.len()).position(|window| window == needle);
        let header = b"{'descr': '<U5', 'fortran_order': False, 'shape': (5,), }";
        let at = find(header).expect("the header of event_type") - 10;
        let data = &bytes[at + 128..];
        assert_eq!(&bytes[at..at + 8], b"\x93NUMPY\x01\x00");
        let text: String = data[..5 * 4 * 5].chunks(4).map(|unit| char::from(unit[0])).collect();
        assert_eq!(text, "birthhit\0\0birthhit\0\0death");
        assert_eq!(bytes[at + 127], b'\n', "the data starts at a multiple of 64");
    }
}

mod pictures {
    use super::*;

    const TOP: [u8; 3] = [252, 255, 164];
    const HALF: [u8; 3] = [188, 55, 84];
    const ZERO: [u8; 3] = [0, 0, 4];

    struct Picture {
        width: usize,
        rgb: Vec<u8>,
    }

    impl Picture {
        fn read(path: &Path) -> Self {
            let file = std::io::BufReader::new(std::fs::File::open(path).unwrap());
            let mut reader = png::Decoder::new(file).read_info().unwrap();
            let mut rgb = vec![0; reader.output_buffer_size()];
            let info = reader.next_frame(&mut rgb).unwrap();
            assert_eq!((info.color_type, info.bit_depth), (png::ColorType::Rgb, png::BitDepth::Eight));
            Picture { width: info.width as usize, rgb }
        }

        fn height(&self) -> usize {
            self.rgb.len() / 3 / self.width
        }

        fn at(&self, x: usize, y: usize) -> [u8; 3] {
            let at = 3 * (y * self.width + x);
            [self.rgb[at], self.rgb[at + 1], self.rgb[at + 2]]
        }

        /// Where runs of a colour start and how long they are, along one row.
        fn runs(&self, y: usize, color: [u8; 3]) -> Vec<(usize, usize)> {
            let mut runs = Vec::new();
            let mut x = 0;
            while x < self.width {
                let length = (x..self.width).take_while(|&x| self.at(x, y) == color).count();
                if length > 0 {
                    runs.push((x, length));
                }
                x += length.max(1);
            }
            runs
        }
    }

    /// Draws a map of 4 x 2 pixels of 1 mm, of which only column 2 of row 1, in the upper half, has flux.
    fn map(quanta: u128) -> Picture {
        let kind = DetectorKind::Irradiance(grid(4.0, 2.0, 4, 2));
        let ir = scene(1.0, Vec::new(), vec![detector("map", kind, true)]);
        let mut tally = Tally::zeros(&ir);
        tally.detectors[0].quanta[6] = quanta;
        let result = TraceResult::new(&ir, &run(1), &tally).unwrap();
        let folder = tempfile::tempdir().unwrap();
        write_all(folder.path(), &result).unwrap();
        Picture::read(&folder.path().join("map.png"))
    }

    #[test]
    fn the_brightest_pixel_has_the_top_colour_and_y_points_up() {
        let picture = map(WEIGHT);
        // The map is 1200 x 600: each of its pixels 300 x 300.
        let row =
            (0..picture.height()).find(|&y| picture.runs(y, TOP).iter().any(|run| run.1 == 300)).unwrap();
        let last = (0..picture.height())
            .rev()
            .find(|&y| picture.runs(y, TOP).iter().any(|run| run.1 == 300))
            .unwrap();
        assert_eq!(last - row + 1, 300);
        let (left, _) = picture.runs(row, TOP)[0];
        assert_eq!(
            picture.runs(row, ZERO),
            [(left - 600, 600), (left + 300, 300)],
            "two pixels left, one right"
        );
        assert_eq!(picture.runs(last + 1, ZERO)[0], (left - 600, 1200), "the lower half is empty");
        assert_ne!(picture.at(left, row - 1), ZERO, "the map ends at its frame");
    }

    #[test]
    fn the_colour_bar_runs_from_the_top_colour_to_zero() {
        let picture = map(WEIGHT);
        let row = (0..picture.height()).find(|&y| picture.runs(y, TOP).len() == 2).unwrap();
        let (left, width) = picture.runs(row, TOP)[1];
        assert!(left > picture.runs(row, TOP)[0].0 + 600, "right of the map");
        assert!(width > 10);
        assert_eq!(picture.at(left, row + 599), ZERO);
        let middle = picture.at(left, row + 299);
        assert!(middle.iter().zip(HALF).all(|(ours, half)| ours.abs_diff(half) <= 2), "{middle:?}");
    }

    #[test]
    fn nothing_is_bright_where_no_ray_went() {
        let picture = map(0);
        let bright: usize =
            (0..picture.height()).map(|y| picture.runs(y, TOP).iter().map(|run| run.1).sum::<usize>()).sum();
        assert!(bright < 200, "only the upper end of the colour bar: {bright}");
    }

    #[test]
    fn every_kind_has_its_picture() {
        let folder = tempfile::tempdir().unwrap();
        write_all(folder.path(), &result_of_everything()).unwrap();
        for name in ["colours.png", "map.png", "rays.png", "sky.png"] {
            let picture = Picture::read(&folder.path().join(name));
            assert!(picture.width > 800 && picture.height() > 600, "{name}");
        }
        let sky = Picture::read(&folder.path().join("sky.png"));
        assert!((0..sky.height()).any(|y| sky.runs(y, TOP).iter().any(|run| run.1 > 100)), "a bright sector");
    }
}

mod addition {
    use super::*;
    use proptest::prelude::*;

    fn any_sum() -> impl Strategy<Value = FluxSum> {
        (0..1u64 << 40, 0..1u128 << 100).prop_map(|(count, quanta)| FluxSum { count, quanta })
    }

    prop_compose! {
        fn any_detector()(
            cells in proptest::collection::vec((0..1u128 << 100, 0..1u64 << 40), 3),
            recorded in any_sum(),
            ids in proptest::collection::vec(0..99u64, 0..4),
        ) -> DetectorTally {
            let rows = ids.into_iter().map(|ray_id| row(ray_id, 0, 1.0)).collect();
            let (quanta, hits) = cells.into_iter().unzip();
            let ended_inside = recorded.count;
            DetectorTally { quanta, hits, recorded, rows, ended_inside, ..DetectorTally::default() }
        }
    }

    prop_compose! {
        fn any_tally()(
            detectors in proptest::collection::vec(any_detector(), 2),
            surfaces in proptest::collection::vec((any::<bool>(), any_sum()), 2),
            flux_sums in proptest::collection::vec(any_sum(), 12),
            counts in (0..1u64 << 40, 0..1u64 << 40),
        ) -> Tally {
            let surfaces = surfaces.into_iter();
            Tally {
                launched: flux_sums[0],
                rays: RaySpans::default(),
                detectors,
                surfaces: surfaces.map(|(reached, absorbed)| SurfaceTally { reached, absorbed, entered_twice: counts.0, ended_inside: counts.1 }).collect(),
                escaped: flux_sums[1],
                depth_killed: flux_sums[2],
                roulette_loss: flux_sums[3],
                roulette_gain: flux_sums[4],
                bulk: flux_sums[5],
                importance_loss: flux_sums[6],
                importance_gain: flux_sums[7],
                coating: flux_sums[8],
                bsdf_loss: flux_sums[9],
                bsdf_gain: flux_sums[10],
                medium_stack_underflows: counts.0,
                split_budget_saturated: counts.0 % 2 == 1,
                invalid_deposits: counts.1,
                moments_overflowed: false,
                paths: Vec::new(),
                filtered_out: flux_sums[11],
                path_sums: None,
            }
        }
    }

    fn sum(parts: &[&Tally]) -> Tally {
        parts.iter().fold(Tally::default(), |mut sum, part| {
            sum += part;
            sum
        })
    }

    /// Rows are a collection; their order is that of the additions, and results sort them.
    fn sorted(mut tally: Tally) -> Tally {
        tally.detectors.iter_mut().for_each(|detector| detector.rows.sort_by_key(|row| row.ray_id));
        tally
    }

    proptest! {
        #[test]
        fn does_not_depend_on_order_or_grouping(a in any_tally(), b in any_tally(), c in any_tally()) {
            prop_assert_eq!(sorted(sum(&[&a, &b])), sorted(sum(&[&b, &a])));
            let (left, right) = (sum(&[&a, &b]), sum(&[&b, &c]));
            prop_assert_eq!(sum(&[&left, &c]), sum(&[&a, &right]));
        }

        #[test]
        fn adds_every_field(a in any_tally(), b in any_tally()) {
            let sum = sum(&[&a, &b]);
            let fields = |t: &Tally| [
                t.launched, t.escaped, t.depth_killed, t.roulette_loss, t.roulette_gain, t.bulk, t.importance_loss,
                t.importance_gain, t.coating, t.bsdf_loss, t.bsdf_gain, t.detectors[1].recorded, t.detectors[0].total(), t.surfaces[1].absorbed,
                FluxSum { count: t.medium_stack_underflows, quanta: t.invalid_deposits.into() },
                FluxSum { count: t.surfaces[1].entered_twice, quanta: t.surfaces[0].ended_inside.into() },
                FluxSum { count: t.detectors[0].ended_inside, quanta: t.detectors[1].ended_inside.into() },
                FluxSum { count: t.detectors[1].hits[2], quanta: t.detectors[1].quanta[2] },
            ];
            for ((total, mut one), other) in fields(&sum).into_iter().zip(fields(&a)).zip(fields(&b)) {
                one += other;
                prop_assert_eq!(total, one);
            }
            prop_assert_eq!(sum.surfaces[0].reached, a.surfaces[0].reached || b.surfaces[0].reached);
            prop_assert_eq!(sum.split_budget_saturated, a.split_budget_saturated || b.split_budget_saturated);
            prop_assert_eq!(sum.detectors[0].rows.len(), a.detectors[0].rows.len() + b.detectors[0].rows.len());
        }

        #[test]
        fn has_a_zero(a in any_tally()) {
            prop_assert_eq!(sum(&[&Tally::default(), &a]), sum(&[&a, &Tally::default()]));
            prop_assert_eq!(sum(&[&a]), a);
        }
    }
}
