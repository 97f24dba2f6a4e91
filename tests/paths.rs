//! Light by its path: the rows of a detector add up to its sums, whatever the table, the parts, and the filter.
#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "clippy's exemption of tests does not reach their helpers"
)]

mod zoo;

use nsq_gpu::TraceOptions;
use nsq_gpu::engine::options::DEFAULT_PATH_ROWS;
use nsq_gpu::model::{End, PathFilter, ScatterSampling, SceneIr};
use nsq_gpu::paths::rows::TableOptions;
use nsq_gpu::program::{Precision, Sampler};
use nsq_gpu::result::{Grouping, LightPath, PathSum, PathTally, Tally};
use nsq_gpu::run::Collect;

fn with_table(num_rays: u64, precision: Precision) -> TraceOptions {
    TraceOptions { collect: Collect::paths(), ..zoo::options(num_rays, 16, precision) }
}

/// A table of paths of so many rows.
fn by_path(rows: u32, ends: bool) -> Collect {
    Collect::Paths { rows, ends }
}

fn sums(tally: &Tally) -> &PathTally {
    tally.path_sums.as_ref().unwrap()
}

/// Counts and quanta of every end are those of the ledger.
fn assert_rows_add_up(ir: &SceneIr, tally: &Tally, has_ends: bool, what: &str) {
    let sums = sums(tally);
    let check = |end: End, count: u64, quanta: u128| {
        let PathSum { count: of_paths, quanta: quanta_of_paths, .. } = sums.total(end);
        assert_eq!((of_paths, quanta_of_paths), (count, quanta), "{what}: {end:?}");
    };
    for (number, detector) in (0..).zip(&tally.detectors) {
        let total = detector.total();
        check(End::Detector(number), total.count, total.quanta);
    }
    if has_ends {
        for (number, surface) in (0..).zip(&tally.surfaces) {
            if ir.surfaces[number as usize].interaction == nsq_gpu::model::Interaction::Absorbing {
                check(End::Absorbed(number), surface.absorbed.count, surface.absorbed.quanta);
            }
        }
        check(End::Missed, tally.escaped.count, tally.escaped.quanta);
        check(End::DepthLimit, tally.depth_killed.count, tally.depth_killed.quanta);
        check(End::Roulette, tally.roulette_loss.count, tally.roulette_loss.quanta);
    }
}

#[test]
fn rows_add_up_to_what_detectors_and_ends_have_in_every_scene() {
    for (k, name) in zoo::scenes_in_turn() {
        let ir = zoo::load(&name);
        let (gpu, precision) = match k % 5 {
            4 => (zoo::gpu(), Precision::Df64),
            0 => (zoo::gpu(), Precision::F32),
            1 => (zoo::gpu(), Precision::F64),
            2 => (zoo::portable_gpu(), Precision::F32),
            _ => (zoo::portable_gpu(), Precision::F64),
        };
        let plain = zoo::trace_on(gpu, &ir, &zoo::options(3000, 16, precision));
        // Each tier has scenes with ends and without: two and five share no factor.
        let has_ends = k % 2 == 0;
        let options =
            TraceOptions { collect: by_path(DEFAULT_PATH_ROWS, has_ends), ..with_table(3000, precision) };
        let mut tally = zoo::trace_on(gpu, &ir, &options);
        let what = format!("{name}, {precision:?}");
        assert_rows_add_up(&ir, &tally, has_ends, &what);
        assert!(!sums(&tally).is_closed && sums(&tally).other.is_empty(), "{what}");
        tally.path_sums = None;
        assert_eq!(tally, plain, "{what}: other sums change");
    }
}

/// Expressions that every scene can have, with names of its surfaces, sources and detectors.
fn expressions(ir: &SceneIr) -> Vec<String> {
    let surface = |at: usize| ir.surface_name(at % ir.surfaces.len());
    let source = &ir.sources[ir.sources.len() - 1].name;
    let detector = &ir.detectors[0].name;
    vec![
        "reflections == 0".into(),
        "reflections == 2 or scatterings > 0".into(),
        "transmissions >= 2 and events < 7".into(),
        format!("hit({0:?}) and not last({0:?})", surface(1)),
        format!("first({:?}) or reflected({:?}) and events != 3", surface(0), surface(1)),
        format!("source({source:?}) and (transmitted({:?}) or scattered('*'))", surface(2)),
        format!("sequence(\"* > R * > * > {detector}\")"),
        format!("sequence(\"{source} > * {} > *\") or sequence(\"* > T * > T * > {detector}\")", surface(0)),
    ]
}

/// What a filter keeps and what its opposite keeps add up to all light, cell by cell. The light that is kept is that of the
/// rows whose sequences match, by the evaluation on the host.
#[test]
fn a_filter_and_its_opposite_add_up_to_the_whole_map() {
    for (k, name) in zoo::scenes_in_turn() {
        let ir = zoo::load(&name);
        let all = expressions(&ir);
        let expression = &all[k % all.len()];
        let (gpu, precision) = match k % 3 {
            0 => (zoo::gpu(), Precision::F32),
            1 => (zoo::portable_gpu(), Precision::F64),
            _ => (zoo::gpu(), Precision::F64),
        };
        let whole = zoo::trace_on(gpu, &ir, &with_table(2000, precision));
        let filtered = |text: &str| {
            let filter = PathFilter::parse(text, &ir).unwrap();
            let options =
                TraceOptions { path_filter: Some(filter.clone().into()), ..with_table(2000, precision) };
            let tally = zoo::trace_on(gpu, &ir, &options);
            assert!(sums(&tally).rows.keys().all(|sequence| filter.keeps(sequence)), "{name}: {text}");
            assert_rows_add_up(&ir, &tally, false, &format!("{name}: {text}"));
            let ledger = zoo::result_of(&ir, &options, &tally).ledger;
            assert_eq!(ledger.imbalance_quanta, 0, "{name}: {text}");
            let kept = sums(&whole).rows.iter().filter(|(sequence, _)| filter.keeps(sequence));
            assert!(kept.eq(&sums(&tally).rows), "{name}: {text}");
            tally
        };
        let (kept, others) = (filtered(expression), filtered(&format!("not ({expression})")));
        for (number, detector) in whole.detectors.iter().enumerate() {
            let mut sum = kept.detectors[number].clone();
            sum += &others.detectors[number];
            assert_eq!((&sum.quanta, &sum.hits), (&detector.quanta, &detector.hits), "{name}: {expression}");
            assert_eq!(sum.recorded, detector.recorded, "{name}: {expression}");
        }
        assert_eq!(kept.escaped, whole.escaped);
        let ends = whole.detectors.iter().zip(&ir.detectors).filter(|(_, detector)| detector.absorb);
        let ended: u64 = ends.map(|(sums, _)| sums.total().count).sum();
        assert_eq!(kept.filtered_out.count + others.filtered_out.count, ended, "{name}: {expression}");
    }
}

/// The same table for one part and for several, whether a part has room for its sequences or not.
#[test]
fn parts_have_the_table_of_the_whole_also_where_sequences_are_more_than_rows() {
    for (name, path_rows, precision) in [
        ("kaleidoscope", 100, Precision::F32),
        ("integrating_sphere", 1 << 18, Precision::F64),
        ("kaleidoscope", 12, Precision::F64),
    ] {
        let ir = zoo::load(name);
        let options = TraceOptions {
            collect: by_path(path_rows, true),
            max_depth: 12,
            ..with_table(20_000, precision)
        };
        let whole = zoo::trace(&ir, &options);
        assert_rows_add_up(&ir, &whole, true, name);
        let whole = sums(&whole);
        assert_eq!(whole.is_closed, path_rows < 1000, "{name}: {} rows", whole.rows.len());
        for num_parts in [2, 7] {
            let mut sum = PathTally::new(path_rows);
            for part in 0..num_parts {
                let (first_ray, end) = (20_000 * part / num_parts, 20_000 * (part + 1) / num_parts);
                let options = TraceOptions {
                    first_ray,
                    num_rays: end - first_ray,
                    of_rays: Some(20_000),
                    ..options.clone()
                };
                let part = zoo::tracer(&ir, &options).unwrap().trace(|_| true).unwrap();
                sum += sums(&part);
            }
            assert_eq!(&sum, whole, "{name} in {num_parts} parts");
        }
    }
}

/// A table that begins too small is made larger, and no deposit is lost or counted twice. The light of a table with few
/// rows is that of a table with many, row by row.
#[test]
fn a_table_that_was_full_has_the_rows_of_one_that_was_not() {
    let ir = zoo::load("mirror_ball_billiard");
    let traced = |batch_size, path_rows| {
        let options = TraceOptions {
            batch_size: Some(batch_size),
            collect: by_path(path_rows, false),
            max_depth: 20,
            ..with_table(8000, Precision::F32)
        };
        let tally = zoo::trace(&ir, &options);
        assert_rows_add_up(&ir, &tally, false, "mirror_ball_billiard");
        tally
    };
    let (whole, in_batches, closed) =
        (traced(1 << 16, 1 << 18), traced(1000, 1 << 18), traced(1 << 16, 1000));
    assert!(sums(&whole).rows.len() > 4096, "{} rows do not fill the first table", sums(&whole).rows.len());
    assert_eq!(whole, in_batches);
    let closed = sums(&closed);
    assert!(closed.is_closed && closed.rows.len() <= 1000 && !closed.other.is_empty());
    assert!(closed.rows.iter().all(|(sequence, sum)| sums(&whole).rows[sequence] == *sum));
}

/// A trace that goes on from its own beginning has the table of an unbroken one, whether the table was closed before or
/// after.
#[test]
fn a_table_that_is_taken_up_again_is_the_same() {
    for (name, path_rows) in [("cooke_triplet", 1 << 18), ("triplet_telescope_ghosts", 200)] {
        let ir = zoo::load(name);
        let options =
            TraceOptions { collect: by_path(path_rows, false), ..with_table(12_000, Precision::F32) };
        let whole = zoo::trace(&ir, &options);
        for position in [500, 4000] {
            let mut tracer = zoo::tracer(&ir, &options).unwrap();
            tracer.pause_at(position);
            let mut begun = Tally::default();
            tracer
                .go_on(tracer.empty_tally(), |progress| {
                    begun = progress.tally()?.clone();
                    Ok(false)
                })
                .unwrap();
            assert!(begun.launched.count < 12_000, "{name}");
            let mut other = zoo::tracer(&ir, &options).unwrap();
            assert_eq!(other.go_on(begun, |_| Ok(true)).unwrap(), whole, "{name} from {position}");
        }
        assert_eq!(sums(&whole).is_closed, path_rows == 200);
    }
}

/// Plates one behind the other, of glasses of these indices, in a beam along the axis; rays are split at each face.
fn plates(indices: &[f64], rr_start_flux: f64) -> SceneIr {
    let media: serde_json::Map<String, serde_json::Value> = (0..)
        .zip(indices)
        .map(|(i, n)| (format!("glass_{i}"), serde_json::json!({"type": "constant", "n": n, "k": 0.0})))
        .collect();
    let plate = |i: usize| {
        serde_json::json!({"type": "lens", "name": format!("plate_{i}"), "cs": {"z": 10.0 * i as f64}, "config": {
            "r1": f64::INFINITY.to_string(), "r2": 0.0, "thickness": 3.0, "front_aperture_radius": 20.0,
            "material": {"type": "medium", "name": format!("glass_{i}")}
        }})
    };
    let scene = serde_json::json!({
        "nsq_schema_version": 1,
        "components": (0..indices.len()).map(plate).collect::<Vec<_>>(),
        "sources": [{"type": "collimated", "name": "lamp", "cs": {"z": -10.0}, "total_flux": 1.0, "aperture_radius": 1.0,
            "spectrum": {"wavelengths": [0.55], "weights": [1.0]}}],
        "detectors": [{"type": "irradiance", "name": "image", "cs": {"z": 10.0 * indices.len() as f64}, "width": 10.0,
            "height": 10.0, "num_pixels_x": 8, "num_pixels_y": 8}],
        "nsq_gpu": {"version": 1, "media": media, "sampling": {"split_depth": 18, "split_budget": 19.0,
            "rr_start_flux": rr_start_flux}}
    });
    let text = scene.to_string().replace("\"inf\"", "Infinity").replace("\"r2\":0.0", "\"r2\":Infinity");
    nsq_gpu::Scene::from_json(&text).unwrap().lower().unwrap()
}

/// The table of a trace, by what is a row.
fn table(ir: &SceneIr, tally: &Tally, num_rays: u64, group: Grouping) -> Vec<LightPath> {
    let unit = nsq_gpu::paths::rows::flux_unit(ir, tally, num_rays);
    let options = TableOptions { group, ..TableOptions::default() };
    nsq_gpu::paths::rows::table(ir, tally, unit, Sampler::Pcg, &options).paths
}

fn reflectance(n: f64) -> f64 {
    ((n - 1.0) / (n + 1.0)).powi(2)
}

/// k bare faces make k (k - 1) / 2 ghosts of two reflections. A ghost of the faces i and j has R_i R_j times the
/// transmittance of each face, and of those between both three times.
#[test]
fn bare_faces_make_a_ghost_a_pair() {
    let indices = [1.5, 1.7, 2.0];
    // No ghost of two reflections is so weak that roulette takes it.
    let ir = plates(&indices, 1e-3);
    let reflectances: Vec<f64> = indices.iter().flat_map(|&n| [reflectance(n); 2]).collect();
    let num_faces = reflectances.len();
    for (precision, tolerance) in [(Precision::F64, 1e-12), (Precision::F32, 1e-6)] {
        let options = TraceOptions { max_depth: 18, ..with_table(500, precision) };
        let tally = zoo::trace(&ir, &options);
        let rows = table(&ir, &tally, 500, Grouping::Faces);
        let ghosts: Vec<&LightPath> =
            rows.iter().filter(|row| row.reflections == 2 && row.detector.is_some()).collect();
        assert_eq!(ghosts.len(), num_faces * (num_faces - 1) / 2);
        for second in 0..num_faces {
            for first in second + 1..num_faces {
                let name = |face: usize| format!("plate_{}.{}", face / 2, ["front", "back"][face % 2]);
                let steps = [["R".to_string(), name(first)], ["R".to_string(), name(second)]];
                let ghost = ghosts.iter().find(|row| row.steps == steps).unwrap();
                let passed = |face: usize| if (second + 1..first).contains(&face) { 3 } else { 1 };
                let passes = (0..num_faces).map(|face| (1.0 - reflectances[face]).powi(passed(face)));
                let expected = reflectances[first] * reflectances[second] * passes.product::<f64>();
                let error = (ghost.flux / expected - 1.0).abs();
                assert!(error < tolerance, "{} {precision:?}: off by {error:e}", ghost.sequence);
            }
        }
    }
}

/// Light of the order m goes 2 m times to and fro within a plate: T^2 R^(2 m) of it.
#[test]
fn a_plate_has_its_orders() {
    let ir = plates(&[2.0], 0.0);
    let options = TraceOptions { max_depth: 16, min_flux_fraction: 0.0, ..with_table(300, Precision::F64) };
    let rows = table(&ir, &zoo::trace(&ir, &options), 300, Grouping::Order);
    let r = reflectance(2.0);
    for order in 0..5 {
        let row = rows.iter().find(|row| row.reflections == 2 * order && row.detector.is_some()).unwrap();
        let expected = (1.0 - r).powi(2) * r.powi(2 * order as i32);
        // A split rounds weights to quanta, by chance.
        let quantum = f64::EPSILON;
        assert!((row.flux - expected).abs() < quantum, "order {order}: {} not {expected}", row.flux);
        // Rays are split, so each brings the same by each path: nothing of the error is chance.
        assert!(row.standard_error.unwrap() < 1e-9, "{row:?}");
    }
}

/// Between two mirrors that reflect 0.98, light that has been reflected m times has 0.98^m of its flux.
#[test]
fn mirrors_face_to_face_have_a_row_for_each_reflection() {
    let ir = zoo::load("bench_cavity");
    for (precision, tolerance) in [(Precision::F64, 1e-12), (Precision::F32, 1e-5), (Precision::Df64, 1e-11)]
    {
        let options = TraceOptions { max_depth: 24, ..with_table(1000, precision) };
        let rows = table(&ir, &zoo::trace(&ir, &options), 1000, Grouping::Sequence);
        assert_eq!(rows.len(), 12);
        for row in &rows {
            assert!((row.flux / 0.98_f64.powi(row.reflections as i32) - 1.0).abs() < tolerance, "{row:?}");
            assert_eq!((row.num_rays, row.scatterings), (1000, 0));
            let mirrors = row.steps.iter().map(|[letter, name]| format!("{letter} {name}"));
            let expected = (0..row.reflections)
                .map(|m| ["R M_far.surface", "R M_near.surface"][m as usize % 2].to_string());
            assert!(mirrors.eq(expected), "{row:?}");
        }
    }
}

/// The expression that a row gives keeps the row's light, to the quantum, and no other.
#[test]
fn the_expression_of_a_row_keeps_its_light_alone() {
    for name in ["cooke_triplet", "scattering_telescope", "split_ghosts"] {
        let ir = zoo::load(name);
        let num_rays = 3000;
        let options = with_table(num_rays, Precision::F32);
        let whole = zoo::trace(&ir, &options);
        for group in [Grouping::Sequence, Grouping::Faces, Grouping::Order] {
            let rows = table(&ir, &whole, num_rays, group);
            for row in [&rows[0], &rows[rows.len() / 2]] {
                let filter = PathFilter::parse(row.filter.as_ref().unwrap(), &ir).unwrap();
                let options = TraceOptions { path_filter: Some(filter.into()), ..options.clone() };
                let found = table(&ir, &zoo::trace(&ir, &options), num_rays, group);
                assert_eq!(found.len(), 1, "{name}: {:?} keeps {found:?}", row.filter);
                assert_eq!((found[0].flux, found[0].num_rays), (row.flux, row.num_rays), "{name}: {row:?}");
            }
        }
    }
}

/// 1e8 rays through scenes that have ever new paths: the table keeps to its rows, and is the same for one part, two and
/// seven.
#[test]
#[ignore = "long"]
fn tables_of_1e8_rays_are_the_same_in_one_part_in_two_and_in_seven() {
    for (name, path_rows) in [("kaleidoscope", 1000), ("integrating_sphere", 20)] {
        let ir = zoo::load(name);
        let num_rays: u64 = 100_000_000;
        let options =
            TraceOptions { collect: by_path(path_rows, false), ..with_table(num_rays, Precision::F32) };
        let whole = zoo::trace(&ir, &options);
        assert_rows_add_up(&ir, &whole, false, name);
        let whole = sums(&whole);
        assert!(whole.is_closed && whole.rows.len() <= path_rows as usize, "{name}");
        for num_parts in [2, 7] {
            let mut sum = PathTally::new(path_rows);
            for part in 0..num_parts {
                let (first_ray, end) = (num_rays * part / num_parts, num_rays * (part + 1) / num_parts);
                let num_rays_of_part = end - first_ray;
                let options = TraceOptions {
                    first_ray,
                    num_rays: num_rays_of_part,
                    of_rays: Some(num_rays),
                    ..options.clone()
                };
                sum += sums(&zoo::tracer(&ir, &options).unwrap().trace(|_| true).unwrap());
            }
            assert_eq!(&sum, whole, "{name} in {num_parts} parts");
        }
    }
}

/// What users read where rows have no standard errors.
#[test]
fn why_rows_have_no_errors_is_said() {
    let said = |ir: &SceneIr, options: &TraceOptions| {
        let result = zoo::result(ir, options);
        let of_errors = |warning: &&String| {
            ["no standard errors", "errors are missing"].iter().any(|of| warning.contains(of))
        };
        result.diagnostics.warnings.iter().filter(of_errors).cloned().collect::<Vec<_>>()
    };
    let mut rough = zoo::load("cooke_triplet");
    zoo::roughen(&mut rough, 1e-4);
    let plain = with_table(1000, Precision::F32);
    assert_eq!(said(&rough, &plain), Vec::<String>::new());

    // A ray that passes six faces unscattered weighs 0.13^-6: its square is above what a sum holds.
    let mut forced = rough.clone();
    forced.scatter_sampling =
        vec![ScatterSampling { prob: Some(0.87), ..ScatterSampling::default() }; rough.surfaces.len()];
    let heavy = said(&forced, &with_table(1 << 20, Precision::F32));
    assert!(
        heavy.len() == 1 && heavy[0].contains("so heavy") && heavy[0].contains("--scatter-prob"),
        "{heavy:?}"
    );

    let mut split = rough.clone();
    split.sampling.split_depth = 2;
    let twice = said(&split, &with_table(100_000, Precision::F32));
    assert!(twice.len() == 1 && twice[0].contains("split_depth"), "{twice:?}");

    let sobol = said(&rough, &TraceOptions { sampler: Sampler::Sobol, ..plain });
    assert!(sobol.len() == 1 && sobol[0].contains("--sampler pcg"), "{sobol:?}");
}
