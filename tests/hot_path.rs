//! A stage for the path that most rays take changes no bit of any result.
#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "clippy's exemption of tests does not reach their helpers"
)]

mod zoo;

use glam::{DMat3, DQuat, DVec3};
use nsq_gpu::cpu::Override;
use nsq_gpu::cpu::path::hot_path::{Crossing, HotPath};
use nsq_gpu::cpu::path::miss_test::{MissTest, Sign};
use nsq_gpu::cpu::path::side_trace::SideTrace;
use nsq_gpu::cpu::request::CpuShader;
use nsq_gpu::model::{
    Annulus, Collimated, Conic, DetectorKind, Frame, Frustum, Interaction, Outline, Point, SceneIr, Shape,
    SourceKind, Spectrum, Sphere, Surface,
};
use nsq_gpu::program::Precision;
use nsq_gpu::program::layout::rng::Sampler;
use nsq_gpu::result::Tally;
use nsq_gpu::{StandardError, TraceOptions, Tracer};
use proptest::prelude::*;
use zoo::forced::{Asked, Forced};

fn options(precision: Precision) -> TraceOptions {
    TraceOptions {
        num_rays: 4000,
        seed: 5,
        precision,
        standard_error: StandardError::Off,
        ..TraceOptions::default()
    }
}

/// The tally, with the path that had a stage of its own.
fn trace(ir: &SceneIr, options: &impl Asked) -> (Tally, Option<HotPath>) {
    let mut tracer = options.tracer(zoo::gpu(), ir).unwrap();
    let tally = tracer.trace(|_| true).unwrap();
    (tally, CpuShader::of_program(tracer.program()).hot_path.clone())
}

/// Of each place that the path's rays log, how often they arrive there; none where they log entries.
fn arrivals(ir: &SceneIr, options: &impl Asked) -> Option<Vec<usize>> {
    let tracer = with_hot_path(options).tracer(zoo::gpu(), ir).unwrap();
    let log = CpuShader::of_program(tracer.program()).path_log.as_ref()?;
    Some(log.places.iter().map(|place| place.arrivals.len()).collect())
}

/// Along the hot path and all side traces.
fn with_hot_path(options: &impl Asked) -> Forced {
    options
        .with(|overrides| (overrides.hot_path, overrides.side_traces) = (Override::Always, Override::Always))
}

/// Asserts that without this text of the shader the bits are others.
fn assert_needed(text: &str, ir: &SceneIr, options: &impl Asked, tally: &Tally) {
    let without = zoo::edited(ir, options, text, "").trace(|_| true).unwrap();
    assert!(without != *tally, "{text}: no ray needs it");
}

/// Scenes of every kind that have a path to give a stage to.
const SOME: [&str; 7] = [
    "bench_lens",
    "tessar_gaussian_beams",
    "cooke_triplet",
    "mangin_catadioptric",
    "coated_projector",
    "light_pipe",
    "bench_cavity",
];

/// Asserts that a scene has the same bits with the stage; false if it cannot have one.
fn has_same_bits(name: &str, options: &TraceOptions) -> bool {
    let ir = zoo::load(name);
    let (tally, hot_path) = trace(&ir, &with_hot_path(options));
    if hot_path.is_some() {
        assert!(tally == trace(&ir, options).0, "{name} with {options:?}: other bits");
    }
    hot_path.is_some()
}

#[test]
fn the_stage_gives_the_same_bits_in_some_scenes() {
    for (name, precision) in
        zoo::in_turn(SOME.into_iter().zip([Precision::F32, Precision::F64].into_iter().cycle()))
    {
        assert!(has_same_bits(name, &options(precision)), "{name} has no hot path");
    }
}

#[test]
#[ignore = "long"]
fn the_stage_gives_the_same_bits_in_every_scene_that_has_one() {
    let precisions = [Precision::F32, Precision::F64].into_iter().cycle();
    let has = |(name, precision): &(String, Precision)| has_same_bits(name, &options(*precision));
    let found: Vec<String> =
        zoo::scenes().into_iter().zip(precisions).filter(has).map(|(name, _)| name).collect();
    println!("{found:?}");
    let places = |name: &&String| arrivals(&zoo::load(name), &options(Precision::F64)).is_some();
    println!("of them with places: {:?}", found.iter().filter(places).collect::<Vec<_>>());
    let missing: Vec<&&str> = SOME.iter().filter(|name| !found.iter().any(|found| found == *name)).collect();
    assert!(missing.is_empty(), "no hot path in {missing:?}");
}

#[test]
#[ignore = "long"]
fn small_batches_and_failed_rays_in_queues_have_the_same_bits() {
    for (name, precision) in SOME.into_iter().zip([Precision::F32, Precision::F64].into_iter().cycle()) {
        let options = TraceOptions { batch_size: Some(300), events_per_dispatch: 2, ..options(precision) };
        assert!(has_same_bits(name, &options), "{name} has no hot path");
    }
}

#[test]
#[ignore = "long"]
fn invocations_of_one_ray_or_several_have_the_same_bits() {
    for (i, name) in SOME.into_iter().enumerate() {
        let ir = zoo::load(name);
        let precision = [Precision::F32, Precision::F64][i % 2];
        let rays = |num| options(precision).with(|overrides| overrides.rays_per_invocation = Some(num));
        let alone = trace(&ir, &rays(1)).0;
        for num in [1, 3, 8] {
            let (tally, hot_path) = trace(&ir, &with_hot_path(&rays(num)));
            assert!(hot_path.is_some() && tally == alone, "{name}, {num} rays an invocation");
        }
    }
}

/// Two mirrors between which rays pass a detector at one place after the other.
fn cavity_without_losses() -> SceneIr {
    let mut ir = zoo::load("bench_cavity");
    ir.sources[0].frame.rotation = DMat3::from_rotation_y(0.02);
    for mirror in &mut ir.surfaces {
        mirror.interaction = Interaction::Reflective { reflectance: vec![1.0] };
    }
    ir
}

/// An invocation follows two rays, where they leave nothing but what they log.
#[test]
#[ignore = "long"]
fn rays_side_by_side_have_the_same_bits() {
    let [lens, cavity, cooke, coated] =
        ["bench_lens", "bench_cavity", "cooke_triplet", "coated_projector"].map(zoo::load);
    let aslant = cavity_without_losses();
    // A lens without its first face: rays leave a solid that they have not entered, and that is counted.
    let mut open = lens.clone();
    open.surfaces.remove(0);
    for (name, ir, max_depth, is_possible) in [
        ("lens", &lens, 16, true),
        ("cavity", &aslant, 6, true),
        ("cavity with losses", &cavity, 6, false),
        ("triplet", &cooke, 16, true),
        ("coated projector", &coated, 16, false),
        ("open lens", &open, 16, false),
    ] {
        // Workgroups that are full; one ray more or less; one ray; the second half of the last one without a ray.
        for (num_rays, precision) in [
            (4096, Precision::F32),
            (4097, Precision::F64),
            (4095, Precision::F32),
            (1, Precision::F64),
            (4150, Precision::F32),
        ] {
            let rays = TraceOptions { num_rays, max_depth, ..options(precision) };
            let tally = trace(ir, &rays).0;
            for (side_by_side, batch_size) in [(true, None), (true, Some(1001)), (false, None)] {
                let rays = TraceOptions { batch_size, ..rays.clone() };
                let with = with_hot_path(&rays)
                    .with(|overrides| overrides.side_by_side = Override::forced(side_by_side));
                let mut tracer = with.tracer(zoo::gpu(), ir).unwrap();
                let has_pairs = tracer.program().wgsl.contains("follow_pair");
                assert_eq!(has_pairs, side_by_side && is_possible, "{name}, {num_rays} rays");
                assert!(CpuShader::of_program(tracer.program()).hot_path.is_some(), "{name} has no path");
                let traced = tracer.trace(|_| true).unwrap();
                assert!(traced == tally, "{name}, {num_rays} rays in {precision:?}: other bits");
            }
        }
    }
    assert!(trace(&open, &options(Precision::F32)).0.medium_stack_underflows > 0, "nothing is counted");
}

/// Errors planted in what two rays share.
#[test]
fn errors_in_rays_side_by_side_are_seen() {
    let lens = zoo::load("bench_lens");
    let rays = options(Precision::F32);
    let tally = trace(&lens, &rays).0;
    for text in ["    take_up_b();\n", "    put_by_b();\n"] {
        assert_needed(text, &lens, &with_hot_path(&rays), &tally);
    }
    // Rays beyond the last one log over the next places of the first.
    let aslant = cavity_without_losses();
    let rays = TraceOptions { num_rays: 4150, max_depth: 6, ..options(Precision::F64) };
    let tally = trace(&aslant, &rays).0;
    let (right, wrong) = ("select(first, second, second < range.count)", "second");
    let traced = zoo::edited(&aslant, &with_hot_path(&rays), right, wrong).trace(|_| true);
    assert!(traced.is_err() || traced.unwrap() != tally, "{wrong} is not seen");
}

#[test]
#[ignore = "long"]
fn scenes_in_tables_have_the_same_bits() {
    for (i, name) in SOME.into_iter().enumerate() {
        let precision = [Precision::F64, Precision::F32][i % 2];
        let options = TraceOptions {
            baked: Some(false),
            tree: Some(i % 4 < 2),
            batch_size: Some(900),
            ..options(precision)
        };
        assert!(has_same_bits(name, &options), "{name} has no hot path");
    }
}

/// Rays that go to and fro between mirrors until they have had as many events as a ray may have, and those that leave.
#[test]
fn rays_that_end_by_their_number_of_events_have_the_same_bits() {
    let mut ir = zoo::load("bench_cavity");
    ir.sources[0].frame.rotation = DMat3::from_rotation_y(0.02);
    ir.sources[0].kind = SourceKind::Collimated(Collimated { aperture_radius: 12.0, sigma: Some(4.0) });
    for (max_depth, precision) in [(1, Precision::F64), (6, Precision::F32), (13, Precision::F64)] {
        let options = TraceOptions { max_depth, ..options(precision) };
        let (tally, hot_path) = trace(&ir, &with_hot_path(&options));
        let events = hot_path.unwrap().events;
        assert!(events.len() == max_depth as usize && events.iter().all(|event| !event.ends));
        assert!(max_depth < 13 || tally.escaped.count > 0, "no ray is unlike the others");
        assert!(tally == trace(&ir, &options).0, "other bits to a depth of {max_depth}");
    }
    let deeper = TraceOptions { max_depth: 40, ..options(Precision::F32) };
    assert!(trace(&ir, &with_hot_path(&deeper)).1.is_none(), "a profile so deep sees no end");
}

/// Rays that arrive on a detector again and again at the same place log it once, and others each time.
#[test]
fn what_rays_weigh_and_where_they_arrive_again_is_not_logged() {
    let straight = zoo::load("bench_cavity");
    let mut aslant = straight.clone();
    aslant.sources[0].frame.rotation = DMat3::from_rotation_y(0.02);
    let mut absorbing = straight.clone();
    absorbing.surfaces[1].interaction = Interaction::Absorbing;
    let mut two_detectors = straight.clone();
    two_detectors.detectors.push(straight.detectors[0].clone());
    two_detectors.detectors[1].name = "second".into();
    two_detectors.detectors[1].frame.origin.z = -10.0;
    let mut turned = two_detectors.clone();
    turned.detectors[1].frame.rotation = DMat3::from_rotation_y(0.1);
    let two_sources = |share: f64| {
        let mut ir = straight.clone();
        let second = straight.sources[0].clone();
        ir.sources.push(second);
        ir.sources[1].total_flux *= share;
        ir
    };
    for (ir, max_depth, num_rays, expected) in [
        (&straight, 16, 4000, Some(vec![8])),
        (&straight, 31, 4000, Some(vec![16])),
        (&aslant, 6, 4000, Some(vec![1, 1, 1])),
        (&absorbing, 16, 4000, Some(vec![2])),
        (&two_detectors, 16, 4000, Some(vec![6, 5])),
        // Rays of two weights; of one; and of two, but for those of the profile.
        (&two_sources(0.3), 5, 4000, None),
        (&two_sources(1.0), 5, 4000, Some(vec![3])),
        (&two_sources(1.0), 5, 4001, None),
    ] {
        for precision in zoo::in_turn([Precision::F32, Precision::F64]) {
            let options = TraceOptions { max_depth, num_rays, batch_size: Some(1500), ..options(precision) };
            assert_eq!(arrivals(ir, &options), expected, "{num_rays} rays to a depth of {max_depth}");
            let (tally, hot_path) = trace(ir, &with_hot_path(&options));
            assert!(hot_path.is_some());
            assert!(tally == trace(ir, &options).0, "{expected:?}: other bits");
        }
    }
    // Roundings decide how many places those from either side of a turned detector are.
    let options = options(Precision::F64);
    assert!(arrivals(&turned, &options).is_some_and(|arrivals| arrivals.iter().sum::<usize>() == 11));
    assert!(trace(&turned, &with_hot_path(&options)).0 == trace(&turned, &options).0, "other bits");
}

/// On how many of its ways a ray loses something to the media, where the path's rays log what they weigh; none where they do
/// not.
fn attenuating_legs(ir: &SceneIr, options: &TraceOptions) -> Option<u32> {
    let tracer = with_hot_path(options).tracer(zoo::gpu(), ir).unwrap();
    CpuShader::of_program(tracer.program()).path_log.as_ref()?.attenuating_legs
}

/// A lens whose glass takes a tenth of the light.
fn tinted_lens() -> SceneIr {
    let mut ir = zoo::load("bench_lens");
    let glass = ir.surfaces[0].back;
    ir.media[glass].k.fill(1e-6);
    ir
}

/// The same, and a lamp so weak that its rays are not among the profile's of the path, but some of them take it; in whatever
/// medium it stands.
fn tinted_lens_of_two_sources(medium: usize) -> SceneIr {
    let mut ir = tinted_lens();
    let mut lamp = ir.sources[0].clone();
    lamp.kind = SourceKind::Point(Point { half_angle: 1.2 });
    lamp.total_flux *= 0.003;
    lamp.medium = medium;
    ir.sources.push(lamp);
    ir
}

/// The same in air that absorbs, and the lamp a hundred times as far from the lens as the beam's source: air takes more from
/// the lamp's rays.
fn tinted_lens_of_a_far_lamp(k_of_air: f64) -> SceneIr {
    let mut ir = tinted_lens_of_two_sources(SceneIr::VACUUM);
    ir.sources[1].frame.origin.z = -2500.0;
    ir.sources[1].kind = SourceKind::Point(Point { half_angle: 0.0125 });
    let air = ir.surfaces[0].front;
    ir.media[air].k.fill(k_of_air);
    ir
}

/// What media took from rays of a path follows from what they weigh at its end.
#[test]
fn where_media_alone_take_from_rays_they_log_what_they_weigh() {
    let lens = tinted_lens();
    let (air, glass) = (lens.surfaces[0].front, lens.surfaces[0].back);
    let mut hazy = lens.clone();
    hazy.media[air].k.fill(1e-8);
    // Weights differ from place to place.
    let mut through_a_window = hazy.clone();
    let mut window = lens.detectors[0].clone();
    (window.name, window.absorb, window.frame.origin.z) = ("window".into(), false, 20.0);
    through_a_window.detectors.push(window);
    let mut past_a_mirror = lens.clone();
    let mut mirror = lens.surfaces[2].clone();
    mirror.shape = Shape::Plane(Outline::Disk { radius: 40.0 });
    mirror.interaction = Interaction::Reflective { reflectance: vec![0.9] };
    mirror.back = mirror.front;
    mirror.frame = Frame { origin: DVec3::new(0.0, 0.0, 50.0), rotation: DMat3::IDENTITY };
    past_a_mirror.surfaces.push(mirror);
    past_a_mirror.detectors[0].frame.origin.z = -30.0;
    // Of two wavelengths, the glass takes from one alone.
    let mut of_two_colours = lens.clone();
    of_two_colours.wavelengths.push(0.6);
    for medium in &mut of_two_colours.media {
        medium.n.push(medium.n[0]);
        medium.k.push(0.0);
    }
    let mut in_both = of_two_colours.clone();
    in_both.media[glass].k.fill(1e-6);
    for ir in [&mut of_two_colours, &mut in_both] {
        ir.sources[0].spectrum = Spectrum { wavelengths: vec![0, 1], cdf: vec![0.5, 1.0] };
    }
    // Nothing on the path absorbs, but sources of unlike rays do not tell their weights before.
    let mut beside_a_filter = tinted_lens_of_two_sources(air);
    beside_a_filter.media.push(beside_a_filter.media[glass].clone());
    beside_a_filter.media[glass].k.fill(0.0);
    let mut filter = lens.surfaces[0].clone();
    filter.shape = Shape::Plane(Outline::Disk { radius: 5.0 });
    filter.back = beside_a_filter.media.len() - 1;
    filter.frame = Frame { origin: DVec3::new(40.0, 0.0, -20.0), rotation: DMat3::IDENTITY };
    beside_a_filter.surfaces.push(filter);
    for (ir, expected) in [
        (&lens, Some(1)),
        (&hazy, Some(3)),
        (&through_a_window, Some(4)),
        (&of_two_colours, None),
        (&in_both, Some(1)),
        (&beside_a_filter, Some(0)),
        (&tinted_lens_of_two_sources(air), Some(1)),
        (&tinted_lens_of_two_sources(glass), Some(1)),
        (&past_a_mirror, None),
        (&zoo::load("bench_lens"), None),
    ] {
        for precision in zoo::in_turn([Precision::F32, Precision::F64]) {
            let rays = TraceOptions { num_rays: 20_000, batch_size: Some(5_500), ..options(precision) };
            assert_eq!(attenuating_legs(ir, &rays), expected, "in {precision:?}");
            let tally = trace(ir, &rays).0;
            for (baked, gpu) in [(true, zoo::gpu()), (false, zoo::portable_gpu())] {
                let rays = TraceOptions { baked: Some(baked), ..rays.clone() };
                assert!(
                    zoo::trace_on(gpu, ir, &with_hot_path(&rays)) == tally,
                    "{expected:?} in {precision:?}: other bits"
                );
            }
        }
    }
}

/// Errors planted in what tells that rays have lost what their weights say.
#[test]
fn errors_in_what_rays_lose_along_the_path_are_seen() {
    let glass = tinted_lens().surfaces[0].back;
    // So high that of the rays through the middle of the lens, where it is thickest, a few come to roulette.
    let lens = tinted_lens();
    let path_um = 4.0 * std::f64::consts::PI * 1e-6 * 5e3;
    let threshold = (-path_um / lens.wavelengths[0]).exp() * (1.0 + 2e-5);
    // Of those of the profile as well.
    let high = TraceOptions { min_flux_fraction: 0.91, ..options(Precision::F64) };
    assert_eq!(attenuating_legs(&lens, &high), None);
    // On the beam's ways, the weight's rounding hides what air takes: air takes something from rays of the lamp alone.
    let way_um = 1.5e5;
    let beside_a_far_lamp = |rounding: f64| {
        let k = 0.25 * rounding * lens.wavelengths[0] / (4.0 * std::f64::consts::PI * way_um);
        let mut ir = tinted_lens_of_a_far_lamp(k);
        ir.media[glass].k.fill(4e-7);
        ir
    };
    let each = [Precision::F32, Precision::F64];
    let (in_f32, in_f64) = (beside_a_far_lamp(2f64.powi(-24)), beside_a_far_lamp(2f64.powi(-53)));
    for (ir, precisions, min_flux_fraction, legs, right, wrong) in [
        (in_f32, &each[..1], 0.0, 1, "num_losses == attenuating_legs", "num_losses > 0u"),
        (in_f64, &each[1..], 0.0, 1, "num_losses == attenuating_legs", "num_losses > 0u"),
        (tinted_lens(), &each[..], threshold, 1, "(*ray).weight >= ROULETTE_THRESHOLD", "true"),
        (tinted_lens_of_a_far_lamp(1e-8), &each[..], 0.0, 3, "abs(exponent) <= NEAR_ZERO", "true"),
    ] {
        for &precision in precisions {
            let options = TraceOptions { min_flux_fraction, num_rays: 20_000, ..options(precision) };
            let with = with_hot_path(&options);
            let tally = trace(&ir, &options).0;
            assert_eq!(attenuating_legs(&ir, &options), Some(legs), "{right}");
            assert!(trace(&ir, &with).0 == tally, "{right}: other bits");
            let edited = zoo::edited(&ir, &with, right, wrong).trace(|_| true).unwrap();
            assert!(edited != tally, "{wrong} is not seen");
        }
    }
}

/// Roulette, which makes those that it spares weigh more on the way.
#[test]
fn rays_that_roulette_has_spared_have_the_same_bits() {
    let ir = zoo::load("bench_cavity");
    for precision in [Precision::F32, Precision::F64] {
        let options = TraceOptions { max_depth: 8, min_flux_fraction: 0.95, ..options(precision) };
        let (tally, hot_path) = trace(&ir, &with_hot_path(&options));
        assert!(hot_path.is_some() && tally.roulette_loss.count > 0);
        assert!(tally == trace(&ir, &options).0, "other bits");
    }
}

/// Dispatches of the stages that new rays, and those that fall back, go through.
fn dispatches(tracer: &mut Tracer) -> [u64; 2] {
    tracer.enable_profile().unwrap();
    tracer.trace(|_| true).unwrap();
    let times = tracer.stage_times();
    let of =
        |stage: &str| times.iter().find(|time| time.stage == stage).map_or(0, |time| time.num_dispatches);
    ["trace_hot_path", "trace_new"].map(of)
}

/// The primitives of each side trace that logs places, with the event at which its rays failed and whether they escape.
fn side_traces(tracer: &Tracer) -> Vec<(usize, Vec<usize>, bool)> {
    let of = |side: &SideTrace| {
        let primitives = side.path.events.iter().map(|event| event.primitive).collect();
        (side.fails_at, primitives, side.path.missed.is_some())
    };
    CpuShader::of_program(tracer.program()).side_traces.iter().map(of).collect()
}

/// What a lens reflects back at its faces has stages of its own: nearly nothing is left to the stage of all others.
#[test]
fn rays_failed_alike_follow_side_traces() {
    let (air, glass) = (tinted_lens().surfaces[0].front, tinted_lens().surfaces[0].back);
    let mut hazy = tinted_lens();
    hazy.media[air].k.fill(1e-8);
    let there_and_back = vec![(0, vec![0], true), (1, vec![0, 1, 0], true)];
    for (ir, attenuating_legs) in [
        (zoo::load("bench_lens"), [None; 2]),
        (tinted_lens(), [Some(0), Some(2)]),
        (hazy, [Some(1), Some(3)]),
        (tinted_lens_of_two_sources(air), [Some(0), Some(2)]),
        (tinted_lens_of_two_sources(glass), [Some(0), Some(2)]),
    ] {
        for precision in zoo::in_turn([Precision::F32, Precision::F64]) {
            let rays = TraceOptions { num_rays: 20_000, batch_size: Some(5_500), ..options(precision) };
            let mut tracer = with_hot_path(&rays).tracer(zoo::gpu(), &ir).unwrap();
            assert_eq!(side_traces(&tracer)[..2], there_and_back, "{precision:?}");
            let legs = CpuShader::of_program(tracer.program())
                .side_traces
                .iter()
                .map(|side| side.log.as_ref().unwrap().attenuating_legs);
            assert!(legs.take(2).eq(attenuating_legs), "not {attenuating_legs:?}");
            let without = with_hot_path(&rays).with(|overrides| overrides.side_traces = Override::Never);
            assert_eq!(side_traces(&without.tracer(zoo::gpu(), &ir).unwrap()), []);
            let tally = trace(&ir, &rays).0;
            assert!(tracer.trace(|_| true).unwrap() == tally, "{precision:?}: other bits");
            assert!(trace(&ir, &without).0 == tally, "{precision:?}: other bits without side traces");
            for [num_followed, num_failed] in &tracer.num_along_paths()[..3] {
                assert!(
                    *num_followed > 500 && 6 * num_failed < *num_followed,
                    "{num_failed} of {num_followed}"
                );
            }
        }
    }
}

/// A lens, and a ring far before it, which catches the outermost of the rays that it reflects.
fn ring_before_a_lens() -> SceneIr {
    let mut ir = gaussian_lens(2.2);
    let ring = Shape::Annulus(Annulus { inner_radius: 12.0, outer_radius: 60.0, z_offset: 0.0 });
    ir.surfaces.push(speck(DVec3::new(0.0, 0.0, -24.0), ring, DQuat::IDENTITY));
    ir
}

/// Or a plate along its axis.
fn plate_before_a_lens() -> SceneIr {
    let mut ir = gaussian_lens(2.2);
    let plate = Shape::Plane(Outline::Disk { radius: 8.0 });
    let along = DQuat::from_rotation_y(std::f64::consts::FRAC_PI_2);
    ir.surfaces.push(speck(DVec3::new(6.0, 0.0, -16.0), plate, along));
    ir
}

/// A strongly curved lens, and a ring around its cap whose plane nearly all rays never reach that the cap reflects; but those of a
/// weak lamp between the two.
fn ring_around_a_lens() -> SceneIr {
    let mut ir = gaussian_lens(2.1);
    ir.surfaces[0].shape = Shape::Conic(Conic { curvature: 1.0 / 20.0, conic: 0.0, aperture_radius: 12.5 });
    let glass = ir.surfaces[0].back;
    ir.media[glass].n.fill(3.0);
    ir.detectors[0].frame.origin.z = 20.0;
    let ring = Shape::Annulus(Annulus { inner_radius: 7.8, outer_radius: 40.0, z_offset: 0.0 });
    ir.surfaces.push(speck(DVec3::new(0.0, 0.0, 1.35), ring, DQuat::IDENTITY));
    let mut lamp = ir.sources[0].clone();
    lamp.kind = SourceKind::Collimated(Collimated { aperture_radius: 0.05, sigma: None });
    lamp.frame.origin = DVec3::new(7.72, 0.0, 1.42);
    lamp.total_flux *= 0.003;
    ir.sources.push(lamp);
    ir
}

#[test]
fn rays_that_do_not_escape_as_nearly_all_have_the_same_bits() {
    for (ir, spared, [right, wrong]) in [
        (ring_before_a_lens(), Some("inside, to the exit"), NEVER_INSIDE),
        (plate_before_a_lens(), None, [".primitive == NONE) &", ".primitive != 99u) &"]),
        (ring_around_a_lens(), Some("past"), ["return exit_distance <= 0.0;", "return true;"]),
    ] {
        for precision in zoo::in_turn([Precision::F32, Precision::F64]) {
            let options = TraceOptions { num_rays: 100_000, ..options(precision) };
            let with = with_hot_path(&options);
            let mut tracer = with.tracer(zoo::gpu(), &ir).unwrap();
            let sides = &CpuShader::of_program(tracer.program()).side_traces;
            let reflected = sides.iter().find(|side| side.fails_at == 0 && side.path.events.len() == 1);
            let missed = reflected.and_then(|side| side.path.missed.as_ref()).unwrap();
            let passed = missed.passed.iter().find(|(i, _)| *i == 3).map(|(_, passed)| kind(passed));
            assert_eq!((passed, missed.candidates.contains(&3)), (spared, spared.is_none()), "{missed:?}");
            let tally = trace(&ir, &options).0;
            assert!(tracer.trace(|_| true).unwrap() == tally, "{spared:?} in {precision:?}: other bits");
            let edited = zoo::edited(&ir, &with, right, wrong).trace(|_| true).unwrap();
            assert!(edited != tally, "{precision:?}: {wrong} for {right} is not seen");
        }
    }
}

/// Rays that do something else than their side trace at each of its events, in scenes of several lenses.
#[test]
#[ignore = "long"]
fn rays_failed_once_more_have_the_same_bits() {
    let mut num_failed = 0;
    for name in ["cooke_triplet", "triplet_telescope_ghosts", "stacked_plates_ghosts", "bench_cavity"] {
        let ir = zoo::load(name);
        for precision in zoo::in_turn([Precision::F32, Precision::F64]) {
            let options = TraceOptions { num_rays: 20_000, batch_size: Some(1000), ..options(precision) };
            let mut tracer = with_hot_path(&options).tracer(zoo::gpu(), &ir).unwrap();
            let tally = tracer.trace(|_| true).unwrap();
            assert!(tally == trace(&ir, &options).0, "{name} in {precision:?}: other bits");
            println!("{name}: {:?} along {:?}", tracer.num_along_paths(), side_traces(&tracer));
            num_failed += tracer.num_along_paths().iter().skip(1).map(|[_, failures]| failures).sum::<u64>();
        }
    }
    assert!(num_failed > 100, "{num_failed} rays failures by side traces");
}

/// Positions along the detector's normal that differ in their last bits make no other place.
#[test]
fn rays_that_arrive_at_the_same_place_from_either_side_are_not_failed() {
    let mut ir = zoo::load("bench_cavity");
    ir.surfaces[0].frame.origin.z = 60.2;
    ir.surfaces[1].frame.origin.z = 0.0;
    ir.detectors[0].frame.origin.z = 59.0;
    ir.sources[0].frame.origin.z = 3.3;
    let options = options(Precision::F64);
    assert_eq!(arrivals(&ir, &options), Some(vec![8]));
    let mut tracer = with_hot_path(&options).tracer(zoo::gpu(), &ir).unwrap();
    assert!(matches!(dispatches(&mut tracer), [1, 0]), "rays failed");
}

/// So long a trace that it looks for a path by itself.
#[test]
fn a_path_that_fails_all_rays_is_left() {
    let ir = zoo::load("bench_lens");
    let by_itself = TraceOptions { num_rays: 1 << 22, ..options(Precision::F32) };
    let plain = by_itself.with(|overrides| overrides.hot_path = Override::Never);
    let (right, wrong) =
        ("real(kept_events)), first_arrival, holds)", "0.0), first_arrival, range.count == 0u)");
    let mut tracer = zoo::edited(&ir, &by_itself, right, wrong);
    let tally = tracer.trace(|_| true).unwrap();
    assert!(tally == trace(&ir, &plain).0, "other bits");
    let [hot_path, new] = dispatches(&mut tracer);
    assert!(8 * hot_path < new, "{hot_path} dispatches along the path, {new} of failed rays");
    let mut kept = by_itself.tracer(zoo::gpu(), &ir).unwrap();
    kept.trace(|_| true).unwrap();
    // How many dispatches these are depends on the machine's pace.
    let [along, failures] = kept.num_along_paths()[0];
    assert!(
        2 * along > by_itself.num_rays && 8 * failures < along,
        "{along} along the path, {failures} failures"
    );
}

/// Errors planted in what such rays log, in a path that arrives at three places.
#[test]
fn errors_in_the_log_of_places_are_seen() {
    let mut ir = zoo::load("bench_cavity");
    ir.sources[0].frame.rotation = DMat3::from_rotation_y(0.02);
    ir.sources[0].kind = SourceKind::Collimated(Collimated { aperture_radius: 12.0, sigma: Some(4.0) });
    let options = TraceOptions { max_depth: 6, ..options(Precision::F32) };
    let tally = trace(&ir, &options).0;
    for [right, wrong] in [
        ["number * range.log_stride + ray.index", "number * (range.log_stride - 1u) + ray.index"],
        ["log_arrival_off_edges(1u,", "log_arrival_off_edges(2u,"],
        ["select(vec2<real>(OFF_DETECTORS, real(kept_events)), first_arrival, holds)", "first_arrival"],
        ["if !holds {\n        restore_bins();\n    }", ""],
    ] {
        let traced = zoo::edited(&ir, &with_hot_path(&options), right, wrong).trace(|_| true);
        assert!(traced.is_err() || traced.unwrap() != tally, "{wrong} is not seen");
    }
}

/// A mirror so little curved that few of many rays arrive on the detector elsewhere than before.
#[test]
fn rays_that_do_not_arrive_at_the_place_of_nearly_all_have_the_same_bits() {
    let mut ir = zoo::load("bench_cavity");
    // From the detector to the mirror and back a ray moves by 50 mm 2 c x: at x = 2 mm by half the last bit.
    let curvature = 1.0001 * 2.0_f64.powi(-25) / 50.0;
    for surface in &mut ir.surfaces {
        surface.shape = Shape::Conic(Conic { curvature, conic: 0.0, aperture_radius: 20.0 });
    }
    let options = TraceOptions { max_depth: 3, num_rays: 400_000, ..options(Precision::F32) };
    assert_eq!(arrivals(&ir, &options), Some(vec![2]));
    let with = with_hot_path(&options).with(|overrides| overrides.side_by_side = Override::Never);
    let tally = trace(&ir, &options).0;
    assert!(trace(&ir, &with).0 == tally, "other bits");
    assert_needed("holds = all(arrival_on(ray, 0u) == arrival_0.at) & holds;", &ir, &with, &tally);
}

/// A paraboloid focuses all rays on the corner of four pixels, where roundings decide which of them is hit.
#[test]
fn rays_focused_on_an_edge_of_pixels_are_not_failed() {
    let mut ir = mirror_met_again().ir;
    ir.surfaces[0].shape =
        Shape::Conic(Conic { curvature: -1.0 / 200.0, conic: -1.0, aperture_radius: 20.0 });
    ir.surfaces[0].frame.origin = DVec3::new(0.0, 0.0, 100.0);
    ir.sources[0].kind = SourceKind::Collimated(Collimated { aperture_radius: 6.0, sigma: None });
    ir.sources[0].frame.origin = DVec3::new(10.0, 0.0, -10.0);
    ir.detectors[0].frame.origin.z = 0.0;
    if let DetectorKind::Irradiance(grid) = &mut ir.detectors[0].kind {
        (grid.width, grid.height) = (5.0, 5.0);
        assert!(grid.num_pixels_x % 2 == 0 && grid.num_pixels_y % 2 == 0, "the centre is no edge");
    }
    for precision in [Precision::F32, Precision::F64] {
        let options = options(precision);
        assert_eq!(arrivals(&ir, &options), Some(vec![1]));
        let mut tracer = with_hot_path(&options).tracer(zoo::gpu(), &ir).unwrap();
        assert!(tracer.trace(|_| true).unwrap() == trace(&ir, &options).0, "other bits");
        assert!(matches!(dispatches(&mut tracer), [1, 0]), "rays failed");
    }
}

/// So many pixels that on a few of many rays roundings decide which one is hit.
#[test]
fn rays_at_the_edges_of_pixels_hit_the_same_ones() {
    let mut ir = zoo::load("bench_lens");
    let DetectorKind::Irradiance(grid) = &mut ir.detectors[0].kind else { panic!("not a map") };
    (grid.num_pixels_x, grid.num_pixels_y) = (1501, 1);
    let options = TraceOptions { num_rays: 200_000, ..options(Precision::F32) };
    let tally = trace(&ir, &options).0;
    assert_eq!(arrivals(&ir, &options), Some(vec![1]));
    let with = with_hot_path(&options).with(|overrides| overrides.side_by_side = Override::Never);
    assert!(trace(&ir, &with).0 == tally, "other bits");
    assert_needed("holds = arrival_0.is_sure & holds;", &ir, &with, &tally);
}

/// A path through a passing detector to one that absorbs: so deep that passes are no longer logged, it has no stage.
#[test]
fn rays_that_pass_a_detector_in_traces_of_any_depth_have_the_same_bits() {
    let mut ir = gaussian_lens(4.0);
    let mut window = ir.detectors[0].clone();
    window.name = "window".into();
    window.absorb = false;
    window.frame.origin.z = -12.0;
    ir.detectors.push(window);
    for (i, max_depth) in [4, 255, 256].into_iter().enumerate() {
        let options = TraceOptions { max_depth, ..options([Precision::F32, Precision::F64][i % 2]) };
        let (tally, hot_path) = trace(&ir, &with_hot_path(&options));
        assert_eq!(hot_path.is_some(), max_depth < 256, "{max_depth}");
        assert!(tally == trace(&ir, &options).0, "other bits to a depth of {max_depth}");
    }
}

/// As many events as a ray may have, and the last one absorbs it: that is its end.
#[test]
fn rays_whose_last_event_ends_them_have_the_same_bits() {
    let mut ir = zoo::load("bench_lens");
    ir.surfaces.push(Surface {
        shape: Shape::Plane(Outline::Disk { radius: 50.0 }),
        ..speck(DVec3::new(0.0, 0.0, 100.0), Shape::Plane(Outline::Infinite), DQuat::IDENTITY)
    });
    let options = TraceOptions { max_depth: 3, ..options(Precision::F64) };
    let (tally, hot_path) = trace(&ir, &with_hot_path(&options));
    assert!(hot_path.unwrap().events.last().unwrap().ends);
    assert!(tally == trace(&ir, &options).0, "other bits");
}

#[test]
fn sobol_points_have_the_same_bits() {
    let cases = SOME.into_iter().zip([Precision::F64, Precision::F32].into_iter().cycle());
    for (name, precision) in zoo::in_turn(cases) {
        let options = TraceOptions { sampler: Sampler::Sobol, ..options(precision) };
        assert!(has_same_bits(name, &options), "{name} has no hot path");
    }
}

/// Of a lens, the caps and the rim between them touch; the detector stands apart.
#[test]
fn what_can_be_met_on_the_way_is_looked_at_and_nothing_else() {
    let ir = zoo::load("bench_lens");
    let (_, hot_path) = trace(&ir, &with_hot_path(&options(Precision::F64)));
    let (front, back, rim, detector) = (0, 1, 2, 3);
    let events = hot_path.unwrap().events;
    let searched: Vec<_> = events.iter().map(|event| (event.primitive, event.candidates.clone())).collect();
    assert_eq!(searched, [(front, vec![front]), (back, vec![back]), (detector, vec![detector])]);
    let passed = |step: usize| -> Vec<usize> { events[step].passed.iter().map(|passed| passed.0).collect() };
    assert_eq!([passed(0), passed(1), passed(2)], [vec![rim], vec![front, rim], vec![back, rim]]);
    let kinds = events.iter().flat_map(|event| event.passed.iter().map(|passed| kind(&passed.1)));
    assert_eq!(kinds.collect::<Vec<_>>(), ["beside", "leaves", "inside", "leaves", "beside"]);
    assert!(
        events.iter().map(|event| event.at_nearer_crossing).eq([true, true, false]),
        "of the detector there is one"
    );
}

fn kind(miss_test: &MissTest) -> &'static str {
    match (miss_test.sign, miss_test.exit.is_some()) {
        (Sign::Leaves, false) => "leaves",
        (Sign::Leaves, true) => "leaves, to the exit",
        (Sign::Beside { .. }, _) => "beside",
        (Sign::Past, _) => "past",
        (Sign::Inside { .. }, false) => "inside",
        (Sign::Inside { .. }, true) => "inside, to the exit",
        (Sign::Off { .. }, false) => "off",
        (Sign::Off { .. }, true) => "off, to the exit",
    }
}

/// A scene where so few rays meet something beside the hot path that it is no longer searched, and what shows that
/// the others are clear of it.
struct Rare {
    ir: SceneIr,
    /// The primitive, as it is looked at before this event, and what spares the search.
    step: usize,
    primitive: usize,
    spared: &'static str,
    /// A change of the shader that takes all rays for clear.
    always: [&'static str; 2],
}

fn gaussian_lens(sigma: f64) -> SceneIr {
    let mut ir = zoo::load("bench_lens");
    ir.sources[0].kind = SourceKind::Collimated(Collimated { aperture_radius: 30.0, sigma: Some(sigma) });
    ir
}

/// A tube around a lens's beam, a little aslant, so that its outermost rays end on it from within.
fn tube_around_the_beam() -> Rare {
    let mut ir = gaussian_lens(2.2);
    let tube = Shape::Frustum(Frustum { r_front: 9.0, r_back: 9.0, z_front: -6.0, z_back: 6.0 });
    ir.surfaces.push(speck(DVec3::new(0.0, 0.0, -12.0), tube, DQuat::from_rotation_y(0.15)));
    Rare { ir, step: 0, primitive: 3, spared: "inside", always: NEVER_INSIDE }
}

/// What takes all rays for inside of what surrounds them.
const NEVER_INSIDE: [&str; 2] =
    ["return (o.x * o.x + o.y * o.y < limit) & (x * x + y * y < limit);", "return true;"];

/// A tube out of whose end a beam goes aslant, so that it would meet it farther on; but the outermost rays before that.
fn tube_around_a_beam_aslant() -> Rare {
    let mut ir = zoo::load("bench_lens");
    let tube = Shape::Frustum(Frustum { r_front: 7.0, r_back: 6.0, z_front: -40.0, z_back: 5.0 });
    ir.surfaces = vec![speck(DVec3::ZERO, tube, DQuat::IDENTITY)];
    ir.sources[0].kind = SourceKind::Collimated(Collimated { aperture_radius: 5.9, sigma: Some(1.6) });
    ir.sources[0].frame = Frame { origin: DVec3::ZERO, rotation: DMat3::from_rotation_y(0.25) };
    ir.detectors[0].frame.origin.z = 60.0;
    Rare { ir, step: 0, primitive: 0, spared: "inside, to the exit", always: NEVER_INSIDE }
}

/// The same with a weak source whose rays go the other way, far enough to meet it.
fn tube_around_two_beams() -> Rare {
    let mut rare = tube_around_a_beam_aslant();
    rare.ir.sources[0].kind = SourceKind::Collimated(Collimated { aperture_radius: 2.0, sigma: None });
    let mut back = rare.ir.sources[0].clone();
    back.frame.rotation = DMat3::from_rotation_y(std::f64::consts::PI - 0.25);
    back.total_flux *= 0.003;
    rare.ir.sources.push(back);
    // Where both would arrive.
    rare.ir.detectors[0].frame = Frame {
        origin: DVec3::new(30.0, 0.0, 0.0),
        rotation: DMat3::from_rotation_y(std::f64::consts::FRAC_PI_2),
    };
    if let DetectorKind::Irradiance(grid) = &mut rare.ir.detectors[0].kind {
        (grid.width, grid.height) = (400.0, 400.0);
    }
    Rare { always: ["return d.z * pace >= 1.0;", "return true;"], ..rare }
}

/// Half a hollow sphere in which a lens's beam begins, but for its outermost rays, which meet it from without.
fn bowl_around_the_beam() -> Rare {
    let mut ir = gaussian_lens(2.2);
    let bowl = Shape::Conic(Conic { curvature: 1.0 / 15.0, conic: 0.0, aperture_radius: 14.95 });
    ir.surfaces.push(speck(DVec3::new(0.0, 0.0, -27.0), bowl, DQuat::IDENTITY));
    let always = ["return both_off(f, halfway, margin) & both_off(halfway, there, margin);", "return true;"];
    Rare { ir, step: 0, primitive: 3, spared: "off", always }
}

/// A bowl that mirrors a beam out of its opening, behind which it would meet the bowl's sphere; but a weak one against its
/// other side.
fn bowl_met_again() -> Rare {
    let mut rare = mirror_met_again();
    rare.ir.surfaces[0].shape =
        Shape::Conic(Conic { curvature: -1.0 / 20.0, conic: 0.0, aperture_radius: 19.0 });
    let mirrored = |at: DVec3, angle: f64| {
        let (place, direction) = (20.0 * at.normalize(), DVec3::new(0.0, angle.sin(), -angle.cos()));
        let comes = direction.reflect(at.normalize());
        let rotation = DMat3::from_quat(DQuat::from_rotation_arc(DVec3::Z, comes));
        let mut source = rare.ir.sources[0].clone();
        source.kind = SourceKind::Collimated(Collimated { aperture_radius: 0.3, sigma: None });
        source.frame = Frame { origin: place - 5.0 * comes, rotation };
        source
    };
    let strong = mirrored(DVec3::new(0.0, -17.3, 10.0), 0.96);
    let mut weak = mirrored(DVec3::new(0.0, -5.0, 19.4), 1.15);
    weak.total_flux *= 0.003;
    rare.ir.sources = vec![strong, weak];
    rare.ir.detectors[0].frame.origin.z = -40.0;
    if let DetectorKind::Irradiance(grid) = &mut rare.ir.detectors[0].kind {
        (grid.width, grid.height) = (1000.0, 1000.0);
    }
    Rare { spared: "leaves, to the exit", ..rare }
}

/// A plate along a lens's axis, beside a beam that comes aslant.
fn plate_along_the_beam() -> Rare {
    let mut ir = gaussian_lens(2.7);
    let slant = DMat3::from_rotation_y(0.3);
    ir.sources[0].frame = Frame { origin: DVec3::new(-7.6, 0.0, -25.0), rotation: slant };
    ir.detectors[0].frame.origin.z = 20.0;
    let plate = Shape::Plane(Outline::Disk { radius: 5.0 });
    let turn = DQuat::from_rotation_y(std::f64::consts::FRAC_PI_2);
    ir.surfaces.push(speck(DVec3::new(7.5, 0.0, -7.0), plate, turn));
    let always = ["return both_off(off, off + distance * d.z, 0.5 * (high - low));", "return true;"];
    Rare { ir, step: 0, primitive: 3, spared: "beside", always }
}

/// Half a hollow sphere that mirrors a beam out of its opening; but the outermost rays against its other side.
fn mirror_met_again() -> Rare {
    let mut ir = zoo::load("bench_lens");
    let mut mirror = ir.surfaces.remove(0);
    mirror.shape = Shape::Conic(Conic { curvature: -1.0 / 20.0, conic: 0.0, aperture_radius: 19.9 });
    mirror.frame.origin = DVec3::new(0.0, 0.0, 20.0);
    mirror.interaction = Interaction::Reflective { reflectance: vec![1.0] };
    mirror.back = mirror.front;
    ir.surfaces = vec![mirror];
    ir.sources[0].kind = SourceKind::Collimated(Collimated { aperture_radius: 7.0, sigma: Some(1.2) });
    ir.sources[0].frame.origin = DVec3::new(0.0, -6.5, 0.0);
    ir.detectors[0].frame.origin.z = -1.0;
    if let DetectorKind::Irradiance(grid) = &mut ir.detectors[0].kind {
        (grid.width, grid.height) = (400.0, 400.0);
    }
    let always = ["return abs(slope_along(o, d, s) + half) > abs(half) + 1e-15;", "return true;"];
    Rare { ir, step: 1, primitive: 0, spared: "leaves", always }
}

/// Half a hollow sphere on whose outside a cone of rays ends; rays that go down rather than up, and so meet it on the other
/// side of their closest approach, are few. The air takes from them on their way.
fn bowl_met_from_the_side() -> Rare {
    let mut rare = mirror_met_again();
    rare.ir.surfaces[0].shape =
        Shape::Conic(Conic { curvature: 1.0 / 20.0, conic: 0.0, aperture_radius: 19.9 });
    rare.ir.surfaces[0].frame.origin = DVec3::ZERO;
    rare.ir.surfaces[0].interaction = Interaction::Absorbing;
    rare.ir.media[0].k.fill(1e-6);
    rare.ir.sources[0].kind = SourceKind::Point(Point { half_angle: 0.1005 });
    let aside = DMat3::from_rotation_y(std::f64::consts::FRAC_PI_2 - 0.1);
    rare.ir.sources[0].frame = Frame { origin: DVec3::new(-60.0, 0.0, 10.0), rotation: aside };
    rare.ir.detectors[0].frame.origin.z = -30.0;
    rare.always = ["is_met & comes_first & on_shape", "is_met & on_shape"];
    Rare { step: 0, spared: "farther crossing", ..rare }
}

/// A window to a tinted block in a black ball, on which rays end whether they were refracted or, few of them, reflected.
fn window_in_a_ball() -> Rare {
    let mut ir = zoo::load("bench_lens");
    let mut window = ir.surfaces.remove(0);
    window.shape = Shape::Plane(Outline::Disk { radius: 30.0 });
    window.frame = Frame { origin: DVec3::new(0.0, 0.0, 20.0), rotation: DMat3::IDENTITY };
    ir.media[window.back].n.fill(1.1);
    ir.media[window.back].k.fill(1e-6);
    let ball = Shape::Sphere(Sphere { radius: 60.0, aperture_radius: None });
    ir.surfaces = vec![window, speck(DVec3::ZERO, ball, DQuat::IDENTITY)];
    let beside = DMat3::from_rotation_y(std::f64::consts::FRAC_PI_2);
    ir.detectors[0].frame = Frame { origin: DVec3::new(50.0, 0.0, 0.0), rotation: beside };
    let always = [" & (reflects == reflected);", ";"];
    Rare { ir, step: 0, primitive: 0, spared: "choice of branch", always }
}

/// The same with a weak source in the block, whose rays cross the window from the other side.
fn window_between_two_sources() -> Rare {
    let mut rare = window_in_a_ball();
    let mut behind = rare.ir.sources[0].clone();
    behind.frame = Frame { origin: DVec3::new(0.0, 0.0, 40.0), rotation: DMat3::from_rotation_y(3.0) };
    behind.medium = rare.ir.surfaces[0].back;
    behind.total_flux *= 0.002;
    // So little that hardly any ray is reflected.
    rare.ir.media[behind.medium].n.fill(1.02);
    rare.ir.sources.push(behind);
    rare.always = ["((cosine > 0.0) == entering_back) & ", ""];
    Rare { spared: "look at the side", ..rare }
}

/// Where faces are in contact, the way on one side tells; where nothing more is met, nothing is assumed.
#[test]
fn crossings_are_assumed_where_the_way_shows_them() {
    let mut ir = zoo::load("bench_lens");
    let face = |z: f64, front: usize, back: usize| Surface {
        shape: Shape::Plane(Outline::Disk { radius: 30.0 }),
        frame: Frame { origin: DVec3::new(0.0, 0.0, z), rotation: DMat3::IDENTITY },
        ..Surface { front, back, ..ir.surfaces[0].clone() }
    };
    let (air, glass) = (ir.surfaces[0].front, ir.surfaces[0].back);
    let two_plates =
        [face(0.0, air, glass), face(5.0, glass, air), face(5.0, air, glass), face(9.0, glass, air)];
    ir.surfaces = two_plates.to_vec();
    ir.media[glass].k.fill(1e-6);
    let crossings = |max_depth: u32| {
        let options = TraceOptions { max_depth, ..options(Precision::F64) };
        let (tally, hot_path) = trace(&ir, &with_hot_path(&options));
        assert!(tally == trace(&ir, &options).0, "other bits");
        let events = hot_path.unwrap().events;
        events.iter().map(|event| (event.primitive, event.crossing)).collect::<Vec<_>>()
    };
    let through = Some(Crossing { entering_back: true, reflected: false });
    assert_eq!(crossings(16), [(0, through), (1, through), (2, through), (3, through), (4, None)]);
    assert_eq!(crossings(3), [(0, through), (1, through), (2, None)]);
}

#[test]
#[ignore = "long"]
fn rays_that_are_not_clear_of_what_nearly_all_pass_have_the_same_bits() {
    let rare = [
        tube_around_the_beam(),
        tube_around_a_beam_aslant(),
        tube_around_two_beams(),
        bowl_around_the_beam(),
        bowl_met_again(),
        plate_along_the_beam(),
        mirror_met_again(),
        bowl_met_from_the_side(),
        window_in_a_ball(),
        window_between_two_sources(),
    ];
    for rare in rare {
        for precision in zoo::in_turn([Precision::F32, Precision::F64]) {
            let options = TraceOptions { num_rays: 40_000, ..options(precision) };
            let with = with_hot_path(&options);
            let (tally, hot_path) = trace(&rare.ir, &with);
            let event = &hot_path.unwrap().events[rare.step];
            let mut spared: Vec<_> = event.passed.iter().map(|(i, passed)| (*i, kind(passed))).collect();
            spared.extend(event.at_nearer_crossing.then_some((event.primitive, "farther crossing")));
            spared.extend(event.crossing.iter().flat_map(|_| {
                ["choice of branch", "look at the side"].map(|spared| (event.primitive, spared))
            }));
            assert!(spared.contains(&(rare.primitive, rare.spared)), "{}: {event:?}", rare.spared);
            assert!(tally == trace(&rare.ir, &options).0, "{}: other bits", rare.spared);
            // Rays that do not look at the side fail by the search for wrong sides, too, which is left out here.
            let edit = |wgsl: String| {
                let always = zoo::replaced(&wgsl, rare.always[0], rare.always[1]);
                always.replace(" & !went_wrong & !is_inside", "")
            };
            let wrong = with.tracer_with(zoo::gpu(), &rare.ir, edit).unwrap().trace(|_| true).unwrap();
            assert!(tally != wrong, "{}: no ray is unlike the others", rare.spared);
        }
    }
}

/// A speck anywhere in a lens's beam, turned anyhow.
fn speck(place: DVec3, shape: Shape, turn: DQuat) -> Surface {
    Surface {
        name: "speck".into(),
        frame: Frame { origin: place, rotation: DMat3::from_quat(turn) },
        shape,
        front: 0,
        back: 0,
        interaction: Interaction::Absorbing,
        ..zoo::load("bench_lens").surfaces.remove(0)
    }
}

/// A shape of about that radius, of each kind.
fn speck_shape(kind: usize, radius: f64) -> Shape {
    match kind {
        0 => Shape::Plane(Outline::Disk { radius }),
        1 => Shape::Plane(Outline::Rectangle { width: radius, height: 2.0 * radius }),
        2 => Shape::Conic(Conic { curvature: 0.7 / radius, conic: 0.5, aperture_radius: radius }),
        3 => Shape::Sphere(Sphere { radius, aperture_radius: Some(0.8 * radius) }),
        4 => Shape::Frustum(Frustum {
            r_front: radius,
            r_back: 0.6 * radius,
            z_front: -radius,
            z_back: 0.5 * radius,
        }),
        _ => Shape::Annulus(Annulus { inner_radius: 0.4 * radius, outer_radius: radius, z_offset: 0.2 }),
    }
}

/// A disk before a lens, on which some rays end.
#[test]
fn rays_that_end_before_a_refracting_surface_do_not_cross_it() {
    let mut ir = zoo::load("bench_lens");
    ir.surfaces.push(speck(DVec3::new(0.0, 0.0, -10.0), speck_shape(0, 3.0), DQuat::IDENTITY));
    let options = options(Precision::F64);
    let tally = trace(&ir, &options).0;
    let with = with_hot_path(&options);
    let (traced, hot_path) = trace(&ir, &with);
    let first = &hot_path.unwrap().events[0];
    assert!(first.crossing.is_some() && first.candidates.len() == 2 && traced == tally, "{first:?}");
    let mut any = zoo::edited(&ir, &with, "(hit.primitive == primitive) & takes_side", "takes_side");
    assert!(any.trace(|_| true).unwrap() != tally, "any surface is crossed");
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 24, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    #[ignore = "long"]
    fn specks_in_the_way_are_met_by_the_same_rays(
        place in [-8.0..8.0f64, -8.0..8.0f64, -24.0..149.0f64],
        kind in 0..6usize,
        radius in 0.5..5.0f64,
        axis in [-1.0..1.0f64, -1.0..1.0f64, 0.1..1.0f64],
        angle in 0.0..std::f64::consts::TAU,
    ) {
        let mut ir = zoo::load("bench_lens");
        let turn = DQuat::from_axis_angle(DVec3::from_array(axis).normalize(), angle);
        ir.surfaces.push(speck(DVec3::from_array(place), speck_shape(kind, radius), turn));
        for precision in zoo::in_turn([Precision::F32, Precision::F64]) {
            let options = options(precision);
            let (tally, hot_path) = trace(&ir, &with_hot_path(&options));
            prop_assert!(hot_path.is_some());
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
        ir.sources[0].frame.origin.z = -FAR;
        ir.detectors[0].frame.origin.z = FAR;
        if let DetectorKind::Irradiance(grid) = &mut ir.detectors[0].kind {
            (grid.width, grid.height) = (FAR, FAR);
        }
        let options = options(Precision::F32);
        let (tally, hot_path) = trace(&ir, &with_hot_path(&options));
        assert!(hot_path.is_some());
        assert!(tally == trace(&ir, &options).0, "{gap} mm: other bits");
    }
}

#[test]
fn short_traces_and_those_that_record_rays_have_none() {
    let ir = zoo::load("bench_lens");
    let hot_path = |change: fn(&mut Forced)| {
        let mut options = options(Precision::F64).with(|overrides| overrides.hot_path = Override::Always);
        change(&mut options);
        trace(&ir, &options).1
    };
    assert!(hot_path(|_| ()).is_some());
    assert!(hot_path(|options| options.overrides.hot_path = Override::Automatic).is_none());
    assert!(hot_path(|options| options.overrides.deferred_splats = Override::Never).is_none());
    assert!(hot_path(|options| options.strict = nsq_gpu::run::Strict::Off).is_none());
    assert!(hot_path(|options| options.standard_error = StandardError::On).is_none());
    assert!(hot_path(|options| options.paths = nsq_gpu::run::RecordPaths::All).is_none());
}
