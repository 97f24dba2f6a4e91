//! Every shader that can be composed is valid on every platform, and host and shaders mean the same by their structs,
//! bindings and codes. No adapter is needed.

#![allow(clippy::unwrap_used, clippy::panic, clippy::print_stdout, reason = "a test fails by panicking")]

#[path = "../zoo/files.rs"]
mod files;
mod layouts;
mod snapshots;
mod targets;
mod twins;
mod variants;

use nsq_gpu::Scene;
use nsq_gpu::program::{Precision, Program};
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use targets::{Target, storage_buffers, validate};
use variants::{
    Choice, Tier, Variant, everything, everything_split, everything_with_derivatives, everything_with_paths,
};

/// The folder of the project.
pub fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).to_path_buf()
}

/// The names of scenes/, without their extension.
pub fn scene_names() -> Vec<String> {
    let mut names: Vec<String> = std::fs::read_dir(root().join("scenes"))
        .unwrap()
        .filter_map(|entry| {
            entry.unwrap().file_name().into_string().unwrap().strip_suffix(".json").map(String::from)
        })
        .collect();
    names.sort();
    names
}

/// A scene of scenes/ as a variant.
pub fn scene_variant(name: &str) -> Variant {
    let path = root().join("scenes").join(format!("{name}.json"));
    let ir = Scene::from_path(&path).and_then(|scene| scene.lower()).unwrap();
    Variant { ir, ..Variant::default() }
}

/// The variant is valid with the capabilities of its tier alone, and is written for every platform that has them.
/// Returns the targets.
fn check(name: &str, program: &Program, checks: &[bool]) -> Vec<Target> {
    let info = validate(name, program);
    let targets = Target::of(&program.options);
    for target in &targets {
        checks.iter().for_each(|&checks| target.write(name, program, &info, checks));
    }
    targets
}

/// Checks one in `step` variants of a tier; texts that were already checked are skipped. Run-time checks in shaders are
/// on and off in turn: they concern each expression alone, and each occurs in many variants.
fn check_every(step: usize, tier: Tier) {
    let mut seen = BTreeSet::new();
    let mut written: BTreeMap<Target, u32> = BTreeMap::new();
    for (name, variant) in variants_of(tier).step_by(step) {
        let program = variant.program(tier);
        let name = format!("{name}, {tier:?}");
        if seen.insert(program.wgsl.clone()) {
            let checks = [seen.len() % 2 == 0];
            check(&name, &program, &checks)
                .into_iter()
                .for_each(|target| *written.entry(target).or_default() += 1);
        }
    }
    println!("{tier:?}: {} different shaders, written: {written:?}", seen.len());
    assert!(seen.len() > 100, "{tier:?}: only {} different shaders", seen.len());
}

/// Every choice alone, everything at once, every scene file, and the tier's half of all pairs of choices. Of the eight
/// tiers of f32 and f64 a pair is in four, which have every two of precision, integers and place of the records together.
fn variants_of(tier: Tier) -> impl Iterator<Item = (String, Variant)> {
    let overrides = Choice::all();
    let half =
        usize::from(tier.precision != Precision::F32) + usize::from(tier.native) + usize::from(tier.baked);
    let pairs: Vec<(Choice, Choice)> = (0..overrides.len())
        .flat_map(|i| (i..overrides.len()).map(move |j| (i, j)))
        .filter(|(i, j)| i == j || (i + j) % 2 == half % 2)
        .map(|(i, j)| (overrides[i], overrides[j]))
        .collect();
    let paired = pairs.into_iter().map(|(a, b)| {
        let mut variant = Variant::default();
        a.apply(&mut variant);
        b.apply(&mut variant);
        (format!("{a:?} with {b:?}"), variant)
    });
    let scenes = scene_names().into_iter().map(|name| (name.clone(), scene_variant(&name)));
    let whole = [("everything", everything()), ("everything, split", everything_split())];
    let paths = everything_with_paths().into_iter().map(|variant| ("everything with paths".into(), variant));
    let derivatives = everything_with_derivatives()
        .into_iter()
        .map(|variant| ("everything with derivatives".into(), variant));
    paired
        .chain(whole.map(|(name, variant)| (name.to_string(), variant)))
        .chain(paths)
        .chain(derivatives)
        .chain(scenes)
}

#[test]
fn a_quarter_of_the_f32_portable_variants_are_valid_everywhere() {
    for baked in files::in_turn([true, false]) {
        check_every(4, Tier { precision: Precision::F32, native: false, baked });
    }
}

#[test]
#[ignore = "long"]
fn f32_portable_variants_are_valid_everywhere() {
    for baked in [true, false] {
        check_every(1, Tier { precision: Precision::F32, native: false, baked });
    }
}

#[test]
#[ignore = "long"]
fn f32_native_variants_are_valid_where_integers_have_64_bits() {
    for baked in [true, false] {
        check_every(1, Tier { precision: Precision::F32, native: true, baked });
    }
}

/// Every second: their text is that of f64, whose every variant is tested.
#[test]
#[ignore = "long"]
fn df64_variants_are_valid_everywhere() {
    for (native, baked) in [(false, true), (true, false)] {
        check_every(2, Tier { precision: Precision::Df64, native, baked });
    }
}

#[test]
#[ignore = "long"]
fn f64_portable_variants_are_valid_where_floats_have_64_bits() {
    for baked in [true, false] {
        check_every(1, Tier { precision: Precision::F64, native: false, baked });
    }
}

#[test]
#[ignore = "long"]
fn f64_native_variants_are_valid_where_everything_has_64_bits() {
    for baked in [true, false] {
        check_every(1, Tier { precision: Precision::F64, native: true, baked });
    }
}

/// In one tier of each precision, unlike in integers and in whether scenes are compiled in.
#[test]
fn full_scenes_are_written_with_and_without_checks() {
    check_full_scenes(files::in_turn(Tier::all().into_iter().step_by(5)));
}

#[test]
#[ignore = "long"]
fn full_scenes_are_written_with_and_without_checks_in_every_tier() {
    check_full_scenes(Tier::all());
}

/// The scene with everything and some scene files, with run-time checks in shaders and without.
fn check_full_scenes(tiers: impl IntoIterator<Item = Tier>) {
    for tier in tiers {
        check("everything", &everything().program(tier), &[true, false]);
        check("everything, split", &everything_split().program(tier), &[true, false]);
        for variant in everything_with_paths() {
            check("everything with paths", &variant.program(tier), &[true, false]);
        }
        for variant in everything_with_derivatives() {
            check("everything with derivatives", &variant.program(tier), &[true, false]);
        }
        for name in ["cooke_triplet", "kaleidoscope", "filter_stack"] {
            check(name, &scene_variant(name).program(tier), &[true, false]);
        }
    }
}

#[test]
fn the_shader_between_dispatches_is_valid_everywhere() {
    targets::check_advance();
}

/// No file of shaders/ is dead: each is part of some variant as it is.
#[test]
fn every_shader_file_is_composed_by_some_variant() {
    let mut unseen = snapshots::shader_files();
    let mut see = |composed: String| {
        unseen.retain(|(_, text)| !composed.contains(text));
        unseen.is_empty()
    };
    see(nsq_gpu::program::wgsl::compose::advance());
    // Files of paths that other choices bring in.
    let variants = || {
        let whole = [everything(), everything_split()].into_iter().chain(everything_with_paths());
        let choices = Choice::all().into_iter().map(|choice| Variant::of_choice(choice).1);
        whole.chain(choices).chain(everything_with_derivatives())
    };
    // Once all are seen, nothing more is composed: every third tier mostly does.
    let _ = [3, 1].into_iter().any(|step| {
        variants().any(|variant| Tier::all().into_iter().step_by(step).any(|tier| see(variant.text(tier))))
    });
    let dead: Vec<String> = unseen.into_iter().map(|(path, _)| path).collect();
    assert_eq!(dead, Vec::<String>::new(), "no variant composes them");
}

/// Of two rays that an invocation follows, each has its own of what these declare: compositions find them by their lines.
#[test]
fn what_is_private_has_a_first_value_in_its_line() {
    let private = |text: &str| text.lines().filter(|line| line.contains("var<private>")).count();
    let found = |text: &str| {
        let declares = |line: &&str| line.starts_with("var<private> ") && line.ends_with(';');
        text.lines().filter(declares).filter(|line| line.contains(": ") && line.contains(" = ")).count()
    };
    for file in
        ["cpu/path/hot_path.wgsl", "cpu/path/path_log.arrivals.wgsl", "cpu/path/path_losses.reported.wgsl"]
    {
        let files = snapshots::shader_files();
        let (_, text) = files.iter().find(|(path, _)| path == file).unwrap();
        assert_eq!(found(text), private(text), "{file}");
        assert!(private(text) > 0, "{file}");
    }
}

/// Plain WebGPU binds 8 storage buffers a stage. What binds more is known by name, with its number.
#[test]
fn portable_shaders_bind_few_storage_buffers() {
    let tier = Tier { precision: Precision::F32, native: false, baked: true };
    let mut beyond = BTreeMap::new();
    let mut most = 0;
    let whole = Choice::all().into_iter().filter(|choice| *choice != Choice::SumsInParts);
    for (name, variant) in whole.map(Variant::of_choice) {
        let buffers = storage_buffers(&variant.program(tier).module);
        assert!(buffers <= targets::WEBGPU_STORAGE_BUFFERS, "{name} alone binds {buffers} storage buffers");
        most = most.max(buffers);
    }
    for name in scene_names() {
        let buffers = storage_buffers(&scene_variant(&name).program(tier).module);
        most = most.max(buffers);
        if buffers > targets::WEBGPU_STORAGE_BUFFERS {
            beyond.insert(name, buffers);
        }
    }
    println!("at most {most}");
    assert_eq!(beyond, BTreeMap::new(), "scenes that plain WebGPU cannot bind");
    // Only processors log where rays end, and only large sums lie in parts.
    let everything = || Variant { deferred_splats: false, part_bytes: 1 << 27, ..everything() };
    let (compiled, tables) =
        (everything().program(tier), everything().program(Tier { baked: false, ..tier }));
    assert_eq!(
        (storage_buffers(&compiled.module), storage_buffers(&tables.module)),
        targets::MOST_STORAGE_BUFFERS
    );
}

/// Two scenes are shown as they are composed: what changes them is seen in review.
#[test]
fn the_composition_is_the_one_that_was_reviewed() {
    snapshots::compare("bench_lens", Tier { precision: Precision::F32, native: false, baked: true });
    snapshots::compare("kaleidoscope", Tier { precision: Precision::F64, native: true, baked: false });
}
