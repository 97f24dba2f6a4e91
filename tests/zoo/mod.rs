//! The scene collection and the devices that tests trace it on.
#![allow(dead_code, reason = "each test binary compiles the helpers and uses its part of them")]
#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "clippy's exemption of tests does not reach their helpers"
)]

pub mod devices;
pub mod draws;
pub mod files;
pub mod forced;

use std::io::Write;

use devices::Devices;
#[allow(unused_imports, reason = "each test binary uses its part of the helpers")]
pub use files::{NUM_TURNS, in_turn, is_of_turn, json_files, repository, scenes_in_turn, turn};
use forced::Asked;
use nsq_gpu::gpu::{AdapterChoice, Gpu, Native};
use nsq_gpu::guide::Guide;
use nsq_gpu::guide::learn::{Wanted, learn};
use nsq_gpu::model::{Bsdf, Coating, HarveyShack, Interaction, Scatter, SceneIr, SimpleCoating};
use nsq_gpu::program::Precision;
use nsq_gpu::result::{PathSum, QUANTA_PER_WEIGHT, RunInfo, Tally};
use nsq_gpu::run::{Collect, ForAdapter, PipelineCache, Shaders};
use nsq_gpu::{Result, Scene, TraceOptions, TraceResult, Tracer};
use std::sync::Arc;

/// The device of a test; its shaders run with every run-time check.
pub fn gpu() -> &'static Gpu {
    &CHECKED.mine(|| Opened::new(Native::Allowed, true)).gpu
}

/// The same without them, as commands open it.
pub fn unchecked_gpu() -> &'static Gpu {
    &UNCHECKED.mine(|| Opened::new(Native::Allowed, false)).gpu
}

/// The one without optional features; it checks as well.
pub fn portable_gpu() -> &'static Gpu {
    &PORTABLE.mine(|| Opened::new(Native::Off, true)).gpu
}

static CHECKED: Devices<Opened> = Devices::new();
static UNCHECKED: Devices<Opened> = Devices::new();
static PORTABLE: Devices<Opened> = Devices::new();

/// A device, and the shaders that tests have compiled on it. Lavapipe spends two thirds of a test's time with compiling, and
/// a third of the shaders of a program's tests are alike.
struct Opened {
    gpu: Gpu,
    cache: PipelineCache,
}

impl Opened {
    fn new(native: Native, runtime_checks: bool) -> Self {
        Opened { gpu: open(native, runtime_checks), cache: PipelineCache::new() }
    }
}

/// The shaders of one of these devices; none for other devices.
pub fn shaders_of(gpu: &Gpu) -> Shaders<'static> {
    let mut all = [&CHECKED, &UNCHECKED, &PORTABLE].into_iter().flat_map(Devices::opened);
    Shaders {
        cache: all.find(|opened| std::ptr::eq(&opened.gpu, gpu)).map(|opened| &opened.cache),
        edit: None,
    }
}

fn open(native: Native, runtime_checks: bool) -> Gpu {
    Gpu::open(&AdapterChoice { native, runtime_checks, ..AdapterChoice::default() })
        .expect("an adapter opens")
}

/// Says that a test is skipped, and why.
pub fn skip(test: &str, reason: &str) {
    // Straight to the stream: the test runner hides what a passing test prints.
    let _ = writeln!(std::io::stderr(), "SKIPPED: {test}: {reason}");
}

/// A shader with a text changed, which it must have: a test whose planted error changes nothing proves nothing.
pub fn replaced(wgsl: &str, before: &str, after: &str) -> String {
    assert!(wgsl.contains(before), "the shader has no `{before}`");
    wgsl.replace(before, after)
}

/// A tracer with a text of its shader changed.
pub fn edited<'a>(ir: &'a SceneIr, options: &impl Asked, before: &str, after: &str) -> Tracer<'a> {
    options.tracer_with(gpu(), ir, |wgsl| replaced(&wgsl, before, after)).unwrap()
}

/// The names of all scenes.
pub fn scenes() -> Vec<String> {
    json_files("scenes")
}

/// A scene of the collection, as the tracer sees it.
pub fn load(name: &str) -> SceneIr {
    let path = repository(&format!("scenes/{name}.json"));
    Scene::from_path(&path)
        .and_then(|scene| scene.lower())
        .unwrap_or_else(|problem| panic!("{name}: {problem}"))
}

/// Options of a trace with so many rays.
pub fn options(num_rays: u64, seed: u64, precision: Precision) -> TraceOptions {
    TraceOptions { num_rays, seed, precision, ..TraceOptions::default() }
}

/// The same with work cut for this test's device, as commands cut it. Where a ray may have more events than a dispatch
/// follows, a second shader follows the rays that live on. Lavapipe follows four times as many in one dispatch.
pub fn tuned(options: TraceOptions) -> TraceOptions {
    options.tuned(&gpu().info)
}

/// A tracer as commands make it, on the device of this test.
pub fn tracer<'a>(ir: &'a SceneIr, options: &TraceOptions) -> Result<Tracer<'a>> {
    Tracer::with(gpu(), ir, options, ForAdapter::WhatPays, shaders_of(gpu()))
}

/// Traces all rays on a device.
pub fn trace_on(gpu: &Gpu, ir: &SceneIr, options: &impl Asked) -> Tally {
    let mut tracer = options.tracer(gpu, ir).unwrap();
    let tally = tracer.trace(|_| true).unwrap();
    assert_eq!(tally.launched.count, options.trace_options().num_rays, "every ray is launched");
    tally
}

/// Traces all rays on the device of this test.
pub fn trace(ir: &SceneIr, options: &impl Asked) -> Tally {
    trace_on(gpu(), ir, options)
}

/// The same options, guided by what a pilot for so many rays learns.
pub fn guided(ir: &SceneIr, options: &TraceOptions, num_rays: u64, wanted: &Wanted) -> TraceOptions {
    let pilot = |guide: &Guide, num_rays, round| {
        let options = TraceOptions {
            num_rays,
            seed: options.seed + 1000 * (round as u64 + 1),
            guide: Some(Arc::new(guide.clone())),
            collect: Collect::paths(),
            ..options.clone()
        };
        tracer(ir, &options)?.trace(|_| true)
    };
    let learned = learn(ir, wanted, num_rays, pilot).unwrap();
    TraceOptions { guide: Some(Arc::new(learned.guide)), ..options.clone() }
}

/// Flux in units of a new ray's weight, and its error, of a sum over rays.
pub fn sum_and_error(sum: &PathSum, num_rays: u64) -> [f64; 2] {
    let [sum, squares] = [sum.quanta, sum.squares].map(|quanta| quanta as f64 / QUANTA_PER_WEIGHT);
    [sum, (squares - sum * sum / num_rays as f64).max(0.0).sqrt()]
}

/// The tally of each of these seeds, with no shader to compile for each.
pub fn tallies_of(tracer: &mut Tracer, seeds: std::ops::Range<u64>) -> impl Iterator<Item = Tally> {
    seeds.map(|seed| {
        tracer.set_seed(seed);
        tracer.trace(|_| true).unwrap()
    })
}

/// What users read of a tally.
pub fn result_of(ir: &SceneIr, options: &TraceOptions, tally: &Tally) -> TraceResult {
    let run = RunInfo {
        num_rays: options.num_rays,
        seed: options.seed,
        max_depth: options.max_depth,
        sampler: options.sampler.name().into(),
        ..RunInfo::default()
    };
    TraceResult::new(ir, &run, tally).unwrap()
}

/// Traces and reads out.
pub fn result(ir: &SceneIr, options: &TraceOptions) -> TraceResult {
    result_of(ir, options, &trace(ir, options))
}

/// Makes every refractive face scatter so much of its light.
pub fn roughen(ir: &mut SceneIr, fraction: f64) {
    let bsdf = Bsdf::HarveyShack(HarveyShack { b0: 0.1, l0: 0.01, s: 1.5, transmissive_fraction: 1.0 });
    let refractive = ir.surfaces.iter_mut().filter(|surface| surface.interaction == Interaction::Refractive);
    refractive.for_each(|surface| surface.scatter = Some(Scatter { fraction, bsdf: bsdf.clone() }));
}

/// Coats every refractive face that has no coating: it reflects this share of the light, and absorbs nothing.
pub fn coat(ir: &mut SceneIr, reflectance: f64) {
    let num_wavelengths = ir.wavelengths.len();
    let bare = ir.surfaces.iter_mut().filter(|surface| surface.coating.is_none());
    for surface in bare.filter(|surface| surface.interaction == Interaction::Refractive) {
        surface.coating = Some(Coating::Simple(SimpleCoating {
            reflectance: vec![reflectance; num_wavelengths],
            transmittance: vec![1.0 - reflectance; num_wavelengths],
        }));
    }
}
