//! A stage for the path that most rays take changes no bit of any result.
#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "clippy's exemption of tests does not reach their helpers"
)]

mod zoo;

use glam::{DMat3, DQuat, DVec3};
use nsq_gpu::ir::{Frame, Interaction, Outline, SceneIr, SensorKind, Shape, Surface};
use nsq_gpu::program::Precision;
use nsq_gpu::program::nominal::NominalPath;
use nsq_gpu::program::rng::Sampler;
use nsq_gpu::result::Tally;
use nsq_gpu::{StandardError, TraceOptions, Tracer};
use proptest::prelude::*;

fn options(precision: Precision) -> TraceOptions {
    TraceOptions {
        num_rays: 4000,
        seed: 5,
        precision,
        standard_error: StandardError::Off,
        nominal_path: Some(false),
        ..TraceOptions::default()
    }
}

/// The tally, with the path that had a stage of its own.
fn trace(ir: &SceneIr, options: &TraceOptions) -> (Tally, Option<NominalPath>) {
    let mut tracer = Tracer::new(zoo::gpu(), ir, options).unwrap();
    let tally = tracer.trace(|_| true).unwrap();
    (tally, tracer.program().nominal.clone())
}

fn with_nominal_path(options: &TraceOptions) -> TraceOptions {
    TraceOptions { nominal_path: Some(true), ..options.clone() }
}

/// Scenes of every kind that have a path to give a stage to.
const SOME: [&str; 6] = [
    "bench_lens",
    "tessar_gaussian_beams",
    "cooke_triplet",
    "mangin_catadioptric",
    "coated_projector",
    "light_pipe",
];

/// Asserts that a scene has the same bits with the stage; false if it cannot have one.
fn has_same_bits(name: &str, options: &TraceOptions) -> bool {
    let ir = zoo::load(name);
    let (tally, nominal) = trace(&ir, &with_nominal_path(options));
    if nominal.is_some() {
        assert!(tally == trace(&ir, options).0, "{name} with {options:?}: other bits");
    }
    nominal.is_some()
}

#[test]
fn the_stage_gives_the_same_bits_in_every_scene_that_has_one() {
    let precisions = [Precision::F32, Precision::F64].into_iter().cycle();
    let has = |(name, precision): &(String, Precision)| has_same_bits(name, &options(*precision));
    let found: Vec<String> =
        zoo::scenes().into_iter().zip(precisions).filter(has).map(|(name, _)| name).collect();
    println!("{found:?}");
    let missing: Vec<&&str> = SOME.iter().filter(|name| !found.iter().any(|found| found == *name)).collect();
    assert!(missing.is_empty(), "no nominal path in {missing:?}");
}

#[test]
fn so_do_small_batches_and_strays_that_go_through_queues() {
    for (name, precision) in SOME.into_iter().zip([Precision::F32, Precision::F64].into_iter().cycle()) {
        let options = TraceOptions { batch_size: Some(300), events_per_dispatch: 2, ..options(precision) };
        assert!(has_same_bits(name, &options), "{name} has no nominal path");
    }
}

#[test]
fn so_do_invocations_of_one_ray_or_several() {
    for (i, name) in SOME.into_iter().enumerate() {
        let ir = zoo::load(name);
        let precision = [Precision::F32, Precision::F64][i % 2];
        let rays = |num| TraceOptions { rays_per_invocation: Some(num), ..options(precision) };
        let alone = trace(&ir, &rays(1)).0;
        for num in [1, 3, 8] {
            let (tally, nominal) = trace(&ir, &with_nominal_path(&rays(num)));
            assert!(nominal.is_some() && tally == alone, "{name}, {num} rays an invocation");
        }
    }
}

#[test]
fn so_do_sobol_points() {
    for (name, precision) in SOME.into_iter().zip([Precision::F64, Precision::F32].into_iter().cycle()) {
        let options = TraceOptions { sampler: Sampler::Sobol, ..options(precision) };
        assert!(has_same_bits(name, &options), "{name} has no nominal path");
    }
}

/// Of a lens, the caps and the rim between them touch; the detector stands apart.
#[test]
fn what_can_be_met_on_the_way_is_asked_and_nothing_else() {
    let ir = zoo::load("bench_lens");
    let (_, nominal) = trace(&ir, &with_nominal_path(&options(Precision::F64)));
    let (front, back, rim, detector) = (0, 1, 2, 3);
    let asked: Vec<(usize, Vec<usize>)> =
        nominal.unwrap().events.into_iter().map(|event| (event.primitive, event.candidates)).collect();
    assert_eq!(
        asked,
        [(front, vec![front, rim]), (back, vec![front, back, rim]), (detector, vec![back, rim, detector])]
    );
}

/// A speck anywhere in a lens's beam, turned anyhow.
fn speck(place: DVec3, radius: f64, turn: DQuat) -> Surface {
    Surface {
        name: "speck".into(),
        frame: Frame { origin: place, rotation: DMat3::from_quat(turn) },
        shape: Shape::Plane(Outline::Disk { radius }),
        front: 0,
        back: 0,
        interaction: Interaction::Absorbing,
        ..zoo::load("bench_lens").surfaces.remove(0)
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 16, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn specks_in_the_way_are_met_by_the_same_rays(
        place in [-8.0..8.0f64, -8.0..8.0f64, -24.0..149.0f64],
        radius in 0.5..5.0f64,
        axis in [-1.0..1.0f64, -1.0..1.0f64, 0.1..1.0f64],
        angle in 0.0..std::f64::consts::TAU,
    ) {
        let mut ir = zoo::load("bench_lens");
        let turn = DQuat::from_axis_angle(DVec3::from_array(axis).normalize(), angle);
        ir.surfaces.push(speck(DVec3::from_array(place), radius, turn));
        for precision in [Precision::F32, Precision::F64] {
            let options = options(precision);
            let (tally, nominal) = trace(&ir, &with_nominal_path(&options));
            prop_assert!(nominal.is_some());
            prop_assert!(tally == trace(&ir, &options).0, "other bits");
        }
    }
}

/// Faces closer than a long way's roundings, at the end of it: which of them a ray meets first is chance, and what the
/// one that it missed does then is not.
#[test]
fn faces_within_the_roundings_of_a_long_way_are_met_by_the_same_rays() {
    const FAR: f64 = 5e4;
    for gap in [1e-4, 1e-3, 3e-3, 1e-2] {
        let mut ir = zoo::load("bench_lens");
        let mut film = ir.surfaces[0].clone();
        film.name = "film".into();
        film.frame.origin.z -= gap;
        film.back = film.front;
        ir.surfaces.push(film);
        ir.emitters[0].frame.origin.z = -FAR;
        ir.sensors[0].frame.origin.z = FAR;
        if let SensorKind::Irradiance(grid) = &mut ir.sensors[0].kind {
            (grid.width, grid.height) = (FAR, FAR);
        }
        let options = options(Precision::F32);
        let (tally, nominal) = trace(&ir, &with_nominal_path(&options));
        assert!(nominal.is_some());
        assert!(tally == trace(&ir, &options).0, "{gap} mm: other bits");
    }
}

#[test]
fn short_traces_and_those_that_record_rays_have_none() {
    let ir = zoo::load("bench_lens");
    let nominal = |change: fn(&mut TraceOptions)| {
        let mut options = TraceOptions { nominal_path: Some(true), ..options(Precision::F64) };
        change(&mut options);
        trace(&ir, &options).1
    };
    assert!(nominal(|_| ()).is_some());
    assert!(nominal(|options| options.nominal_path = None).is_none());
    assert!(nominal(|options| options.host_sums = Some(false)).is_none());
    assert!(nominal(|options| options.strict = nsq_gpu::trace::Strict::Off).is_none());
    assert!(nominal(|options| options.standard_error = StandardError::On).is_none());
    assert!(nominal(|options| options.paths = nsq_gpu::trace::RecordPaths::All).is_none());
}
