//! The plain loop, and the wing for processors, give the same bits: those of tests/data/bits.json, for every scene, whether
//! this is compiled with the cargo feature `software` (`cargo test`) or without it (`make test-plain`).
//!
//! The committed bits are those of lavapipe in strict arithmetic. `NSQ_GPU_UPDATE_BITS=1` writes them anew.
#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "clippy's exemption of tests does not reach their helpers"
)]

#[path = "zoo/files.rs"]
mod files;

use std::collections::BTreeMap;
use std::path::PathBuf;

use files::{json_files, repository};
use nsq_gpu::gpu::{AdapterChoice, Gpu};
use nsq_gpu::program::Precision;
use nsq_gpu::result::Tally;
use nsq_gpu::trace::Strict;
use nsq_gpu::{Scene, TraceOptions, Tracer};
use sha2::{Digest, Sha256};

const NUM_RAYS: u64 = 3000;

fn bits_file() -> PathBuf {
    repository("tests/data/bits.json")
}

/// All that a trace has summed up.
fn hash(tally: &Tally) -> String {
    let bytes = postcard::to_allocvec(tally).unwrap();
    Sha256::digest(&bytes).iter().map(|byte| format!("{byte:02x}")).collect()
}

fn trace(gpu: &Gpu, name: &str, precision: Precision) -> Tally {
    let model =
        Scene::from_path(&repository("scenes").join(name).with_extension("json")).unwrap().lower().unwrap();
    let options = TraceOptions {
        num_rays: NUM_RAYS,
        seed: 11,
        precision,
        strict: Strict::On,
        ..TraceOptions::default()
    };
    Tracer::new(gpu, &model, &options).unwrap().trace(|_| true).unwrap()
}

#[test]
fn every_scene_gives_the_committed_bits() {
    let gpu = Gpu::open(&AdapterChoice::default()).unwrap();
    // f32 and f64 by turns.
    let turn = |i: usize| if i.is_multiple_of(2) { Precision::F32 } else { Precision::F64 };
    let found: BTreeMap<String, String> = json_files("scenes")
        .into_iter()
        .enumerate()
        .map(|(i, name)| {
            let bits = hash(&trace(&gpu, &name, turn(i)));
            (name, bits)
        })
        .collect();
    if std::env::var_os("NSQ_GPU_UPDATE_BITS").is_some() {
        std::fs::write(bits_file(), serde_json::to_string_pretty(&found).unwrap() + "\n").unwrap();
    }
    let text = std::fs::read_to_string(bits_file()).unwrap();
    let committed: BTreeMap<String, String> = serde_json::from_str(&text).unwrap();
    let differ: Vec<&String> = found.keys().filter(|name| committed.get(*name) != found.get(*name)).collect();
    assert_eq!(
        differ,
        Vec::<&String>::new(),
        "with{} the wing",
        if cfg!(feature = "software") { "" } else { "out" }
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
