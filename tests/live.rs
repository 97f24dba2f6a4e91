//! Live numbers: the shader of a scene's shape, with the numbers in a table, gives the bits of the shader that has them
//! compiled in. Scenes that differ in their numbers alone share a shader, and none sees another one's numbers.
#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "clippy's exemption of tests does not reach their helpers"
)]

#[path = "zoo/bits.rs"]
#[allow(dead_code, reason = "plain.rs alone writes them")]
mod bits;
#[path = "zoo/files.rs"]
mod files;

use std::io::Write;
use std::path::Path;

use bits::{hash, precision};
use files::{json_files, repository, scenes_in_turn, turn};
use nsq_gpu::gpu::{AdapterChoice, Gpu};
use nsq_gpu::model::SceneIr;
use nsq_gpu::program::Precision;
use nsq_gpu::result::Tally;
use nsq_gpu::run::{ForAdapter, PipelineCache, Shaders};
use nsq_gpu::{Scene, TraceOptions, Tracer};
use serde_json::Value;

/// A tracer with the shaders of a cache.
fn cached<'a>(
    gpu: &'a Gpu,
    ir: &'a SceneIr,
    options: &TraceOptions,
    cache: &PipelineCache,
) -> nsq_gpu::Result<Tracer<'a>> {
    Tracer::with(gpu, ir, options, ForAdapter::WhatPays, Shaders { cache: Some(cache), edit: None })
}

fn gpu() -> Gpu {
    Gpu::open(&AdapterChoice::default()).unwrap()
}

fn options(precision: Precision, live: bool) -> TraceOptions {
    TraceOptions { live, ..bits::options(precision) }
}

fn text(name: &str) -> String {
    std::fs::read_to_string(repository(&format!("scenes/{name}.json"))).unwrap()
}

fn model(text: &str) -> nsq_gpu::Result<SceneIr> {
    Scene::with_numbers(text, &repository("scenes"), &[])?.lower()
}

/// The places of all numbers that have digits behind the point, or are 0, below a place.
fn numbers(value: &Value, place: String, found: &mut Vec<String>) {
    match value {
        Value::Number(number)
            if number.as_f64().is_some_and(|n| n.abs() > 1.0 || n.fract() != 0.0 && n.abs() > 1e-9) =>
        {
            found.push(place);
        }
        Value::Array(items) => {
            items.iter().enumerate().for_each(|(i, item)| numbers(item, format!("{place}/{i}"), found));
        }
        Value::Object(entries) => {
            entries.iter().for_each(|(key, entry)| numbers(entry, format!("{place}/{key}"), found));
        }
        _ => {}
    }
}

/// A scene with one number a little larger; `None` if it is no valid scene then.
fn changed(document: &Value, place: &str) -> Option<(Value, SceneIr)> {
    let mut document = document.clone();
    let number = document.pointer_mut(place)?;
    *number = (number.as_f64()? * (1.0 - 3e-4)).into();
    let ir = model(&document.to_string()).ok()?;
    Some((document, ir))
}

fn document(name: &str) -> Value {
    let text = text(name).replace("-Infinity", "-1e300").replace("Infinity", "1e300");
    serde_json::from_str(&text).unwrap_or_else(|problem| panic!("{name}: {problem}"))
}

#[test]
fn every_scene_gives_the_committed_bits() {
    let (gpu, cache) = (gpu(), PipelineCache::new());
    let committed = bits::committed();
    let mut differ = Vec::new();
    for (i, name) in scenes_in_turn() {
        let ir = model(&text(&name)).unwrap();
        let mut tracer = cached(&gpu, &ir, &options(precision(i), true), &cache).unwrap();
        if hash(&tracer.trace(|_| true).unwrap()) != committed[&name] {
            differ.push(name);
        }
    }
    assert_eq!(differ, Vec::<String>::new());
}

#[test]
fn scenes_of_one_shape_share_a_shader_and_each_has_its_own_numbers() {
    check_scenes_of_one_shape(4);
}

#[test]
#[ignore = "long"]
fn all_scenes_of_one_shape_share_a_shader() {
    check_scenes_of_one_shape(1);
}

/// Of each scene, or of every so many one: another with as many of its numbers changed as leave it valid and of its shape.
fn check_scenes_of_one_shape(every: usize) {
    let gpu = gpu();
    let (mut num_changed, mut num_scenes) = (0, 0);
    for (i, name) in json_files("scenes").into_iter().enumerate().step_by(every) {
        let original = document(&name);
        let cache = PipelineCache::new();
        let live = |ir: &SceneIr| -> (String, Tally) {
            let mut tracer = cached(&gpu, ir, &options(precision(i), true), &cache).unwrap();
            let text = tracer.program().wgsl.clone();
            (text, tracer.trace(|_| true).unwrap())
        };
        let (shape, tally) = live(&model(&original.to_string()).unwrap());
        let mut places = Vec::new();
        numbers(&original, String::new(), &mut places);
        let mut scene = original.clone();
        for place in places {
            let Some((next, ir)) = changed(&scene, &place) else { continue };
            let is_of_the_shape = |ir: &SceneIr| {
                let tracer = cached(&gpu, ir, &options(precision(i), true), &cache);
                tracer.is_ok_and(|tracer| tracer.program().wgsl == shape)
            };
            if is_of_the_shape(&ir) {
                scene = next;
                num_changed += 1;
            }
        }
        let ir = model(&scene.to_string()).unwrap();
        let (text, changed) = live(&ir);
        assert_eq!(text, shape, "{name}");
        let compiled_in =
            Tracer::new(&gpu, &ir, &options(precision(i), false)).unwrap().trace(|_| true).unwrap();
        assert_eq!(hash(&changed), hash(&compiled_in), "{name}");
        if hash(&changed) != hash(&tally) {
            num_scenes += 1;
        }
        // And the first scene has its own numbers again.
        assert_eq!(hash(&live(&model(&original.to_string()).unwrap()).1), hash(&tally), "{name}");
    }
    let _ = writeln!(
        std::io::stderr(),
        "{num_changed} numbers were changed, in {num_scenes} scenes to another result"
    );
    assert!(num_changed * every > 1000 && num_scenes * every > 30, "{num_changed} {num_scenes}");
}

#[test]
fn a_quarter_of_the_numbers_of_every_scene_reach_the_device() {
    check_numbers(4, 0);
}

#[test]
#[ignore = "long"]
fn every_number_of_every_scene_reaches_the_device() {
    check_numbers(1, 2);
}

/// Whatever changes the model changes the shader or what it reads; but for the flux of a single source, which is the
/// host's. Every so many one is changed. Two have no effect, of which so many are among these.
fn check_numbers(every: usize, num_without_effect: usize) {
    let gpu = gpu();
    let (mut num_numbers, mut without_effect) = (0, Vec::new());
    for (_, name) in scenes_in_turn() {
        let (original, cache) = (document(&name), PipelineCache::new());
        let read = |ir: &SceneIr| {
            let tracer = cached(&gpu, ir, &options(Precision::F64, true), &cache).ok()?;
            let program = tracer.program();
            Some((program.wgsl.clone(), program.buffers.clone(), program.source_uniforms.clone()))
        };
        let ir = model(&original.to_string()).unwrap();
        let before = read(&ir).unwrap();
        let mut places = Vec::new();
        numbers(&original, String::new(), &mut places);
        for place in places.into_iter().step_by(every) {
            let Some((_, other)) = changed(&original, &place) else { continue };
            let is_flux = place.ends_with("total_flux") && ir.sources.len() == 1;
            // Without dispersion and absorption a wavelength is a name; few bounds of bins lie at one.
            if other == ir || is_flux || place.contains("/wavelengths/") || place.contains("/wl_m") {
                continue;
            }
            let Some(after) = read(&other) else { continue };
            num_numbers += 1;
            if after == before {
                without_effect.push(format!("{name}: {place}"));
            }
        }
    }
    let _ = writeln!(std::io::stderr(), "{num_numbers} numbers");
    // Any half-angle from 90 degrees on means Lambert's law.
    let known = ["searchlight: /sources/0/half_angle_deg", "tapered_light_guide: /sources/1/half_angle_deg"];
    assert!(without_effect.iter().all(|place| known.contains(&place.as_str())), "{without_effect:?}");
    assert_eq!(without_effect.len(), num_without_effect, "{without_effect:?}");
    let least = if turn().is_none() { 1000 } else { 300 };
    assert!(num_numbers * every > least, "{num_numbers}");
}

#[test]
fn without_live_numbers_the_shader_is_the_same_text_as_before() {
    let gpu = gpu();
    let ir = Scene::from_path(Path::new(&repository("scenes/cooke_triplet.json"))).unwrap().lower().unwrap();
    let plain = Tracer::new(&gpu, &ir, &options(Precision::F64, false)).unwrap();
    assert!(!plain.program().wgsl.contains("numbers.n0"));
    let live = Tracer::new(&gpu, &ir, &options(Precision::F64, true)).unwrap();
    assert!(live.program().wgsl.contains("numbers.n0"));
}
