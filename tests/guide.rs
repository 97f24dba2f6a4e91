//! Guided light: the same sums on average, exact weights within their bound, and rows of equal relative errors.
#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "clippy's exemption of tests does not reach their helpers"
)]

mod command;
mod zoo;

use command::{run, stderr};
use zoo::{guided, sum_and_error};

use nsq_gpu::guide::Guide;
use nsq_gpu::guide::learn::Wanted;
use nsq_gpu::guide::table::PLAIN_SHARE;
use nsq_gpu::model::bsdfs::{Bsdf, Scatter, Specular};
use nsq_gpu::model::scatter_sampling::ScatterSampling;
use nsq_gpu::model::{PathFilter, ReflectProb, SceneIr, Sequence, StepKind};
use nsq_gpu::paths::rows::{TableOptions, flux_unit, table};
use nsq_gpu::program::{Precision, Sampler};
use nsq_gpu::result::{Grouping, LightPath, PathSum, QUANTA_PER_WEIGHT, Tally};
use nsq_gpu::run::{Collect, StandardError};
use nsq_gpu::{Error, TraceOptions};
use std::sync::Arc;

fn with_table(num_rays: u64, seed: u64, precision: Precision) -> TraceOptions {
    zoo::tuned(TraceOptions {
        collect: Collect::paths(),
        max_depth: 40,
        ..zoo::options(num_rays, seed, precision)
    })
}

/// The rows of a table, by their sequences: flux and standard error \[W\].
fn rows(ir: &SceneIr, tally: &Tally, group: Grouping) -> Vec<LightPath> {
    let listing = TableOptions { group, ..TableOptions::default() };
    table(ir, tally, flux_unit(ir, tally, u64::MAX), Sampler::Pcg, &listing).paths
}

/// Sets the reflectance of every refractive face that has no coating.
fn coated(name: &str, reflectance: f64) -> SceneIr {
    let mut ir = zoo::load(name);
    zoo::coat(&mut ir, reflectance);
    ir
}

fn ledger_closes(ir: &SceneIr, options: &TraceOptions, tally: &Tally, what: &str) {
    assert_eq!(zoo::result_of(ir, options, tally).ledger.imbalance_quanta, 0, "{what}");
}

/// What rows and ends get is the same on average, for each of these scenes; every second one is coated.
fn guided_rays_bring_the_light_of_plain_ones(scenes: impl Iterator<Item = (Precision, String)>) {
    const NUM_RAYS: u64 = 30_000;
    let mut num_rows = 0;
    for (k, (precision, name)) in scenes.enumerate() {
        let mut ir = if k % 2 == 0 { zoo::load(&name) } else { coated(&name, 0.005) };
        ir.sampling.reflect_prob = ReflectProb::Fresnel;
        ir.sampling.split_depth = 0;
        let (options, what) = (with_table(NUM_RAYS, 5, precision), format!("{name}, {precision:?}"));
        let asked = guided(&ir, &TraceOptions { seed: 6, ..options.clone() }, 1 << 14, &Wanted::default());
        let [plain, guided] = [&options, &asked].map(|options| zoo::trace(&ir, options));
        ledger_closes(&ir, &asked, &guided, &what);
        for (one, two) in plain.detectors.iter().zip(&guided.detectors) {
            // A detector gets light of many rays: 2 % of it is more than chance.
            let [one, two] = [one, two].map(|detector| detector.total().quanta as f64 / QUANTA_PER_WEIGHT);
            let error = 8.0 * (one.max(two)).sqrt() + 1e-5 * one;
            assert!((one - two).abs() < error, "{what}: a detector gets {two} by a guide, {one} without");
        }
        let [plain, guided] = [plain, guided].map(|tally| rows(&ir, &tally, Grouping::Order));
        let effective = |row: &LightPath| (row.flux / row.standard_error.unwrap()).powi(2);
        for one in plain.iter().filter(|row| effective(row) >= 50.0) {
            let Some(two) = guided.iter().find(|row| row.sequence == one.sequence) else {
                panic!("{what}: guided rays bring no light of {}", one.sequence);
            };
            if effective(two) < 25.0 {
                continue;
            }
            // Beyond chance, f32 rounds products of weights.
            let sigma = one.standard_error.unwrap().hypot(two.standard_error.unwrap()).max(1e-5 * one.flux);
            let score = (one.flux - two.flux) / sigma;
            assert!(
                score.abs() < 5.0,
                "{what}: {} {} by a guide, {} without, {score} sigma",
                one.sequence,
                two.flux,
                one.flux
            );
            num_rows += 1;
        }
    }
    assert!(num_rows > 20, "{num_rows} rows are compared");
}

#[test]
fn guided_rays_bring_the_light_of_plain_ones_in_some_scenes() {
    // Scatterers, coated bare faces, a mesh, and media that absorb. Shaders in df64 take long to compile.
    let scenes = [
        (Precision::F64, "opal_lamp"),
        (Precision::F64, "ball_lens_ghosts"),
        (Precision::F32, "mesh_prism"),
        (Precision::F32, "cooke_triplet"),
    ];
    guided_rays_bring_the_light_of_plain_ones(
        scenes.into_iter().map(|(precision, name)| (precision, name.into())),
    );
}

#[test]
#[ignore = "long"]
fn guided_rays_bring_the_light_of_plain_ones_in_every_scene() {
    let tiers = [Precision::F32, Precision::F64, Precision::Df64];
    guided_rays_bring_the_light_of_plain_ones(tiers.into_iter().cycle().zip(zoo::scenes()));
}

/// 95 % intervals of a ghost's flux hold its mean over many seeds in 92 to 98 % of all seeds.
#[test]
fn intervals_of_ghosts_hold_as_often_as_they_say() {
    check_intervals(zoo::in_turn([
        ("cooke_triplet", None, 0.0, None),
        ("cooke_triplet", None, 1e-4, Some("scatterings == 1")),
    ]));
}

#[test]
#[ignore = "long"]
fn intervals_of_more_ghosts_hold_as_often_as_they_say() {
    check_intervals([
        ("double_gauss", Some(0.002), 0.0, None),
        ("double_gauss", Some(0.002), 0.0, Some("reflections == 2")),
        ("double_gauss", Some(0.002), 1e-4, None),
    ]);
}

/// Of lenses with this reflectance of their faces, this share of scattered light, and this filter of paths.
fn check_intervals<'a>(lenses: impl IntoIterator<Item = (&'a str, Option<f64>, f64, Option<&'a str>)>) {
    const SEEDS: u64 = 400;
    const NUM_RAYS: u64 = 6000;
    for (name, reflectance, roughness, filter) in lenses {
        let mut ir = reflectance.map_or_else(|| zoo::load(name), |reflectance| coated(name, reflectance));
        if roughness > 0.0 {
            zoo::roughen(&mut ir, roughness);
        }
        ir.sampling = nsq_gpu::model::Sampling::default();
        ir.sources.truncate(1);
        let filter = filter.map(|text| Arc::new(PathFilter::parse(text, &ir).unwrap()));
        let options = TraceOptions { path_filter: filter, ..with_table(NUM_RAYS, 1, Precision::F64) };
        let wanted = Wanted { top: 15, ..Wanted::default() };
        let options = guided(&ir, &options, 1 << 17, &wanted);
        let mut tracer = zoo::tracer(&ir, &options).unwrap();
        let tables: Vec<_> =
            zoo::tallies_of(&mut tracer, 100..100 + SEEDS).map(|tally| tally.path_sums.unwrap()).collect();
        let mut shares = Vec::new();
        let is_rare = |sequence: &&Sequence| sequence.reflections() == 2 || sequence.scatterings() == 1;
        for ghost in tables[0].rows.keys().filter(is_rare) {
            let rows = || tables.iter().map(|table| table.rows.get(ghost).copied().unwrap_or_default());
            if rows().map(|sum| sum.count).sum::<u64>() < 80 * SEEDS {
                continue;
            }
            let of_seeds: Vec<[f64; 2]> = rows().map(|sum| sum_and_error(&sum, NUM_RAYS)).collect();
            let mean = of_seeds.iter().map(|[flux, _]| flux).sum::<f64>() / SEEDS as f64;
            let held = of_seeds.iter().filter(|[flux, error]| (flux - mean).abs() < 1.96 * error).count();
            shares.push(held as f64 / SEEDS as f64);
        }
        // Of a hundred such shares, one lies 2.6 standard errors of 1.1 % beyond.
        let outside = shares.iter().filter(|share| !(0.92..=0.98).contains(*share)).count();
        let mean = shares.iter().sum::<f64>() / shares.len() as f64;
        assert!(shares.len() >= 3 && outside <= shares.len() / 20, "{name}: {shares:?}");
        assert!((mean - 0.95).abs() < 0.01, "{name}: {mean} of the intervals hold: {shares:?}");
    }
}

/// The first rows have errors alike, and far smaller ones than without a guide.
#[test]
fn the_first_rows_get_equal_relative_errors() {
    const NUM_RAYS: u64 = 200_000;
    let mut ir = coated("double_gauss", 0.002);
    ir.sampling = nsq_gpu::model::Sampling::default();
    let options = with_table(NUM_RAYS, 3, Precision::F64);
    let image = ir.detectors.iter().position(|detector| detector.name == "image");
    let wanted = Wanted { detector: image, top: 16, ..Wanted::default() };
    let asked = guided(&ir, &options, NUM_RAYS, &wanted);
    let tally = zoo::trace(&ir, &asked);
    let ghosts: Vec<LightPath> = rows(&ir, &tally, Grouping::Sequence)
        .into_iter()
        .filter(|row| row.reflections == 2 && row.detector.as_deref() == Some("image"))
        .take(12)
        .collect();
    let errors: Vec<f64> = ghosts.iter().map(|row| row.standard_error.unwrap() / row.flux).collect();
    let (least, most) =
        errors.iter().fold((f64::INFINITY, 0.0_f64), |(low, high), &error| (low.min(error), high.max(error)));
    assert!(errors.len() == 12 && most < 0.02 && most / least < 1.5, "{errors:?}");
    // As many plain rays as a guided one is worth bring the same error of the strongest ghost.
    let (flux, error) = (ghosts[0].flux, ghosts[0].standard_error.unwrap());
    let worth = flux / (error * error) / NUM_RAYS as f64;
    assert!(worth > 100.0, "a guided ray is worth {worth} plain rays");
}

/// No ray weighs more than 1 / PLAIN_SHARE times a plain ray on its path.
#[test]
fn weights_keep_their_bound() {
    for (name, precision) in [
        ("cooke_triplet", Precision::F32),
        ("double_gauss", Precision::F64),
        ("cooke_triplet", Precision::Df64),
    ] {
        let mut ir = coated(name, 0.002);
        ir.sampling = nsq_gpu::model::Sampling::default();
        let options = with_table(100_000, 2, precision);
        let asked = guided(&ir, &options, 1 << 18, &Wanted { top: 10, ..Wanted::default() });
        let tally = zoo::trace(&ir, &asked);
        for (sequence, sum) in &tally.path_sums.as_ref().unwrap().rows {
            // The mean square over the mean is at most the largest weight, which a plain ray has as 1.
            let most = sum.squares as f64 / sum.quanta.max(1) as f64;
            assert!(
                most <= (1.0 + 1e-4) / PLAIN_SHARE,
                "{name}: rays of {} weigh {most}",
                sequence.text(&ir)
            );
        }
        assert!(tally.importance_gain.quanta > 0 && tally.importance_loss.quanta > 0);
    }
}

/// A plate's ghosts by the closed form of its coatings: R1 R2 T1 T2 for the first, and so on.
#[test]
fn orders_of_a_coated_plate_are_those_of_the_closed_form() {
    let ir = nsq_gpu::Scene::from_json(PLATE).unwrap().lower().unwrap();
    let (r, t) = ([0.01_f64, 0.002], [0.985_f64, 0.99]);
    for precision in zoo::in_turn([Precision::F32, Precision::F64, Precision::Df64]) {
        let options = with_table(60_000, 4, precision);
        let asked = guided(&ir, &options, 1 << 18, &Wanted { top: 4, ..Wanted::default() });
        let sums = zoo::trace(&ir, &asked).path_sums.unwrap();
        for order in 0..=3 {
            let rows: Vec<_> =
                sums.rows.iter().filter(|(sequence, _)| sequence.reflections() == 2 * order).collect();
            assert_eq!(rows.len(), 1, "{precision:?}: order {order}");
            let [flux, error] = sum_and_error(rows[0].1, 60_000).map(|sum| sum / 60_000.0);
            let exact = t[0] * t[1] * (r[0] * r[1]).powi(order as i32);
            let score = (flux - exact) / error.max(1e-7 * exact);
            assert!(
                score.abs() < 4.0 && (error / exact < 0.02 || order > 1),
                "{precision:?}: order {order} has {flux} +- {error}, not {exact}"
            );
        }
    }
}

const PLATE: &str = r#"{
    "nsq_schema_version": 1,
    "components": [
        {"type": "lens", "name": "P", "cs": {"z": 10.0}, "config": {"r1": Infinity, "r2": Infinity, "thickness": 5.0,
            "front_aperture_radius": 20.0, "material": "N-BK7"}}
    ],
    "sources": [{"type": "collimated", "name": "S", "cs": {}, "spectrum": {"wavelengths": [0.55], "weights": [1.0]},
        "total_flux": 1.0, "aperture_radius": 3.0}],
    "detectors": [{"type": "irradiance", "name": "D", "cs": {"z": 40.0}, "width": 12.0, "height": 12.0,
        "num_pixels_x": 4, "num_pixels_y": 4}],
    "nsq_gpu": {"version": 1, "overrides": {
        "P.front": {"coating": {"type": "simple", "reflectance": 0.01, "transmittance": 0.985}},
        "P.back": {"coating": {"type": "simple", "reflectance": 0.002, "transmittance": 0.99}}}}
}"#;

/// A plate of which either face also scatters: as a mirror does, so that all light stays on the axis.
fn scattering_plate(fraction: f64) -> SceneIr {
    let mut ir = nsq_gpu::Scene::from_json(PLATE).unwrap().lower().unwrap();
    let scatter = Scatter { fraction, bsdf: Bsdf::Specular(Specular {}) };
    ir.surfaces[..2].iter_mut().for_each(|surface| surface.scatter = Some(scatter.clone()));
    ir
}

/// The rows of that plate by their closed forms: how much light of each arrives.
fn rows_of_scattering_plate(f: f64) -> [(&'static str, f64); 6] {
    let (r, t) = ([0.01, 0.002], [0.985, 0.99]);
    // A scattered ray goes back from the transmitted branch, and on from the reflected one.
    let (passes, on, back) = (
        [0, 1].map(|face| t[face] * (1.0 - f)),
        [0, 1].map(|face| r[face] * f),
        [0, 1].map(|face| t[face] * f),
    );
    let mirrored = [0, 1].map(|face| r[face] * (1.0 - f));
    [
        ("S > T P.front > T P.back > D", passes[0] * passes[1]),
        ("S > ST P.front > T P.back > D", on[0] * passes[1]),
        ("S > T P.front > ST P.back > D", passes[0] * on[1]),
        (
            "S > T P.front > R P.back > R P.front > T P.back > D",
            passes[0] * mirrored[1] * mirrored[0] * passes[1],
        ),
        (
            "S > T P.front > R P.back > SR P.front > T P.back > D",
            passes[0] * mirrored[1] * back[0] * passes[1],
        ),
        ("S > T P.front > SR P.back > SR P.front > T P.back > D", passes[0] * back[1] * back[0] * passes[1]),
    ]
}

/// Light that faint scatterers send on has the closed form of its row, whether all light is kept or scattered light alone.
#[test]
fn light_of_faint_scatterers_is_that_of_the_closed_form() {
    const NUM_RAYS: u64 = 100_000;
    const FRACTION: f64 = 1e-3;
    let ir = scattering_plate(FRACTION);
    for precision in zoo::in_turn([Precision::F32, Precision::F64, Precision::Df64]) {
        // Which light is kept, by how often it reflects and scatters.
        type Keeps = fn(usize, usize) -> bool;
        let filters: [(Option<&str>, Keeps); 3] = [
            (None, |_, _| true),
            (Some("scatterings == 1"), |_, scatterings| scatterings == 1),
            (Some("reflections == 2 or scatterings == 2"), |reflections, scatterings| {
                reflections == 2 || scatterings == 2
            }),
        ];
        // Shaders in df64 take long to compile.
        let num_filters = if precision == Precision::F64 { filters.len() } else { 1 };
        for (filter, keeps) in filters.into_iter().take(num_filters) {
            let expected = rows_of_scattering_plate(FRACTION).map(|(path, exact)| {
                let steps =
                    |letters: &[&str]| letters.iter().map(|letter| path.matches(letter).count()).sum();
                (path, exact, keeps(steps(&[" R P"]), steps(&[" ST P", " SR P"])))
            });
            // A hundredth or less of the rays that scatter on purpose have been reflected before, and are sent on.
            assert_rows(&ir, (precision, NUM_RAYS), (filter, 7), &expected, 0.25);
        }
    }
}

/// Guides so many rays to so many rows of light that a filter keeps. Each of these paths then has its exact share of the light,
/// with a small relative error, or no ray if the filter does not keep it.
fn assert_rows(
    ir: &SceneIr,
    (precision, num_rays): (Precision, u64),
    (filter, top): (Option<&str>, usize),
    expected: &[(&str, f64, bool)],
    most_error: f64,
) {
    let what = format!("{precision:?}, {filter:?}");
    let filter = filter.map(|text| Arc::new(PathFilter::parse(text, ir).unwrap()));
    let options = TraceOptions { path_filter: filter.clone(), ..with_table(num_rays, 4, precision) };
    let asked = guided(ir, &options, num_rays, &Wanted { top, filter, ..Wanted::default() });
    let tally = zoo::trace(ir, &asked);
    ledger_closes(ir, &asked, &tally, &what);
    let sums = tally.path_sums.unwrap();
    for &(path, exact, is_kept) in expected {
        let row = sums.rows.iter().find(|(sequence, _)| sequence.text(ir) == path);
        if !is_kept {
            assert!(row.is_none(), "{what}: {path} is kept");
            continue;
        }
        let [flux, error] =
            row.map_or([0.0; 2], |(_, sum)| sum_and_error(sum, num_rays).map(|sum| sum / num_rays as f64));
        let score = (flux - exact) / error.max(2e-6 * exact);
        assert!(
            score.abs() < 4.0 && error < most_error * exact,
            "{what}: {path} has {flux} +- {error}, not {exact}"
        );
    }
}

/// A scene without a refractive face: the ledger knows what guided weights gain and lose there, too.
#[test]
fn mirrors_that_scatter_are_guided() {
    const NUM_RAYS: u64 = 50_000;
    let ir = nsq_gpu::Scene::from_json(SCATTERING_MIRROR).unwrap().lower().unwrap();
    // From a point to a square of half width a, at a distance of 1 (Howell, A catalog of radiation heat transfer
    // configuration factors, B-3).
    let a = 20.0_f64 / 60.0;
    let root = (1.0 + a * a).sqrt();
    let seen = 4.0 / std::f64::consts::PI * a / root * (a / root).atan();
    for (filter, precision, [is_kept, is_kept_scattered]) in [
        (None, Precision::F64, [true, true]),
        (None, Precision::F32, [true, true]),
        (Some("scatterings == 1"), Precision::F64, [false, true]),
        (Some("scatterings == 0"), Precision::F64, [true, false]),
    ] {
        let expected =
            [("S > R M > D", 0.9 * 0.999, is_kept), ("S > SR M > D", 0.9 * 0.001 * seen, is_kept_scattered)];
        assert_rows(&ir, (precision, NUM_RAYS), (filter, Wanted::default().top), &expected, 0.03);
    }
}

const SCATTERING_MIRROR: &str = r#"{
    "nsq_schema_version": 1,
    "components": [],
    "sources": [{"type": "collimated", "name": "S", "cs": {}, "spectrum": {"wavelengths": [0.55], "weights": [1.0]},
        "total_flux": 1.0, "aperture_radius": 0.01}],
    "detectors": [{"type": "irradiance", "name": "D", "cs": {"z": -10.0}, "width": 40.0, "height": 40.0,
        "num_pixels_x": 4, "num_pixels_y": 4}],
    "nsq_gpu": {"version": 1, "surfaces": [
        {"name": "M", "cs": {"z": 50.0}, "shape": {"type": "plane", "width": 20.0, "height": 20.0},
            "interaction": "reflective", "reflectance": 0.9, "bsdf": {"type": "lambertian"}, "scatter_fraction": 0.001}]}
}"#;

/// A coated lens of faces that are a little rough: rows of ghosts and of scattered light have errors alike.
#[test]
fn scattered_light_and_ghosts_get_equal_relative_errors() {
    const NUM_RAYS: u64 = 200_000;
    let mut ir = coated("double_gauss", 0.002);
    ir.sampling = nsq_gpu::model::Sampling::default();
    ir.sources.truncate(1);
    zoo::roughen(&mut ir, 1e-4);
    let options = with_table(NUM_RAYS, 3, Precision::F64);
    let image = ir.detectors.iter().position(|detector| detector.name == "image");
    let asked = guided(&ir, &options, NUM_RAYS, &Wanted { detector: image, top: 24, ..Wanted::default() });
    let tally = zoo::trace(&ir, &asked);
    let listed = rows(&ir, &tally, Grouping::Sequence);
    let rare = |row: &&LightPath| {
        row.detector.as_deref() == Some("image")
            && matches!((row.reflections, row.scatterings), (0, 1) | (2, 0))
    };
    let first: Vec<&LightPath> = listed.iter().filter(rare).take(22).collect();
    let scattered = first.iter().filter(|row| row.scatterings == 1).count();
    let errors: Vec<f64> = first.iter().map(|row| row.standard_error.unwrap() / row.flux).collect();
    let (least, most) =
        errors.iter().fold((f64::INFINITY, 0.0_f64), |(low, high), &error| (low.min(error), high.max(error)));
    assert!(
        scattered >= 8 && first.len() >= scattered + 8 && most < 0.05 && most / least < 2.0,
        "{scattered} rows scatter; {errors:?}"
    );
}

/// With a filter, rays follow the one branch whose light may be kept. What the filter keeps and what its opposite keeps add up.
#[test]
fn a_filter_and_its_opposite_add_up_where_rays_are_guided() {
    const NUM_RAYS: u64 = 60_000;
    for (name, text) in [
        ("cooke_triplet", "reflections == 2"),
        ("heliar_ghosts", "reflections >= 1 and events < 20"),
        ("scattering_telescope", "scatterings > 0 or reflections > 2"),
        ("filter_stack", "reflections < 2"),
        ("ball_lens_ghosts", "not sequence(\"* > R * > * > R * > *\")"),
    ] {
        let mut ir = zoo::load(name);
        ir.sampling = nsq_gpu::model::Sampling::default();
        let whole = zoo::trace(&ir, &with_table(NUM_RAYS, 8, Precision::F64)).path_sums.unwrap();
        let mut sum = [0.0; 2];
        for text in [text.to_string(), format!("not ({text})")] {
            let filter = Arc::new(PathFilter::parse(&text, &ir).unwrap());
            let options =
                TraceOptions { path_filter: Some(filter.clone()), ..with_table(NUM_RAYS, 9, Precision::F64) };
            let asked =
                guided(&ir, &options, 1 << 18, &Wanted { filter: Some(filter.clone()), ..Wanted::default() });
            let tally = zoo::trace(&ir, &asked);
            ledger_closes(&ir, &asked, &tally, &format!("{name}: {text}"));
            let sums = tally.path_sums.unwrap();
            assert!(sums.rows.keys().all(|sequence| filter.keeps(sequence)), "{name}: {text}");
            for total in sums.totals().values() {
                let [flux, error] = sum_and_error(total, NUM_RAYS);
                sum = [sum[0] + flux, sum[1].hypot(error)];
            }
        }
        let of_whole: Vec<[f64; 2]> =
            whole.totals().values().map(|total| sum_and_error(total, NUM_RAYS)).collect();
        let (flux, error) =
            of_whole.iter().fold((0.0, 0.0_f64), |(flux, error), [f, e]| (flux + f, error.hypot(*e)));
        let sigma = sum[1].hypot(error);
        assert!(
            (sum[0] - flux).abs() < 4.0 * sigma,
            "{name}: {} +- {} of parts, {flux} +- {error} of all",
            sum[0],
            sum[1]
        );
    }
}

/// Every ray follows a chosen ghost, as far as its geometry lets it.
#[test]
fn every_ray_follows_a_chosen_ghost() {
    const NUM_RAYS: u64 = 20_000;
    let mut ir = coated("double_gauss", 0.002);
    ir.media.iter_mut().for_each(|medium| medium.k.fill(0.0));
    ir.sampling = nsq_gpu::model::Sampling::default();
    let options = with_table(NUM_RAYS, 3, Precision::F64);
    let all = zoo::trace(&ir, &guided(&ir, &options, 1 << 18, &Wanted::default())).path_sums.unwrap();
    let (ghost, sum) = all
        .rows
        .iter()
        .filter(|(sequence, _)| sequence.reflections() == 2)
        .max_by_key(|(_, sum)| sum.quanta)
        .unwrap();
    let [flux, error] = sum_and_error(sum, NUM_RAYS);
    let text = format!("sequence(\"{}\")", ghost.text(&ir));
    let filter = Arc::new(PathFilter::parse(&text, &ir).unwrap());
    let options = TraceOptions { path_filter: Some(filter.clone()), ..options };
    let asked = guided(&ir, &options, 1 << 18, &Wanted { filter: Some(filter), ..Wanted::default() });
    let tally = zoo::trace(&ir, &asked);
    ledger_closes(&ir, &asked, &tally, &text);
    let sums = tally.path_sums.unwrap();
    assert_eq!(sums.rows.keys().collect::<Vec<_>>(), [ghost]);
    let [alone, error_alone] = sum_and_error(&sums.rows[ghost], NUM_RAYS);
    assert!(
        (alone - flux).abs() < 4.0 * error.hypot(error_alone),
        "{alone} +- {error_alone}, {flux} +- {error}"
    );
    // As many rays come through as of the image, and all weigh the same: R^2 T^n.
    let count = sums.rows[ghost].count;
    assert!(count > NUM_RAYS / 8, "{count} of {NUM_RAYS} rays");
    let passes = ghost.steps.iter().filter(|step| step.kind == StepKind::Transmitted).count() as i32;
    let exact = 0.002_f64.powi(2) * 0.998_f64.powi(passes) * count as f64;
    // Three fields share 20,000 rays, so that a new ray weighs 1 to a ten-thousandth.
    assert!((alone / exact - 1.0).abs() < 1e-4, "{alone}, not {exact}");
}

/// The rays of parts that share a guide are those of the whole, to the bit.
#[test]
fn parts_with_one_guide_add_up_to_the_whole() {
    let mut ir = coated("cooke_triplet", 0.01);
    ir.sampling = nsq_gpu::model::Sampling::default();
    let options = TraceOptions { standard_error: StandardError::On, ..with_table(9000, 3, Precision::F64) };
    let asked = guided(&ir, &options, 1 << 18, &Wanted::default());
    let whole = zoo::trace(&ir, &asked);
    let part = |first_ray, num_rays| {
        let options = TraceOptions { first_ray, num_rays, of_rays: Some(9000), ..asked.clone() };
        zoo::tracer(&ir, &options).unwrap().trace(|_| true).unwrap()
    };
    let mut sum = part(0, 2500);
    sum += &part(2500, 6500);
    assert_eq!(sum, whole);
    // A guide survives its file.
    let text = asked.guide.as_ref().unwrap().to_json().unwrap();
    let file = tempfile::NamedTempFile::new().unwrap();
    std::fs::write(file.path(), text).unwrap();
    let read = Guide::read(file.path()).unwrap();
    assert_eq!(zoo::trace(&ir, &TraceOptions { guide: Some(Arc::new(read)), ..asked }), whole);
}

/// Sobol points are guided as well, and so are groups of sequences.
#[test]
fn sobol_points_and_groups_are_guided() {
    const NUM_RAYS: u64 = 1 << 15;
    let mut ir = coated("cooke_triplet", 0.002);
    ir.sampling = nsq_gpu::model::Sampling::default();
    let options = with_table(NUM_RAYS, 3, Precision::F64);
    let ghosts = |tally: Tally| {
        let sums = tally.path_sums.unwrap();
        let all = sums.rows.iter().filter(|(sequence, _)| sequence.reflections() == 2);
        let mut total = PathSum::default();
        all.for_each(|(_, sum)| total += *sum);
        sum_and_error(&total, NUM_RAYS)
    };
    let asked = guided(&ir, &options, 1 << 18, &Wanted { group: Grouping::Order, ..Wanted::default() });
    let [flux, error] = ghosts(zoo::trace(&ir, &asked));
    let [sobol, _] = ghosts(zoo::trace(&ir, &TraceOptions { sampler: Sampler::Sobol, ..asked.clone() }));
    assert!(
        (sobol - flux).abs() < 4.0 * error && error < 0.05 * flux,
        "{sobol} by Sobol points, {flux} +- {error}"
    );
}

/// What cannot be guided is refused by name.
#[test]
fn what_cannot_be_guided_is_refused() {
    let mut ir = coated("cooke_triplet", 0.01);
    ir.sampling = nsq_gpu::model::Sampling::default();
    let asked = guided(&ir, &with_table(4096, 3, Precision::F64), 1 << 12, &Wanted::default());
    let problem = |ir: &SceneIr, options: &TraceOptions| match zoo::tracer(ir, options) {
        Err(Error::Usage(problem)) => problem,
        Err(other) => panic!("{other}"),
        Ok(_) => panic!("it is traced"),
    };
    let mut other = ir.clone();
    other.sampling.reflect_prob = ReflectProb::Auto;
    assert!(problem(&other, &asked).contains("--reflect-prob fresnel"));
    other.sampling = nsq_gpu::model::Sampling { split_depth: 3, ..ir.sampling };
    assert!(problem(&other, &asked).contains("--split-depth 0"));
    let mut rough = scattering_plate(0.1);
    rough.scatter_sampling =
        vec![ScatterSampling { prob: Some(0.5), ..Default::default() }; rough.surfaces.len()];
    let of_plate = TraceOptions { guide: Some(Arc::new(Guide::plain(&rough))), ..asked.clone() };
    assert!(problem(&rough, &of_plate).contains("scatter_prob; leave one of them out"));
    assert!(
        problem(&ir, &TraceOptions { collect: Collect::Adjoints, ..asked.clone() }).contains("derivatives")
    );
    assert!(problem(&zoo::load("double_gauss"), &asked).contains("learned for another scene"));
}

/// Planted errors turn the comparison with plain rays red.
#[test]
fn planted_errors_are_noticed() {
    let ir = nsq_gpu::Scene::from_json(PLATE).unwrap().lower().unwrap();
    let options = with_table(60_000, 4, Precision::F64);
    let asked = guided(&ir, &options, 1 << 18, &Wanted { top: 4, ..Wanted::default() });
    let flux_of = |tally: Tally, reflections: usize| {
        let sums = tally.path_sums.unwrap();
        let row = sums.rows.iter().find(|(sequence, _)| sequence.reflections() == reflections);
        row.map_or([0.0; 2], |(_, sum)| sum_and_error(sum, 60_000).map(|sum| sum / 60_000.0))
    };
    let exact = 0.985 * 0.99 * 0.01 * 0.002;
    let is_off = |tally: Tally| {
        let [flux, error] = flux_of(tally, 2);
        (flux - exact).abs() > 6.0 * error || error == 0.0
    };
    assert!(!is_off(zoo::trace(&ir, &asked)));
    for (before, after) in [
        ("first / drawn", "2.0 * first / drawn"),
        ("second / (1.0 - drawn)", "second"),
        ("real(f32(units)) * 2.3283064365386963e-10", "real(mixed)"),
        ("bits < units", "bits < units / 2u"),
    ] {
        // Where paths change, a ray that is traced again does not take the path that the table has of it.
        let planted = zoo::edited(&ir, &asked, before, after).trace(|_| true);
        assert!(planted.map_or(true, is_off), "`{after}` is not noticed");
    }
}

fn with_guide(extra: &serde_json::Value) -> String {
    let mut scene: serde_json::Value = serde_json::from_str(&PLATE.replace("Infinity", "1e9")).unwrap();
    scene["nsq_gpu"]["sampling"] = extra.clone();
    scene.to_string()
}

fn path_in(folder: &tempfile::TempDir, name: &str) -> String {
    folder.path().join(name).to_str().unwrap().to_string()
}

fn written(folder: &tempfile::TempDir, name: &str, text: &str) -> String {
    let path = path_in(folder, name);
    std::fs::write(&path, text).unwrap();
    path
}

/// The command learns, writes and reads guides; parts and resumed traces have the bits of the whole.
#[test]
fn a_trace_that_goes_on_is_guided_as_it_began() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| path_in(&folder, name);
    let scene = written(&folder, "plate.json", &with_guide(&serde_json::json!({})));
    let succeeds = |arguments: &[&str]| {
        let output = run(arguments);
        assert!(output.status.success(), "{arguments:?}: {}", stderr(&output));
        String::from_utf8(output.stdout).unwrap()
    };
    let trace = |rays: &str, more: &[&str]| {
        let sums = path(more[0]);
        let arguments = ["trace", &scene, "-n", rays, "--precision=f64", "--checkpoint", &sums];
        succeeds(&[&arguments, &more[1..]].concat());
        std::fs::read(sums).unwrap()
    };
    let guide = path("guide.json");
    let whole = trace("20000", &["whole", "--guide", "--guide-to", &guide]);
    assert_eq!(
        trace("20000", &["given", "--guide-from", &guide]),
        whole,
        "a frozen guide draws the same rays"
    );
    // Parts share the guide, and a part alone learns none.
    let parts = ["0", "12000"].map(|first| {
        let (name, rays) = (format!("part{first}"), if first == "0" { "12000" } else { "8000" });
        trace(rays, &[&name, "--first-ray", first, "--of-rays=20000", "--guide-from", &guide]);
        path(&name)
    });
    let merged = path("merged");
    succeeds(&["merge", &parts[0], &parts[1], "-o", &merged, "--no-pictures"]);
    let report: serde_json::Value =
        serde_json::from_str(&std::fs::read_to_string(folder.path().join("merged/report.json")).unwrap())
            .unwrap();
    assert_eq!(report["guide"]["most_weight"], 4.0);
    let learned_alone =
        run(&["trace", &scene, "-n", "8000", "--first-ray=12000", "--of-rays=20000", "--guide"]);
    assert!(stderr(&learned_alone).contains("--guide --guide-to FILE"), "{}", stderr(&learned_alone));
    // Sums of another guide are not added.
    trace("12000", &["other", "--first-ray=0", "--of-rays=20000", "--seed=0"]);
    let other = run(&["merge", &path("other"), &parts[1], "-o", &path("no")]);
    assert!(stderr(&other).contains("guide: "), "{}", stderr(&other));
    // What began with a guide goes on with it, also where nobody says so.
    let begun = path("begun");
    succeeds(&[
        "trace",
        &scene,
        "-n",
        "20000",
        "--precision=f64",
        "--guide-from",
        &guide,
        "--time-limit=1ms",
        "--checkpoint",
        &begun,
    ]);
    succeeds(&[
        "trace",
        &scene,
        "-n",
        "20000",
        "--precision=f64",
        "--resume",
        &begun,
        "--checkpoint",
        &begun,
    ]);
    assert_eq!(std::fs::read(&begun).unwrap(), whole, "a resumed trace has the bits of an unbroken one");
}

/// Files that are no guides, guides of other scenes, and light that a scene does not have are named.
#[test]
fn wrong_guides_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| path_in(&folder, name);
    let write = |name: &str, text: &str| written(&folder, name, text);
    let problem = |arguments: &[&str]| {
        let output = run(arguments);
        assert!(!output.status.success(), "{arguments:?}");
        stderr(&output)
    };
    let plate = write("plate.json", &with_guide(&serde_json::json!({})));
    let from =
        |text: &str| problem(&["trace", &plate, "-n", "100", "--guide-from", &write("guide.json", text)]);
    assert!(from("no").contains("is no guide, as --guide-to writes it"));
    let table = |words: &str| {
        format!(
            r#"{{"nsq_gpu_guide": 2, "faces": ["P.front", "P.back", "P.edge"], "sources": ["S"], "words": [{words}]}}"#
        )
    };
    assert!(from(&table("0, 0, 0, 0")).contains("has 4 words"), "{}", from(&table("0, 0, 0, 0")));
    let old = table("0, 0, 0, 0").replace("\"nsq_gpu_guide\": 2", "\"nsq_gpu_guide\": 1");
    assert!(from(&old).contains("is of format 1; this program reads format 2"), "{}", from(&old));
    let far = format!("0, 0, 9, 0, 0{}", ", 0".repeat(25));
    assert!(from(&table(&far)).contains("leads to node 9, of 2"), "{}", from(&table(&far)));
    let other = table(&format!("0{}", ", 0".repeat(29))).replace("P.back", "P.rear");
    assert!(from(&other).contains("face 1 is `P.rear` there, and `P.back` here"), "{}", from(&other));
    let kept = problem(&["trace", &plate, "-n", "100", "--guide", "--guide-to", &plate]);
    assert!(kept.contains("read by this command"), "{kept}");
    let kept = problem(&["trace", &plate, "-n", "100", "--guide", "--guide-to", &write("mine.txt", "mine")]);
    assert!(kept.contains("mine.txt"), "{kept}");
    assert_eq!(std::fs::read_to_string(path("mine.txt")).unwrap(), "mine");
    let new = path("new.json");
    let none = problem(&["diff", &plate, &plate, "-n", "100", "--guide", "--guide-to", &new]);
    assert!(none.contains("a difference writes no guide"), "{none}");
    let none = problem(&[
        "sweep",
        &plate,
        "--set",
        "S.total_flux=1:2:2",
        "-n",
        "100",
        "--guide",
        "--guide-to",
        &new,
    ]);
    assert!(none.contains("a sweep writes no guide"), "{none}");
    for (sampling, said) in [
        (
            serde_json::json!({"guide": {"detector": "DD"}}),
            "nsq_gpu.sampling.guide.detector: `DD` is no detector",
        ),
        (serde_json::json!({"guide": {"where": "reflection == 2"}}), "nsq_gpu.sampling.guide.where"),
        (serde_json::json!({"guide": {"wher": null}}), "wher"),
    ] {
        let scene = write("guided.json", &with_guide(&sampling));
        let found = problem(&["trace", &scene, "-n", "100"]);
        assert!(found.contains(said), "{found}");
    }
    let scene = write(
        "guided.json",
        &with_guide(&serde_json::json!({"guide": {"detector": "D", "where": "reflections == 2"}})),
    );
    let report = run(&["paths", &scene, "-n", "1e4", "--json", "--maps=0"]);
    let report: serde_json::Value = serde_json::from_slice(&report.stdout).unwrap();
    let row = report["paths"].as_array().unwrap().iter().find(|row| row["reflections"] == 2).unwrap();
    assert!(row["num_rays"].as_u64().unwrap() > 1000 && row["plain_rays"].as_f64().unwrap() > 1e6, "{row}");
}
