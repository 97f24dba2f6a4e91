//! What other coatings would do, from a table of paths: against closed forms, and against traces with those coatings.
#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "clippy's exemption of tests does not reach their helpers"
)]

mod command;
mod zoo;

use command::{run, stderr};
use nsq_gpu::model::{Coating, Interaction, SceneIr, SimpleCoating, StepKind};
use nsq_gpu::paths::rows::{self, TableOptions, Traced, flux_unit, table_with_maps};
use nsq_gpu::paths::what_if;
use nsq_gpu::program::{Precision, Sampler};
use nsq_gpu::result::{CoatingRank, Grouping, LightPath, Recoating, Tally, total_reflection};
use nsq_gpu::run::Collect;
use nsq_gpu::{Scene, TraceOptions};
use serde_json::{Value, json};
use std::collections::HashMap;
use std::path::Path;

fn options(num_rays: u64) -> TraceOptions {
    // No roulette: what is split has no chance in it.
    TraceOptions {
        collect: Collect::paths(),
        max_depth: 18,
        min_flux_fraction: 0.0,
        ..zoo::options(num_rays, 3, Precision::F64)
    }
}

/// A plate with coatings of R and T on its two faces, in a beam along the axis; rays are split at each face.
fn plate_text(coatings: [[f64; 2]; 2]) -> String {
    let coating =
        |[r, t]: [f64; 2]| json!({"coating": {"type": "simple", "reflectance": r, "transmittance": t}});
    let scene = json!({
        "nsq_schema_version": 1,
        "components": [{"type": "lens", "name": "plate", "cs": {"z": 0.0}, "config": {"r1": "inf", "r2": "inf",
            "thickness": 3.0, "front_aperture_radius": 20.0, "material": {"type": "medium", "name": "glass"}}}],
        "sources": [{"type": "collimated", "name": "lamp", "cs": {"z": -10.0}, "total_flux": 1.0, "aperture_radius": 1.0,
            "spectrum": {"wavelengths": [0.5, 0.6], "weights": [1.0, 1.0]}}],
        "detectors": [{"type": "irradiance", "name": "image", "cs": {"z": 10.0}, "width": 10.0, "height": 10.0,
            "num_pixels_x": 4, "num_pixels_y": 4}],
        "nsq_gpu": {"version": 1, "media": {"glass": {"type": "constant", "n": 2.0, "k": 0.0}},
            "overrides": {"plate.front": coating(coatings[0]), "plate.back": coating(coatings[1])},
            "sampling": {"split_depth": 18, "split_budget": 19.0, "rr_start_flux": 0.0}}
    });
    scene.to_string().replace("\"inf\"", "Infinity")
}

fn plate(coatings: [[f64; 2]; 2]) -> SceneIr {
    Scene::from_json(&plate_text(coatings)).unwrap().lower().unwrap()
}

/// New coatings, as the command has them.
fn recoating(ir: &SceneIr, coatings: &[&str]) -> Result<Recoating, String> {
    let wanted: Vec<_> = coatings.iter().map(|text| text.parse().unwrap()).collect();
    Recoating::new(ir, &wanted).map_err(|error| error.to_string())
}

/// The rows with new coatings.
fn table(ir: &SceneIr, tally: &Tally, num_rays: u64, group: Grouping, coatings: &[&str]) -> Vec<LightPath> {
    let options =
        TableOptions { group, recoating: recoating(ir, coatings).unwrap(), ..TableOptions::default() };
    rows::table(ir, tally, flux_unit(ir, tally, num_rays), Sampler::Pcg, &options).paths
}

/// A table with maps, ranked.
fn ranked(ir: &SceneIr, trace: &TraceOptions, tally: &Tally, group: Grouping, coatings: &[&str]) -> Traced {
    let recoating = recoating(ir, coatings).unwrap();
    let options = TableOptions { group, recoating, num_maps: 8, ..TableOptions::default() };
    let found = HashMap::new();
    let mut traced = table_with_maps(zoo::gpu(), ir, trace, tally, &found, &options, || true).unwrap();
    what_if::rank_coatings(ir, trace, tally, &options, &mut traced);
    traced
}

fn rank_of<'a>(traced: &'a Traced, face: &str) -> &'a CoatingRank {
    traced.table.coatings.as_ref().unwrap().iter().find(|rank| rank.face == face).unwrap()
}

/// Light of the order m of a plate has T1 T2 (R1 R2)^m, whatever the coatings of the trace were.
#[test]
fn orders_of_a_plate_are_those_of_the_new_coatings() {
    let ir = plate([[0.2, 0.7], [0.3, 0.65]]);
    let tally = zoo::trace(&ir, &options(300));
    let cases: [(&[&str], [f64; 4]); 5] = [
        (&["plate.front=0.05"], [0.05, 0.85, 0.3, 0.65]),
        (&["plate.front=0.05,0.9", "plate.back=0.6"], [0.05, 0.9, 0.6, 0.35]),
        (&["plate.back=0,1"], [0.2, 0.7, 0.0, 1.0]),
        (&["plate.back=1,0"], [0.2, 0.7, 1.0, 0.0]),
        (&[], [0.2, 0.7, 0.3, 0.65]),
    ];
    for (coatings, [r1, t1, r2, t2]) in cases {
        for group in [Grouping::Sequence, Grouping::Faces, Grouping::Order] {
            let rows = table(&ir, &tally, 300, group, coatings);
            for order in 0..5 {
                let row = rows.iter().find(|row| row.reflections == 2 * order).unwrap();
                let expected = t1 * t2 * (r1 * r2).powi(order as i32);
                assert!(
                    (row.flux - expected).abs() < 1e-12,
                    "{coatings:?} {order}: {} not {expected}",
                    row.flux
                );
            }
            let total: f64 = rows.iter().map(|row| row.share).sum();
            assert!((total - 1.0).abs() < 1e-12 || t2 == 0.0, "{coatings:?}: shares add up to {total}");
            assert!(rows.is_sorted_by(|a, b| a.flux >= b.flux));
        }
    }
}

/// The derivative of T1 T2 (R1 R2)^m by R1 is m / R1 - 1 / T1 times that; differences of the table's own rows agree.
#[test]
fn derivatives_are_those_of_the_closed_form_and_of_differences() {
    let [r1, t1, r2, t2] = [0.2, 0.7, 0.3, 0.65];
    let ir = plate([[r1, t1], [r2, t2]]);
    let trace = options(300);
    let tally = zoo::trace(&ir, &trace);
    let traced = ranked(&ir, &trace, &tally, Grouping::Sequence, &[]);
    let num_orders = table(&ir, &tally, 300, Grouping::Order, &[]).len() as i32;
    for (face, r, t) in [("plate.front", r1, t1), ("plate.back", r2, t2)] {
        let rank = rank_of(&traced, face);
        let flux = |order: i32| t1 * t2 * (r1 * r2).powi(order);
        let slope = |order: i32| flux(order) * (f64::from(order) / r - 1.0 / t);
        let expected: f64 = (1..num_orders).map(slope).sum();
        let found = rank.derivative.unwrap();
        assert!((found / expected - 1.0).abs() < 1e-12, "{face}: {found} not {expected}");
        assert_eq!((rank.reflectance, rank.share), (Some(r), 1.0));
        // Rays are split, so nothing is chance but the rounding of weights.
        assert!(rank.standard_error.unwrap() < 1e-7, "{rank:?}");
        let ghosts = |r: f64| {
            let rows = table(&ir, &tally, 300, Grouping::Sequence, &[&format!("{face}={r}")]);
            rows.iter().filter(|row| row.reflections >= 2).map(|row| row.flux).sum::<f64>()
        };
        let difference = (ghosts(r + 1e-5) - ghosts(r - 1e-5)) / 2e-5;
        assert!((found / difference - 1.0).abs() < 1e-8, "{face}: {found} not {difference}");
        // The beam's ghosts lie in one place: the first is the brightest.
        let peak =
            traced.table.paths.iter().find(|row| row.reflections == 2).unwrap().peak_irradiance.unwrap();
        let of_peak = rank.peak_derivative.unwrap();
        assert!((of_peak / (peak * (1.0 / r - 1.0 / t)) - 1.0).abs() < 1e-12, "{face}: {of_peak}");
    }
    // With new coatings the derivative is that at the new ones, also where R is 0.
    let traced = ranked(&ir, &trace, &tally, Grouping::Sequence, &["plate.front=0", "plate.back=0.1"]);
    let rank = rank_of(&traced, "plate.front");
    let expected = 0.9 * 0.85 * 0.1;
    assert_eq!(rank.reflectance, Some(0.0));
    assert!((rank.derivative.unwrap() / expected - 1.0).abs() < 1e-12, "{rank:?} not {expected}");
}

/// The peaks of rows, and their places, are those of a trace with the new coatings.
#[test]
fn peaks_and_places_are_those_of_a_trace_with_the_new_coatings() {
    let trace = options(300);
    let rows = |ir: &SceneIr, coatings: &[&str]| {
        ranked(ir, &trace, &zoo::trace(ir, &trace), Grouping::Sequence, coatings).table.paths
    };
    let found = rows(&plate([[0.2, 0.7], [0.3, 0.65]]), &["plate.front=0.1,0.6"]);
    let expected = rows(&plate([[0.1, 0.6], [0.3, 0.65]]), &[]);
    for (found, expected) in found.iter().zip(&expected).take(4) {
        assert_eq!(found.sequence, expected.sequence);
        let ratio = found.peak_irradiance.unwrap() / expected.peak_irradiance.unwrap();
        assert!((ratio - 1.0).abs() < 1e-9, "{found:?} not {expected:?}");
        let [a, b] = [found, expected].map(|row| row.centroid.unwrap()[0]);
        assert!(
            (a - b).abs() < 1e-9 && (found.rms_radius.unwrap() - expected.rms_radius.unwrap()).abs() < 1e-9
        );
    }
}

fn double_gauss(coatings: &[(&str, [f64; 2])]) -> SceneIr {
    let mut ir = zoo::load("double_gauss");
    ir.sampling.split_depth = 12;
    for surface in 0..ir.surfaces.len() {
        let name = ir.surface_name(surface);
        let own = coatings.iter().find(|(face, _)| *face == name).map_or([0.02, 0.97], |(_, own)| *own);
        coat(&mut ir, surface, own);
    }
    ir
}

fn coat(ir: &mut SceneIr, surface: usize, [r, t]: [f64; 2]) {
    let count = ir.wavelengths.len();
    let surface = &mut ir.surfaces[surface];
    if surface.interaction == Interaction::Refractive {
        surface.coating = Some(Coating::Simple(SimpleCoating {
            reflectance: vec![r; count],
            transmittance: vec![t; count],
        }));
    }
}

/// How many joint standard errors two rows are apart.
fn apart(found: &LightPath, expected: &LightPath) -> f64 {
    let errors = [found, expected].map(|row| row.standard_error.unwrap());
    (found.flux - expected.flux) / errors[0].hypot(errors[1]).max(1e-12 * expected.flux)
}

/// Ghosts of a camera lens in which two faces are coated otherwise, against those of a trace of that lens.
#[test]
fn ghosts_of_a_lens_are_those_of_a_trace_with_the_new_coatings() {
    const NUM_RAYS: u64 = 20_000;
    let trace = TraceOptions { max_depth: 32, ..options(NUM_RAYS) };
    let old = double_gauss(&[]);
    let new = double_gauss(&[("face_9", [0.006, 0.984]), ("face_11", [0.05, 0.9])]);
    let (old_tally, new_tally) = (zoo::trace(&old, &trace), zoo::trace(&new, &trace));
    let coatings = ["face_9=0.006", "face_11=0.05,0.9"];
    let image = |row: &&LightPath| row.detector.as_deref() == Some("image");
    let found = table(&old, &old_tally, NUM_RAYS, Grouping::Faces, &coatings);
    let unchanged = table(&old, &old_tally, NUM_RAYS, Grouping::Faces, &[]);
    let expected = table(&new, &new_tally, NUM_RAYS, Grouping::Faces, &[]);
    let (mut num_rows, mut num_changed) = (0, 0);
    let mut squares = 0.0;
    for expected in expected.iter().filter(image).filter(|row| row.num_rays >= 300) {
        let own = |row: &&LightPath| row.sequence == expected.sequence;
        let Some(found) = found.iter().find(own).filter(|row| row.num_rays >= 300) else { continue };
        let sigmas = apart(found, expected);
        assert!(sigmas.abs() < 5.0, "{}: {} and {}", found.sequence, found.flux, expected.flux);
        squares += sigmas * sigmas;
        num_rows += 1;
        num_changed += usize::from(apart(unchanged.iter().find(own).unwrap(), expected).abs() > 5.0);
    }
    println!(
        "{num_rows} rows, {num_changed} of them changed, {:.2} sigmas rms",
        (squares / f64::from(num_rows)).sqrt()
    );
    assert!(num_rows >= 15 && num_changed >= 5, "{num_rows} rows, {num_changed} of them changed");
    assert!(
        squares < 2.0 * f64::from(num_rows),
        "the rows are {} sigmas apart",
        (squares / f64::from(num_rows)).sqrt()
    );
}

/// A coated face that scatters, in a beam between two detectors.
fn scattering_face(coating: [f64; 2], bsdf: &Value) -> SceneIr {
    let detector = |name: &str, z: f64| {
        json!({"type": "irradiance", "name": name, "cs": {"z": z}, "width": 1e3,
        "height": 1e3, "num_pixels_x": 2, "num_pixels_y": 2})
    };
    let scene = json!({
        "nsq_schema_version": 1, "components": [],
        "sources": [{"type": "collimated", "name": "lamp", "cs": {"z": -1.0}, "total_flux": 1.0, "aperture_radius": 1.0,
            "spectrum": {"wavelengths": [0.5], "weights": [1.0]}}],
        "detectors": [detector("back", -2.0), detector("front", 2.0)],
        "nsq_gpu": {"version": 1, "media": {"glass": {"type": "constant", "n": 1.5, "k": 0.0}},
            "surfaces": [{"name": "face", "cs": {"z": 0.0}, "shape": {"type": "plane"}, "interaction": "refractive",
                "material_front": null, "material_back": {"type": "medium", "name": "glass"},
                "coating": {"type": "simple", "reflectance": coating[0], "transmittance": coating[1]},
                "bsdf": bsdf, "scatter_fraction": 0.6}]}
    });
    Scene::from_json(&scene.to_string()).unwrap().lower().unwrap()
}

fn lobe(kind: &str, transmissive_fraction: f64) -> Value {
    match kind {
        "lambertian" => {
            json!({"type": "lambertian", "reflectance_value": 0.9, "transmissive_fraction": transmissive_fraction})
        }
        _ => {
            json!({"type": "harvey_shack", "b0": 1.0, "l0": 0.05, "s": 2.5, "transmissive_fraction": transmissive_fraction})
        }
    }
}

#[test]
fn scattered_light_has_the_factor_of_the_branch_that_it_came_by() {
    const NUM_RAYS: u64 = 40_000;
    for (kind, fraction) in [("lambertian", 0.4), ("harvey_shack", 1.0), ("harvey_shack", 0.0)] {
        let bsdf = lobe(kind, fraction);
        let (old, new) = (scattering_face([0.3, 0.5], &bsdf), scattering_face([0.5, 0.2], &bsdf));
        let trace = options(NUM_RAYS);
        let (old_tally, new_tally) = (zoo::trace(&old, &trace), zoo::trace(&new, &trace));
        recoating(&old, &["face=0.5,0.2"]).unwrap();
        let found = table(&old, &old_tally, NUM_RAYS, Grouping::Sequence, &["face=0.5,0.2"]);
        let expected = table(&new, &new_tally, NUM_RAYS, Grouping::Sequence, &[]);
        assert_eq!(found.len(), 4, "{kind} {fraction}");
        for expected in &expected {
            let found = found.iter().find(|row| row.sequence == expected.sequence).unwrap();
            let sigmas = apart(found, expected);
            assert!(sigmas.abs() < 4.0, "{kind} {fraction}: {sigmas} sigmas, {found:?} not {expected:?}");
        }
    }
    // Both branches scatter to either side: nobody knows by which branch such light came.
    let ir = scattering_face([0.3, 0.5], &lobe("harvey_shack", 0.5));
    let trace = options(1000);
    let tally = zoo::trace(&ir, &trace);
    let listing = |coatings: &[&str]| TableOptions {
        recoating: recoating(&ir, coatings).unwrap(),
        ..TableOptions::default()
    };
    let said =
        what_if::check_recoating(&ir, &trace, &tally, &listing(&["face=0.5"])).unwrap_err().to_string();
    assert!(
        said.contains("2 paths are scattered there") && said.contains("not scattered(\"face\")"),
        "{said}"
    );
    assert_eq!(what_if::check_recoating(&ir, &trace, &tally, &listing(&[])), Ok(Vec::new()));
}

/// Rows of several sequences with factors of their own: sums of the sequences' rows, with no smaller errors; and no peak.
#[test]
fn groups_add_up_sequences_with_factors_of_their_own() {
    let ir = double_gauss(&[]);
    let trace = options(2000);
    let tally = zoo::trace(&ir, &trace);
    let coatings = ["face_9=0.1", "face_3=0.001,0.5"];
    let alone = table(&ir, &tally, 2000, Grouping::Sequence, &coatings);
    let together = table(&ir, &tally, 2000, Grouping::Order, &coatings);
    let mut has_several = false;
    for row in &together {
        let own: Vec<&LightPath> = alone
            .iter()
            .filter(|other| {
                (other.reflections, other.scatterings, &other.detector)
                    == (row.reflections, row.scatterings, &row.detector)
            })
            .collect();
        has_several |= own.len() > 10;
        let flux: f64 = own.iter().map(|row| row.flux).sum();
        assert!((row.flux / flux - 1.0).abs() < 1e-9, "{row:?}");
        let bound: f64 = own.iter().map(|row| row.standard_error.unwrap()).sum();
        // Rays are split: the errors of a row's sequences are those of one sum at most.
        assert!(row.standard_error.unwrap() <= bound * (1.0 + 1e-3), "{row:?} above {bound}");
    }
    assert!(has_several);
    let traced = ranked(&ir, &trace, &tally, Grouping::Order, &coatings);
    let ghosts = traced.table.paths.iter().find(|row| row.reflections == 2).unwrap();
    assert_eq!(ghosts.peak_irradiance, None, "its sequences have factors of their own");
    assert!(rank_of(&traced, "face_9").peak_derivative.is_none());
}

/// Faces that reflect nothing reflect totally alone: each such path is suspected.
#[test]
fn total_reflection_is_never_overlooked() {
    let scenes = ["ball_lens_ghosts", "cooke_triplet", "light_pipe", "opal_lamp", "prism_spectrometer"];
    let mut num_total = 0;
    for name in scenes {
        let mut ir = zoo::load(name);
        (0..ir.surfaces.len()).for_each(|surface| coat(&mut ir, surface, [0.0, 1.0]));
        let tally = zoo::trace(&ir, &options(1000));
        let rows = tally.path_sums.unwrap().rows;
        // Where reflection is drawn all the same, it brings nothing.
        for (sequence, _) in rows.iter().filter(|(_, sum)| sum.quanta > 0) {
            let suspected = total_reflection::possible(&ir, sequence);
            let reflected = sequence.steps.iter().filter(|step| {
                let is_refractive = ir.surfaces[step.surface as usize].interaction == Interaction::Refractive;
                step.kind == StepKind::Reflected && is_refractive
            });
            for step in reflected {
                num_total += 1;
                assert!(suspected.contains(&step.surface), "{name}: {}", sequence.text(&ir));
            }
        }
    }
    println!("{num_total} total reflections");
    assert!(num_total > 100, "{num_total} total reflections");
}

/// No light that came into a plate from outside is totally reflected by the other face. Light that is born in it is.
#[test]
fn a_plate_is_not_suspected_of_total_reflection() {
    let with_source = |half_angle: f64, is_inside: bool| {
        let mut scene: Value =
            serde_json::from_str(&plate_text([[0.2, 0.7], [0.3, 0.65]]).replace("Infinity", "0.0")).unwrap();
        let z = if is_inside { 1.0 } else { -10.0 };
        let medium = if is_inside { json!({"type": "medium", "name": "glass"}) } else { Value::Null };
        scene["sources"] = json!([{"type": "point", "name": "lamp", "cs": {"x": 0.0, "y": 0.0, "z": z}, "total_flux": 1.0,
            "half_angle_deg": half_angle, "medium": medium, "spectrum": {"wavelengths": [0.5], "weights": [1.0]}}]);
        Scene::from_json(&scene.to_string()).unwrap().lower().unwrap()
    };
    // The critical angle is 30 degrees.
    for (half_angle, is_inside, is_suspected) in
        [(80.0, false, false), (29.0, true, false), (31.0, true, true)]
    {
        let ir = with_source(half_angle, is_inside);
        let trace = options(2000);
        let tally = zoo::trace(&ir, &trace);
        let listing = TableOptions {
            recoating: recoating(&ir, &["plate.back=0.1"]).unwrap(),
            ..TableOptions::default()
        };
        let warnings = what_if::check_recoating(&ir, &trace, &tally, &listing).unwrap();
        assert_eq!(!warnings.is_empty(), is_suspected, "{half_angle}: {warnings:?}");
        let begins = "plate.back: in ";
        assert!(warnings.iter().all(|text| text.starts_with(begins) && text.contains("totally reflected")));
    }
}

#[test]
fn coatings_of_which_the_trace_says_nothing_are_refused() {
    let ir = plate([[0.2, 0.7], [0.3, 0.0]]);
    let refused = |ir: &SceneIr, coatings: &[&str], texts: &[&str]| {
        let said = recoating(ir, coatings).unwrap_err();
        assert!(texts.iter().all(|text| said.contains(text)), "{coatings:?}: {said}");
    };
    refused(&ir, &["plate.frnt=0.1"], &["plate.frnt", "did you mean `plate.front`?"]);
    refused(&ir, &["plate=0.1"], &["no face of this name", "`plate.front`"]);
    refused(&ir, &["plate.front=1.5"], &["cannot reflect 1.5", "0 to 1"]);
    refused(&ir, &["plate.front=-0.1"], &["cannot reflect -0.1"]);
    refused(&ir, &["plate.front=nan"], &["cannot reflect NaN"]);
    refused(&ir, &["plate.front=0.1,1.2"], &["cannot transmit 1.2"]);
    refused(&ir, &["plate.front=0.6,0.6"], &["more light than it gets", "R + T <= 1"]);
    refused(&ir, &["plate.front=0.95"], &["absorbs 0.1", "FACE=R,T"]);
    refused(&ir, &["plate.front=0.1", "plate.front=0.2"], &["named twice"]);
    // Its absorption is held, so less R means more T.
    refused(&ir, &["plate.back=0.2"], &["transmits nothing", "FACE=R,0"]);
    assert!(recoating(&ir, &["plate.back=0.2,0"]).is_ok());
    for text in
        ["plate.front", "plate.front=", "plate.front=a", "plate.front=0.1,b", "plate.front=0.1,0.2,0.3"]
    {
        let said = text.parse::<nsq_gpu::result::NewCoating>().unwrap_err().to_string();
        assert!(said.contains("FACE=R,T"), "{text}: {said}");
    }
    let with = |surface: usize, coating: Option<Coating>| {
        let mut ir = ir.clone();
        ir.surfaces[surface].coating = coating;
        ir
    };
    let front = ir.surfaces.iter().position(|surface| surface.name == "plate.front").unwrap();
    let simple = |reflectance: [f64; 2]| {
        Some(Coating::Simple(SimpleCoating {
            reflectance: reflectance.to_vec(),
            transmittance: vec![0.5; 2],
        }))
    };
    refused(&with(front, None), &["plate.front=0.1"], &["is bare", "constant coating first", "nsq-gpu diff"]);
    refused(&with(front, simple([0.1, 0.2])), &["plate.front=0.1"], &["by the wavelength", "nsq-gpu diff"]);
    refused(&with(front, simple([0.0; 2])), &["plate.front=0.1"], &["reflects nothing", "above 0"]);
    let by_angle = with(front, simple([0.1; 2])).surfaces[front].coating.as_ref().map(Coating::tabulated);
    let by_angle = with(front, by_angle.map(Coating::Tabulated));
    refused(&by_angle, &["plate.front=0.1"], &["by the angle", "nsq-gpu diff"]);
    let mut other = ir.clone();
    other.surfaces[front].interaction = Interaction::Absorbing;
    refused(&other, &["plate.front=0.1"], &["absorbs all light", "a face that reflects"]);
    other.surfaces[front].interaction = Interaction::Reflective { reflectance: vec![0.9; 2] };
    other.surfaces[front].coating = None;
    refused(&other, &["plate.front=0.1,0.5"], &["is a mirror", "R alone"]);
    assert!(recoating(&other, &["plate.front=0.1"]).is_ok());
    other.surfaces[front].name = "plate.back".into();
    refused(&other, &["plate.back=0.1"], &["several faces have this name"]);
}

/// Light between two mirrors, of which one is recoated: a factor a reflection.
#[test]
fn mirrors_have_a_factor_for_each_reflection() {
    let ir = zoo::load("bench_cavity");
    let tally = zoo::trace(&ir, &TraceOptions { max_depth: 24, ..options(1000) });
    let rows = table(&ir, &tally, 1000, Grouping::Sequence, &["M_far.surface=0.5"]);
    assert!(rows.len() >= 12);
    for row in &rows {
        let far = row.steps.iter().filter(|[_, name]| name == "M_far.surface").count() as i32;
        let near = row.reflections as i32 - far;
        let expected = 0.5_f64.powi(far) * 0.98_f64.powi(near);
        assert!((row.flux / expected - 1.0).abs() < 1e-12, "{row:?} not {expected}");
    }
}

fn written(folder: &Path, text: &str) -> String {
    let path = folder.join("plate.json");
    std::fs::write(&path, text).unwrap();
    path.to_str().unwrap().to_string()
}

fn json_of(arguments: &[&str]) -> Value {
    let said = run(arguments);
    assert!(said.status.success(), "{arguments:?}: {}", stderr(&said));
    serde_json::from_slice(&said.stdout).unwrap()
}

#[test]
fn the_command_lists_rows_with_new_coatings_and_ranks_them() {
    let folder = tempfile::tempdir().unwrap();
    let scene = written(folder.path(), &plate_text([[0.2, 0.7], [0.3, 0.65]]));
    let plain = json_of(&["paths", &scene, "-n=300", "--json"]);
    for key in ["recoated", "coatings", "coating_warnings"] {
        assert_eq!(plain.get(key), None, "{key} stands where nobody asked for it");
    }
    let out = folder.path().join("out");
    let options = ["--recoat=plate.front=0.1,0.8", "--rank-coatings", "--no-pictures"];
    let arguments =
        [&["paths", &scene, "-n=300", "--json", "-o", out.to_str().unwrap()] as &[&str], &options];
    let found = json_of(&arguments.concat());
    let expected = json!([{"face": "plate.front", "old_reflectance": 0.2, "old_transmittance": 0.7,
        "reflectance": 0.1, "transmittance": 0.8}]);
    assert_eq!(found["recoated"], expected);
    let ratio = |row: usize| {
        found["paths"][row]["flux"].as_f64().unwrap() / plain["paths"][row]["flux"].as_f64().unwrap()
    };
    assert!((ratio(0) - 0.8 / 0.7).abs() < 1e-12 && (ratio(1) - 0.5 * 0.8 / 0.7).abs() < 1e-12);
    assert_eq!(found["coatings"].as_array().unwrap().len(), 2);
    let report: Value = serde_json::from_slice(&std::fs::read(out.join("report.json")).unwrap()).unwrap();
    assert_eq!((&report["recoated"], &report["coatings"]), (&expected, &found["coatings"]));
    let table = nsq_gpu::result::TraceResult::read(&out).unwrap().paths.unwrap();
    assert_eq!(json!(table.recoated), expected);
    assert_eq!(json!(table.coatings), found["coatings"]);
    // A map would have the coatings of the trace.
    assert!(!out.join("path_1.npz").exists() && report["detectors"].get("path_1").is_none());
    let verified = run(&["verify", out.to_str().unwrap()]);
    assert!(verified.status.success(), "{}", stderr(&verified));
    let said = String::from_utf8(run(&["paths", &scene, "-n=300", options[0], options[1]]).stdout).unwrap();
    assert!(said.contains("recoated: plate.front, R 0.2 -> 0.1, T 0.7 -> 0.8\n"), "{said}");
    assert!(
        said.contains("\nface                    R     dF/dR W  std. error   % of ghosts   dpeak/dR W/mm2\n"),
        "{said}"
    );
}

#[test]
fn bare_faces_have_a_share_and_a_reason() {
    let said = run(&[
        "paths",
        "scenes/double_gauss.json",
        "-n=3000",
        "--split-depth=8",
        "--rank-coatings",
        "--detector=image",
    ]);
    let text = String::from_utf8(said.stdout).unwrap();
    let reason = "-: no dF/dR, as the face is bare: what it reflects depends on the angle: face_";
    assert!(text.contains(reason), "{text}");
    let refused = run(&["paths", "scenes/double_gauss.json", "-n=3000", "--recoat=face_9=0.01"]);
    assert_eq!(refused.status.code(), Some(2));
    assert!(stderr(&refused).contains("recoat face_9: the face is bare"), "{}", stderr(&refused));
}
