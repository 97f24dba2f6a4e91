//! Strict arithmetic: the same scene compiled in, in tables and searched by a tree gives the same bits; so do the ways of
//! graphics processors, and other drivers.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test fails by panicking")]

mod zoo;

use nsq_gpu::gpu::{AdapterChoice, AdapterClass, Gpu, Ways, list_adapters};
use nsq_gpu::model::SceneIr;
use nsq_gpu::program::{Precision, Sampler};
use nsq_gpu::result::Tally;
use nsq_gpu::run::{RecordPaths, Strict};
use nsq_gpu::{Error, TraceOptions, Tracer};
use std::collections::BTreeSet;
use zoo::devices::Devices;

/// True where the device can be strict; else says on stderr what is skipped.
fn can_be_strict(test: &str) -> bool {
    let can = zoo::gpu().info.strict;
    if !can {
        zoo::skip(test, "the adapter takes no SPIR-V");
    }
    can
}

/// All sums and all paths of a scene in one form of its shader: compiled in, or in tables that are searched by a tree or in
/// turn.
fn form(ir: &SceneIr, options: &TraceOptions, (baked, tree): (bool, bool)) -> Tally {
    zoo::trace(ir, &TraceOptions { baked: Some(baked), tree: Some(tree), ..options.clone() })
}

const COMPILED_IN: (bool, bool) = (true, true);
const BY_TREE: (bool, bool) = (false, true);
const IN_TURN: (bool, bool) = (false, false);

fn assert_same_bits(name: &str, precision: Precision, forms: &[(bool, bool)]) {
    let options =
        TraceOptions { strict: Strict::On, paths: RecordPaths::All, ..zoo::options(600, 3, precision) };
    let ir = zoo::load(name);
    let baked = form(&ir, &options, COMPILED_IN);
    for &which in forms {
        let other = form(&ir, &options, which);
        let differing = baked.paths.iter().zip(&other.paths).find(|(a, b)| a != b);
        assert!(differing.is_none(), "{name}, {precision:?}, {which:?}: {differing:?}");
        assert!(baked == other, "{name}, {precision:?}, {which:?}: other sums");
    }
}

#[test]
fn scenes_in_tables_have_the_bits_of_scenes_compiled_in() {
    if can_be_strict("same bits in tables") {
        zoo::scenes_in_turn().for_each(|(_, name)| assert_same_bits(&name, Precision::F32, &[BY_TREE]));
    }
}

#[test]
fn every_form_of_a_scene_has_the_same_bits() {
    if can_be_strict("same bits of every form") {
        for name in ["cooke_triplet", "double_gauss", "mesh_lens", "scattering_telescope", "opal_lamp"] {
            assert_same_bits(name, Precision::F64, &[BY_TREE, IN_TURN]);
        }
    }
}

/// A processor's adapter as if it were a graphics processor's.
fn as_graphics_processor() -> &'static Gpu {
    static GPUS: Devices<Gpu> = Devices::new();
    GPUS.mine(|| open(None, Ways::OfGraphicsProcessors))
}

fn open(name: Option<String>, ways: Ways) -> Gpu {
    Gpu::open(&AdapterChoice { name, ways, ..AdapterChoice::default() }).unwrap()
}

/// Asserts it of every other scene, from the first or the second on.
fn assert_ways_agree(test: &str, first: usize, precision: Precision) {
    let (own, graphics) = (zoo::unchecked_gpu(), as_graphics_processor());
    if !can_be_strict(test) {
        return;
    }
    if own.info.class != AdapterClass::Processor {
        return zoo::skip(test, "the adapter is a graphics processor");
    }
    let options = TraceOptions { strict: Strict::On, ..zoo::options(3000, 8, precision) };
    for name in zoo::scenes().iter().skip(first).step_by(2) {
        let ir = zoo::load(name);
        let [own, graphics] = [own, graphics].map(|gpu| zoo::trace_on(gpu, &ir, &options));
        assert!(own == graphics, "{name} in {precision:?}: other bits");
    }
}

#[test]
fn the_ways_of_graphics_processors_have_the_same_bits_in_f32() {
    assert_ways_agree("ways in f32", 0, Precision::F32);
}

#[test]
fn the_ways_of_graphics_processors_have_the_same_bits_in_f64() {
    assert_ways_agree("ways in f64", 1, Precision::F64);
}

/// Of processors: graphics processors may round divisions and roots otherwise (Vulkan, "Precision of Individual
/// Operations").
#[test]
#[ignore = "wants two drivers on processors: make test-drivers"]
fn drivers_on_processors_give_the_same_bits() {
    // SwiftShader's compiler takes gigabytes for it.
    const LEFT_OUT: &str = "mesh_prism";
    let names: BTreeSet<String> = list_adapters()
        .into_iter()
        .filter(|info| info.class == AdapterClass::Processor)
        .map(|info| info.name)
        .collect();
    if names.len() < 2 {
        return zoo::skip("same bits of drivers", &format!("not two on processors: {names:?}"));
    }
    let gpus: Vec<Gpu> = names.into_iter().map(|name| open(Some(name), Ways::OfItsKind)).collect();
    let [strict, plain] = [Strict::On, Strict::Off]
        .map(|strict| TraceOptions { strict, ..zoo::options(20_000, 8, Precision::F32) });
    let differ = |name: &str, options: &TraceOptions| {
        let ir = zoo::load(name);
        let first = zoo::trace_on(&gpus[0], &ir, options);
        gpus[1..].iter().any(|gpu| zoo::trace_on(gpu, &ir, options) != first)
    };
    let scenes: Vec<String> = zoo::scenes().into_iter().filter(|name| name != LEFT_OUT).collect();
    let others: Vec<&String> = scenes.iter().filter(|name| differ(name, &strict)).collect();
    assert!(others.is_empty(), "other bits in {others:?}");
    assert!(differ("cooke_triplet", &plain), "without strict arithmetic, too: this test could not fail");
}

/// What strict arithmetic is for: without it some of the same rays come out otherwise. Of another driver this need not be
/// so, and is only said.
#[test]
fn without_it_drivers_may_round_otherwise() {
    let options = TraceOptions {
        strict: Strict::Off,
        paths: RecordPaths::All,
        ..zoo::options(4000, 3, Precision::F64)
    };
    let ir = zoo::load("cooke_triplet");
    let [baked, tables] = [COMPILED_IN, BY_TREE].map(|which| form(&ir, &options, which));
    let others = baked.paths.iter().zip(&tables.paths).filter(|(a, b)| a != b).count();
    eprintln!("{others} of {} events differ", baked.paths.len());
    if zoo::gpu().info.class.is_strict_by_default() {
        assert!(others > 0, "the tests of strict arithmetic could not fail");
    }
}

#[test]
fn strict_arithmetic_moves_rays_by_rounding_alone() {
    if !can_be_strict("strict against plain") {
        return;
    }
    let plain = TraceOptions { strict: Strict::Off, ..zoo::options(4000, 3, Precision::F64) };
    for name in ["cooke_triplet", "integrating_sphere"] {
        let ir = zoo::load(name);
        let strict = zoo::trace(&ir, &TraceOptions { strict: Strict::On, ..plain.clone() });
        let plain = zoo::trace(&ir, &plain);
        assert_eq!(strict.escaped.count, plain.escaped.count, "{name}");
        for (strict, plain) in strict.detectors.iter().zip(&plain.detectors) {
            assert_eq!(strict.hits, plain.hits, "{name}");
        }
    }
}

#[test]
fn where_it_cannot_be_had_it_is_refused_and_never_taken_by_itself() {
    let mut gpu = Gpu::open(&AdapterChoice::default()).unwrap();
    gpu.info.strict = false;
    let ir = zoo::load("bench_lens");
    let options = zoo::options(100, 0, Precision::F32);
    assert!(!options.strict.holds(&gpu.info));
    assert!(Tracer::new(&gpu, &ir, &options).is_ok());
    let refused = Tracer::new(&gpu, &ir, &TraceOptions { strict: Strict::On, ..options }).err();
    assert!(matches!(&refused, Some(Error::Usage(why)) if why.contains("SPIR-V")), "{refused:?}");
}

/// A tracer with another seed is a tracer of that seed.
#[test]
fn reseeded_tracers_draw_what_new_ones_draw() {
    for sampler in [Sampler::Pcg, Sampler::Sobol] {
        for name in ["bench_lens", "tessar_gaussian_beams"] {
            let ir = zoo::load(name);
            let options = |seed| TraceOptions { sampler, ..zoo::options(3000, seed, Precision::F32) };
            let mut tracer = zoo::tracer(&ir, &options(1)).unwrap();
            let first = tracer.trace(|_| true).unwrap();
            tracer.set_seed((1 << 40) + 7);
            let second = tracer.trace(|_| true).unwrap();
            assert!(first != second, "{name}, {sampler:?}");
            assert!(second == zoo::trace(&ir, &options((1 << 40) + 7)), "{name}, {sampler:?}");
        }
    }
}
