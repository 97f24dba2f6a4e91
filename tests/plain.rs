//! The plain loop, and the CPU backend, give the same bits: those of tests/data/bits.json, for every scene, whether
//! this is compiled with the cargo feature `cpu` (`cargo test`) or without it (`make test-plain`).
//!
//! The committed bits are those of lavapipe in strict arithmetic. `NSQ_GPU_UPDATE_BITS=1` writes them anew.
#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "clippy's exemption of tests does not reach their helpers"
)]

#[path = "zoo/bits.rs"]
mod bits;
#[path = "zoo/files.rs"]
mod files;

use std::collections::BTreeMap;

use bits::{bits_file, committed, hash, options, precision};
use files::{json_files, repository};
use nsq_gpu::gpu::{AdapterChoice, Gpu};
use nsq_gpu::program::Precision;
use nsq_gpu::result::Tally;
use nsq_gpu::{Scene, Tracer};

fn trace(gpu: &Gpu, name: &str, precision: Precision) -> Tally {
    let model =
        Scene::from_path(&repository("scenes").join(name).with_extension("json")).unwrap().lower().unwrap();
    Tracer::new(gpu, &model, &options(precision)).unwrap().trace(|_| true).unwrap()
}

#[test]
fn every_scene_gives_the_committed_bits() {
    let gpu = Gpu::open(&AdapterChoice::default()).unwrap();
    let found: BTreeMap<String, String> = json_files("scenes")
        .into_iter()
        .enumerate()
        .map(|(i, name)| {
            let bits = hash(&trace(&gpu, &name, precision(i)));
            (name, bits)
        })
        .collect();
    if std::env::var_os("NSQ_GPU_UPDATE_BITS").is_some() {
        std::fs::write(bits_file(), serde_json::to_string_pretty(&found).unwrap() + "\n").unwrap();
    }
    let committed = committed();
    let differ: Vec<&String> = found.keys().filter(|name| committed.get(*name) != found.get(*name)).collect();
    assert_eq!(
        differ,
        Vec::<&String>::new(),
        "with{} the CPU backend",
        if cfg!(feature = "cpu") { "" } else { "out" }
    );
    assert_eq!(committed.len(), found.len());
}

#[test]
fn one_ray_more_gives_other_bits() {
    let gpu = Gpu::open(&AdapterChoice::default()).unwrap();
    let tally = trace(&gpu, "bench_lens", Precision::F32);
    let mut other = tally.clone();
    other.detectors[0].quanta[0] += 1;
    assert_ne!(hash(&other), hash(&tally));
}
