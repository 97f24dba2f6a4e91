//! What must not change a result, and what must change it in a known way.
#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "clippy's exemption of tests does not reach their helpers"
)]

mod zoo;

use std::collections::BTreeMap;

use glam::{DMat3, DVec3};
use nsq_gpu::cpu::Override;
use nsq_gpu::cpu::adapter_traits::AdapterTraits;
use nsq_gpu::gpu::Gpu;
use nsq_gpu::model::{
    Detector, DetectorKind, FarField, Frame, Frustum, Interaction, Medium, PixelGrid, Point, Sampling,
    SceneIr, Shape, Source, SourceKind, Spectrum, Sphere, Splat, Surface,
};
use nsq_gpu::program::Precision;
use nsq_gpu::program::layout::rng::Sampler;
use nsq_gpu::result::{FluxSum, PathEvent, PathEventKind, Tally};
use nsq_gpu::run::{RecordPaths, Strict};
use nsq_gpu::{StandardError, TraceOptions, Tracer};
use std::time::Duration;
use zoo::forced::{Asked, Forced};

const PRECISIONS: [Precision; 2] = [Precision::F32, Precision::F64];

/// Mirrors with roulette, absorbing media born in, Gaussian splats, a ray database with several sources, spectral bins
/// with a capped database, far fields, deep paths.
const DIVERSE: [&str; 7] = [
    "kaleidoscope",
    "nested_media",
    "tessar_gaussian_beams",
    "filter_stack",
    "telephoto_spectral",
    "erfle_eyepiece",
    "stacked_plates_ghosts",
];

/// Scattering of every kind on mirrors and lenses, and coatings. Azimuths of scattering count from an axis that is fixed
/// in the global frame, as in the reference, so these scenes cannot be turned ray for ray.
const SCATTERING: [&str; 3] = ["scattering_telescope", "coated_projector", "opal_lamp"];

// The same bits.

/// Asserts that each of several ways to trace some rays gives the tally of the plain way, over the diverse scenes; of the
/// precisions, ways and scenes take each in turn.
fn assert_same_bits(num_rays: u64, changes: &[fn(&mut Forced)]) {
    assert_same_bits_from(&TraceOptions { num_rays, ..TraceOptions::default() }, changes);
}

/// The same with options that all the ways share.
fn assert_same_bits_from(base: &impl Asked, changes: &[fn(&mut Forced)]) {
    for (i, name) in zoo::in_turn(DIVERSE.into_iter().chain(SCATTERING).enumerate()) {
        let ir = zoo::load(name);
        for (k, precision) in PRECISIONS.into_iter().enumerate() {
            let in_turn = changes.iter().enumerate().filter(|(j, _)| (i + j + k) % 2 == 0);
            let mut options = base.with(|_| ());
            (options.seed, options.precision) = (11, precision);
            let mut plain = None;
            for (_, change) in in_turn {
                let plain = plain.get_or_insert_with(|| zoo::trace(&ir, &options));
                let mut changed = options.clone();
                change(&mut changed);
                assert!(
                    zoo::trace(&ir, &changed) == *plain,
                    "{name} in {precision:?}: other bits with {changed:?}"
                );
            }
        }
    }
}

#[test]
fn a_second_run_and_any_batch_size_give_the_same_bits() {
    assert_same_bits(
        20_000,
        &[
            |_| (),
            |options| options.batch_size = Some(1000),
            |options| options.batch_size = Some(16_384),
            |options| options.batch_size = Some(1_000_000),
        ],
    );
}

#[test]
#[ignore = "long"]
fn short_submissions_give_the_same_bits() {
    let num_rays = 20_000;
    // Dispatches of 4 workgroups a processor, at the least.
    let least = 4 * 32 * nsq_gpu::gpu::processors::count() as u64;
    for (name, hot_path) in [
        ("bench_lens", true),
        ("bench_cavity", false),
        ("split_ghosts", false),
        ("opal_lamp", false),
        ("mesh_prism", false),
    ] {
        let ir = zoo::load(name);
        for deferred_splats in [true, false] {
            let options = TraceOptions {
                num_rays,
                standard_error: StandardError::Off,
                workgroup_size: 32,
                events_per_dispatch: 3,
                batch_size: Some(5000),
                ..TraceOptions::default()
            };
            let options = options.with(|overrides| {
                overrides.deferred_splats = Override::forced(deferred_splats);
                overrides.hot_path = Override::forced(hot_path && deferred_splats);
            });
            let plain = zoo::trace(&ir, &options);
            let mut tracer = options.tracer(zoo::gpu(), &ir).unwrap();
            tracer.set_pass_time(Duration::ZERO);
            assert!(
                tracer.trace(|_| true).unwrap() == plain,
                "{name}, deferred_splats {deferred_splats}: other bits"
            );
            let num = tracer.num_submissions();
            assert!(hot_path && deferred_splats || num > num_rays / 2 / least, "{name}: {num} submissions");
        }
    }
}

/// Before any dispatch was timed, it is the largest number of events that tells how long one may take.
#[test]
fn the_first_dispatch_of_a_deep_trace_is_short() {
    let ir = zoo::load("bench_cavity");
    let first_pass = |max_depth| {
        let options =
            TraceOptions { num_rays: 100_000, max_depth, precision: Precision::F32, ..Default::default() };
        let mut tracer = zoo::tracer(&ir, &options).unwrap();
        let rays = tracer.trace(|_| false).unwrap().launched.count;
        (rays, tracer.num_submissions())
    };
    let (rays, submissions) = first_pass(16);
    assert!(submissions == 1 && first_pass(1000).0 < rays / 2);
    // A submission has at most 64 rounds of 64 events.
    let (rays, submissions) = first_pass(100_000);
    assert!(rays * 64 * 64 <= 4451 * 1001 && submissions > 1, "{rays} rays in {submissions} submissions");
}

/// A trace that is allowed a hundred thousand events asks for the rays that are left, and one that is allowed 64 does not.
#[test]
fn a_depth_that_no_ray_reaches_changes_no_bit() {
    // The light of the pipe that has more than 64 events needs thousands.
    let scenes = [("double_gauss", 64), ("bench_lens", 64), ("light_pipe", 20_000), ("opal_lamp", 20_000)];
    for (name, shallow) in zoo::in_turn(scenes) {
        let ir = zoo::load(name);
        for precision in [Precision::F32, Precision::F64] {
            for standard_error in [StandardError::Off, StandardError::On] {
                let options = |max_depth| TraceOptions {
                    num_rays: 20_000,
                    max_depth,
                    precision,
                    standard_error,
                    ..TraceOptions::default()
                };
                let tally = zoo::trace(&ir, &options(shallow).with(|_| ()));
                assert_eq!(tally.depth_killed.count, 0, "{name}");
                assert!(zoo::trace(&ir, &options(100_000).with(|_| ())) == tally, "{name} in {precision:?}");
            }
        }
    }
}

#[test]
#[ignore = "long"]
fn workgroups_of_32_128_and_256_give_the_same_bits_as_of_64() {
    assert_same_bits(
        3000,
        &[
            |options| options.workgroup_size = 32,
            |options| options.workgroup_size = 128,
            |options| options.workgroup_size = 256,
        ],
    );
}

#[test]
#[ignore = "long"]
fn dispatches_of_1_2_and_5_events_give_the_same_bits_as_of_16() {
    // With second moments, no ray outlives a dispatch where detectors let rays pass.
    let base = TraceOptions { num_rays: 3000, standard_error: StandardError::Off, ..TraceOptions::default() };
    assert_same_bits_from(
        &base,
        &[
            |options| options.events_per_dispatch = 1,
            |options| options.events_per_dispatch = 2,
            |options| options.events_per_dispatch = 5,
        ],
    );
}

#[test]
fn the_host_and_the_device_add_up_the_same_bits() {
    assert!(AdapterTraits::of(zoo::gpu()).deferred_splats, "lavapipe is a processor");
    let deposited = |options: &mut Forced| options.overrides.deferred_splats = Override::Never;
    assert_same_bits(3000, &[deposited]);
    let base = TraceOptions { num_rays: 3000, standard_error: StandardError::On, ..TraceOptions::default() };
    assert_same_bits_from(&base, &[deposited]);
    let base = TraceOptions {
        num_rays: 3000,
        events_per_dispatch: 2,
        batch_size: Some(700),
        standard_error: StandardError::Off,
        ..TraceOptions::default()
    };
    assert_same_bits_from(&base, &[deposited]);
}

/// So far from the scene's centre an f32 is a hundredth of a millimetre: of what is found on a map of such pixels, some lies
/// beyond it.
#[test]
fn so_they_do_where_rounding_puts_rays_beyond_the_map() {
    const FAR: f64 = 2e5;
    let mut ir = zoo::load("bench_lens");
    ir.sources[0].kind = SourceKind::Point(Point { half_angle: 0.01 });
    ir.sources[0].frame.origin = DVec3::new(FAR, 0.0, -100.0);
    ir.detectors[0].frame.origin = DVec3::new(FAR, 0.0, 0.0);
    let DetectorKind::Irradiance(grid) = &mut ir.detectors[0].kind else { panic!("another detector") };
    *grid = PixelGrid { width: 1.01, height: 1.0, num_pixels_x: 1010, num_pixels_y: 10, ..*grid };
    let options =
        TraceOptions { standard_error: StandardError::Off, ..zoo::options(20_000, 1, Precision::F32) };
    let trace = |deferred_splats| {
        let options = options.with(|overrides| overrides.deferred_splats = Override::forced(deferred_splats));
        options.tracer(zoo::gpu(), &ir).unwrap().trace(|_| true).unwrap()
    };
    assert!(trace(true) == trace(false), "other bits");
}

#[test]
#[ignore = "long"]
fn any_number_of_rays_an_invocation_gives_the_same_bits() {
    let off = TraceOptions { num_rays: 3000, standard_error: StandardError::Off, ..TraceOptions::default() };
    for deferred_splats in [true, false] {
        let base = off.with(|overrides| {
            overrides.rays_per_invocation = Some(1);
            overrides.deferred_splats = Override::forced(deferred_splats);
        });
        assert_same_bits_from(
            &base,
            &[
                |options| options.overrides.rays_per_invocation = Some(3),
                |options| options.overrides.rays_per_invocation = Some(8),
                |options| {
                    options.overrides.rays_per_invocation = Some(8);
                    options.batch_size = Some(700);
                },
            ],
        );
    }
}

#[test]
fn an_invocation_follows_several_rays_where_none_outlives_it_and_loops_are_short() {
    let ir = zoo::load("bench_cavity");
    let rays = |change: fn(&mut Forced)| {
        let mut options = zoo::options(3000, 1, Precision::F32).with(|c| c.rays_per_invocation = Some(8));
        options.standard_error = StandardError::Off;
        (options.max_depth, options.events_per_dispatch) = (16, 16);
        change(&mut options);
        let tracer = options.tracer(zoo::gpu(), &ir).unwrap();
        tracer.program().options.rays_per_invocation(&tracer.program().features)
    };
    assert_eq!(rays(|_| ()), 8);
    assert_eq!(rays(|options| (options.max_depth, options.events_per_dispatch) = (64, 64)), 4, "256 events");
    assert_eq!(rays(|options| options.overrides.rays_per_invocation = Some(0)), 1);
    assert_eq!(rays(|options| options.events_per_dispatch = 3), 1, "rays wait in a queue");
    assert_eq!(rays(|options| options.baked = Some(false)), 1, "loops over tables");
    assert_eq!(rays(|options| options.standard_error = StandardError::On), 1, "visits are remembered");
    let few = |options: &mut Forced| (options.num_rays, options.overrides.rays_per_invocation) = (255, None);
    assert_eq!(rays(few), 1, "few rays");
}

/// What a ray leaves on detectors that it passes is logged with where it ends: cells, taps, spectral bins, directions,
/// and Gaussian splats between them, which are not.
#[test]
fn what_rays_leave_in_passing_adds_up_to_the_same_bits_on_host_and_device() {
    for name in zoo::in_turn(DIVERSE.into_iter().chain(["bench_cavity", "newtonian_telescope", "bench_lens"]))
    {
        let mut ir = zoo::load(name);
        for detector in &mut ir.detectors {
            detector.absorb = false;
            // Sums of whole weights follow from counts.
            if let (DetectorKind::Irradiance(grid), "bench_lens") = (&mut detector.kind, name) {
                grid.splat = Splat::Hard;
            }
        }
        for precision in PRECISIONS {
            let options =
                TraceOptions { standard_error: StandardError::Off, ..zoo::options(2000, 11, precision) };
            let deposited = zoo::trace(&ir, &options.on_device());
            let queued = TraceOptions { events_per_dispatch: 3, batch_size: Some(777), ..options.clone() };
            for logged in [&options, &queued] {
                assert!(
                    zoo::trace(&ir, logged) == deposited,
                    "{name} in {precision:?}: other bits, {logged:?}"
                );
            }
            let portable = zoo::trace_on(zoo::portable_gpu(), &ir, &queued);
            assert!(portable == deposited, "{name} in {precision:?}: other bits with pairs");
        }
    }
}

/// Commands leave out the checks that tests run with, which are branches in every loop: without them a driver may treat
/// lanes that have left a loop otherwise (shaders/stages/state.wgsl).
#[test]
#[ignore = "long"]
fn shaders_without_run_time_checks_give_the_same_bits() {
    let assert_same = |name: &str, ir: &SceneIr, options: &TraceOptions| {
        let [checked, unchecked] =
            [zoo::gpu(), zoo::unchecked_gpu()].map(|gpu| zoo::trace_on(gpu, ir, options));
        assert!(checked == unchecked, "{name}: other bits, {options:?}");
    };
    for name in DIVERSE.into_iter().chain(SCATTERING).chain(["bench_lens", "bench_cavity", "mesh_lens"]) {
        let ir = zoo::load(name);
        let plain = zoo::options(1000, 11, Precision::F64);
        for options in [
            TraceOptions { standard_error: StandardError::On, ..plain.clone() },
            TraceOptions { baked: Some(false), tree: Some(false), ..plain.clone() },
            TraceOptions { tree: Some(true), baked: Some(false), precision: Precision::F32, ..plain },
        ] {
            assert_same(name, &ir, &options);
        }
    }
    for which in SPLIT {
        assert_same(which.0, &split(which), &zoo::options(500, 11, Precision::F64));
    }
}

/// Where every surface absorbs, no shader marks what was reached.
#[test]
fn absorbers_are_told_as_reached_in_every_form() {
    let mut ir = zoo::load("bench_lens");
    ir.surfaces.iter_mut().for_each(|surface| surface.interaction = Interaction::Absorbing);
    for precision in PRECISIONS {
        let plain = zoo::options(2000, 11, precision);
        for options in [
            plain.clone().into(),
            plain.on_device(),
            plain.with(|overrides| overrides.hot_path = Override::Always),
            TraceOptions { standard_error: StandardError::On, ..plain.clone() }.into(),
            TraceOptions { sampler: Sampler::Sobol, standard_error: StandardError::On, ..plain.clone() }
                .into(),
            TraceOptions { baked: Some(false), tree: Some(false), ..plain.clone() }.into(),
            Forced::from(TraceOptions { baked: Some(false), tree: Some(true), ..plain }),
        ] {
            let surfaces = zoo::trace(&ir, &options).surfaces;
            let told: Vec<(bool, u64)> = surfaces.iter().map(|s| (s.reached, s.absorbed.count)).collect();
            // The front takes all, and shades the others.
            assert_eq!(told, [(true, 2000), (false, 0), (false, 0)], "{options:?}");
        }
    }
}

/// So deep that a ray's passes would not fit the log, and just less deep; with second moments, and loosely rounded.
#[test]
fn a_cavity_of_any_depth_has_the_same_bits_on_host_and_device() {
    let ir = zoo::load("bench_cavity");
    for precision in PRECISIONS {
        let plain = zoo::options(3000, 11, precision);
        for options in [
            TraceOptions { max_depth: 300, ..plain.clone() },
            TraceOptions { max_depth: 255, ..plain.clone() },
            TraceOptions { max_depth: 1, ..plain.clone() },
            TraceOptions { standard_error: StandardError::On, ..plain.clone() },
            TraceOptions { strict: Strict::Off, ..plain.clone() },
        ] {
            let deposited = options.on_device();
            assert!(zoo::trace(&ir, &options) == zoo::trace(&ir, &deposited), "other bits: {options:?}");
        }
    }
}

#[test]
fn pairs_of_32_bit_integers_give_the_same_bits_as_64_bit_ones() {
    assert!(zoo::gpu().int64, "lavapipe has 64-bit integers");
    assert!(!zoo::portable_gpu().int64);
    for name in zoo::in_turn(DIVERSE.into_iter().chain(SCATTERING)) {
        let ir = zoo::load(name);
        for precision in PRECISIONS {
            let options = zoo::options(3000, 11, precision);
            let portable = zoo::trace_on(zoo::portable_gpu(), &ir, &options);
            assert!(zoo::trace(&ir, &options) == portable, "{name} in {precision:?}: other bits");
        }
    }
}

/// The options with a tracer's sums in 10 to 23 parts, which with a scene's other buffers are fewer than lavapipe binds.
fn in_parts(whole: &Tracer, options: &impl Asked) -> Forced {
    let bytes = whole.program().sums.all().map(|sums| sums.num_elements * sums.words.element_bytes());
    assert!(num_parts(whole) <= 3, "what fits is not cut");
    let mut cut = options.with(|_| ());
    cut.part_bytes = Some(bytes.sum::<u64>() / 10);
    cut
}

fn num_parts(tracer: &Tracer) -> usize {
    tracer.program().sums.all().map(|sums| sums.bindings.len()).sum()
}

fn assert_same_bits_in_parts(gpu: &Gpu, ir: &SceneIr, options: &(impl Asked + std::fmt::Debug)) {
    let mut whole = options.tracer(gpu, ir).unwrap();
    let mut cut = in_parts(&whole, options).tracer(gpu, ir).unwrap();
    assert!(num_parts(&cut) >= 10);
    let [whole, cut] = [&mut whole, &mut cut].map(|tracer| tracer.trace(|_| true).unwrap());
    assert!(whole == cut, "other bits in parts with {options:?}");
}

#[test]
#[ignore = "long"]
fn sums_in_parts_are_the_same_bits_as_in_one() {
    let changes: [fn(&mut Forced); 5] = [
        |_| (),
        |options| {
            options.standard_error = StandardError::On;
            options.overrides.deferred_splats = Override::Never;
        },
        |options| (options.baked, options.tree) = (Some(false), Some(false)),
        |options| {
            (options.events_per_dispatch, options.batch_size) = (2, Some(700));
            options.standard_error = StandardError::Off;
        },
        |options| {
            options.overrides.deferred_splats = Override::Never;
            options.overrides.rays_per_invocation = Some(7);
        },
    ];
    for (i, name) in zoo::in_turn(DIVERSE.into_iter().chain(SCATTERING).enumerate()) {
        let ir = zoo::load(name);
        // Each scene in another precision, and with other integers, than the one before.
        let gpu = if i % 2 == 0 { zoo::gpu() } else { zoo::portable_gpu() };
        let precision = [Precision::F32, Precision::F64, Precision::Df64][i % 3];
        let mut options = Forced::from(zoo::options(1000, 11, precision));
        changes[i % 5](&mut options);
        assert_same_bits_in_parts(gpu, &ir, &options);
    }
}

#[test]
fn split_rays_and_replicates_have_the_same_bits_in_parts() {
    let ir = split(SPLIT[1]);
    let off = TraceOptions { standard_error: StandardError::Off, ..zoo::options(1000, 11, Precision::F64) };
    assert_same_bits_in_parts(zoo::gpu(), &ir, &off);
    assert_same_bits_in_parts(zoo::portable_gpu(), &ir, &off);
    let sobol = TraceOptions {
        sampler: Sampler::Sobol,
        standard_error: StandardError::On,
        ..zoo::options(2000, 11, Precision::F32)
    };
    assert_same_bits_in_parts(zoo::gpu(), &zoo::load("bench_lens"), &sobol);
}

/// Text of the shader in parts, and what stands there by mistake.
const WRONG_PARTS: [(&str, &str); 8] = [
    ("case 1u: { return atomicAdd(&sums_1[", "case 1u: { return atomicAdd(&sums_0["),
    (
        "default: { return atomicAdd(&sums_",
        "default: { return atomicAdd(&sums_0[within], value); return atomicAdd(&sums_",
    ),
    (
        "fn add_to_tops(at: u32, value: u32) -> u32 {\n",
        "fn add_to_tops(to: u32, value: u32) -> u32 {\n let at = to ^ 1u;\n",
    ),
    ("case 0u: { return atomicAdd(&counters_0[", "case 0u: { return atomicAdd(&counters_1["),
    ("case 1u: { return atomicAdd(&counters_1[", "case 1u: { return atomicAdd(&counters_0["),
    ("{ atomicStore(&counters_", "{ return; atomicStore(&counters_"),
    ("let within = at & ", "let within = (at ^ 1u) & "),
    ("    switch at >> ", "    switch 1u + at >> "),
];

#[test]
fn a_wrong_part_is_noticed() {
    // In tables, so that what was reached is stored; mirrors take more than 64 bits hold.
    let ir = zoo::load("kaleidoscope");
    let options = TraceOptions {
        baked: Some(false),
        standard_error: StandardError::Off,
        ..zoo::options(60_000, 11, Precision::F32)
    }
    .on_device();
    let mut whole = options.tracer(zoo::gpu(), &ir).unwrap();
    let cut = in_parts(&whole, &options);
    let plain = whole.trace(|_| true).unwrap();
    for (right, wrong) in WRONG_PARTS {
        let tally = zoo::edited(&ir, &cut, right, wrong).trace(|_| true).unwrap();
        assert!(tally != plain, "`{wrong}` is not noticed");
    }
}

#[test]
fn sums_of_too_many_parts_are_refused_with_the_numbers() {
    let ir = zoo::load("bench_lens");
    let options = TraceOptions { part_bytes: Some(512), ..zoo::options(1, 0, Precision::F32) };
    let error = zoo::tracer(&ir, &options).err().unwrap().to_string();
    let most = zoo::gpu().device.limits().max_storage_buffers_per_shader_stage.to_string();
    for words in ["storage buffers", " bytes of sums", "binds at most", "use fewer pixels", &most] {
        assert!(error.contains(words), "{error}");
    }
}

/// Families with budget enough, and without: importance sampling and absorption; a mesh; scattering.
const SPLIT: [(&str, u32, f64); 4] = [
    ("stacked_plates_ghosts", 3, 4.0),
    ("stacked_plates_ghosts", 5, 2.5),
    ("mesh_lens", 4, 2.0),
    ("opal_lamp", 4, 2.5),
];

fn split((name, split_depth, split_budget): (&str, u32, f64)) -> SceneIr {
    let mut ir = zoo::load(name);
    ir.sampling = Sampling { split_depth, split_budget, ..ir.sampling };
    ir
}

fn assert_same_bits_split(which: (&str, u32, f64), num_rays: u64, changes: &[fn(&mut TraceOptions)]) {
    let ir = split(which);
    for precision in PRECISIONS {
        let options = zoo::options(num_rays, 11, precision);
        let plain = zoo::trace(&ir, &options);
        assert_eq!(plain.split_budget_saturated, which.2 < f64::from(which.1) + 1.0, "{which:?}");
        assert!(zoo::result_of(&ir, &options, &plain).ledger.closes(), "{which:?} in {precision:?}");
        for change in changes {
            let mut changed = options.clone();
            change(&mut changed);
            assert!(
                zoo::trace(&ir, &changed) == plain,
                "{which:?} in {precision:?}: other bits with {changed:?}"
            );
        }
        let portable = zoo::trace_on(zoo::portable_gpu(), &ir, &options);
        assert!(portable == plain, "{which:?} in {precision:?}: other bits with pairs of 32-bit integers");
    }
}

#[test]
fn split_rays_have_the_same_bits_in_batches_of_any_size() {
    for which in &SPLIT[..2] {
        assert_same_bits_split(
            *which,
            20_000,
            &[
                |options| options.batch_size = Some(1000),
                |options| options.batch_size = Some(16_384),
                |options| options.batch_size = Some(1_000_000),
            ],
        );
    }
}

#[test]
#[ignore = "long"]
fn split_rays_have_the_same_bits_however_they_are_dispatched() {
    for which in SPLIT {
        assert_same_bits_split(
            which,
            1000,
            &[
                |options| options.batch_size = Some(77),
                |options| options.workgroup_size = 32,
                |options| options.workgroup_size = 128,
                |options| options.events_per_dispatch = 3,
            ],
        );
    }
}

/// A child has its launched ray's point, scrambled by its number.
#[test]
fn split_rays_of_quasi_random_points_have_the_same_bits_in_any_batches() {
    for which in SPLIT {
        let ir = split(which);
        let options = TraceOptions { sampler: Sampler::Sobol, ..zoo::options(1000, 11, Precision::F32) };
        let batches = TraceOptions { batch_size: Some(77), ..options.clone() };
        let plain = zoo::trace(&ir, &options);
        assert!(zoo::result_of(&ir, &options, &plain).ledger.closes(), "{which:?}");
        assert!(zoo::trace(&ir, &batches) == plain, "{which:?}: other bits");
        assert!(
            zoo::trace_on(zoo::portable_gpu(), &ir, &options) == plain,
            "{which:?}: other bits with pairs"
        );
    }
}

#[test]
fn split_rays_in_tables_are_those_compiled_in() {
    for which in SPLIT {
        let ir = split(which);
        let [baked, table] = [true, false].map(|baked| {
            zoo::trace(&ir, &TraceOptions { baked: Some(baked), ..zoo::options(1000, 11, Precision::F64) })
        });
        let deviation = deviation(&table, &baked);
        assert!(deviation < 1e-9, "{which:?}: {deviation}");
    }
}

#[test]
fn paths_of_split_rays_are_the_same_rows_in_any_batches() {
    for which in SPLIT {
        let ir = split(which);
        let options = TraceOptions { paths: RecordPaths::All, ..zoo::options(100, 11, Precision::F64) };
        let batches = TraceOptions { batch_size: Some(7), ..options.clone() };
        let (one, other) = (zoo::trace(&ir, &options), zoo::trace(&ir, &batches));
        assert!(one.paths.iter().any(|event| event.ray.ray_id >= options.num_rays), "{which:?}: no children");
        assert!(one == other, "{which:?}");
    }
}

#[test]
fn a_trace_that_stops_early_is_the_first_rays_of_the_whole() {
    for name in ["nested_media", "kaleidoscope"] {
        let ir = zoo::load(name);
        let options = TraceOptions { batch_size: Some(1000), ..zoo::options(50_000, 11, Precision::F64) };
        let mut tracer = zoo::tracer(&ir, &options).unwrap();
        let begun = tracer.trace(|_| false).unwrap();
        assert!(begun.launched.count < options.num_rays, "{name}: the trace stops early");
        assert!(
            tracer.trace(|_| true).unwrap() == zoo::trace(&ir, &options),
            "{name}: a tracer starts afresh"
        );
        let mut whole = zoo::trace(&ir, &options);
        let before = whole.clone();
        whole += &begun;
        assert_eq!(whole.launched.count, before.launched.count + begun.launched.count);
        assert_eq!(whole.launched.quanta, before.launched.quanta + begun.launched.quanta);
    }
}

#[test]
fn another_seed_gives_other_bits() {
    for name in DIVERSE {
        let ir = zoo::load(name);
        let tallies = [1, 2].map(|seed| zoo::trace(&ir, &zoo::options(3000, seed, Precision::F32)));
        assert!(tallies[0] != tallies[1], "{name}");
    }
}

#[test]
fn f32_and_f64_give_other_bits() {
    for name in DIVERSE {
        let ir = zoo::load(name);
        let tallies = PRECISIONS.map(|precision| zoo::trace(&ir, &zoo::options(3000, 1, precision)));
        assert!(tallies[0] != tallies[1], "{name}: f32 was traced in f64, or f64 in f32");
    }
}

// Scenes compiled in or in tables.

/// The largest difference of two tallies of one scene, in units of the largest cell of the detector or of the weight
/// launched; infinite where a count differs.
fn deviation(ours: &Tally, theirs: &Tally) -> f64 {
    if counts(ours) != counts(theirs) {
        return f64::INFINITY;
    }
    let launched = theirs.launched.quanta as f64;
    let totals = flux_sums(ours).zip(flux_sums(theirs));
    let totals = totals.map(|(mine, other)| mine.quanta.abs_diff(other.quanta) as f64 / launched);
    let maps = ours.detectors.iter().zip(&theirs.detectors).flat_map(|(mine, other)| {
        let peak = other.quanta.iter().copied().max().unwrap_or(0).max(1) as f64;
        mine.quanta.iter().zip(&other.quanta).map(move |(mine, other)| mine.abs_diff(*other) as f64 / peak)
    });
    totals.chain(maps).fold(0.0, f64::max)
}

fn flux_sums(tally: &Tally) -> impl Iterator<Item = FluxSum> {
    let whole = [
        tally.launched,
        tally.escaped,
        tally.depth_killed,
        tally.roulette_loss,
        tally.roulette_gain,
        tally.bulk,
        tally.importance_loss,
        tally.importance_gain,
        tally.coating,
        tally.bsdf_loss,
        tally.bsdf_gain,
    ];
    let surfaces = tally.surfaces.iter().map(|surface| surface.absorbed);
    whole.into_iter().chain(surfaces).chain(tally.detectors.iter().map(|detector| detector.total()))
}

/// Every count: of sums, of hits in each cell, of surfaces reached, of underflows, of rays on wrong sides.
fn counts(tally: &Tally) -> Vec<u64> {
    let flux_sums = flux_sums(tally).map(|flux_sum| flux_sum.count);
    let hits = tally.detectors.iter().flat_map(|detector| detector.hits.iter().copied());
    let reached = tally.surfaces.iter().map(|surface| u64::from(surface.reached));
    let rest = [tally.medium_stack_underflows, tally.invalid_deposits];
    let wrong = tally.surfaces.iter().flat_map(|surface| [surface.entered_twice, surface.ended_inside]);
    let inside = tally.detectors.iter().map(|detector| detector.ended_inside);
    flux_sums.chain(hits).chain(reached).chain(rest).chain(wrong).chain(inside).collect()
}

#[test]
fn scenes_in_tables_agree_with_scenes_compiled_in() {
    for (_, name) in zoo::scenes_in_turn() {
        let ir = zoo::load(&name);
        let options = zoo::options(3000, 2, Precision::F64);
        let [baked, tables] = [true, false]
            .map(|baked| zoo::trace(&ir, &TraceOptions { baked: Some(baked), ..options.clone() }));
        let deviation = deviation(&tables, &baked);
        eprintln!("{name:28} {deviation:.1e}");
        assert!(deviation <= 1e-12, "{name}: {deviation:e}");
    }
}

#[test]
fn a_count_or_a_bin_that_differs_is_reported() {
    let tally = zoo::trace(&zoo::load("bench_lens"), &zoo::options(3000, 2, Precision::F64));
    assert_eq!(deviation(&tally, &tally), 0.0);
    let mut other = tally.clone();
    other.detectors[0].hits[7] += 1;
    assert_eq!(deviation(&other, &tally), f64::INFINITY);
    let mut other = tally.clone();
    let peak = tally.detectors[0].quanta.iter().copied().max().unwrap();
    other.detectors[0].quanta[7] += 2 * peak / 1_000_000_000_000;
    assert!(deviation(&other, &tally) > 1e-12);
    let mut other = tally.clone();
    other.escaped.quanta += tally.launched.quanta / 100_000_000_000;
    assert!(deviation(&other, &tally) > 1e-12);
}

// Scaling and motion.

#[test]
fn maps_scale_with_the_flux_of_the_sources() {
    for name in ["filter_stack", "tessar_gaussian_beams", "nested_media"] {
        let ir = zoo::load(name);
        let options = zoo::options(3000, 3, Precision::F64);
        let plain = zoo::result(&ir, &options);
        for scale in [1e30, 1e-30] {
            let mut scaled = ir.clone();
            scaled.sources.iter_mut().for_each(|source| source.total_flux *= scale);
            let scaled = zoo::result(&scaled, &options);
            let deviation = scaled_deviation(&plain, &scaled, scale);
            assert!(deviation <= 1e-13, "{name} times {scale:e}: {deviation:e}");
            assert!(
                scaled_deviation(&plain, &scaled, scale * (1.0 + 1e-12)) > 1e-13,
                "the comparison is blind"
            );
        }
    }
}

/// Largest deviation of the totals and of every detector's flux and map from `scale` times the plain ones.
fn scaled_deviation(plain: &nsq_gpu::TraceResult, scaled: &nsq_gpu::TraceResult, scale: f64) -> f64 {
    let relative = |mine: f64, other: f64, unit: f64| (mine / scale - other).abs() / unit;
    let launched = plain.total_flux_in;
    let mut worst = relative(scaled.total_flux_detected, plain.total_flux_detected, launched).max(relative(
        scaled.total_flux_escaped,
        plain.total_flux_escaped,
        launched,
    ));
    for (mine, other) in scaled.detectors.iter().zip(&plain.detectors) {
        assert_eq!(mine.num_rays_hit, other.num_rays_hit, "{}", other.name);
        worst = worst.max(relative(mine.total_flux, other.total_flux, launched));
        let peak = values(other).into_iter().fold(1e-300, f64::max);
        let bins = values(mine).into_iter().zip(values(other));
        worst = bins.map(|(mine, other)| relative(mine, other, peak)).fold(worst, f64::max);
    }
    worst
}

/// The bins of a map, or the fluxes of rows.
fn values(detector: &nsq_gpu::result::Detector) -> Vec<f64> {
    use nsq_gpu::result::DetectorData;
    match &detector.data {
        DetectorData::Irradiance(map) => map.irradiance.iter().copied().collect(),
        DetectorData::Spectral(map) => map.pixels.irradiance.iter().copied().collect(),
        DetectorData::FarField(map) => map.intensity.iter().copied().collect(),
        DetectorData::RayDatabase(rays) => rays.columns().unwrap().flux.to_vec(),
    }
}

/// The scene turned about an axis of no symmetry, then shifted.
fn moved(ir: &SceneIr, rotation: DMat3, shift: DVec3) -> SceneIr {
    let mut ir = ir.clone();
    let move_frame = |frame: &mut Frame| {
        *frame = Frame { origin: rotation * frame.origin + shift, rotation: rotation * frame.rotation };
    };
    ir.surfaces.iter_mut().for_each(|surface| move_frame(&mut surface.frame));
    ir.sources.iter_mut().for_each(|source| move_frame(&mut source.frame));
    ir.detectors.iter_mut().for_each(|detector| move_frame(&mut detector.frame));
    ir
}

#[test]
fn a_rigid_motion_changes_nothing() {
    let turn = DMat3::from_axis_angle(DVec3::new(1.0, -2.0, 0.5).normalize(), 0.7);
    let motions = [
        ("turned and shifted", turn, DVec3::new(30.0, -70.0, 110.0)),
        ("shifted far away", DMat3::IDENTITY, DVec3::new(1e6, -1e6, 1e6)),
    ];
    for name in DIVERSE {
        let ir = zoo::load(name);
        let options = zoo::options(10_000, 4, Precision::F64);
        let still = zoo::trace(&ir, &options);
        for (motion, rotation, shift) in motions {
            let tally = zoo::trace(&moved(&ir, rotation, shift), &options);
            let flips = count_changes(&tally, &still);
            let change = total_change(&tally, &still);
            eprintln!("{name:28} {motion}: {flips} count changes, totals {change:.1e}");
            assert_eq!(flips, 0, "{name} {motion}");
            assert!(change <= 1e-9, "{name} {motion}: {change:e}");
        }
    }
}

/// Events deposited elsewhere, over all sums.
fn count_changes(ours: &Tally, theirs: &Tally) -> u64 {
    flux_sums(ours).zip(flux_sums(theirs)).map(|(mine, other)| mine.count.abs_diff(other.count)).sum()
}

/// The largest difference of a sum, in units of the weight launched.
fn total_change(ours: &Tally, theirs: &Tally) -> f64 {
    let launched = theirs.launched.quanta as f64;
    let changes =
        flux_sums(ours).zip(flux_sums(theirs)).map(|(mine, other)| mine.quanta.abs_diff(other.quanta));
    changes.max().unwrap_or(0) as f64 / launched
}

#[test]
fn a_scene_whose_detector_stays_behind_is_no_rigid_motion() {
    let ir = zoo::load("erfle_eyepiece");
    let options = zoo::options(3000, 4, Precision::F64);
    let mut torn = moved(&ir, DMat3::IDENTITY, DVec3::new(1.0, 0.0, 0.0));
    torn.detectors = ir.detectors.clone();
    let (torn, still) = (zoo::trace(&torn, &options), zoo::trace(&ir, &options));
    assert!(deviation(&torn, &still) > 1e-9);
}

// Physics.

/// A ball of glass in vacuum, a lamp in it near its rim, and a far field on one side.
fn lamp_in_a_ball() -> SceneIr {
    let at = |z: f64| Frame { origin: DVec3::new(0.0, 0.0, z), rotation: DMat3::IDENTITY };
    let medium =
        |name: &str, n: f64| Medium { name: name.into(), ambient: n == 1.0, n: vec![n], k: vec![0.0] };
    SceneIr {
        wavelengths: vec![0.55],
        media: vec![medium("vacuum", 1.0), medium("glass", 1.5)],
        surfaces: vec![Surface {
            name: "ball".into(),
            frame: at(0.0),
            shape: Shape::Sphere(Sphere { radius: 10.0, aperture_radius: None }),
            interaction: Interaction::Refractive,
            coating: None,
            scatter: None,
            front: SceneIr::VACUUM,
            back: 1,
        }],
        meshes: vec![],
        sources: vec![Source {
            name: "lamp".into(),
            frame: at(8.0),
            kind: SourceKind::Point(Point { half_angle: std::f64::consts::PI }),
            total_flux: 1.0,
            spectrum: Spectrum { wavelengths: vec![0], cdf: vec![1.0] },
            medium: 1,
        }],
        detectors: vec![Detector {
            name: "sky".into(),
            frame: at(20.0),
            kind: DetectorKind::FarField(FarField { num_theta: 9, num_phi: 9, sphere: false }),
            absorb: true,
        }],
        sampling: Sampling { rr_start_flux: 0.0, ..Sampling::default() },
        scatter_sampling: Vec::new(),
        allowed: Default::default(),
    }
}

/// True of the last event of a ray that has left the ball: it flew on, or was about to when its events ran out.
fn has_left(event: &PathEvent) -> bool {
    match event.kind {
        PathEventKind::Escaped | PathEventKind::Detector(_) => true,
        PathEventKind::DepthKilled => {
            DVec3::from_array(event.ray.position).dot(DVec3::from_array(event.ray.direction)) > 0.0
        }
        PathEventKind::Birth(_) | PathEventKind::Surface(_) | PathEventKind::FluxKilled => false,
    }
}

#[test]
fn a_source_born_in_glass_counts_one_underflow_for_every_ray_that_leaves() {
    let mut ir = lamp_in_a_ball();
    for precision in PRECISIONS {
        let paths = RecordPaths::All;
        let tally = zoo::trace(&ir, &TraceOptions { paths, ..zoo::options(20_000, 0, precision) });
        let left = tally.paths.iter().filter(|event| has_left(event)).count() as u64;
        assert!(tally.depth_killed.count > 0, "some rays never leave");
        assert_eq!(tally.escaped.count + tally.detectors[0].total().count + tally.depth_killed.count, 20_000);
        assert_eq!(tally.medium_stack_underflows, left);
    }
    // The same lamp outside: every ray that leaves has entered.
    ir.sources[0].medium = SceneIr::VACUUM;
    ir.sources[0].frame.origin.z = 15.0;
    let tally = zoo::trace(&ir, &zoo::options(20_000, 0, Precision::F64));
    assert_eq!(tally.medium_stack_underflows, 0);
}

// The command in other circumstances.

/// The files of a trace by the command, by name; of the report without its timing and the hash of its own text, which holds the timing.
fn files_of_command(scene: &str, precision: &str, threads: &str) -> BTreeMap<String, Vec<u8>> {
    let folder = tempfile::tempdir().unwrap();
    let status = std::process::Command::new(env!("CARGO_BIN_EXE_nsq-gpu"))
        .args([
            "trace",
            &format!("scenes/{scene}.json"),
            "-n",
            "20000",
            "--seed",
            "3",
            "--precision",
            precision,
        ])
        .args(["--json", "--progress", "never", "-o"])
        .arg(folder.path().join("results"))
        .current_dir(env!("CARGO_MANIFEST_DIR"))
        .env("LP_NUM_THREADS", threads)
        .output()
        .unwrap();
    assert!(status.status.success(), "{}", String::from_utf8_lossy(&status.stderr));
    let entries = std::fs::read_dir(folder.path().join("results")).unwrap();
    let mut files: BTreeMap<String, Vec<u8>> = entries
        .map(|entry| entry.unwrap().path())
        .map(|path| (path.file_name().unwrap().to_string_lossy().into(), std::fs::read(&path).unwrap()))
        .collect();
    for bytes in [files.get_mut("report.json").unwrap(), &mut { status.stdout }] {
        let mut report: serde_json::Value = serde_json::from_slice(bytes).unwrap();
        for timing in ["trace_time_sec", "first_rays_sec", "rays_per_sec"] {
            report.as_object_mut().unwrap().remove(timing).expect("the report tells its timing");
        }
        let hashes = report["meta"].as_object_mut().unwrap();
        hashes.remove("sha256").expect("the report holds the hash of its own text");
        *bytes = report.to_string().into_bytes();
    }
    files
}

#[test]
fn one_thread_and_two_write_the_same_bytes() {
    for scene in zoo::in_turn(["filter_stack", "kaleidoscope", "tessar_gaussian_beams"]) {
        for precision in ["f32", "f64"] {
            let [one, two] = ["1", "2"].map(|threads| files_of_command(scene, precision, threads));
            assert!(one.len() > 2, "{scene}: {:?}", one.keys());
            for (name, bytes) in &one {
                assert!(two.get(name) == Some(bytes), "{scene} in {precision}: {name} differs");
            }
            assert_eq!(one.len(), two.len());
        }
    }
}

#[test]
fn files_of_another_precision_differ() {
    let [f32, f64] = ["f32", "f64"].map(|precision| files_of_command("kaleidoscope", precision, "2"));
    assert!(f32["eye.npz"] != f64["eye.npz"]);
    assert!(f32["report.json"] != f64["report.json"]);
}

/// A cone of glass whose tip points along z, or against it, and a ray that arrives there: its normal is the axis, outward.
#[test]
fn rays_through_the_tip_of_a_cone_are_turned_as_by_a_face_across_its_axis() {
    for outward in [1.0, -1.0] {
        let mut ir = lamp_in_a_ball();
        let (r_front, r_back) = if outward > 0.0 { (5.0, 0.0) } else { (0.0, 5.0) };
        ir.surfaces[0].shape = Shape::Frustum(Frustum { r_front, r_back, z_front: 0.0, z_back: 10.0 });
        (ir.surfaces[0].front, ir.surfaces[0].back) = (1, 0);
        let z = DVec3::new(0.0, 0.0, -outward);
        let rotation = DMat3::from_cols(DVec3::X, z.cross(DVec3::X), z);
        ir.sources[0].frame = Frame { origin: -20.0 * z, rotation };
        ir.sources[0].kind = SourceKind::Point(Point { half_angle: 0.0 });
        ir.sources[0].medium = 0;
        for precision in [Precision::F32, Precision::Df64, Precision::F64] {
            let options = zoo::options(1000, 5, precision);
            let what = format!("{precision:?}, outward {outward}");
            ir.surfaces[0].interaction = Interaction::Refractive;
            let tally = zoo::trace(&ir, &options);
            assert_eq!((tally.invalid_deposits, tally.medium_stack_underflows), (0, 0), "{what}");
            assert_eq!(tally.detectors[0].hits.iter().sum::<u64>() + tally.escaped.count, 1000, "{what}");
            ir.surfaces[0].interaction = Interaction::Reflective { reflectance: vec![1.0] };
            let options = TraceOptions { paths: RecordPaths::All, ..options };
            let tally = zoo::trace(&ir, &options);
            let are = |is: fn(&PathEventKind) -> bool| -> Vec<&PathEvent> {
                tally.paths.iter().filter(|event| is(&event.kind)).collect()
            };
            let met = are(|kind| matches!(kind, PathEventKind::Surface(_)));
            let left = are(|kind| matches!(kind, PathEventKind::Escaped | PathEventKind::Detector(_)));
            assert_eq!((met.len(), left.len()), (1000, 1000), "{what}");
            assert!(met.iter().all(|event| event.ray.position == [0.0, 0.0, 5.0 + 5.0 * outward]), "{what}");
            assert!(left.iter().all(|event| event.ray.direction == [0.0, 0.0, outward]), "{what}");
        }
    }
}
