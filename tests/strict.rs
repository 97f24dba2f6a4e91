//! Strict arithmetic: the same scene compiled in, in tables and searched by a tree gives the same bits.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test fails by panicking")]

mod zoo;

use nsq_gpu::Error;
use nsq_gpu::gpu::{AdapterChoice, Gpu};
use nsq_gpu::ir::SceneIr;
use nsq_gpu::program::{Precision, Sampler};
use nsq_gpu::result::Tally;
use nsq_gpu::trace::{RecordPaths, Strict};
use nsq_gpu::{TraceOptions, Tracer};
use std::io::Write;

/// True where the device can be strict; else says on stderr what is skipped.
fn can_be_strict(test: &str) -> bool {
    let can = zoo::gpu().info.strict;
    if !can {
        let _ = writeln!(std::io::stderr(), "SKIPPED: {test}: the adapter takes no SPIR-V");
    }
    can
}

/// Whether the scene is compiled in, and whether tables are searched by a tree.
const FORMS: [(bool, bool); 3] = [(true, true), (false, true), (false, false)];

/// All sums and all paths of a scene in every form of its shader.
fn forms(ir: &SceneIr, options: &TraceOptions) -> [Tally; 3] {
    FORMS.map(|(baked, tree)| {
        let form = TraceOptions { baked: Some(baked), tree: Some(tree), ..options.clone() };
        zoo::trace(ir, &form)
    })
}

fn assert_same_bits(name: &str, precision: Precision) {
    let options =
        TraceOptions { strict: Strict::On, paths: RecordPaths::All, ..zoo::options(600, 3, precision) };
    let [baked, by_tree, in_turn] = forms(&zoo::load(name), &options);
    for (form, other) in [("in tables, by a tree", &by_tree), ("in tables, in turn", &in_turn)] {
        let differing = baked.paths.iter().zip(&other.paths).find(|(a, b)| a != b);
        assert!(differing.is_none(), "{name}, {precision:?}, {form}: {differing:?}");
        assert!(&baked == other, "{name}, {precision:?}, {form}: other sums");
    }
}

#[test]
fn every_form_of_a_scene_gives_the_same_bits_in_f32() {
    if can_be_strict("same bits of every form in f32") {
        zoo::scenes().iter().for_each(|name| assert_same_bits(name, Precision::F32));
    }
}

#[test]
fn every_form_of_a_scene_gives_the_same_bits_in_f64() {
    if can_be_strict("same bits of every form in f64") {
        let names = ["cooke_triplet", "double_gauss", "mesh_lens", "scattering_telescope", "opal_lamp"];
        names.iter().for_each(|name| assert_same_bits(name, Precision::F64));
    }
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
    let [baked, tables, _] = forms(&zoo::load("cooke_triplet"), &options);
    let others = baked.paths.iter().zip(&tables.paths).filter(|(a, b)| a != b).count();
    eprintln!("{others} of {} events differ", baked.paths.len());
    if zoo::gpu().info.kind == "Cpu" {
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
        for (strict, plain) in strict.sensors.iter().zip(&plain.sensors) {
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
            let mut tracer = Tracer::new(zoo::gpu(), &ir, &options(1)).unwrap();
            let first = tracer.trace(|_| true).unwrap();
            tracer.set_seed((1 << 40) + 7);
            let second = tracer.trace(|_| true).unwrap();
            assert!(first != second, "{name}, {sampler:?}");
            assert!(second == zoo::trace(&ir, &options((1 << 40) + 7)), "{name}, {sampler:?}");
        }
    }
}
